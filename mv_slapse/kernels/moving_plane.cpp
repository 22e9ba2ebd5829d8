// The moving plane of a region of blocks, its gauge settled; see movers/moving_plane.py.

#include <cmath>

#include "arrays.hpp"
#include "contact.hpp"
#include "movers.hpp"
#include "small.hpp"

namespace kernels {
namespace {

constexpr int N = 6, SLOPE = 3, GAUGE = 5;  // rate, slope, ln Z

struct Gauge {
  double value, variance, by_slope[2];
  bool contact;
};

// ln Z at which t - Z g is smallest, within sensible depths.
double smallest_motion(const Vec3& rate, const Vec3& t, double nearest, double farthest) {
  if (dot(t, t) == 0) return 0.5 * (std::log(nearest) + std::log(farthest));
  const double depth = dot(rate, t) / std::max(dot(rate, rate), 1e-12);
  return std::log(std::min(std::max(depth, nearest), farthest));
}

// J P J^T
void transformed(const double (&J)[N][N], const double (&P)[N][N], double* out) {
  double half[N][N] = {};
  for (int i = 0; i < N; ++i)
    for (int k = 0; k < N; ++k)
      for (int j = 0; j < N; ++j) half[i][j] += J[i][k] * P[k][j];
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j) {
      out[N * i + j] = 0;
      for (int k = 0; k < N; ++k) out[N * i + j] += half[i][k] * J[j][k];
    }
}

// Region i of a fit of `fit_moving_surfaces`; blocks: x, block (N, 2), the members of one region
// after the other (M,), where each begins (R,) -> plane (3,), covariance (6, 6) of it and t_d, t_d
// (3,), (t - t_d) plane^T (3, 3), whether the ground settled the gauge, or None where too few
// vectors agree
py::object settle_surface(const py::tuple& fit, const py::tuple& blocks, std::int64_t i,
                          const py::object& camera, const py::object& ground_,
                          const py::object& constants) {
  constexpr auto kernel = "settle_surface";
  require(fit.size() == 5 && blocks.size() == 4, kernel,
          "a fit has five columns, and blocks have x, block, members, first");
  const In<std::int64_t> members(kernel, "members", blocks[2], {ANY}),
      first(kernel, "first", blocks[3], {ANY});
  const In<double> x(kernel, "x", blocks[0], {ANY, 2}),
      block(kernel, "block", blocks[1], {x.size(), 2});
  const auto regions = first.size();
  const In<double> theta_(kernel, "theta", fit[0], {regions, 5}),
      fitted(kernel, "covariance", fit[1], {regions, 5, 5}),
      centre_(kernel, "centre", fit[2], {regions, 2});
  const In<bool> inlier(kernel, "inlier", fit[3], {members.size()});
  check_first(kernel, first, members.size());
  require(i >= 0 && i < regions, kernel, "there must be such a region");
  const auto begin = first[i], end = i + 1 < regions ? first[i + 1] : members.size();
  std::vector<std::int64_t> agree;
  for (auto k = begin; k < end; ++k) {
    require(members[k] >= 0 && members[k] < x.size(), kernel, "members must be blocks");
    if (inlier[k]) agree.push_back(members[k]);
  }
  const double *theta = &theta_(i, 0), *centre = &centre_(i, 0), *slope = theta + SLOPE;
  bool finite = true;
  for (int k = 0; k < GAUGE; ++k) finite &= std::isfinite(theta[k]);
  const auto least = std::max(number(constants, "least"), 0.5 * static_cast<double>(end - begin));
  if (!finite || static_cast<double>(agree.size()) < least) return py::none();
  const Mat3 K = matrix(kernel, "K", camera.attr("K"));
  const Vec3 t = vector(kernel, "t", camera.attr("t")), rate{theta[0], theta[1], theta[2]};
  Gauge gauge{0, 0, {}, false};
  if (!ground_.is_none()) {
    const auto at = [&](std::size_t k, int what) {
      return what == 2 ? block(agree[k], 1) : x(agree[k], what);
    };
    const Contact foot = contact_of(agree.size(), at, number(constants, "covered"));
    const ContactDepth found =
        contact_depth(vector(kernel, "ground", ground_), foot, K, slope, centre);
    if (found.tells)
      gauge = {found.value, square(found.sigma), {found.by_slope[0], found.by_slope[1]}, true};
  }
  if (!gauge.contact) {
    gauge.variance = square(number(constants, "free_sigma"));
    gauge.value = smallest_motion(rate, t, number(constants, "nearest"),
                                  number(constants, "farthest"));
  }
  // Of (rate, slope, ln Z): the gauge goes with the slope.
  double open[N][N] = {}, by_theta[N][N] = {}, P[N][N];
  for (int r = 0; r < GAUGE; ++r) {
    by_theta[r][r] = 1;
    for (int s = 0; s < GAUGE; ++s) open[r][s] = fitted.data()[(5 * i + r) * 5 + s];
  }
  for (int k = 0; k < 2; ++k) by_theta[GAUGE][SLOPE + k] = gauge.by_slope[k];
  transformed(by_theta, open, &P[0][0]);
  P[GAUGE][GAUGE] += gauge.variance;
  const double depth = std::exp(gauge.value);
  const Vec3 w{slope[0], slope[1], 1 - (slope[0] * centre[0] + slope[1] * centre[1])};
  Out<double> plane({3}), t_d({3}), covariance({N, N}), product({3, 3});
  double J[N][N] = {};
  for (int k = 0; k < 3; ++k) {
    plane[k] = -w[k] / depth;
    t_d[k] = t[k] - rate[k] * depth;
    for (int j = 0; j < 3; ++j) product(k, j) = -(rate[k] * w[j]);
    J[k][GAUGE] = -plane[k];
    J[3 + k][k] = -depth;
    J[3 + k][GAUGE] = -(rate[k] * depth);
  }
  for (int k = 0; k < 2; ++k) {
    J[k][SLOPE + k] = -1 / depth;
    J[2][SLOPE + k] = centre[k] / depth;
  }
  transformed(J, P, covariance.data());
  return py::make_tuple(plane.array(), covariance.array(), t_d.array(), product.array(),
                        gauge.contact);
}

}  // namespace
}  // namespace kernels

void bind_moving_plane(kernels::py::module_& module) {
  module.def("settle_surface", kernels::settle_surface);
}
