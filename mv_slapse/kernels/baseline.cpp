// Depths by macroblock, and how long a baseline is against the one before it.

#include <algorithm>
#include <limits>
#include <numeric>

#include "arrays.hpp"
#include "two_view.hpp"

namespace kernels {
namespace {

constexpr double SIZE = 16;  // px, a macroblock
constexpr double UNKNOWN = std::numeric_limits<double>::quiet_NaN();

struct Policy {
  double same_surface;  // share of inverse depth by which blocks of one surface differ next door
  double max_spread;    // a depth's error by which two pairs may differ, as a share of it
  double change;        // common change of log(speed) from pair to pair
  int min_neighbours, min_blocks;
};

struct Map {  // see DepthMap
  In<std::int64_t> grid;
  In<double> x, rho, noise;
  double approach, relief;

  // Of a block where its surface has about `depth`: a block's own depth must not set its weight in
  // a mean, as what errs low would count more.
  double variance(std::int64_t block, double depth) const {
    const double along = 1 - depth * approach, own = noise[block] * along * along;
    return std::max(own * own + relief * relief * depth * depth, 1e-24);
  }
};

Map map_of(const char* kernel, const py::tuple& of) {
  require(of.size() == 6, kernel, "a map must be (grid, x, rho, noise, approach, relief)");
  const In<double> rho(kernel, "rho", of[2], {ANY});
  const In<std::int64_t> grid(kernel, "grid", of[0], {ANY, ANY});
  require(grid.size(0) > 2 && grid.size(1) > 2, kernel, "grid must have a margin of one");
  for (py::ssize_t k = 0; k < grid.size(0) * grid.size(1); ++k)
    require(grid[k] < rho.size(), kernel, "grid names a block that is not given");
  return {grid, In<double>(kernel, "x", of[1], {rho.size(), 2}, Check::finite), rho,
          In<double>(kernel, "noise", of[3], {rho.size()}), of[4].cast<double>(),
          of[5].cast<double>()};
}

Policy policy_of(const char* kernel, const py::object& values) {
  const In<double> of(kernel, "policy", values, {5}, Check::finite);
  return {of[0], of[1], of[2], static_cast<int>(of[3]), static_cast<int>(of[4])};
}

std::int64_t cell(double x, std::int64_t count) {
  return std::clamp(static_cast<std::int64_t>(std::floor((x + 0.5) / SIZE)), std::int64_t{0},
                    count - 1);
}

// Interpolates at a pixel by a plane through the blocks of 3 x 3 macroblocks, as inverse depth is
// linear on planes. The nearest block's value alone would err one way: seen from the epipole a
// match lies on the inner side of its block, where a street is farther (0.2 % a pair, as measured).
void interpolate(const Map& map, const Policy& policy, double x, double y, double& value,
                 double& error) {
  value = error = UNKNOWN;
  const auto rows = map.grid.size(0) - 2, columns = map.grid.size(1) - 2;
  const auto row = cell(y, rows), column = cell(x, columns);
  const auto middle = map.grid(row + 1, column + 1);
  if (middle < 0) return;
  const double there = map.rho[middle];
  std::int64_t near[9];
  int count = 0;
  double mean = 0;
  for (int k = 0; k < 9; ++k) {
    const auto block = map.grid(row + k / 3, column + k % 3);
    if (block < 0) continue;
    const double rho = map.rho[block];
    const double gap = std::abs(rho - there) - policy.same_surface * there;
    if (gap >= 0 && !(gap * gap < 9 * map.variance(block, rho))) continue;  // 3 sigma
    near[count++] = block;
    mean += rho;
  }
  if (count < policy.min_neighbours) return;
  mean /= count;
  // A plane by least squares: s, sx, ... are the sums of its normal equations.
  double s = 0, sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0, r = 0, rx = 0, ry = 0;
  for (int k = 0; k < count; ++k) {
    const double w = 1 / map.variance(near[k], mean);
    const double dx = (map.x(near[k], 0) - x) / SIZE, dy = (map.x(near[k], 1) - y) / SIZE;
    const double rho = map.rho[near[k]];
    s += w;
    sx += w * dx;
    sy += w * dy;
    sxx += w * dx * dx;
    sxy += w * dx * dy;
    syy += w * dy * dy;
    r += w * rho;
    rx += w * dx * rho;
    ry += w * dy * rho;
  }
  const double first = sxx * syy - sxy * sxy;  // the first row of the adjugate
  const double second = sxy * sy - sx * syy, third = sx * sxy - sxx * sy;
  const double determinant = s * first + sx * second + sy * third, size = (s + sxx + syy) / 3;
  if (!(determinant > 1e-4 * size * size * size)) return;  // they lie in one row
  value = (first * r + second * rx + third * ry) / determinant;
  error = std::sqrt(first / determinant);
}

struct Ratio {
  double log = 0, sigma = std::numeric_limits<double>::infinity();
};

// Values with one over their kernels' widths, padded to whole lanes by ones that count nothing.
struct Values {
  explicit Values(std::size_t n)
      : count(n), x((n + LANES - 1) / LANES * LANES), inverse(x.size()) {}
  std::size_t count;
  std::vector<double> x, inverse;
};

// The value with the largest Lorentzian support, of at most 31 from all over the picture, which
// holds them row by row; of two modes the one nearer to what is expected may be the smaller.
KERNELS_WIDE
double mode(const Values& values, const Policy& policy, double expected) {
  const std::size_t candidates = std::min<std::size_t>(values.count, 31);
  double best = -1, at = 0;
  for (std::size_t k = 0; k < candidates; ++k) {
    const double candidate = values.x[k * values.count / candidates];
    Four total = {};
    for (std::size_t i = 0; i < values.x.size(); i += LANES) {
      const Four inverse = load(&values.inverse[i]);
      const Four off = (load(&values.x[i]) - candidate) * inverse;
      total += inverse / (1.0 + off * off);
    }
    const double unlike = (candidate - expected) / policy.change;
    const double support = sum(total) / (1 + unlike * unlike);
    if (support > best) {
      best = support;
      at = candidate;
    }
  }
  return at;
}

// Mode of values with errors sigma, refined; far values count nothing.
Ratio robust_mean(const double* value, const double* sigma, std::size_t n, const Policy& policy,
                  double expected) {
  if (n < static_cast<std::size_t>(policy.min_blocks)) return {};
  Values values(n);
  for (std::size_t i = 0; i < n; ++i) {
    values.x[i] = value[i];
    values.inverse[i] = 1 / (3 * std::max(sigma[i], 0.02));
  }
  double mean = mode(values, policy, expected), scatter = 0;
  for (int step = 0; step < 8; ++step) {
    Four total = {}, first = {}, second = {};
    for (std::size_t i = 0; i < values.x.size(); i += LANES) {
      const Four inverse = load(&values.inverse[i]), off = load(&values.x[i]) - mean;
      const Four scaled = off * inverse, kernel = inverse / (1.0 + scaled * scaled);
      const Four weight = kernel * kernel;
      total += weight;
      first += weight * off;
      second += weight * off * off;
    }
    const double move = sum(first) / sum(total);
    scatter = sum(second) / sum(total) - move * move;  // about the mean that they have
    mean += move;
  }
  int inliers = 0;
  for (std::size_t i = 0; i < n; ++i)
    inliers += std::abs(value[i] - mean) * values.inverse[i] < 1;
  if (inliers < policy.min_blocks) return {};
  return {mean, std::sqrt(std::max(scatter, 0.0) / inliers)};
}

// Robust mean of log(rho / rho around it in the other map). Errors are shares of the smooth depth,
// which nine blocks make sure: with the single one a block that errs low would weigh more.
Ratio excess(const Map& single, const Map& smooth, const Policy& policy, double expected) {
  std::vector<std::int64_t> block;
  std::vector<double> around, error, value;
  for (std::int64_t k = 0; k < single.grid.size(0) * single.grid.size(1); ++k) {
    const auto i = single.grid[k];
    if (i < 0) continue;
    double rho, sigma;
    interpolate(smooth, policy, single.x(i, 0), single.x(i, 1), rho, sigma);
    if (!(rho > 0 && single.rho[i] > 0)) continue;
    block.push_back(i);
    around.push_back(rho);
    error.push_back(sigma);
    value.push_back(std::log(single.rho[i] / rho));
  }
  if (value.size() < static_cast<std::size_t>(policy.min_blocks)) return {};
  auto sorted = value;
  const double likely_ratio = std::exp(median(sorted));
  std::size_t kept = 0;
  for (std::size_t i = 0; i < value.size(); ++i) {
    const double likely = likely_ratio * around[i];
    const double own = single.variance(block[i], likely) / (likely * likely);
    const double other = error[i] / around[i], spread = std::sqrt(own + other * other);
    if (!(spread < policy.max_spread)) continue;
    value[kept] = value[i];
    error[kept++] = spread;
  }
  return robust_mean(value.data(), error.data(), kept, policy, expected);
}

}  // namespace
}  // namespace kernels

