// Movers in the picture: how each moves there, where its outline moves on to, and what around it
// moves as it does; see movers/mask.py and movers/possibly_dynamic.py.

#include <algorithm>
#include <cmath>
#include <vector>

#include "arrays.hpp"
#include "blocks.hpp"
#include "movers.hpp"

namespace kernels {
namespace {

constexpr double SIZE = MACROBLOCK;   // px
constexpr double MOST_GROWTH = 0.5;  // of a mover in a pair

// Centre, shift and growth (5,) of the vectors of some blocks, back in time, without those that are
// ``stray`` times as far off as the middle one; None for fewer than ``least``.
py::object motion_in_picture(const py::object& x_cur, const py::object& x_prev,
                             const py::object& member, std::int64_t least, double stray,
                             double weak) {
  constexpr auto kernel = "motion_in_picture";
  const In<float> cur(kernel, "x_cur", x_cur, {ANY, 2});
  const In<float> prev(kernel, "x_prev", x_prev, {cur.size(), 2});
  const In<bool> chosen(kernel, "member", member, {cur.size()});
  std::vector<py::ssize_t> at;
  for (py::ssize_t i = 0; i < cur.size(); ++i)
    if (chosen[i]) at.push_back(i);
  if (static_cast<std::int64_t>(at.size()) < std::max<std::int64_t>(least, 1)) return py::none();
  double centre[2] = {}, shift[2];
  for (int axis = 0; axis < 2; ++axis) {
    std::vector<double> vectors;
    for (const auto i : at) {
      centre[axis] += cur(i, axis);
      vectors.push_back(static_cast<double>(prev(i, axis)) - cur(i, axis));
    }
    centre[axis] /= static_cast<double>(at.size());
    shift[axis] = median(std::move(vectors));
  }
  const auto left = [&](py::ssize_t i, int axis) {
    return static_cast<double>(prev(i, axis)) - cur(i, axis) - shift[axis];
  };
  std::vector<double> lengths;
  for (const auto i : at) lengths.push_back(std::hypot(left(i, 0), left(i, 1)));
  const double far = stray * median(lengths) + 1;
  double along = 0, square = weak * weak;
  for (std::size_t k = 0; k < at.size(); ++k)
    for (int axis = 0; axis < 2 && lengths[k] <= far; ++axis) {
      const double off = cur(at[k], axis) - centre[axis];
      along += off * left(at[k], axis);
      square += off * off;
    }
  Out<double> out({5});
  const double row[5] = {centre[0], centre[1], shift[0], shift[1],
                         std::clamp(along / square, -MOST_GROWTH, MOST_GROWTH)};
  std::copy_n(row, 5, out.data());
  return out.array();
}

// What was seen (M,) of the macroblocks of a mover, moved on by a motion as above; -1, as where
// nothing was seen, where that lies in the future or ``lifetime`` or more ago.
py::array_t<std::int64_t> carry_cells(const py::object& seen_, const py::object& motion_,
                                      std::int64_t width, std::int64_t height, std::int64_t stamp,
                                      std::int64_t lifetime) {
  constexpr auto kernel = "carry_cells";
  require(width > 0 && height > 0 && width < (1 << 20) && height < (1 << 20), kernel,
          "a picture has a size");
  const std::int64_t columns = macroblocks(static_cast<int>(width)),
                     rows = macroblocks(static_cast<int>(height));
  const In<std::int64_t> seen(kernel, "seen", seen_, {columns * rows});
  const In<double> motion(kernel, "motion", motion_, {5}, Check::finite);
  Out<std::int64_t> out({columns * rows});
  const auto from = [&](double at, int axis, std::int64_t n) -> std::int64_t {
    const double x = at + motion[2 + axis] + motion[4] * (at - motion[axis]);
    const double cell = std::floor((x + 0.5) / SIZE);
    return cell >= 0 && cell < static_cast<double>(n) ? static_cast<std::int64_t>(cell) : -1;
  };
  std::vector<std::int64_t> column(columns);
  for (std::int64_t c = 0; c < columns; ++c)
    column[c] = from(SIZE * static_cast<double>(c) + (SIZE - 1) / 2, 0, columns);
  for (std::int64_t r = 0; r < rows; ++r) {
    const auto row = from(SIZE * static_cast<double>(r) + (SIZE - 1) / 2, 1, rows);
    for (std::int64_t c = 0; c < columns; ++c) {
      const auto when = row < 0 || column[c] < 0 ? -1 : seen[row * columns + column[c]];
      out[r * columns + c] = when > stamp || stamp - when >= lifetime ? -1 : when;
    }
  }
  return out.array();
}

// Which blocks (N,) on no plane lie around some mover of those with ids (K,) and move by its
// homography (K, 3, 3), x_prev ~ H x_cur, to ``slack`` px and that share of their parallax (N,).
py::array_t<bool> blocks_like_movers(const py::object& x_cur, const py::object& x_prev,
                                     const py::object& plane_id, const py::object& parallax_,
                                     const py::object& ids_, const py::object& H_,
                                     const py::tuple& reach, const py::tuple& slack) {
  constexpr auto kernel = "blocks_like_movers";
  const In<float> cur(kernel, "x_cur", x_cur, {ANY, 2});
  const auto n = cur.size();
  const In<float> prev(kernel, "x_prev", x_prev, {n, 2});
  const In<std::int32_t> plane(kernel, "plane_id", plane_id, {n});
  const In<double> parallax(kernel, "parallax", parallax_, {n});
  const In<std::int64_t> ids(kernel, "ids", ids_, {ANY});
  const In<double> rows(kernel, "homographies", H_, {ids.size(), 9});
  const double above = reach[0].cast<double>(), below = reach[1].cast<double>();
  const double least = slack[0].cast<double>(), share = slack[1].cast<double>();
  Out<bool> out({n});
  for (py::ssize_t k = 0; k < ids.size(); ++k) {
    double low[2] = {HUGE_VAL, HUGE_VAL}, high[2] = {-HUGE_VAL, -HUGE_VAL};
    for (py::ssize_t i = 0; i < n; ++i)
      for (int axis = 0; axis < 2 && plane[i] == ids[k]; ++axis) {
        low[axis] = std::min<double>(low[axis], cur(i, axis));
        high[axis] = std::max<double>(high[axis], cur(i, axis));
      }
    const double tall = high[1] - low[1] + 2 * SIZE;
    const double left = low[0] - SIZE, right = high[0] + SIZE,
                 top = low[1] - SIZE - above * tall, bottom = high[1] + SIZE + below * tall;
    const double* H = rows.data() + 9 * k;
    for (py::ssize_t i = 0; i < n; ++i) {
      const double x = cur(i, 0), y = cur(i, 1);
      if (plane[i] >= 0 || !(x >= left && x <= right && y >= top && y <= bottom)) continue;
      const double z = H[6] * x + H[7] * y + H[8];
      const double dx = (H[0] * x + H[1] * y + H[2]) / z - prev(i, 0),
                   dy = (H[3] * x + H[4] * y + H[5]) / z - prev(i, 1);
      if (std::hypot(dx, dy) < least + share * parallax[i]) out[i] = true;
    }
  }
  return out.array();
}

}  // namespace
}  // namespace kernels

void bind_silhouettes(kernels::py::module_& module) {
  module.def("motion_in_picture", kernels::motion_in_picture);
  module.def("carry_cells", kernels::carry_cells);
  module.def("blocks_like_movers", kernels::blocks_like_movers);
}
