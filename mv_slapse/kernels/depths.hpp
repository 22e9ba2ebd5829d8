// Inverse depths of blocks, and planes fitted to them: -plane . ray = rho, linear in the plane.

#pragma once

#include <cstring>
#include <limits>
#include <vector>

#include "arrays.hpp"
#include "lanes.hpp"
#include "small.hpp"

namespace kernels {

constexpr double INFINITE = std::numeric_limits<double>::infinity();

inline Vec3 vector3(const char* kernel, const char* name, const py::object& object) {
  const In<double> v(kernel, name, object, {3}, Check::finite);
  return {v[0], v[1], v[2]};
}

inline Mat3 matrix3(const double* from) {
  Mat3 A;
  std::memcpy(A.data(), from, sizeof A);
  return A;
}

// Inverse of a symmetric positive definite matrix; false where it is not.
inline bool inverse(Mat3 A, Mat3& out) {
  if (!cholesky(A.data(), 3)) return false;
  for (int j = 0; j < 3; ++j) {
    double column[3] = {j == 0 ? 1.0 : 0.0, j == 1 ? 1.0 : 0.0, j == 2 ? 1.0 : 0.0};
    cholesky_solve(A.data(), 3, column);
    for (int i = 0; i < 3; ++i) out[3 * i + j] = column[i];
  }
  return true;
}

inline double trace(const Mat3& A) { return A[0] + A[4] + A[8]; }

// Rays and inverse depths in standard deviations, by column: error = rays . plane + rho.
// Columns end with LANES zeros, which may be read.
struct Whitened {
  std::vector<double> ray[3], rho;
  int n = 0;

  void resize(int size) {
    n = size;
    for (auto* column : {&ray[0], &ray[1], &ray[2], &rho}) column->assign(static_cast<std::size_t>(size) + LANES, 0.0);
  }
  double error(int i, const Vec3& plane) const {
    return ray[0][i] * plane[0] + ray[1][i] * plane[1] + ray[2][i] * plane[2] + rho[i];
  }
};

// A plane's normal equations: A plane = b.
struct Equations {
  Mat3 A{};
  Vec3 b{};

  void mirror() {
    A[3] = A[1];
    A[6] = A[2];
    A[7] = A[5];
  }
  void ridge(double share) {
    const double more = share * trace(A) + 1e-12;  // never singular
    for (int i = 0; i < 9; i += 4) A[i] += more;
  }
};

// Weights of Geman and McClure for errors; `softness` is 1 / width^2.
KERNELS_INLINE Four geman_mcclure(const Four& error, double softness) {
  const Four d = 1 + error * error * softness;
  return 1 / (d * d);
}

struct Gaussian {
  Vec3 plane;
  Mat3 covariance;
};

// Sums of a plane's equations over n blocks (ray, rho), each weighted by its error on the plane, in
// their order; n is a multiple of LANES, and the last may be zeros.
KERNELS_WIDE
static Equations equations(const double* blocks, std::size_t n, const Vec3& plane,
                           double softness) {
  Four sums[3] = {};
  for (const double* end = blocks + LANES * n; blocks < end; blocks += LANES * LANES) {
    Four b[LANES];
    for (std::size_t k = 0; k < LANES; ++k) b[k] = load(blocks + LANES * k);
    const Four3 ray{{b[0][0], b[1][0], b[2][0], b[3][0]},
                    {b[0][1], b[1][1], b[2][1], b[3][1]},
                    {b[0][2], b[1][2], b[2][2], b[3][2]}};
    const Four rho{b[0][3], b[1][3], b[2][3], b[3][3]};
    const Four weight = geman_mcclure(dot(ray, plane) + rho, softness);
    for (std::size_t k = 0; k < LANES; ++k) {
      const Four weighted = weight[k] * b[k];
      for (int j = 0; j < 3; ++j) sums[j] += weighted[j] * b[k];
    }
  }
  Equations e;
  for (int j = 0; j < 3; ++j) {
    for (int k = j; k < 3; ++k) e.A[3 * j + k] = sums[j][k];
    e.b[j] -= sums[j][3];
  }
  e.mirror();
  return e;
}

// Reweighted least squares of a plane from a start, with a prior (mean, information) or none.
inline Gaussian refined(const Whitened& blocks, const std::vector<int>& which, Vec3 plane,
                        double softness, int steps, const Gaussian* prior = nullptr) {
  const std::size_t n = (which.size() + LANES - 1) / LANES * LANES;
  std::vector<double> own(LANES * n);
  for (std::size_t k = 0; k < which.size(); ++k) {
    for (int j = 0; j < 3; ++j) own[LANES * k + j] = blocks.ray[j][which[k]];
    own[LANES * k + 3] = blocks.rho[which[k]];
  }
  Gaussian out{plane, {}};
  for (int step = 0; step < steps; ++step) {
    Equations e = equations(own.data(), n, out.plane, softness);
    if (prior) {
      e.b = e.b + prior->covariance * prior->plane;
      for (int i = 0; i < 9; ++i) e.A[i] += prior->covariance[i];
    }
    e.ridge(1e-9);
    inverse(e.A, out.covariance);
    out.plane = out.covariance * e.b;
  }
  return out;
}

}  // namespace kernels
