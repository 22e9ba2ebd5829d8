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

  // Adds a block, whose weight is that of its squared error.
  void add(const Whitened& blocks, int i, double weight) {
    const double r[3] = {blocks.ray[0][i], blocks.ray[1][i], blocks.ray[2][i]};
    for (int j = 0; j < 3; ++j) {
      const double w = weight * r[j];
      for (int k = j; k < 3; ++k) A[3 * j + k] += w * r[k];
      b[j] -= w * blocks.rho[i];
    }
  }
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

// Weight of Geman and McClure for a squared error; `softness` is 1 / width^2.
inline double geman_mcclure(double squared, double softness) {
  const double d = 1 + squared * softness;
  return 1 / (d * d);
}

struct Gaussian {
  Vec3 plane;
  Mat3 covariance;
};

// Reweighted least squares of a plane from a start, with a prior (mean, information) or none.
inline Gaussian refined(const Whitened& blocks, const std::vector<int>& which, Vec3 plane,
                        double softness, int steps, const Gaussian* prior = nullptr) {
  Gaussian out{plane, {}};
  for (int step = 0; step < steps; ++step) {
    Equations e;
    for (const int i : which) {
      const double error = blocks.error(i, out.plane);
      e.add(blocks, i, geman_mcclure(error * error, softness));
    }
    e.mirror();
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
