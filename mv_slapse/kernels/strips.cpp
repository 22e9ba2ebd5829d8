// Vectors that two pictures tell, of macroblocks and, on the way ahead, of strips of these:
// Gauss-Newton steps on what the brightness of a patch, less its mean, differs by (Lucas and Kanade,
// "An iterative image registration technique with an application to stereo vision", IJCAI 1981). See
// codec/strips.py and codec/merging.py.

#include "blocks.hpp"
#include "lanes.hpp"
#include "picture.hpp"

namespace kernels {
namespace {

constexpr int WIDTH = MACROBLOCK, HEIGHT = 4;  // px, of a strip
constexpr int STRIPS = MACROBLOCK / HEIGHT;
constexpr int STEPS = 3;        // from a vector that is right to half a pixel
constexpr float NOISE = 3;      // grey levels, by which a picture differs from its match at least
constexpr float SURE = 1 / (NOISE * NOISE);  // information of a grey level
constexpr float SHARE = 15;     // of squared residuals: side by side they are alike, see texture.cpp
constexpr float OUTWARDS = 1;   // px, how far from where the search begins a right vector may lie
constexpr float SHARP = 0.3f;   // px, sigma up to which a strip tells more than its macroblock
constexpr float NEAR = 8;       // px around the expansion point, where no direction is outwards
constexpr py::ssize_t ENOUGH = 300;  // vectors that tell that point
constexpr int ROUNDS = 5;            // of weights, which sharpen fourfold each
constexpr float LEAST = 1;           // px, of a vector that has a direction
constexpr float ERROR = 0.5f;        // px, of a vector across its direction
constexpr float BESIDE = 4;          // px, by which vectors of what stands still pass the point
constexpr float ROUND = 0.01f;       // smallest ratio of eigenvalues at which they meet in a point
constexpr float TELLING = 0.6f;      // px, sigma up to which a place in an earlier picture tells much
constexpr float STRAIGHT = 1e-4f;    // share of a texture's gradients that only rounding leaves
constexpr float TOGETHER = 0.5f;     // px, by which strips in it err alike, and across their way
constexpr float GROWN_MOST = 0.6f, SHRUNK_MOST = 1.3f;  // size of what was seen, as a share of now's

// The point (2,) [px] that most vectors lead away from, or to: robust least squares on how far each
// passes by it. None where they do not meet within the picture, as while the camera turns.
py::object expansion(const py::object& places, const py::object& matches,
                     const py::object& probabilities, int width, int height) {
  const char* name = "expansion";
  const In<float> x_cur(name, "x_cur", places, {ANY, 2}, Check::finite);
  const In<float> x_prev(name, "x_prev", matches, {x_cur.size(), 2}, Check::finite);
  const In<float> probability(name, "probability", probabilities, {x_cur.size()}, Check::finite);
  const float least = least_supported(probability);
  const py::ssize_t every = std::max<py::ssize_t>(x_cur.size() / ENOUGH, 1);
  Vec2 point{0.5f * static_cast<float>(width - 1), 0.5f * static_cast<float>(height - 1)};
  float scale = static_cast<float>(width);
  for (int round = 0; round < ROUNDS; ++round) {
    double xx = 0, xy = 0, yy = 0, bx = 0, by = 0;
    for (py::ssize_t i = 0; i < x_cur.size(); i += every) {
      const Vec2 x = at(x_cur, i), vector = at(x_prev, i) - x, off = x - point;
      const float far = length(vector);
      if (probability[i] < least || far < LEAST) continue;
      const Vec2 across{-vector.y / far, vector.x / far};
      const float passes = across.x * off.x + across.y * off.y;
      const float sigma = std::max(ERROR * length(off) / far, BESIDE);
      const float ratio = passes / (scale + sigma), kernel = 1 + ratio * ratio;
      const double weight = 1 / (kernel * kernel * sigma * sigma);
      xx += weight * across.x * across.x;
      xy += weight * across.x * across.y;
      yy += weight * across.y * across.y;
      bx += weight * across.x * passes;
      by += weight * across.y * passes;
    }
    const double determinant = xx * yy - xy * xy;
    if (!(determinant > ROUND * (xx + yy) * (xx + yy))) return py::none();
    point = point + Vec2{static_cast<float>((yy * bx - xy * by) / determinant),
                         static_cast<float>((xx * by - xy * bx) / determinant)};
    scale = std::max(scale / 4, BESIDE);
  }
  if (!(point.x >= 0 && point.x < width && point.y >= 0 && point.y < height)) return py::none();
  Out<double> out({2});
  out[0] = point.x;
  out[1] = point.y;
  return out.array();
}

// Values of a strip or macroblock, a row after another; sums go down the columns first, so that they
// are the same in registers of any width.
template <int HEIGHT>
struct Patch {
  static constexpr int PIXELS = WIDTH * HEIGHT;
  float value[PIXELS];
};

KERNELS_INLINE float sum(const float (&column)[WIDTH]) {
  float part[WIDTH / 4];
  for (int i = 0; i < WIDTH / 4; ++i)
    part[i] = (column[i] + column[i + 4]) + (column[i + 8] + column[i + 12]);
  return (part[0] + part[1]) + (part[2] + part[3]);
}

template <int HEIGHT>
KERNELS_INLINE float product(const Patch<HEIGHT>& a, const Patch<HEIGHT>& b) {
  float column[WIDTH]{};
  for (int j = 0; j < HEIGHT; ++j)
    for (int i = 0; i < WIDTH; ++i)
      column[i] += a.value[j * WIDTH + i] * b.value[j * WIDTH + i];
  return sum(column);
}

template <int HEIGHT>
KERNELS_INLINE void take_mean_off(Patch<HEIGHT>& patch) {
  float column[WIDTH]{};
  for (int j = 0; j < HEIGHT; ++j)
    for (int i = 0; i < WIDTH; ++i) column[i] += patch.value[j * WIDTH + i];
  const float mean = sum(column) / patch.PIXELS;
  for (float& value : patch.value) value -= mean;
}

// What a patch differs by, less the mean, from that of a picture whose first pixel lies at x, between
// pixels; false outside.
template <int HEIGHT>
KERNELS_INLINE bool compare(const Picture& picture, Vec2 x, const Patch<HEIGHT>& patch,
                            Patch<HEIGHT>& out) {
  const int left = floor_of(x.x), top = floor_of(x.y);
  if (left < 0 || top < 0 || left + WIDTH >= picture.width || top + HEIGHT >= picture.height)
    return false;
  const float a = x.x - static_cast<float>(left), b = x.y - static_cast<float>(top);
  float level[HEIGHT + 1][WIDTH];  // of rows, between the columns
  for (int j = 0; j <= HEIGHT; ++j) {
    const std::uint8_t* row = picture.row(top + j) + left;
#pragma GCC unroll 1  // else the compiler takes one pixel at a time
    for (int i = 0; i < WIDTH; ++i)
      level[j][i] = static_cast<float>(row[i]) + a * static_cast<float>(row[i + 1] - row[i]);
  }
  for (int j = 0; j < HEIGHT; ++j)
    for (int i = 0; i < WIDTH; ++i)
      out.value[j * WIDTH + i] =
          patch.value[j * WIDTH + i] - (level[j][i] + b * (level[j + 1][i] - level[j][i]));
  take_mean_off(out);
  return true;
}

struct Symmetric {  // of two rows and columns
  float xx, xy, yy;
};
KERNELS_INLINE Symmetric operator+(Symmetric a, Symmetric b) {
  return {a.xx + b.xx, a.xy + b.xy, a.yy + b.yy};
}
KERNELS_INLINE Symmetric operator*(float s, Symmetric a) { return {s * a.xx, s * a.xy, s * a.yy}; }
KERNELS_INLINE Vec2 operator*(Symmetric a, Vec2 x) {
  return {a.xx * x.x + a.xy * x.y, a.xy * x.x + a.yy * x.y};
}
KERNELS_INLINE Vec2 solve(Symmetric a, Vec2 b) {
  const float determinant = a.xx * a.yy - a.xy * a.xy;
  return {(a.yy * b.x - a.xy * b.y) / determinant, (a.xx * b.y - a.xy * b.x) / determinant};
}

// Largest variance [px^2] in any direction of what has this information.
KERNELS_INLINE float variance(Symmetric a) {
  const float half = 0.5f * (a.xx - a.yy);
  return 1 / (0.5f * (a.xx + a.yy) - std::sqrt(half * half + a.xy * a.xy));
}

// Information of where the search begins: along the way out from the expansion point a vector is not
// known so well as across it, where what stands still and what drives ahead have none.
Symmetric beforehand(Vec2 off, float across) {
  const float away = length(off), out = 1 / (OUTWARDS * OUTWARDS), side = 1 / (across * across);
  if (away < NEAR) return {out, 0, out};
  const Vec2 n = (1 / away) * off;
  return {out * n.x * n.x + side * n.y * n.y, (out - side) * n.x * n.y,
          out * n.y * n.y + side * n.x * n.x};
}

// Whether a macroblock at `off` from the expansion point is looked at.
bool lies_ahead(Vec2 off, float reach) {
  return std::abs(off.x) < reach && off.y > -MACROBLOCK && off.y < reach;
}

struct Strip {
  Vec2 x, vector;
  float variance;
};

// Two more values of a column of places.
void append(std::vector<float>& column, Vec2 x) {
  column.push_back(x.x);
  column.push_back(x.y);
}

template <int HEIGHT>
struct Shown {  // what a patch shows, and its gradients less their means
  Patch<HEIGHT> value, by_x, by_y;
  Symmetric texture;
};

// Of the patch whose first pixel lies at (left, top); false where the picture ends there.
template <int HEIGHT>
KERNELS_INLINE bool look(const Picture& picture, int left, int top, Shown<HEIGHT>& out) {
  if (left < 1 || top < 1 || left + WIDTH >= picture.width || top + HEIGHT >= picture.height)
    return false;
  for (int j = 0; j < HEIGHT; ++j) {
    const std::uint8_t *row = picture.row(top + j) + left, *above = picture.row(top + j - 1) + left,
                       *below = picture.row(top + j + 1) + left;
    for (int i = 0; i < WIDTH; ++i) {
      out.value.value[j * WIDTH + i] = row[i];
      out.by_x.value[j * WIDTH + i] = 0.5f * static_cast<float>(row[i + 1] - row[i - 1]);
      out.by_y.value[j * WIDTH + i] = 0.5f * static_cast<float>(below[i] - above[i]);
    }
  }
  take_mean_off(out.by_x);
  take_mean_off(out.by_y);
  out.texture = {product(out.by_x, out.by_x), product(out.by_x, out.by_y),
                 product(out.by_y, out.by_y)};
  return true;
}

// A vector one step further towards what a patch shows, and away from where it began as it is
// known; `apart` is what the patch differs by.
template <int HEIGHT>
KERNELS_INLINE Vec2 step(const Shown<HEIGHT>& patch, const Symmetric& known, Vec2 start,
                         const Patch<HEIGHT>& apart, Vec2 vector) {
  const Vec2 slope{product(patch.by_x, apart), product(patch.by_y, apart)};
  return vector + solve(SURE * patch.texture + known, SURE * slope - known * (vector - start));
}

// The vector of the strip whose first pixel lies at (left, top), from the best of some; false where
// it is not sharp or leaves one of the pictures.
KERNELS_WIDE bool find(const Picture& now, const Picture& then, int left, int top,
                       const Symmetric& known, const std::vector<Vec2>& starts, Strip& out) {
  Shown<HEIGHT> strip;
  Patch<HEIGHT> apart, other;
  if (!look(now, left, top, strip)) return false;
  if (variance(SURE * strip.texture + known) >= SHARP * SHARP) return false;  // whatever is there
  const Vec2 corner{static_cast<float>(left), static_cast<float>(top)};
  Vec2 start{};
  float best = INFINITY;
  for (const Vec2& each : starts) {
    if (!compare(then, corner + each, strip.value, other)) continue;
    const float misfit = product(other, other);
    if (misfit < best) {
      best = misfit;
      start = each;
      apart = other;
    }
  }
  if (!std::isfinite(best)) return false;
  Vec2 vector = start;
  for (int k = 0; k < STEPS; ++k) {
    vector = step(strip, known, start, apart, vector);
    if (!compare(then, corner + vector, strip.value, apart)) return false;
  }
  const float noise = NOISE * NOISE + SHARE * product(apart, apart) / apart.PIXELS;
  const Vec2 middle{0.5f * (WIDTH - 1), 0.5f * (HEIGHT - 1)};
  out = {corner + middle, vector, variance(1 / noise * strip.texture + known)};
  return out.variance < SHARP * SHARP;
}

// The same of a strip that was `size` times as large when it lay around x.
KERNELS_INLINE bool compare(const Picture& picture, Vec2 x, float size, const Patch<HEIGHT>& patch,
                            Patch<HEIGHT>& out) {
  int left[WIDTH];
  float right[WIDTH];
  const float first = x.x - 0.5f * (WIDTH - 1) * size, upper = x.y - 0.5f * (HEIGHT - 1) * size;
  for (int i = 0; i < WIDTH; ++i) {
    const float at = first + size * static_cast<float>(i);
    left[i] = floor_of(at);
    right[i] = at - static_cast<float>(left[i]);
  }
  const int last = floor_of(upper + size * (HEIGHT - 1));
  if (left[0] < 0 || floor_of(upper) < 0 || left[WIDTH - 1] + 1 >= picture.width ||
      last + 1 >= picture.height)
    return false;
  constexpr int SPAN = static_cast<int>(SHRUNK_MOST * WIDTH) + 3;  // columns that a row reaches over
  const int span = std::min(left[WIDTH - 1] + 2 - left[0], SPAN);
  for (int j = 0; j < HEIGHT; ++j) {
    const float at = upper + size * static_cast<float>(j);
    const int top = floor_of(at);
    const float below = at - static_cast<float>(top);
    const std::uint8_t *row = picture.row(top) + left[0], *next = picture.row(top + 1) + left[0];
    float level[SPAN];  // between the rows
    for (int i = 0; i < span; ++i)
      level[i] = static_cast<float>(row[i]) + below * static_cast<float>(next[i] - row[i]);
    for (int i = 0; i < WIDTH; ++i) {
      const float* here = level + (left[i] - left[0]);
      out.value[j * WIDTH + i] =
          patch.value[j * WIDTH + i] - (here[0] + right[i] * (here[1] - here[0]));
    }
  }
  take_mean_off(out);
  return true;
}

// How large something at `off` from the expansion point was, by the vector to where it was.
float earlier_size(Vec2 off, Vec2 vector) {
  constexpr float least = 12;  // px, nearer to that point vectors do not tell
  const float along = off.x * vector.x + off.y * vector.y;
  return std::clamp(1 + along / std::max(square(off), least * least), GROWN_MOST, SHRUNK_MOST);
}

// Where the strip whose first pixel lies at (left, top) was in an earlier picture, by a place
// `start_of` it that may be off by a pixel or two; false where that tells little, or lies outside.
template <typename Start>
KERNELS_WIDE bool find_earlier(const Picture& now, const Picture& then, int left, int top,
                               Vec2 point, Start start_of, Strip& out) {
  const Vec2 x = Vec2{static_cast<float>(left), static_cast<float>(top)} +
                 Vec2{0.5f * (WIDTH - 1), 0.5f * (HEIGHT - 1)};
  const Vec2 off = x - point;
  const float away = length(off);
  Shown<HEIGHT> strip;
  Patch<HEIGHT> apart;
  if (away < NEAR || !look(now, left, top, strip)) return false;
  // Of the way out, where the pixels alone are asked.
  const Vec2 n = (1 / away) * off;
  const auto variance_out = [&](float noise) {
    const Symmetric& a = strip.texture;
    if (!(a.xx * a.yy - a.xy * a.xy > STRAIGHT * a.xx * a.yy)) return INFINITY;
    const Vec2 across = solve(a, n);
    return noise * (n.x * across.x + n.y * across.y);
  };
  // Whatever its size was it tells little.
  constexpr float most = TELLING * TELLING;
  if (!(GROWN_MOST * GROWN_MOST * variance_out(1 / SURE) < most)) return false;
  const Vec2 start = start_of(x);
  const float size = earlier_size(off, start - x);
  for (int i = 0; i < WIDTH * HEIGHT; ++i) {
    strip.by_x.value[i] /= size;
    strip.by_y.value[i] /= size;
  }
  strip.texture = 1 / (size * size) * strip.texture;
  if (!(variance_out(1 / SURE) < most)) return false;
  const Symmetric known = beforehand(off, TOGETHER);
  if (!compare(then, start, size, strip.value, apart)) return false;
  Vec2 place = start;
  for (int k = 0; k <= STEPS; ++k) {
    place = step(strip, known, start, apart, place);
    if (!compare(then, place, size, strip.value, apart)) return false;
  }
  const float noise = NOISE * NOISE + SHARE * product(apart, apart) / apart.PIXELS;
  out = {x, place, variance_out(noise)};
  return out.variance < most;
}

// The vector that two pictures tell of the macroblock around x, from one that may be off by a pixel;
// that one where a picture ends.
KERNELS_WIDE Vec2 refined(const Picture& now, const Picture& then, Vec2 x, Vec2 start) {
  constexpr Symmetric known{1 / (OUTWARDS * OUTWARDS), 0, 1 / (OUTWARDS * OUTWARDS)};
  const int left = floor_of(x.x) - WIDTH / 2 + 1, top = floor_of(x.y) - MACROBLOCK / 2 + 1;
  const Vec2 corner{static_cast<float>(left), static_cast<float>(top)};
  Shown<MACROBLOCK> shown;
  Patch<MACROBLOCK> apart;
  if (!look(now, left, top, shown)) return start;
  Vec2 vector = start;
  for (int k = 0; k < STEPS; ++k) {
    if (!compare(then, corner + vector, shown.value, apart)) return start;
    vector = step(shown, known, start, apart, vector);
  }
  return vector;
}

// Matches (N, 2) float32 [px] of macroblocks around x_cur, as the two pictures tell, near those given.
py::object refine(const py::object& picture, const py::object& before, const py::object& places,
                  const py::object& matches) {
  const char* name = "refine";
  const auto now = Picture::of(name, "now", picture), then = Picture::of(name, "before", before);
  require(now && then, name, "both pictures must be there");
  const In<float> x_cur(name, "x_cur", places, {ANY, 2}, Check::finite);
  const In<float> x_prev(name, "x_prev", matches, {x_cur.size(), 2}, Check::finite);
  Out<float> out({x_cur.size(), 2});
  for (py::ssize_t i = 0; i < x_cur.size(); ++i) {
    const Vec2 x = at(x_cur, i), there = x + refined(*now, *then, x, at(x_prev, i) - x);
    out[2 * i] = there.x;
    out[2 * i + 1] = there.y;
  }
  return out.array();
}

struct Columns {  // of a pair, as they grow
  std::vector<float> x_cur, x_prev, sigma, probability;
  std::vector<std::uint8_t> block;

