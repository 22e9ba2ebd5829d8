// What the kernels of movers share: constants of a record by name, matrices, the grid of cells.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "arrays.hpp"
#include "small.hpp"

namespace kernels {

inline double square(double x) { return x * x; }

// A constant of a Python record of them, by its name.
inline double number(const py::object& record, const char* name) {
  return record.attr(name).cast<double>();
}

inline Mat3 matrix(const char* kernel, const char* name, const py::object& A) {
  const In<double> view(kernel, name, A, {3, 3}, Check::finite);
  Mat3 out;
  std::copy_n(view.data(), 9, out.begin());
  return out;
}

inline Vec3 vector(const char* kernel, const char* name, const py::object& v) {
  const In<double> view(kernel, name, v, {3}, Check::finite);
  return {view[0], view[1], view[2]};
}

// Inverse by cofactors, of a matrix that has one.
inline Mat3 inverse(const Mat3& A) {
  const Vec3 a{A[0], A[1], A[2]}, b{A[3], A[4], A[5]}, c{A[6], A[7], A[8]};
  const Vec3 bc = cross(b, c), ca = cross(c, a), ab = cross(a, b);
  const double d = 1 / dot(a, bc);
  return {d * bc[0], d * ca[0], d * ab[0], d * bc[1], d * ca[1],
          d * ab[1], d * bc[2], d * ca[2], d * ab[2]};
}

// A camera and its motion, X_cur = R X_prev + t: movers/moving_plane.py's View.
struct View {
  View(const char* kernel, const py::object& o)
      : K(matrix(kernel, "K", o.attr("K"))), R(matrix(kernel, "R", o.attr("R"))),
        t(vector(kernel, "t", o.attr("t"))), inverse_K(inverse(K)) {}
  bool drives() const { return t[0] != 0 || t[1] != 0 || t[2] != 0; }
  Mat3 K, R;
  Vec3 t;
  Mat3 inverse_K;
};

// Starts of regions (R,) must rise from 0 and stay below the number of rows.
inline void check_first(const char* kernel, const In<std::int64_t>& first, py::ssize_t rows) {
  for (py::ssize_t r = 0; r < first.size(); ++r)
    require(first[r] >= 0 && first[r] < rows && (r ? first[r] > first[r - 1] : first[r] == 0),
            kernel, "first must rise from 0 and stay below the number of blocks");
}

// The grid of the smallest blocks, and who covers it.
class BlockGrid {
 public:
  BlockGrid(std::int64_t width, std::int64_t height)
      : columns_((width + SIZE - 1) / SIZE), rows_((height + SIZE - 1) / SIZE),
        owner_(columns_ * rows_ + 1, -1) {}

  // Paints blocks with their numbers, corner by corner: of one corner the later block wins.
  template <typename X, typename Size>
  void paint(const X& x, const Size& block, const std::vector<std::int64_t>& those) {
    paint(x, block, those, [](std::int64_t i) { return static_cast<int>(i); });
  }
  // The same with other numbers.
  template <typename X, typename Size, typename Number>
  void paint(const X& x, const Size& block, const std::vector<std::int64_t>& those,
             Number number) {
    const auto n = those.size();
    const auto cells_from = [&](int axis, int corner, std::int64_t cells, std::vector<int>& out) {
      for (std::size_t k = 0; k < n; ++k) {
        const auto i = those[k];
        const double size = block(i, axis);
        out[k] = corner < size ? clipped(x(i, axis) - size / 2 + corner + 0.5, cells) : -1;
      }
    };
    std::vector<int> column(n), upper(n), lower(n);
    cells_from(1, 0, rows_, upper);
    cells_from(1, SIZE, rows_, lower);
    for (int dx = 0; dx < MACROBLOCK; dx += SIZE) {
      cells_from(0, dx, columns_, column);
      for (const auto* row : {&upper, &lower})
        for (std::size_t k = 0; k < n; ++k) {
          const int r = (*row)[k], c = column[k];
          owner_[(r | c) < 0 ? size() : r * columns_ + c] = number(those[k]);
        }
    }
  }

  // The number at a pixel, -1 outside of the picture or where nothing was painted.
  std::int64_t operator()(double x, double y) const {
    const bool inside =
        x >= -0.5 && x < columns_ * SIZE - 0.5 && y >= -0.5 && y < rows_ * SIZE - 0.5;
    return inside ? owner_[at(x, y)] : -1;
  }

  std::int64_t columns() const { return columns_; }
  std::int64_t rows() const { return rows_; }
  std::int64_t size() const { return columns_ * rows_; }
  const int* data() const { return owner_.data(); }

  static constexpr int SIZE = 8, MACROBLOCK = 16;  // px, as in geometry/blocks.py

 private:
  static int clipped(double at, std::int64_t n) {  // what is not negative is cut down
    return static_cast<int>(std::min(std::max((at + 0.5) / SIZE, 0.0), n - 1.0));
  }
  std::int64_t at(double x, double y) const {
    return clipped(y, rows_) * columns_ + clipped(x, columns_);
  }

  std::int64_t columns_, rows_;
  std::vector<int> owner_;  // and one more, which takes what lies nowhere
};

// Blocks (M,) of one region after the other, and where each begins (R,).
inline py::tuple listed(const std::vector<std::vector<std::int64_t>>& regions) {
  py::ssize_t total = 0, r = 0;
  for (const auto& region : regions) total += static_cast<py::ssize_t>(region.size());
  Out<std::int64_t> members({total}), first({static_cast<py::ssize_t>(regions.size())});
  total = 0;
  for (const auto& region : regions) {
    first[r++] = total;
    for (const auto i : region) members[total++] = i;
  }
  return py::make_tuple(members.array(), first.array());
}

}  // namespace kernels