void bind_baseline(kernels::py::module_& module) {
  using namespace kernels;
  // -> grid (rows + 2, columns + 2): the last usable block in each macroblock, -1 for none
  module.def("depth_grid", [](const py::object& x, const py::object& usable, py::ssize_t rows,
                              py::ssize_t columns) {
    const char* kernel = "depth_grid";
    const In<double> place(kernel, "x", x, {ANY, 2}, Check::finite);
    const In<bool> use(kernel, "usable", usable, {place.size()});
    require(rows > 0 && columns > 0, kernel, "rows and columns must be positive");
    Out<std::int64_t> grid({rows + 2, columns + 2});
    std::fill_n(grid.data(), (rows + 2) * (columns + 2), -1);
    for (py::ssize_t i = 0; i < place.size(); ++i)
      if (use[i]) grid(cell(place(i, 1), rows) + 1, cell(place(i, 0), columns) + 1) = i;
    return grid.array();
  });
  // -> inverse depths (N,) as camera k-1 sees them, and which (N,) are before it
  module.def("previous_depths", [](const py::object& rays_cur, const py::object& rho,
                                   const py::object& usable, const py::object& R,
                                   const py::object& t) {
    const char* kernel = "previous_depths";
    const In<double> depth(kernel, "rho", rho, {ANY}), view(kernel, "R", R, {3, 3}, Check::finite);
    const In<double> rays(kernel, "rays_cur", rays_cur, {depth.size(), 3}, Check::finite);
    const In<double> way(kernel, "t", t, {3}, Check::finite);
    const In<bool> use(kernel, "usable", usable, {depth.size()});
    Out<double> out({depth.size()});
    Out<bool> before({depth.size()});
    for (py::ssize_t i = 0; i < depth.size(); ++i) {
      double z = 0;
      for (int k = 0; k < 3; ++k) z += (rays(i, k) / depth[i] - way[k]) * view(k, 2);
      before[i] = use[i] && depth[i] > 0 && z > 0;
      out[i] = before[i] ? 1 / z : 1;
    }
    return py::make_tuple(out.array(), before.array());
  });
  // map: see DepthMap -> rho (N,), sigma (N,), NaN where it cannot be told
  module.def("depths_at", [](const py::tuple& map, const py::object& x, const py::object& policy) {
    const char* kernel = "depths_at";
    const In<double> place(kernel, "x", x, {ANY, 2}, Check::finite);
    const Map from = map_of(kernel, map);
    const Policy how = policy_of(kernel, policy);
    Out<double> value({place.size()}), error({place.size()});
    for (py::ssize_t i = 0; i < place.size(); ++i)
      interpolate(from, how, place(i, 0), place(i, 1), value[i], error[i]);
    return py::make_tuple(value.array(), error.array());
  });
  // -> log, sigma
  module.def("depth_excess", [](const py::tuple& single, const py::tuple& smooth,
                                const py::object& policy, double expected) {
    const char* kernel = "depth_excess";
    const Ratio out = excess(map_of(kernel, single), map_of(kernel, smooth),
                             policy_of(kernel, policy), expected);
    return py::make_tuple(out.log, out.sigma);
  });
  module.def("robust_mean", [](const py::object& value, const py::object& sigma,
                               const py::object& policy, double expected) {
    const char* kernel = "robust_mean";
    const In<double> values(kernel, "value", value, {ANY}, Check::finite);
    const In<double> errors(kernel, "sigma", sigma, {values.size()}, Check::finite);
    const Ratio out = robust_mean(values.data(), errors.data(),
                                  static_cast<std::size_t>(values.size()),
                                  policy_of(kernel, policy), expected);
    return py::make_tuple(out.log, out.sigma);
  });
}
