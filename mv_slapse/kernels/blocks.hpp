// The blocks that a codec's pictures are cut into, as in geometry/blocks.py, and arithmetic that
// several kernels of motion vectors share. Vectors are float, as they are stored: what is compared
// with a threshold is computed as numpy does it on float32.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "arrays.hpp"
#include "small.hpp"

namespace kernels {

constexpr int MACROBLOCK = 16;     // px
constexpr int CELL = 8;            // px, the smallest partition that decoders report
constexpr float ABSENT = 1e6f;     // px, a place or a vector that is near no other
constexpr float SUPPORTED = 0.5f;  // share of the highest probability; lone vectors lie below

struct Vec2 {
  float x, y;
};
inline Vec2 operator+(Vec2 a, Vec2 b) { return {a.x + b.x, a.y + b.y}; }
inline Vec2 operator-(Vec2 a, Vec2 b) { return {a.x - b.x, a.y - b.y}; }
inline Vec2 operator*(float s, Vec2 a) { return {s * a.x, s * a.y}; }
inline bool is_zero(Vec2 a) { return a.x == 0 && a.y == 0; }
inline float square(Vec2 a) { return a.x * a.x + a.y * a.y; }
inline float length(Vec2 a) {
  return static_cast<float>(std::sqrt(double(a.x) * a.x + double(a.y) * a.y));
}
inline Vec2 at(const In<float>& rows, py::ssize_t i) { return {rows[2 * i], rows[2 * i + 1]}; }

// Column or row of the macroblock, or of the cell, that holds a coordinate [px].
inline int floor_within(float x) {  // without the library, which x86-64 calls for each number
  const int towards_zero = static_cast<int>(x);
  return towards_zero - (static_cast<float>(towards_zero) > x);
}
inline int floor_of(float x) { return floor_within(std::clamp(x, -1e6f, 1e6f)); }
inline int macroblock_of(float x) { return floor_of((x + 0.5f) / MACROBLOCK); }
inline int cell_of(float x, int size) { return floor_of((x + 0.5f - 0.5f * size) / CELL); }
inline int macroblocks(int pixels) { return (pixels + MACROBLOCK - 1) / MACROBLOCK; }

// Column or row of the macroblock at a coordinate, or of the nearest one of n.
inline int nearest_of(float x, int n) {
  const float place = std::max((x + 0.5f) / MACROBLOCK, 0.0f);
  return static_cast<int>(std::min(place, static_cast<float>(n - 1)));
}
// Number of that at a pixel, row by row.
inline int nearest_macroblock(Vec2 x, int columns, int rows) {
  return nearest_of(x.y, rows) * columns + nearest_of(x.x, columns);
}

// 2^x, for x from -1000 to 1000, from additions and products alone: libraries differ in the last
// bit between processors. There are no branches, so that the compiler can take several at a time.
inline double power_of_two(float x) {
  constexpr double COEFFICIENT[] = {  // (ln 2)^k / k!; the rest lies below 1e-13
      1.0, 0.69314718055994530942, 0.24022650695910071233, 0.055504108664821579953,
      0.0096181291076284771620, 0.0013333558146428443423, 1.5403530393381609954e-4,
      1.5252733804059840280e-5, 1.3215486790144309488e-6, 1.0178086009239699728e-7,
      7.0549116208011233299e-9, 4.4455382718708114976e-10};
  const int whole = floor_within(x + 0.5f);
  const double part = double(x) - whole;
  double sum = 0;
  for (int k = 11; k >= 0; --k) sum = sum * part + COEFFICIENT[k];
  const std::uint64_t bits = static_cast<std::uint64_t>(1023 + whole) << 52;  // 2^whole
  double scale;
  std::memcpy(&scale, &bits, sizeof scale);
  return sum * scale;
}

// Smallest probability of a vector that others support, see `Correspondences.lone`.
inline float least_supported(const In<float>& probability) {
  float most = 0;
  for (py::ssize_t i = 0; i < probability.size(); ++i) most = std::max(most, probability[i]);
  return SUPPORTED * most;
}

// Vectors of the macroblocks of a pair (x_cur, x_prev, probability) that others support, row by
// row; NaN where there is none.
inline std::vector<Vec2> field_of(const char* kernel, const py::tuple& pair, int columns, int rows) {
  require(pair.size() == 3, kernel, "a pair has three columns");
  const In<float> x_cur(kernel, "x_cur", pair[0], {ANY, 2}, Check::finite);
  const In<float> x_prev(kernel, "x_prev", pair[1], {x_cur.size(), 2}, Check::finite);
  const In<float> probability(kernel, "probability", pair[2], {x_cur.size()}, Check::finite);
  std::vector<Vec2> field(columns * rows, {NAN, NAN});
  const float least = least_supported(probability);
  for (py::ssize_t i = 0; i < x_cur.size(); ++i)
    if (!(probability[i] < least))
      field[nearest_macroblock(at(x_cur, i), columns, rows)] = at(x_prev, i) - at(x_cur, i);
  return field;
}

// A copy of values as an array whose rows have a given width (0: no second axis).
template <typename T>
py::array_t<T> array_of(const std::vector<T>& values, py::ssize_t width = 0) {
  const auto n = static_cast<py::ssize_t>(values.size());
  Out<T> out = width ? Out<T>({n / width, width}) : Out<T>({n});
  std::copy(values.begin(), values.end(), out.data());
  return out.array();
}

}  // namespace kernels
