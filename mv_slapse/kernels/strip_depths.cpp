// What strips tell of depths by where they were a while ago. movers/strip_depths.py.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "arrays.hpp"
#include "movers.hpp"
#include "small.hpp"

namespace kernels {
namespace {

constexpr double SAME = 0.5;  // px, between centres of one strip

struct StripRules {
  explicit StripRules(const py::object& o)
      : height(number(o, "height")), passes(number(o, "passes")), agrees(number(o, "agrees")) {}
  double height, passes, agrees;
};

// What one strip tells of a pair of key frames, as if it had been matched in these.
struct Told {
  std::int64_t row;  // among the blocks, or behind them
  Vec3 ray;
  double rho, noise, under, x_prev[2], parallax[2];
};

// The pair's view, and the camera's way since the earlier key frame in baselines of the pair.
struct Since {
  const View& view;
  Mat3 R;
  Vec3 t;
  Vec3 ground;
  double passes;

  // False where the strip did not move along its epipolar line.
  bool tell(double x, double y, const double* earlier, double sigma, Told& out) const {
    const double focal[2] = {view.K[0], view.K[4]};
    const Vec3 ray = out.ray = view.inverse_K * Vec3{x, y, 1};
    const Vec3 turned = R * (view.inverse_K * Vec3{earlier[0], earlier[1], 1});
    const double at[2] = {turned[0] / turned[2], turned[1] / turned[2]};
    // The inverse depth at which X = ray / rho was seen there, (1) to (5) of [MVO].
    double g[2], off[2];
    for (int a = 0; a < 2; ++a) {
      g[a] = (t[a] - at[a] * t[2]) * focal[a];
      off[a] = (ray[a] - at[a]) * focal[a];
    }
    const double length = std::hypot(g[0], g[1]);
    if (!(std::abs(off[0] * g[1] - off[1] * g[0]) < passes * length)) return false;
    out.rho = (off[0] * g[0] + off[1] * g[1]) / square(length);
    out.noise = sigma * std::abs(1 - out.rho * t[2]) / length;
    out.under = -dot(ray, ground);
    // The same depth, seen in the pair.
    Vec3 X;
    for (int a = 0; a < 3; ++a) X[a] = ray[a] - out.rho * view.t[a];
    const Vec3 before = view.K * (transposed(view.R) * X);
    for (int a = 0; a < 2; ++a) {
      out.x_prev[a] = before[a] / before[2];
      out.parallax[a] = (ray[a] - X[a] / X[2]) * focal[a];
    }
    return std::isfinite(out.noise + out.x_prev[0] + out.x_prev[1]) && before[2] > 0;
  }
};

py::tuple strip_depths(const py::object& blocks, const py::tuple& strips, const py::tuple& way,
                       const py::object& view_, const py::object& ground,
                       const py::object& constants) {
  constexpr auto kernel = "strip_depths";
  const In<double> x(kernel, "x", blocks.attr("x"), {ANY, 2});
  const auto n = x.size();
  const In<double> block(kernel, "block", blocks.attr("block"), {n, 2}),
      rho(kernel, "rho", blocks.attr("rho"), {n}), noise(kernel, "noise", blocks.attr("noise"), {n});
  require(strips.size() == 3 && way.size() == 2, kernel, "strips are three columns, a way two");
  const In<double> x_cur(kernel, "x_cur", strips[0], {ANY, 2}, Check::finite);
  const auto m = x_cur.size();
  const In<double> x_earlier(kernel, "x_earlier", strips[1], {m, 2}, Check::finite),
      sigma(kernel, "sigma", strips[2], {m}, Check::finite);
  const View view(kernel, view_);
  const StripRules rules(constants);
  const Since since{view, matrix(kernel, "R", way[0]), vector(kernel, "t", way[1]),
                    vector(kernel, "ground", ground), rules.passes};
  std::vector<py::ssize_t> cut;
  for (py::ssize_t i = 0; i < n; ++i)
    if (block(i, 1) == rules.height) cut.push_back(i);
  std::vector<Told> told;
  auto next = n;
  for (py::ssize_t k = 0; k < m; ++k) {
    Told strip;
    if (!since.tell(x_cur(k, 0), x_cur(k, 1), &x_earlier(k, 0), sigma[k], strip)) continue;
    const auto same = std::find_if(cut.begin(), cut.end(), [&](py::ssize_t i) {
      return std::abs(x(i, 0) - x_cur(k, 0)) < SAME && std::abs(x(i, 1) - x_cur(k, 1)) < SAME;
    });
    if (same != cut.end() && !(strip.noise < noise[*same] &&
                               std::abs(strip.rho - rho[*same]) < rules.agrees * noise[*same]))
      continue;
    strip.row = same == cut.end() ? next++ : *same;
    told.push_back(strip);
  }
  const auto found = static_cast<py::ssize_t>(told.size());
  Out<std::int64_t> rows({found});
  Out<double> rhos({found}), noises({found}), at({found, 2}), x_prev({found, 2}),
      parallax({found, 2}), under({found});
  for (py::ssize_t i = 0; i < found; ++i) {
    const Told& strip = told[i];
    rows[i] = strip.row;
    rhos[i] = strip.rho;
    noises[i] = strip.noise;
    const Vec3 pixel = view.K * strip.ray;
    for (int a = 0; a < 2; ++a) {
      at(i, a) = pixel[a];
      x_prev(i, a) = strip.x_prev[a];
      parallax(i, a) = strip.parallax[a];
    }
    under[i] = strip.under;
  }
  return py::make_tuple(rows.array(), rhos.array(), noises.array(), at.array(), x_prev.array(),
                        parallax.array(), under.array());
}

}  // namespace
}  // namespace kernels

void bind_strip_depths(kernels::py::module_& module) {
  module.def("strip_depths", kernels::strip_depths);
}
