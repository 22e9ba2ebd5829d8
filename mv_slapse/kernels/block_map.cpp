// The block map: depths of what stands still, carried from camera to camera; a pair's motion against
// them; see surfaces/block_map.py.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include "two_view_arguments.hpp"

namespace kernels {
namespace {

constexpr double INFINITE = std::numeric_limits<double>::infinity();
constexpr double MACROBLOCK = 16;  // px
constexpr double AHEAD = 0.05;     // z of a unit ray, beyond which a point may lie in the picture

struct Point {  // of the map, in the camera of a key frame
  Vec3 ray;     // unit
  double rho;   // inverse distance [1/map unit]
  double variance;
};
static_assert(sizeof(Point) == 5 * sizeof(double));  // as rows of an array are

struct Known {  // what the map tells of a block: inverse depth in camera k-1
  double rho, variance;
  double smooth;  // the same of what lies around, which does not err with the block
  bool any() const { return variance < INFINITE; }
};

std::vector<Point> points_of(const char* kernel, const py::object& object) {
  const In<double> rows(kernel, "points", object, {ANY, 5}, Check::finite);
  std::vector<Point> out(rows.size());
  if (!out.empty()) std::memcpy(out.data(), rows.data(), out.size() * sizeof(Point));
  return out;
}

// The newest points, so many at most.
py::array_t<double> array_of(const std::vector<Point>& points, std::size_t most) {
  const std::size_t n = std::min(points.size(), most);
  Out<double> out({static_cast<py::ssize_t>(n), 5});
  if (n) std::memcpy(out.data(), points.data() + (points.size() - n), n * sizeof(Point));
  return out.array();
}

// A picture's macroblocks.
struct Picture {
  Picture(const char* kernel, const py::object& K_, const py::object& size_) {
    const In<double> K(kernel, "K", K_, {3, 3}, Check::finite);
    const In<std::int64_t> size(kernel, "size", size_, {2});
    fx = K(0, 0), fy = K(1, 1), cx = K(0, 2), cy = K(1, 2);
    columns = static_cast<int>((size[0] + 15) / 16), rows = static_cast<int>((size[1] + 15) / 16);
  }
  // Pixel of a ray before the camera.
  std::pair<double, double> pixel(const Vec3& ray) const {
    return {fx * ray[0] / ray[2] + cx, fy * ray[1] / ray[2] + cy};
  }
  static int cell_of(double x) {  // by hand: without SSE4, the library's floor is called
    const double cell = (std::min(std::max(x, -1e6), 1e6) + 0.5) / MACROBLOCK;
    const int towards_zero = static_cast<int>(cell);
    return towards_zero - (towards_zero > cell);
  }
  // Number of the macroblock of a pixel, -1 outside of the picture.
  int cell(double x, double y) const {
    const int column = cell_of(x), row = cell_of(y);
    return column < 0 || row < 0 || column >= columns || row >= rows ? -1 : row * columns + column;
  }
  double fx, fy, cx, cy;
  int columns, rows;
};

// Those of some points that lie ahead and in a picture that is wider by a margin [macroblocks].
struct Shown {
  Shown(const Point* points, std::size_t n, const Picture& picture, int margin)
      : number(n + 1), x(n + 1), y(n + 1) {
    find(points, n, picture, margin, *this);
  }
  std::size_t count = 0;  // longer are the columns
  std::vector<int> number;
  std::vector<double> x, y;  // px

 private:
  static void find(const Point* points, std::size_t n, const Picture& picture, double margin,
                   Shown& out);
};

KERNELS_WIDE
void Shown::find(const Point* points, std::size_t n, const Picture& picture, double margin,
                 Shown& out) {
  const double right = picture.columns + margin, bottom = picture.rows + margin;
  std::size_t count = 0;
  for (std::size_t i = 0; i < n; i += LANES) {
    Four X, Y, Z;
    for (std::size_t j = 0; j < LANES; ++j) {
      const Vec3& ray = points[std::min(i + j, n - 1)].ray;
      X[j] = ray[0], Y[j] = ray[1], Z[j] = ray[2];
    }
    const auto ahead = Z > AHEAD;
    const Four z = ahead ? Z : Four{} + 1.0;
    const Four u = picture.fx * X / z + picture.cx, v = picture.fy * Y / z + picture.cy;
    const Four column = (u + 0.5) / MACROBLOCK, row = (v + 0.5) / MACROBLOCK;
    const auto in = ahead & (column >= -margin) & (column < right) &
                    (row >= -margin) & (row < bottom);
    for (std::size_t j = 0; j < std::min(LANES, n - i); ++j) {  // every other one is shown
      out.number[count] = static_cast<int>(i + j), out.x[count] = u[j], out.y[count] = v[j];
      count -= in[j];
    }
  }
  out.count = count;
}

// The points that a picture shows, by macroblock; some beyond its edges, too.
class View {
 public:
  struct Item {
    double x, y, rho, variance, slack;  // pixel, inverse depth, two standard deviations of it
  };
  struct Near {  // what a search finds, with its scratch memory
    explicit Near(const View& view)
        : square(view.items_.size() + RUN), number(square.size()), found(LANES * square.size()) {}
    int operator[](std::size_t k) const { return static_cast<int>(found[LANES * k + LANES - 1]); }
    std::vector<double> square, number;  // of the distances of points [px^2], and which they are
    std::vector<double> found;           // their numbers, each in the last of some lanes
  };
  View(const Point* points, std::size_t n, const Picture& picture)
      : columns_(picture.columns + 2 * MARGIN), rows_(picture.rows + 2 * MARGIN) {
    const Shown shown(points, n, picture, MARGIN);
    std::vector<int> cell(shown.count);
    start_.resize(columns_ * rows_ + 1);
    for (std::size_t i = 0; i < shown.count; ++i) {
      const int column = Picture::cell_of(shown.x[i]), row = Picture::cell_of(shown.y[i]);
      cell[i] = (row + MARGIN) * columns_ + column + MARGIN;
      ++start_[cell[i] + 1];
    }
    for (std::size_t c = 1; c < start_.size(); ++c) start_[c] += start_[c - 1];
    items_.resize(shown.count + 1);
    items_.back() = {0, 0, 0, 1, -INFINITE};
    x_.resize(shown.count + RUN);
    y_.resize(shown.count + RUN);
    auto next = start_;
    for (std::size_t i = 0; i < shown.count; ++i) {
      const int to = next[cell[i]]++;
      const Point& p = points[shown.number[i]];
      const double z = p.ray[2];
      x_[to] = shown.x[i], y_[to] = shown.y[i];
      items_[to] = {x_[to], y_[to], p.rho / z, p.variance / (z * z), 2 * std::sqrt(p.variance) / z};
    }
  }