  explicit Columns(py::ssize_t usual) {
    for (auto* column : {&x_cur, &x_prev, &sigma, &probability}) column->reserve(2 * usual);
    block.reserve(2 * usual);
  }
  void add(Vec2 x, Vec2 match, float sigma_, float probability_, int width, int height) {
    append(x_cur, x);
    append(x_prev, match);
    sigma.push_back(sigma_);
    probability.push_back(probability_);
    for (const int side : {width, height}) block.push_back(static_cast<std::uint8_t>(side));
  }
};

// Columns of a pair whose supported macroblocks up to `reach` [px] beside and below a point are cut
// into strips, where half of them are sharp; the others go. Four strips tell no more than a
// macroblock with a vector of that sigma [px]: what they err by in common is not less.
py::tuple strips(const py::object& picture, const py::object& before, const py::tuple& pair,
                 const py::object& place, float reach, float vector_sigma) {
  const char* name = "strips";
  const auto now = Picture::of(name, "now", picture), then = Picture::of(name, "before", before);
  require(now && then, name, "both pictures must be there");
  require(pair.size() == 5, name, "a pair has five columns");
  const In<float> x_cur(name, "x_cur", pair[0], {ANY, 2}, Check::finite);
  const auto n = x_cur.size();
  const In<float> x_prev(name, "x_prev", pair[1], {n, 2}, Check::finite),
      sigma(name, "sigma", pair[2], {n}, Check::finite),
      probability(name, "probability", pair[3], {n}, Check::finite);
  const In<std::uint8_t> block(name, "block", pair[4], {n, 2});
  const In<double> to(name, "point", place, {2}, Check::finite);
  const Vec2 point{static_cast<float>(to[0]), static_cast<float>(to[1])};
  const int columns = macroblocks(now->width), rows = macroblocks(now->height);
  const auto field = field_of(name, py::make_tuple(pair[0], pair[1], pair[3]), columns, rows);
  const float least = least_supported(probability);
  const float floor = STRIPS * vector_sigma * vector_sigma;
  Columns out(n + n / 2);
  std::vector<Vec2> starts;
  for (py::ssize_t i = 0; i < n; ++i) {
    const Vec2 x = at(x_cur, i), off = x - point;
    Strip found[STRIPS];
    int sharp = 0;
    if (!(probability[i] < least) && lies_ahead(off, reach)) {
      const int macroblock = nearest_macroblock(x, columns, rows);
      starts.assign(1, at(x_prev, i) - x);
      for (const int other : {macroblock - columns, macroblock + columns})
        if (other >= 0 && other < columns * rows && std::isfinite(field[other].x) &&
            !is_zero(field[other] - starts[0]))
          starts.push_back(field[other]);
      const Symmetric known = beforehand(off, vector_sigma);
      for (int k = 0; k < STRIPS; ++k)
        if (find(*now, *then, MACROBLOCK * (macroblock % columns),
                 MACROBLOCK * (macroblock / columns) + HEIGHT * k, known, starts, found[sharp]))
          ++sharp;
    }
    if (2 * sharp < STRIPS)
      out.add(x, at(x_prev, i), sigma[i], probability[i], block(i, 0), block(i, 1));
    else
      for (int k = 0; k < sharp; ++k)
        out.add(found[k].x, found[k].x + found[k].vector, std::sqrt(found[k].variance + floor),
                probability[i], WIDTH, HEIGHT);
  }
  return py::make_tuple(array_of(out.x_cur, 2), array_of(out.x_prev, 2), array_of(out.sigma),
                        array_of(out.probability), array_of(out.block, 2));
}

// Vectors of a pair near the expansion point, by the macroblock of the picture that each lies in.
class Link {
 public:
  Link(In<float> x_cur, In<float> x_prev, int columns, int rows)
      : x_cur_(std::move(x_cur)), x_prev_(std::move(x_prev)), columns_(columns), rows_(rows),
        cells_(columns * rows) {
    for (py::ssize_t i = 0; i < x_cur_.size(); ++i)
      cells_[nearest_macroblock(at(x_cur_, i), columns, rows)].push_back(i);
  }

