// Where a region of blocks meets the ground, and how far off that is; see benchmarks/papers/moving_plane.py.

#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "small.hpp"

namespace kernels {

struct Contact {
  double x, y, sigma;
};

struct ContactDepth {
  double value, sigma;  // of ln Z
  double by_slope[2];
  bool tells;
};

// Of n blocks; `at(i, k)` is x, y, height of one.
template <typename At>
Contact contact_of(std::size_t n, const At& at, double covered) {
  std::vector<double> bottom(n);
  for (std::size_t i = 0; i < n; ++i) bottom[i] = at(i, 1) + 0.5 * at(i, 2);
  auto sorted = bottom;
  std::sort(sorted.begin(), sorted.end());
  const double edge = n > 3 ? sorted[n - 2] : sorted.back();
  double sum = 0, height = 0;
  int number = 0;
  for (std::size_t i = 0; i < n; ++i)
    if (bottom[i] >= edge - 0.5) {
      sum += at(i, 0);
      height = std::max(height, at(i, 2));
      ++number;
    }
  return {sum / number, edge - (0.5 - covered) * height, height / std::sqrt(12.0)};
}

inline void ray_of(const Mat3& K, const double* x, double* ray) {
  ray[1] = (x[1] - K[5]) / K[4];
  ray[0] = (x[0] - K[2]) / K[0] - K[1] / K[0] * ray[1];
}

// Depth of a region's centre from the ground under its lower edge, by slope (2,) and centre (2,).
inline ContactDepth contact_depth(const Vec3& ground, const Contact& foot, const Mat3& K,
                                  const double* slope, const double* centre) {
  const double point[2] = {foot.x, foot.y};
  Vec3 ray{0, 0, 1};
  ray_of(K, point, ray.data());
  const double offset[2] = {ray[0] - centre[0], ray[1] - centre[1]};
  const double rho = -dot(ground, ray);
  const double relative = 1 + slope[0] * offset[0] + slope[1] * offset[1];
  const double sigma = rho > 0 ? std::abs(ground[1] / K[4]) * foot.sigma / rho : HUGE_VAL;
  if (!(sigma < 0.5) || relative < 0.2) return {0, 0, {}, false};
  return {std::log(relative / rho), sigma, {offset[0] / relative, offset[1] / relative}, true};
}

}  // namespace kernels