  // Finds the points within REACH of a pixel, the CLOSE nearest of them first, in that order, and
  // returns their number; they are followed by LANES that lie nowhere.
  KERNELS_INLINE int near(double x, double y, Near& out) const {
    const int column = Picture::cell_of(x) + MARGIN, row = Picture::cell_of(y) + MARGIN;
    const int left = std::max(column - MARGIN, 0), right = std::min(column + MARGIN, columns_ - 1);
    const int top = std::max(row - MARGIN, 0), bottom = std::min(row + MARGIN, rows_ - 1);
    double* square = out.square.data();
    double* number = out.number.data();
    int some = 0;
    for (int r = top; left <= right && r <= bottom; ++r) {
      const int last = start_[r * columns_ + right + 1];
      int i = start_[r * columns_ + left];
      do {  // mostly once: how often a branch is taken would be guessed wrong
        for (int j = 0; j < RUN; j += LANES) {
          const Four dx = load(&x_[i + j]) - x, dy = load(&y_[i + j]) - y;
          store(dx * dx + dy * dy, square + some + j);
          store(Four{0, 1, 2, 3} + double(i + j), number + some + j);
        }
        some += std::min(RUN, last - i);
        i += RUN;
      } while (i < last);
    }
    int n = 0;
    for (int i = 0; i < some; ++i) {  // half of them are within
      const double own = square[i];
      square[n] = own, number[n] = number[i];
      n += own < REACH * REACH;
    }
    // The nearest so far, in rising order. Before one that is nearer than the last of them, the
    // farther ones move up, and the last of them gets its place.
    double* found = out.found.data();
    Four nearest = Four{} + INFINITE, which = {};
    for (int i = 0; i < n; ++i) {
      const Four own = Four{} + square[i], name = Four{} + number[i];
      const Four before{square[i], nearest[0], nearest[1], nearest[2]};
      const Four there{number[i], which[0], which[1], which[2]};
      const auto moves = own < nearest;
      store(moves ? which : name, found + LANES * i);
      which = moves ? (own < before ? there : name) : which;
      nearest = moves ? (own < before ? before : own) : nearest;
    }
    const auto put = [found](std::size_t k, double what) { found[LANES * k + LANES - 1] = what; };
    for (std::size_t k = 0; k < LANES; ++k) put(k, which[k]);
    for (std::size_t k = 0; k < LANES; ++k) put(n + k, static_cast<double>(items_.size() - 1));
    return n;
  }
  const Item& operator[](int i) const { return items_[i]; }
  static constexpr int CLOSE = LANES;

