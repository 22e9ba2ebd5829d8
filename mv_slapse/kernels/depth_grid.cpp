// Inverse depths by macroblock, carried from pair to pair; see surfaces/depth_grid.py.

#include <algorithm>
#include <cmath>

#include "depths.hpp"

namespace kernels {
namespace {

constexpr double MACROBLOCK = 16;  // px
constexpr double NONE = 1e-18;     // least divisor

// What a grid (rows, columns) of inverse depths and information tells of pixels (N, 2), whose rays
// are moved by X_cur = R X_prev + t, |t| = 1 = `ratio` old baselines: rho, information (N,).
py::tuple carry_depths(const py::object& grid, const py::object& information,
                       const py::object& x_prev, const py::object& rays_prev, const py::object& R,
                       const py::object& t, double ratio, const py::dict& is) {
  const char* name = "carry_depths";
  const In<double> depth(name, "grid", grid, {ANY, ANY}, Check::finite);
  const auto rows = depth.size(), columns = depth.size(1);
  const In<double> known(name, "information", information, {rows, columns}, Check::finite);
  const In<double> x(name, "x_prev", x_prev, {ANY, 2}, Check::finite);
  const auto n = x.size();
  const In<double> ray(name, "rays_prev", rays_prev, {n, 3}, Check::finite);
  const Mat3 turn = matrix3(In<double>(name, "R", R, {3, 3}, Check::finite).data());
  const Vec3 way = vector3(name, "t", t);
  const double least = policy(is, "least_weight"), same = policy(is, "same_surface"),
               forgetting = policy(is, "forgetting"), drift = policy(is, "drift");
  Out<double> rho({n}), weight({n});
  for (py::ssize_t i = 0; i < n; ++i) {
    const double place[2] = {(x(i, 0) + 0.5) / MACROBLOCK - 0.5,
                             (x(i, 1) + 0.5) / MACROBLOCK - 0.5};
    if (!(place[0] > -1 && place[1] > -1 && place[0] < static_cast<double>(columns) &&
          place[1] < static_cast<double>(rows)))
      continue;
    const auto left = static_cast<py::ssize_t>(std::floor(place[0])),
               top = static_cast<py::ssize_t>(std::floor(place[1]));
    // Inverse depth is linear on a plane: bilinear interpolation of what is known.
    double total = 0, mean = 0, variance = 0, low = INFINITE, high = 0;
    for (py::ssize_t row = std::max<py::ssize_t>(top, 0); row <= std::min(top + 1, rows - 1); ++row)
      for (py::ssize_t column = std::max<py::ssize_t>(left, 0);
           column <= std::min(left + 1, columns - 1); ++column) {
        const double share = (1 - std::abs(place[0] - static_cast<double>(column))) *
                             (1 - std::abs(place[1] - static_cast<double>(row)));
        const double here = depth(row, column), sure = known(row, column);
        if (sure == 0 || share <= 0) continue;
        total += share;
        mean += share * here;
        variance += share * share / std::max(sure, NONE);
        low = std::min(low, here);
        high = std::max(high, here);
      }
    if (!(total > least && high < same * low)) continue;
    const double was = ratio * mean / total;
    variance *= ratio * ratio / (total * total);
    const double ahead = ray(i, 0) * turn[6] + ray(i, 1) * turn[7] + ray(i, 2) * turn[8];
    const double nearer = ahead + was * way[2];
    if (!(nearer > 0)) continue;  // behind the camera now
    rho[i] = was / nearer;
    const double slope = ahead / (nearer * nearer), error = drift * rho[i];
    weight[i] = 1 / (slope * slope * variance / forgetting + error * error + NONE);
  }
  return py::make_tuple(rho.array(), weight.array());
}

// Depths (N,) joined with what was known of each beforehand, unless it contradicts.
py::tuple join_depths(const py::object& rho, const py::object& sigma, const py::object& before,
                      const py::object& information, double gate) {
  const char* name = "join_depths";
  const In<double> own(name, "rho", rho, {ANY}, Check::finite);
  const auto n = own.size();
  const In<double> blur(name, "sigma", sigma, {n}, Check::finite);
  const In<double> known(name, "before", before, {n}, Check::finite);
  const In<double> sure(name, "information", information, {n}, Check::finite);
  Out<double> joined({n}), sharper({n});
  for (py::ssize_t i = 0; i < n; ++i) {
    const double off = known[i] - own[i], share = blur[i] * blur[i] * sure[i];
    const double gain = off * off * sure[i] < gate * (1 + share) ? share / (1 + share) : 0;
    joined[i] = own[i] + gain * off;
    sharper[i] = blur[i] * std::sqrt(1 - gain);
  }
  return py::make_tuple(joined.array(), sharper.array());
}

// A grid (rows, columns) of the depths of chosen blocks: rho, weighted by accuracy, information.
py::tuple note_depths(const py::object& rho, const py::object& sigma, const py::object& x,
                      const py::object& chosen, py::ssize_t rows, py::ssize_t columns) {
  const char* name = "note_depths";
  const In<double> depth(name, "rho", rho, {ANY}, Check::finite);
  const auto n = depth.size();
  const In<double> blur(name, "sigma", sigma, {n}, Check::finite);
  const In<double> pixels(name, "x", x, {n, 2}, Check::finite);
  const In<bool> use(name, "chosen", chosen, {n});
  Out<double> mean({rows, columns}), information({rows, columns});
  std::vector<int> count(rows * columns);
  for (py::ssize_t i = 0; i < n; ++i) {
    const double column = std::floor((pixels(i, 0) + 0.5) / MACROBLOCK),
                 row = std::floor((pixels(i, 1) + 0.5) / MACROBLOCK);
    if (!use[i] || !(column >= 0 && row >= 0 && column < static_cast<double>(columns) &&
                     row < static_cast<double>(rows)))
      continue;
    const auto cell = static_cast<py::ssize_t>(row) * columns + static_cast<py::ssize_t>(column);
    const double each = 1 / (blur[i] * blur[i]);
    mean[cell] += each * depth[i];
    information[cell] += each;
    ++count[cell];
  }
  for (py::ssize_t cell = 0; cell < rows * columns; ++cell) {
    mean[cell] /= std::max(information[cell], NONE);
    // What one macroblock's vectors tell is hardly more than what one of them does.
    information[cell] /= std::max(count[cell], 1);
  }
  return py::make_tuple(mean.array(), information.array());
}

}  // namespace
}  // namespace kernels

void bind_depth_grid(kernels::py::module_& module) {
  using namespace kernels;
  module.def("carry_depths", carry_depths);
  module.def("join_depths", join_depths);
  module.def("note_depths", note_depths);
}
