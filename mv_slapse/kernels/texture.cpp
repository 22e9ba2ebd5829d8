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
constexpr float TWICE = 2;     // pixels apart that a gradient is taken from
constexpr int STEPS = 16;      // of a pixel, to which a vector is taken
constexpr float NOISE = 3;     // grey levels, by which a picture differs from its match at least
constexpr float SHARE = 15;    // of squared residuals: side by side they are alike, not noise
constexpr float USUAL = 1.5f;  // grey levels squared, residual where one picture is known
constexpr float SMOOTH = 0.7f; // px, by which encoders let vectors differ from those around

struct Products {  // sums of products of differences, for each column of pixels
  std::vector<int> xx, xy, yy;
  explicit Products(int width) : xx(width, 0), xy(width, 0), yy(width, 0) {}
};

KERNELS_WIDE void add(const std::uint8_t* __restrict above, const std::uint8_t* __restrict row,
                      const std::uint8_t* __restrict below, int width, int* __restrict xx,
                      int* __restrict xy, int* __restrict yy) {
  for (int i = 1; i < width - 1; ++i) {
    const int x = int(row[i + 1]) - row[i - 1], y = int(below[i]) - above[i];
    xx[i] += x * x;
    xy[i] += x * y;
    yy[i] += y * y;
  }
}

// Smaller eigenvalue [grey levels^2 / px^2] of the structure tensor of each macroblock, row by row.
std::vector<float> texture(const Picture& picture) {
  const int columns = macroblocks(picture.width), rows = macroblocks(picture.height);
  std::vector<float> out(columns * rows);
  for (int r = 0; r < rows; ++r) {
    Products sums(picture.width);
    const int last = std::min(MACROBLOCK * (r + 1), picture.height - 1);
    for (int y = std::max(MACROBLOCK * r, 1); y < last; y += EVERY)
      add(picture.row(y - 1), picture.row(y), picture.row(y + 1), picture.width, sums.xx.data(),
          sums.xy.data(), sums.yy.data());
    for (int c = 0; c < columns; ++c) {
      float xx = 0, xy = 0, yy = 0;
      for (int i = MACROBLOCK * c; i < std::min(MACROBLOCK * (c + 1), picture.width); ++i) {
        xx += static_cast<float>(sums.xx[i]);
        xy += static_cast<float>(sums.xy[i]);
        yy += static_cast<float>(sums.yy[i]);
      }
      const float half = (xx - yy) / 2;
      const float smaller = (xx + yy) / 2 - std::sqrt(half * half + xy * xy);
      out[r * columns + c] = std::max(smaller, 0.0f) * EVERY / (TWICE * TWICE);
    }
  }
  return out;
}

// Sum and sum of squares of what 16 pixels differ by from those between two rows.
KERNELS_INLINE void compare(const std::uint8_t* __restrict now, const std::uint8_t* __restrict upper,
                            const std::uint8_t* __restrict lower, const int (&weight)[4], int& sum,
                            int& squares) {
  for (int i = 0; i < MACROBLOCK; ++i) {
    const int then = weight[0] * upper[i] + weight[1] * upper[i + 1] + weight[2] * lower[i] +
                     weight[3] * lower[i + 1];
    const int apart = now[i] - (then + STEPS * STEPS / 2) / (STEPS * STEPS);
    sum += apart;
    squares += apart * apart;
  }
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
  const int weight[] = {(STEPS - a) * (STEPS - b), a * (STEPS - b), (STEPS - a) * b, a * b};
  int sum = 0, squares = 0;
  for (int j = 0; j < MACROBLOCK; j += FOURTH)
    compare(now.row(top + j) + left, then.row(under + j) + there, then.row(under + j + 1) + there,
            weight, sum, squares);
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
  const std::vector<float> shown = texture(one);
  Out<float> out({x_cur.size()});
  for (py::ssize_t i = 0; i < x_cur.size(); ++i) {
    const Vec2 vector = at(x_prev, i) - at(x_cur, i);
    const float left = now && then ? residual(*now, *then, at(x_cur, i), vector) : USUAL;
    const float noise = NOISE * NOISE + SHARE * left;
    const int macroblock =
        nearest_macroblock(at(x, i), macroblocks(one.width), macroblocks(one.height));
    const float variance = noise / (shown[macroblock] + noise / (SMOOTH * SMOOTH));
    out[i] = std::sqrt(sigma[i] * sigma[i] + variance);
  }
  return out.array();
}

}  // namespace
}  // namespace kernels

void bind_texture(kernels::py::module_& module) {
  module.def("match_sigma", kernels::match_sigma);
}