 private:
  static constexpr int MARGIN = 2;     // macroblocks
  static constexpr double REACH = 32;  // px
  static constexpr int RUN = 8;        // points of a row of macroblocks that are looked at together
  int columns_, rows_;
  std::vector<int> start_;
  std::vector<double> x_, y_;
  std::vector<Item> items_;  // and one that lies nowhere
};

struct Interpolation {
  explicit Interpolation(const py::dict& is)
      : same(policy(is, "same_surface")), spread(policy(is, "spread")),
        roughness(policy(is, "roughness")), slack(policy(is, "slack")) {}
  double same, spread, roughness, slack;
};

// Sums over the points near pixels, of which each has a lane.
struct PlaneSums {
  Four weight{}, variance{}, x{}, y{}, xx{}, xy{}, yy{}, rho{}, rho_x{}, rho_y{};
  Four count{}, around{}, count_around{};  // around: of those beyond the CLOSE nearest
};

// Sums of one pixel, over points on one surface with the nearest.
KERNELS_INLINE void add_sums(const View& view, const View::Near& near, int n, double x, double y,
                             const Interpolation& is, std::size_t lane, PlaneSums& out) {
  const double p0 = view[near[0]].rho, p1 = view[near[1]].rho, p2 = view[near[2]].rho;
  const double reference = std::max(std::min(p0, p1), std::min(std::max(p0, p1), p2));
  const double same = is.same * std::abs(reference), rough = is.roughness * reference;
  const Four zero = {}, one = zero + 1;
  Four weights = zero, variances = zero, sx = zero, sy = zero, sxx = zero, sxy = zero, syy = zero;
  Four sr = zero, srx = zero, sry = zero, count = zero, around = zero, count_around = zero;
  for (int k = 0; k < n; k += LANES) {
    Four px, py, rho, variance, slack;
    for (std::size_t j = 0; j < LANES; ++j) {
      const View::Item& point = view[near[k + j]];
      px[j] = point.x, py[j] = point.y;
      rho[j] = point.rho, variance[j] = point.variance, slack[j] = point.slack;
    }
    const Four off = rho - reference, within = slack + same;
    const Four on = (off < within) & (-off < within) ? one : zero;
    const Four right = px - x, down = py - y, square = right * right + down * down;
    const Four far = square / (is.spread * is.spread) + 1;
    const Four weight = on / (far * far * (variance + (rough * rough + 1e-12)));
    const Four dx = right / MACROBLOCK, dy = down / MACROBLOCK;
    const Four weight_x = weight * dx, weight_y = weight * dy;
    weights += weight, variances += weight * variance;
    sx += weight_x, sy += weight_y;
    sxx += weight_x * dx, sxy += weight_x * dy, syy += weight_y * dy;
    sr += weight * rho, srx += weight_x * rho, sry += weight_y * rho;
    count += on;
    if (k) around += on * rho, count_around += on;
  }
  out.weight[lane] = sum(weights), out.variance[lane] = sum(variances);
  out.x[lane] = sum(sx), out.y[lane] = sum(sy);
  out.xx[lane] = sum(sxx), out.xy[lane] = sum(sxy), out.yy[lane] = sum(syy);
  out.rho[lane] = sum(sr), out.rho_x[lane] = sum(srx), out.rho_y[lane] = sum(sry);
  out.count[lane] = sum(count);
  out.around[lane] = sum(around), out.count_around[lane] = sum(count_around);
}

struct FourKnown {
  Four rho, variance, smooth;
};

// Inverse depths at four pixels, each by the plane through the points around it.
KERNELS_INLINE FourKnown by_planes(const PlaneSums& of, const Interpolation& is) {
  const Four x = of.x / of.weight, y = of.y / of.weight, mean = of.rho / of.weight;
  // 0.05: square of the slope that a few points in a row leave open
  const Four xx = of.xx / of.weight + 0.05, xy = of.xy / of.weight, yy = of.yy / of.weight + 0.05;
  // Cholesky's factor of (1, x, y; x, xx, xy; y, xy, yy), its own first column, and the solution.
  const Four xx_left = xx - x * x, xx_root = root(xx_left), xy_root = (xy - y * x) / xx_root;
  const Four yy_left = yy - y * y - xy_root * xy_root, yy_root = root(yy_left);
  const Four first = (of.rho_x / of.weight - x * mean) / xx_root;
  const Four second = (of.rho_y / of.weight - y * mean - xy_root * first) / yy_root;
  const Four slope_y = second / yy_root, slope_x = (first - xy_root * slope_y) / xx_root;
  const Four rho = mean - x * slope_x - y * slope_y;
  const Four off = rho - mean, most = is.slack * (mean < 0.0 ? -mean : mean), zero = {};
  const auto good = (of.count >= double(View::CLOSE)) & (xx_left > 0.0) & (yy_left > 0.0) &
                    (off < most) & (-off < most);
  const Four smooth = of.count_around >= 2.0 ? of.around / of.count_around : mean;
  const Four variance = of.variance / of.weight;
  return {good ? rho : zero, good ? variance : zero + INFINITE, good ? smooth : zero};
}

// What a view tells of up to four pixels.
KERNELS_WIDE
FourKnown interpolated(const View& view, const double* x, std::size_t pixels, View::Near& near,
                       PlaneSums& sums, const Interpolation& is) {
  sums.count = Four{};
  for (std::size_t i = 0; i < pixels; ++i, x += 2) {
    const int n = view.near(x[0], x[1], near);
    if (n >= View::CLOSE) add_sums(view, near, n, x[0], x[1], is, i, sums);
  }
  return by_planes(sums, is);
}

py::array_t<double> map_at(const py::object& points_, const py::object& x_, const py::object& K,
                           const py::object& size, const py::dict& is) {
  constexpr auto kernel = "map_at";
  const In<double> points(kernel, "points", points_, {ANY, 5}, Check::finite);
  const In<double> x(kernel, "x", x_, {ANY, 2}, Check::finite);
  const View view(reinterpret_cast<const Point*>(points.data()), points.size(),
                  Picture(kernel, K, size));
  const Interpolation how(is);
  Out<double> out({x.size(), 3});
  View::Near near(view);
  PlaneSums sums;
  for (py::ssize_t i = 0; i < x.size(); i += LANES) {
    const auto pixels = std::min<std::size_t>(LANES, x.size() - i);
    const FourKnown known = interpolated(view, &x(i, 0), pixels, near, sums, how);
    for (std::size_t j = 0; j < pixels; ++j) {
      double* row = &out(i + j, 0);
      row[0] = known.rho[j], row[1] = known.variance[j], row[2] = known.smooth[j];
    }
  }
  return out.array();
}

std::vector<Known> known_of(const char* kernel, const py::object& object, py::ssize_t n) {
  const In<double> rows(kernel, "known", object, {n, 3});
  std::vector<Known> out(n);
  for (py::ssize_t i = 0; i < n; ++i) out[i] = {rows(i, 0), rows(i, 1), rows(i, 2)};
  return out;
}

struct Fit {  // what a pair's blocks and the map tell of its motion
  double A[36] = {}, b[6] = {};  // by (w, t), R -> exp(w) R
  double cost = 0;
  double length = 0;  // information about the log of the way alone
};

struct FitPolicy {
  double relief;  // of a surface between the points of the map, as a share of depth
  double weak;    // standard deviation of a depth that is not known, over the usual one
  double usual;   // inverse depth
};

// A pair's blocks with what the map tells of them, by column.
struct Foretold {
  // Every ``step``-th of a pair.
  Foretold(const PairArrays& pair, const std::vector<Known>& known, const FitPolicy& is,
           std::size_t step = 1)
      : blocks((pair.size() + step - 1) / step), told(blocks.x.size()),
        rho(blocks.x.size(), is.usual), at(blocks.x.size()), variance(blocks.x.size()) {
    for (std::size_t k = 0; k < blocks.count; ++k) {
      const Known& one = known[k * step];
      pair.set(blocks, k, k * step);
      const double rough = one.any() ? is.relief * one.smooth : is.weak * is.usual;
      variance[k] = rough * rough;
      if (!one.any()) continue;
      told[k] = 1, rho[k] = one.rho, at[k] = one.smooth, variance[k] += one.variance;
    }
  }
  Blocks blocks;
  // 1 where the map tells the depth; inverse depth, what it is linearised about, its variance.
  std::vector<double> told, rho, at, variance;
};

struct Projected {  // of a ray at an inverse depth: depth, error [px] and its slope by that
  Four z, u, v, ex, ey, gx, gy;
};

KERNELS_INLINE Projected projected(const TwoView& view, const Four3& a, const Four& x,
                                   const Four& y, const Four& rho) {
  Projected out;
  out.z = at_least(a.z + rho * view.t[2], 1e-3);
  out.u = (a.x + rho * view.t[0]) / out.z;
  out.v = (a.y + rho * view.t[1]) / out.z;
  out.ex = view.fx * (x - out.u);
  out.ey = view.fy * (y - out.v);
  out.gx = view.fx * (view.t[0] - out.u * view.t[2]) / out.z;
  out.gy = view.fy * (view.t[1] - out.v * view.t[2]) / out.z;
  return out;
}

// Sums over blocks, four at a time.
struct FitSums {
  Four A[21] = {}, b[6] = {};  // the lower triangle
  Four cost = {}, length = {};
};

// Where ``equations`` is false, the cost alone.
template <bool equations>
KERNELS_INLINE FitSums sums_of(const Foretold& pair, const TwoView& view, double width) {
  const Four zero = {}, one = zero + 1.0;
  const double softness = 1 / (width * width);
  FitSums out;
  struct {
    Four3 a;
    Four at, ex, ey, along, weight, c;
    Projected p;
  } terms[AT_ONCE];
  const std::size_t groups = pair.rho.size() / LANES;
  for (std::size_t begin = 0; begin < groups; begin += AT_ONCE) {
    const std::size_t n = std::min(AT_ONCE, groups - begin);
    for (std::size_t g = 0; g < n; ++g) {
      const std::size_t i = (begin + g) * LANES;
      const Four3 a = view.R * Four3{load(&pair.blocks.u[i]), load(&pair.blocks.v[i]), one};
      const Four x = load(&pair.blocks.x[i]), y = load(&pair.blocks.y[i]);
      const Four rho = load(&pair.rho[i]), variance = load(&pair.variance[i]);
      const Four sigma = load(&pair.blocks.sigma[i]), counts = load(&pair.blocks.counts[i]);
      const Four noise = sigma * sigma, known = load(&pair.told[i]);
      const auto told = known > 0.0;
      auto possible = told;
      const bool all_told = sum(known) == LANES;  // mostly
      const Projected expected = projected(view, a, x, y, rho);
      // Linearised about a depth that does not err with the block's own: its weight, and what the
      // way does to it, would depend on that error else, and lengths drift by 0.1 % a pair. A depth
      // that is not known is the one that the block itself tells; where that lies beyond infinity,
      // nothing can, and the whole error there counts.
      Four at = load(&pair.at[i]);
      if (!all_told) {
        const Four dx = view.fx * (view.t[0] - x * view.t[2]);
        const Four dy = view.fy * (view.t[1] - y * view.t[2]);
        const Four itself = (view.fx * (x * a.z - a.x) * dx + view.fy * (y * a.z - a.y) * dy) /
                            at_least(dx * dx + dy * dy, 1e-18);
        const Four slope = variance * (expected.gx * expected.gx + expected.gy * expected.gy);
        const Four best = rho + slope / (noise + slope) * (itself - rho);
        Four own = at_least(best, 0);
        own = own > 8.0 * rho ? 8.0 * rho : own;
        at = told ? at : own;
        possible = told | (best >= 0.0);
      }
      const Projected p = projected(view, a, x, y, at);
      Four ex = expected.ex, ey = expected.ey;
      const Four square = p.gx * p.gx + p.gy * p.gy;
      Four c = variance / (noise + variance * square);
      if (!all_told) {
        const Four off = possible ? at - rho : zero;
        ex = told ? ex : p.ex + p.gx * off;
        ey = told ? ey : p.ey + p.gy * off;
        c = possible ? c : zero;
      }
      const Four along = p.gx * ex + p.gy * ey;
      const Four error = at_least((ex * ex + ey * ey - c * along * along) / noise, 0);
      const Four kernel = one / (one + error * softness);
      out.cost += counts * error * kernel;
      if constexpr (!equations) continue;
      const Four weight = counts * kernel * kernel / noise;
      out.length += told ? weight * at * at * square * (one - c * square) : zero;
      terms[g] = {a, at, ex, ey, along, weight, c, p};
    }
    if constexpr (!equations) continue;
    for (std::size_t g = 0; g < n; ++g) {
      const auto& [a, at, ex, ey, along, weight, c, p] = terms[g];
      const Four inverse = one / p.z;
      const Four3 du{view.fx * inverse, zero, -view.fx * p.u * inverse},
                  dv{zero, view.fy * inverse, -view.fy * p.v * inverse};
      const Four3 wu = cross(a, du), wv = cross(a, dv);
      const Four U[6] = {wu.x, wu.y, wu.z, at * du.x, zero, at * du.z};
      const Four V[6] = {wv.x, wv.y, wv.z, zero, at * dv.y, at * dv.z};
      Four G[6];
      for (int k = 0; k < 6; ++k) G[k] = p.gx * U[k] + p.gy * V[k];
      for (int r = 0, k = 0; r < 6; ++r) {
        const Four u = weight * U[r], v = weight * V[r], h = weight * c * G[r];
        for (int s = 0; s <= r; ++s, ++k) out.A[k] += u * U[s] + v * V[s] - h * G[s];
        out.b[r] += u * ex + v * ey - h * along;
      }
    }
  }
  return out;
}

KERNELS_WIDE
double cost_of(const Foretold& pair, const TwoView& view, double width) {
  return sum(sums_of<false>(pair, view, width).cost);
}

KERNELS_WIDE
Fit terms(const Foretold& pair, const TwoView& view, double width) {
  const FitSums sums = sums_of<true>(pair, view, width);
  Fit out;
  for (int r = 0, k = 0; r < 6; ++r) {
    for (int s = 0; s <= r; ++s, ++k) out.A[6 * r + s] = out.A[6 * s + r] = sum(sums.A[k]);
    out.b[r] = sum(sums.b[r]);
  }
  out.cost = sum(sums.cost);
  out.length = sum(sums.length);
  return out;
}

constexpr std::size_t EVERY = 3;  // of the blocks, by which starts and medians are judged

// Lengths [map unit] that blocks give to a pair's own motion, |t| = 1, where both that, to the
// share ``sure``, and the map tell their depth.
KERNELS_WIDE
std::vector<double> lengths_of(const PairArrays& pair, const TwoView& view,
                               const std::vector<Known>& known, double sure) {
  std::vector<double> out(pair.size() + 1);
  std::size_t n = 0;
  // In camera k-1, where the map's depths are: x_prev ~ x + rho u with x = R^T x_cur.
  const Mat3 back = transposed(view.R);
  const Vec3 t = back * (-1.0 * view.t);
  for (std::size_t i = 0; i < pair.size(); i += LANES) {
    const std::size_t lanes = std::min(LANES, pair.size() - i);
    Four cur_x, cur_y, prev_x, prev_y, sigma, before, variance;
    for (std::size_t j = 0; j < LANES; ++j) {
      const auto at = static_cast<py::ssize_t>(j < lanes ? i + j : i);
      cur_x[j] = pair.rays_cur(at, 0), cur_y[j] = pair.rays_cur(at, 1);
      prev_x[j] = pair.rays_prev(at, 0), prev_y[j] = pair.rays_prev(at, 1);
      sigma[j] = pair.sigma[at], before[j] = known[at].rho, variance[j] = known[at].variance;
    }
    const Four3 a = back * Four3{cur_x, cur_y, Four{} + 1.0};
    const Four x = a.x / a.z, y = a.y / a.z;
    const Four gx = (t[0] - x * t[2]) * view.fx, gy = (t[1] - y * t[2]) * view.fy;
    const Four square = at_least(gx * gx + gy * gy, 1e-18);
    const Four rho = ((prev_x - x) * view.fx * gx + (prev_y - y) * view.fy * gy) / square;
    const Four ahead = 1.0 - rho * t[2], length = rho / before;
    const auto told = (variance < INFINITE) & (before > 0.0) &
                      (ahead * ahead * sigma < sure * rho * root(square));
    for (std::size_t j = 0; j < lanes; ++j) {
      out[n] = length[j];
      n -= told[j];
    }
  }
  out.resize(n);
  return out;
}

// Number of such blocks, and the median of their lengths.
py::tuple told_length(const py::tuple& pair_, const py::object& known_, const py::object& R,
                      const py::object& t, double sure) {
  constexpr auto kernel = "told_length";
  require(pair_.size() == 4, kernel, "a pair has rays_cur, rays_prev, sigma, focal");
  const PairArrays pair(kernel, pair_[0], pair_[1], pair_[2]);
  const TwoView view = two_view(kernel, R, t, pair_[3]);
  auto lengths = lengths_of(pair, view, known_of(kernel, known_, pair.rays_cur.size()), sure);
  const auto count = lengths.size();
  return py::make_tuple(count, median(std::move(lengths)));
}

// Covariance of (w, t / |t|) by the information A (6, 6) about (w, t).
std::array<double, 36> covariance_of(const double* A, const Vec3& t) {
  std::array<double, 36> P, half{}, out{};
  std::copy_n(A, 36, P.begin());
  double trace = 0;
  for (int r = 0; r < 6; ++r) trace += P[7 * r];
  for (int r = 0; r < 6; ++r) P[7 * r] += 1e-12 * trace;  // what no block tells: wide open, finite
  pseudo_inverse(P.data(), 6);
  const double length = std::max(norm(t), 1e-12);
  double D[36] = {};
  for (int r = 0; r < 3; ++r) {
    D[7 * r] = 1;
    for (int s = 0; s < 3; ++s)
      D[6 * (3 + r) + 3 + s] = ((r == s) - t[r] * t[s] / (length * length)) / length;
  }
  for (int r = 0; r < 6; ++r)
    for (int s = 0; s < 6; ++s)
      for (int k = 0; k < 6; ++k) half[6 * r + s] += D[6 * r + k] * P[6 * k + s];
  for (int r = 0; r < 6; ++r)
    for (int s = 0; s < 6; ++s)
      for (int k = 0; k < 6; ++k) out[6 * r + s] += half[6 * r + k] * D[6 * s + k];
  return out;
}

// -> R (3, 3), t (3,), A (6, 6) with the covariance (6, 6) of (w, t / |t|), information about the
// log of |t|, mean robust cost
py::tuple fit_to_map(const py::tuple& pair_, const py::object& known_, const py::object& starts_,
                     const py::object& widths_, const py::dict& is) {
  constexpr auto kernel = "fit_to_map";
  require(pair_.size() == 4, kernel, "a pair has rays_cur, rays_prev, sigma, focal");
  const PairArrays pair(kernel, pair_[0], pair_[1], pair_[2]);
  const In<double> focal(kernel, "focal", pair_[3], {2}, Check::finite);
  const auto known = known_of(kernel, known_, pair.rays_cur.size());
  const In<double> starts(kernel, "starts", starts_, {ANY, 12}, Check::finite);
  const In<double> widths(kernel, "widths", widths_, {ANY}, Check::finite);
  require(starts.size() > 0 && widths.size() > 1, kernel, "there must be a start and two widths");
  std::vector<double> depths;
  for (const Known& one : known)
    if (one.any()) depths.push_back(one.rho);
  const FitPolicy how{policy(is, "relief"), policy(is, "weak"), std::max(median(depths), 1e-9)};
  const Foretold all(pair, known, how), few(pair, known, how, EVERY);
  TwoView view{};
  double least = INFINITE;
  for (py::ssize_t k = 0; k < starts.size(); ++k) {
    TwoView trial{{}, {starts(k, 9), starts(k, 10), starts(k, 11)}, focal[0], focal[1]};
    std::copy_n(&starts[12 * k], 9, trial.R.begin());
    const double cost = cost_of(few, trial, widths[1]);
    if (cost < least) least = cost, view = trial;
  }
  Fit now;
  for (py::ssize_t k = 0; k < widths.size(); ++k) {
    now = terms(all, view, widths[k]);
    double L[36], step[6];
    std::copy_n(now.A, 36, L);
    std::copy_n(now.b, 6, step);
    for (int r = 0; r < 6; ++r) L[7 * r] += 1e-9 * L[7 * r] + 1e-12;
    if (!cholesky(L, 6)) break;
    cholesky_solve(L, 6, step);
    view.R = rotation_exp({step[0], step[1], step[2]}) * view.R;
    view.t = view.t + Vec3{step[3], step[4], step[5]};
    // Hundredths of what a pair knows of its motion.
    if (k > 2 && norm({step[0], step[1], step[2]}) < 1e-5 &&
        norm({step[3], step[4], step[5]}) < 3e-4 * norm(view.t))
      break;
  }
  Out<double> A({6, 6});
  std::copy_n(now.A, 36, A.data());
  return py::make_tuple(matrix_of(view.R, {3, 3}), matrix_of(view.t, {3}), A.array(),
                        matrix_of(covariance_of(now.A, view.t), {6, 6}), now.length,
                        now.cost / std::max<double>(1, static_cast<double>(pair.size())));
}

// A pair's inverse depths (N,) and their errors, joined with what the map foretold of each unless
// that contradicts; t [map unit], while the pair's own are in units of its baseline.
py::tuple join_map(const py::object& rho_, const py::object& sigma_, const py::object& known_,
                   const py::object& rays_prev, const py::object& R, const py::object& t_,
                   const py::dict& is) {
  constexpr auto kernel = "join_map";
  const In<double> rho(kernel, "rho", rho_, {ANY}, Check::finite);
  const auto n = rho.size();
  const In<double> sigma(kernel, "sigma", sigma_, {n}, Check::finite);
  const In<double> ray(kernel, "rays_prev", rays_prev, {n, 3}, Check::finite);
  const In<double> turn(kernel, "R", R, {3, 3}, Check::finite);
  const In<double> t(kernel, "t", t_, {3}, Check::finite);
  const auto known = known_of(kernel, known_, n);
  const double length = norm({t[0], t[1], t[2]}), gate = policy(is, "gate"),
               drift = policy(is, "drift"), alike = policy(is, "alike");
  Out<double> joined({n}), sharper({n});
  for (py::ssize_t i = 0; i < n; ++i) {
    joined[i] = rho[i], sharper[i] = sigma[i];
    const double turned = ray(i, 0) * turn[6] + ray(i, 1) * turn[7] + ray(i, 2) * turn[8];
    const double ahead = turned + known[i].rho * t[2];
    if (!known[i].any() || !(ahead > 1e-6)) continue;
    const double before = length * known[i].rho / ahead, off = before - rho[i];
    const double slope = length * turned / (ahead * ahead), error = drift * before;
    const double noise = sigma[i] * sigma[i];
    const double variance = slope * slope * known[i].variance + error * error + alike * noise;
    const double gain = noise / (noise + variance);
    if (!(off * off < gate * (noise + variance))) continue;
    joined[i] = rho[i] + gain * off;
    sharper[i] = sigma[i] * std::sqrt(1 - gain);
  }
  return py::make_tuple(joined.array(), sharper.array());
}

KERNELS_WIDE
void move(std::vector<Point>& points, const TwoView& view, double inflation) {
  for (std::size_t i = 0; i < points.size(); i += LANES) {
    const std::size_t lanes = std::min(LANES, points.size() - i);
    Four x, y, z, rho, variance;
    for (std::size_t j = 0; j < LANES; ++j) {
      const Point& p = points[j < lanes ? i + j : i];
      x[j] = p.ray[0], y[j] = p.ray[1], z[j] = p.ray[2];
      rho[j] = p.rho, variance[j] = p.variance;
    }
    const Four3 turned = view.R * Four3{x, y, z};
    const Four3 h{turned.x + rho * view.t[0], turned.y + rho * view.t[1],
                  turned.z + rho * view.t[2]};
    const Four n = at_least(root(dot(h, h)), 1e-9), inverse = 1.0 / n;
    const Four slope = inverse - rho * dot(h, view.t) / (n * n * n), away = rho / n;
    const Four3 to = inverse * h;
    const Four known = slope * slope * variance + inflation * inflation * away * away;
    for (std::size_t j = 0; j < lanes; ++j)
      points[i + j] = {{to.x[j], to.y[j], to.z[j]}, away[j], known[j]};
  }
}

struct Seen {  // a block's own inverse depth in camera k, and what the map foretold of it
  double rho, sigma, before, variance;
  bool good, foretold;
};

// What each block shows, and the usual inverse depth: of what the map foretold, or of the pair's.
std::pair<std::vector<Seen>, double> measured(const PairArrays& pair,
                                              const std::vector<Known>& known,
                                              const TwoView& view, double epsilon) {
  std::vector<Seen> out(pair.size());
  std::vector<double> foretold, own;
  foretold.reserve(pair.size());
  own.reserve(pair.size());
  const Vec3& t = view.t;
  const auto error = epipolar_errors(pair.blocks(), view);
  for (std::size_t i = 0; i < pair.size(); ++i) {
    const Vec3 a = view.R * Vec3{pair.rays_prev(i, 0), pair.rays_prev(i, 1), 1};
    const double dx = a[0] / a[2], dy = a[1] / a[2];
    const double gx = (t[0] - dx * t[2]) * view.fx, gy = (t[1] - dy * t[2]) * view.fy;
    const double square = gx * gx + gy * gy;
    Seen& one = out[i];
    one.good = square > 1e-18 && std::abs(error[i]) < epsilon;
    one.rho = one.good ? ((pair.rays_cur(i, 0) - dx) * view.fx * gx +
                          (pair.rays_cur(i, 1) - dy) * view.fy * gy) / square : 0;
    const double ahead = a[2] + known[i].rho * t[2];
    one.foretold = known[i].any() && ahead > 1e-6;
    if (one.foretold) {
      one.before = known[i].rho / ahead;
      const double slope = a[2] / (ahead * ahead);
      one.variance = slope * slope * known[i].variance;
      foretold.push_back(one.before);
    }
    if (one.good) own.push_back(one.rho);
  }
  const double usual = median(std::move(foretold.size() > 20 ? foretold : own));
  for (std::size_t i = 0; i < pair.size(); ++i) {
    // By the depth that was foretold: by its own, what errs towards the camera would count more.
    const double rho = out[i].foretold ? out[i].before : usual, ahead = 1 - rho * t[2];
    const double gx = (t[0] - pair.rays_cur(i, 0) * t[2]) * view.fx,
                 gy = (t[1] - pair.rays_cur(i, 1) * t[2]) * view.fy;
    out[i].sigma = ahead * ahead * pair.sigma[i] / std::max(std::sqrt(gx * gx + gy * gy), 1e-12);
  }
  return {std::move(out), usual};
}

// Points after a pair: moved, corrected by its blocks, and joined by new ones where there was none.
py::array_t<double> fuse_map(const py::object& points_, const py::tuple& pair_,
                             const py::object& known_, const py::object& motion,
                             const py::tuple& picture_, const py::dict& is) {
  constexpr auto kernel = "fuse_map";
  auto points = points_of(kernel, points_);
  require(pair_.size() == 4, kernel, "a pair has rays_cur, rays_prev, sigma, focal");
  require(picture_.size() == 2, kernel, "a picture has K and size");
  const PairArrays pair(kernel, pair_[0], pair_[1], pair_[2]);
  const In<double> focal(kernel, "focal", pair_[3], {2}, Check::finite);
  const In<double> Rt(kernel, "motion", motion, {12}, Check::finite);
  TwoView view{{}, {Rt[9], Rt[10], Rt[11]}, focal[0], focal[1]};
  std::copy_n(Rt.data(), 9, view.R.begin());
  const auto known = known_of(kernel, known_, pair.rays_cur.size());
  const Picture picture(kernel, picture_[0], picture_[1]);
  move(points, view, policy(is, "inflation"));
  const auto [seen, usual] = measured(pair, known, view, policy(is, "epsilon"));
  // The surest block of each macroblock.
  std::vector<int> first(picture.columns * picture.rows, -1);
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (!seen[i].good) continue;
    const auto [x, y] = picture.pixel({pair.rays_cur(i, 0), pair.rays_cur(i, 1), 1});
    const int cell = picture.cell(x, y);
    if (cell >= 0 && (first[cell] < 0 || seen[i].sigma < seen[first[cell]].sigma))
      first[cell] = static_cast<int>(i);
  }
  std::vector<double> distances;
  for (std::size_t k = 0; k < points.size(); k += EVERY) distances.push_back(points[k].rho);
  const double worst = 1.5 * std::max(median(std::move(distances)), 0.0);
  const double gate = policy(is, "gate"), least = policy(is, "least_gain"),
               sure = policy(is, "sure"), doubt = policy(is, "doubt"),
               relief = policy(is, "first_relief");
  std::vector<int> best(first.size(), -1);  // the surest point of each macroblock: it stays alone
  const auto unsure = [&](int k) {
    return points[k].variance / std::max(points[k].rho * points[k].rho, 1e-24);
  };
  std::vector<char> kept(points.size(), 1);
  // Some at a time, for which little memory is enough.
  constexpr std::size_t SOME = 256;
  for (std::size_t begin = 0; begin < points.size(); begin += SOME) {
    const Shown shown(&points[begin], std::min(SOME, points.size() - begin), picture, 0);
    for (std::size_t i = 0; i < shown.count; ++i) {
      const int k = static_cast<int>(begin) + shown.number[i];
      const int column = Picture::cell_of(shown.x[i]), row = Picture::cell_of(shown.y[i]);
      const int cell = row * picture.columns + column;
      Point& p = points[k];
      if (first[cell] >= 0 && seen[first[cell]].foretold) {
        const Seen& one = seen[first[cell]];
        const double off = one.rho - one.before, noise = one.sigma * one.sigma,
                     sum = one.variance + noise;
        if (off * off < gate * sum) {
          double gain = one.variance / sum;
          if (one.sigma < sure * std::abs(one.before)) gain = std::max(gain, least);
          const int block = first[cell];
          const double longer = norm({pair.rays_cur(block, 0), pair.rays_cur(block, 1), 1});
          const double share = p.rho * longer / (std::abs(one.before) > 1e-9 ? one.before : 1e-9);
          p.rho += gain * off * (share > 0.5 && share < 2 ? share : 1) / longer;
          p.variance *= ((1 - gain) * (1 - gain) * one.variance + gain * gain * noise) /
                        std::max(one.variance, 1e-18);
        } else {
          p.variance *= doubt;
        }
      }
      const int other = best[cell];
      if (!(p.variance < worst * worst) || (other >= 0 && unsure(other) <= unsure(k))) {
        kept[k] = 0;
      } else {
        if (other >= 0) kept[other] = 0;
        best[cell] = k;
      }
    }
  }
  std::size_t n = 0;
  for (std::size_t k = 0; k < points.size(); ++k)
    if (kept[k]) points[n++] = points[k];
  points.resize(n);
  for (std::size_t cell = 0; cell < first.size(); ++cell) {
    if (best[cell] >= 0 || first[cell] < 0) continue;
    const Seen& one = seen[first[cell]];
    if (!(one.sigma < usual && one.rho > -3 * one.sigma)) continue;
    const Vec3 ray{pair.rays_cur(first[cell], 0), pair.rays_cur(first[cell], 1), 1};
    const double length = norm(ray), rough = relief * one.rho;
    points.push_back({(1 / length) * ray, one.rho / length,
                      (one.sigma * one.sigma + rough * rough) / (length * length)});
  }
  return array_of(points, static_cast<std::size_t>(policy(is, "most")));
}

}  // namespace
}  // namespace kernels

void bind_block_map(kernels::py::module_& module) {
  using namespace kernels;
  module.def("map_at", map_at);
  module.def("told_length", told_length);
  module.def("fit_to_map", fit_to_map);
  module.def("join_map", join_map);
  module.def("fuse_map", fuse_map);
}