  // Where something at x was in the earlier key frame, by the nearest vector; rows differ more.
  Vec2 before(Vec2 x, Vec2 point) const {
    Nearest nearest;
    const int column = nearest_of(x.x, columns_), row = nearest_of(x.y, rows_);
    for (int r = std::max(row - 1, 0); r < std::min(row + 2, rows_); ++r)
      for (int c = std::max(column - 1, 0); c < std::min(column + 2, columns_); ++c)
        for (const auto i : cells_[r * columns_ + c]) compare(i, x, nearest);
    if (nearest.distance > 1)  // of a cell farther off there may be a nearer one
      for (py::ssize_t i = 0; i < x_cur_.size(); ++i) compare(i, x, nearest);
    const Vec2 from = at(x_cur_, nearest.i), to = at(x_prev_, nearest.i);
    return to + earlier_size(from - point, to - from) * (x - from);
  }

 private:
  struct Nearest {
    py::ssize_t i = 0;
    float distance = INFINITY;
  };

  void compare(py::ssize_t i, Vec2 x, Nearest& nearest) const {
    const Vec2 apart = at(x_cur_, i) - x;
    const float distance = square(Vec2{apart.x / MACROBLOCK, apart.y / 6});
    if (distance < nearest.distance || (distance == nearest.distance && i < nearest.i))
      nearest = {i, distance};
  }

