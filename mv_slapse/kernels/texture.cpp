// How well the pictures fix where a macroblock matches: the covariance of least squares matching
// (Foerstner, "On the geometric precision of digital correlation", 1982), in the direction in which
// the macroblock shows least (Shi and Tomasi, "Good features to track", CVPR 1994).

#include "blocks.hpp"
#include "lanes.hpp"
#include "picture.hpp"

namespace kernels {
namespace {

constexpr int EVERY = 2;       // rows of which one is asked for texture: the others show the same
constexpr int FOURTH = 4;      // and for residuals, of which 64 pixels tell enough
constexpr int AHEAD = 80;      // pixels, of what soon will be asked for: matches go on to the right
constexpr float TWICE = 2;     // pixels apart that a gradient is taken from
constexpr int STEPS = 16;      // of a pixel, to which a vector is taken
constexpr int BITS = 8;        // of STEPS squared
constexpr float NOISE = 3;     // grey levels, by which a picture differs from its match at least
constexpr float SHARE = 15;    // of squared residuals: side by side they are alike, not noise
constexpr float USUAL = 1.5f;  // grey levels squared, residual where one picture is known
constexpr float SMOOTH = 0.7f; // px, by which encoders let vectors differ from those around

// Differences of the pixels beside each other, and above each other, of a row of a macroblock.
KERNELS_INLINE void differ(const std::uint8_t* above, const std::uint8_t* row,
                           const std::uint8_t* below, int first, int last,
                           std::int16_t* __restrict x, std::int16_t* __restrict y) {
  for (int i = first; i < last; ++i) {
    x[i] = static_cast<std::int16_t>(row[i + 1] - row[i - 1]);
    y[i] = static_cast<std::int16_t>(below[i] - above[i]);
  }
}

// Smaller eigenvalue [grey levels^2 / px^2] of the structure tensor of a macroblock. In registers
// of the usual width: a processor waits where it reads more at a time than it has just written.
float texture(const Picture& picture, int column, int row) {
  constexpr int ROWS = MACROBLOCK / EVERY;
  const int left = MACROBLOCK * column, top = std::max(MACROBLOCK * row, 1);
  const int first = std::max(1 - left, 0), last = std::min(MACROBLOCK, picture.width - 1 - left);
  const int rows = std::min(ROWS, (picture.height - top) / EVERY);
  const bool whole = last - first == MACROBLOCK && rows == ROWS;
  std::int16_t x[ROWS * MACROBLOCK], y[ROWS * MACROBLOCK];
  if (!whole) {
    std::memset(x, 0, sizeof x);
    std::memset(y, 0, sizeof y);
  }
  for (int j = 0; j < rows; ++j) {
    const int at = top + EVERY * j;
    const std::uint8_t *above = picture.row(at - 1) + left, *here = picture.row(at) + left,
                       *below = picture.row(at + 1) + left;
    __builtin_prefetch(here + AHEAD);
    __builtin_prefetch(below + AHEAD);
    std::int16_t *to_x = x + MACROBLOCK * j, *to_y = y + MACROBLOCK * j;
    if (whole) differ(above, here, below, 0, MACROBLOCK, to_x, to_y);
    else differ(above, here, below, first, last, to_x, to_y);
  }
  int xx = 0, xy = 0, yy = 0;
  for (int i = 0; i < ROWS * MACROBLOCK; ++i) {
    xx += x[i] * x[i];
    xy += x[i] * y[i];
    yy += y[i] * y[i];
  }
  const float half = static_cast<float>(xx - yy) / 2, both = static_cast<float>(xy);
  const float smaller = static_cast<float>(xx + yy) / 2 - std::sqrt(half * half + both * both);
  return std::max(smaller, 0.0f) * EVERY / (TWICE * TWICE);
}

// Adds sum and sum of squares of what 16 pixels differ by from those between two rows. All
// but these fits into sixteen bits.
KERNELS_INLINE void compare(const std::uint8_t* now, const std::uint8_t* upper,
                            const std::uint8_t* lower, const std::uint16_t (&weight)[4], int& sum,
                            int& squares) {
  std::int16_t row_sum = 0;
  int row_squares = 0;
  for (int i = 0; i < MACROBLOCK; ++i) {
    const auto then = static_cast<std::uint16_t>(
        weight[0] * upper[i] + weight[1] * upper[i + 1] + weight[2] * lower[i] +
        weight[3] * lower[i + 1] + STEPS * STEPS / 2);
    const auto apart = static_cast<std::int16_t>(now[i] - (then >> BITS));
    row_sum = static_cast<std::int16_t>(row_sum + apart);
    row_squares += apart * apart;
  }
  sum += row_sum;
  squares += row_squares;
}

// Variance [grey levels^2] of what a macroblock around x differs by from its match; USUAL where
// one of them is not whole.
KERNELS_WIDE float residual(const Picture& now, const Picture& then, Vec2 x, Vec2 vector) {
  const int left = floor_of(x.x) - MACROBLOCK / 2 + 1, top = floor_of(x.y) - MACROBLOCK / 2 + 1;
  const float u = static_cast<float>(left) + vector.x, v = static_cast<float>(top) + vector.y;
  const int there = floor_of(u), under = floor_of(v);
  if (std::min({left, top, there, under}) < 0 || left + MACROBLOCK > now.width ||
      top + MACROBLOCK > now.height || there + MACROBLOCK >= then.width ||
      under + MACROBLOCK >= then.height)
    return USUAL;
  const int a = static_cast<int>((u - static_cast<float>(there)) * STEPS);
  const int b = static_cast<int>((v - static_cast<float>(under)) * STEPS);
  const auto share = [](int x, int y) { return static_cast<std::uint16_t>(x * y); };
  const std::uint16_t weight[] = {share(STEPS - a, STEPS - b), share(a, STEPS - b),
                                  share(STEPS - a, b), share(a, b)};
  int sum = 0, squares = 0;
  for (int j = 0; j < MACROBLOCK; j += FOURTH) {
    const std::uint8_t *upper = then.row(under + j) + there,
                       *lower = then.row(under + j + 1) + there;
    __builtin_prefetch(upper + AHEAD);
    __builtin_prefetch(lower + AHEAD);
    compare(now.row(top + j) + left, upper, lower, weight, sum, squares);
  }
  constexpr float n = MACROBLOCK * MACROBLOCK / FOURTH;
  return (static_cast<float>(squares) - static_cast<float>(sum) * static_cast<float>(sum) / n) / n;
}

// Standard deviation [px] of each match, given that of its vector alone, for what the two pictures
// show; of one of them, where the other is not known. Measured against true epipolar lines (KITTI, a
// rendered street and a garage, MPEG-2 and H.264), squared errors grow with NOISE^2 + SHARE *
// residual, and fall with the texture; where there is none they stay below SMOOTH^2.
py::object match_sigma(const py::object& picture, const py::object& before,
                       const py::object& places, const py::object& matches,
                       const py::object& given) {
  const char* name = "match_sigma";
  const auto now = Picture::of(name, "luma", picture), then = Picture::of(name, "before", before);
  if (!now && !then) return given;
  const In<float> x_cur(name, "x_cur", places, {ANY, 2}, Check::finite);
  const In<float> x_prev(name, "x_prev", matches, {x_cur.size(), 2}, Check::finite);
  const In<float> sigma(name, "sigma", given, {x_cur.size()}, Check::finite);
  const Picture& one = now ? *now : *then;
  const In<float>& x = now ? x_cur : x_prev;
  const int columns = macroblocks(one.width), rows = macroblocks(one.height);
  Out<float> out({x_cur.size()});
  for (py::ssize_t i = 0; i < x_cur.size(); ++i) {
    const Vec2 vector = at(x_prev, i) - at(x_cur, i);
    const float left = now && then ? residual(*now, *then, at(x_cur, i), vector) : USUAL;
    const float noise = NOISE * NOISE + SHARE * left;
    const float shown = texture(one, nearest_of(x(i, 0), columns), nearest_of(x(i, 1), rows));
    const float variance = noise / (shown + noise / (SMOOTH * SMOOTH));
    out[i] = std::sqrt(sigma[i] * sigma[i] + variance);
  }
  return out.array();
}

}  // namespace
}  // namespace kernels

void bind_texture(kernels::py::module_& module) {
  module.def("match_sigma", kernels::match_sigma);
}