  In<float> x_cur_, x_prev_;
  int columns_, rows_;
  std::vector<std::vector<py::ssize_t>> cells_;
};

// Strips up to `reach` [px] beside and below a point, and where they were in an earlier picture, as
// far as its pixels tell: centres (M, 2), places (M, 2), and sigma [px] of these along their way.
// The links (x_cur, x_prev) of key frame pairs lead there, the newest first.
py::tuple earlier(const py::object& picture, const py::object& before, const py::tuple& way,
                  const py::object& place, float reach) {
  const char* name = "earlier";
  const auto now = Picture::of(name, "now", picture), then = Picture::of(name, "before", before);
  require(now && then, name, "both pictures must be there");
  const In<double> to(name, "point", place, {2}, Check::finite);
  const Vec2 point{static_cast<float>(to[0]), static_cast<float>(to[1])};
  const int columns = macroblocks(now->width), rows = macroblocks(now->height);
  std::vector<Link> links;
  for (py::ssize_t i = 0; i < way.size(); ++i) {
    const auto link = way[i].cast<py::tuple>();
    require(link.size() == 2, name, "a link has two columns");
    In<float> x_cur(name, "x_cur", link[0], {ANY, 2}, Check::finite);
    In<float> x_prev(name, "x_prev", link[1], {x_cur.size(), 2}, Check::finite);
    require(x_cur.size() > 0, name, "a link has vectors");
    links.emplace_back(std::move(x_cur), std::move(x_prev), columns, rows);
  }
  std::vector<float> x_cur, x_earlier, sigma;
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column) {
      const int left = MACROBLOCK * column, top = MACROBLOCK * row;
      const Vec2 off = Vec2{left + 0.5f * (MACROBLOCK - 1), top + 0.5f * (MACROBLOCK - 1)} - point;
      if (!lies_ahead(off, reach)) continue;
      for (int k = 0; k < STRIPS; ++k) {
        const auto start_of = [&](Vec2 x) {
          for (const Link& link : links) x = link.before(x, point);
          return x;
        };
        Strip found;
        if (!find_earlier(*now, *then, left, top + HEIGHT * k, point, start_of, found)) continue;
        append(x_cur, found.x);
        append(x_earlier, found.vector);
        sigma.push_back(std::sqrt(found.variance + TOGETHER * TOGETHER));
      }
    }
  return py::make_tuple(array_of(x_cur, 2), array_of(x_earlier, 2), array_of(sigma));
}

}  // namespace
}  // namespace kernels

void bind_strips(kernels::py::module_& module) {
  module.def("earlier", kernels::earlier);
  module.def("expansion", kernels::expansion);
  module.def("refine", kernels::refine);
  module.def("strips", kernels::strips);
}
