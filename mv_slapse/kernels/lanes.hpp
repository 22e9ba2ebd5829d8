// Four blocks at a time: the same formulas as for one, in the vector registers that there are. The
// lanes are summed in a fixed order, so that results are the same with registers of any width.

#pragma once

#include <cmath>
#include <cstddef>
#include <cstring>
#include <vector>

#include "small.hpp"

// What passes four numbers is inlined, so that nobody can see how it passes them.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace kernels {

constexpr std::size_t LANES = 4;
using Four = double __attribute__((vector_size(LANES * sizeof(double))));

// Groups of lanes whose terms are computed before they are summed: while one group's quotients and
// roots wait for each other, the next group's begin.
constexpr std::size_t AT_ONCE = 16;

struct Four3 {  // four vectors of three
  Four x, y, z;
};

#define KERNELS_INLINE inline __attribute__((always_inline))

// Compiles a function for wide registers, too, and takes what the processor has: with four lanes
// and no fused multiply-add the results are the same, bit by bit.
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__clang__) && !SANITIZED
#define KERNELS_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define KERNELS_WIDE
#endif

KERNELS_INLINE Four load(const double* from) {
  Four out;
  std::memcpy(&out, from, sizeof out);
  return out;
}
KERNELS_INLINE void store(const Four& from, double* to) { std::memcpy(to, &from, sizeof from); }
KERNELS_INLINE double sum(const Four& a) { return (a[0] + a[1]) + (a[2] + a[3]); }
KERNELS_INLINE Four root(const Four& a) {
  Four out;
  for (std::size_t j = 0; j < LANES; ++j) out[j] = std::sqrt(a[j]);
  return out;
}
KERNELS_INLINE Four magnitude(const Four& a) {
  Four out;
  for (std::size_t j = 0; j < LANES; ++j) out[j] = std::abs(a[j]);
  return out;
}
KERNELS_INLINE Four hypotenuse(const Four& a, const Four& b) { return root(a * a + b * b); }
KERNELS_INLINE Four at_least(const Four& a, double low) {
  const Four bound = Four{} + low;
  return a > bound ? a : bound;
}
KERNELS_INLINE Four larger(const Four& a, const Four& b) { return a > b ? a : b; }
KERNELS_INLINE Four dot(const Four3& a, const Four3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
KERNELS_INLINE Four dot(const Four3& a, const Vec3& b) {
  return a.x * b[0] + a.y * b[1] + a.z * b[2];
}
KERNELS_INLINE Four3 cross(const Four3& a, const Four3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
KERNELS_INLINE Four3 cross(const Four3& a, const Vec3& b) {
  return {a.y * b[2] - a.z * b[1], a.z * b[0] - a.x * b[2], a.x * b[1] - a.y * b[0]};
}
KERNELS_INLINE Four3 operator*(const Mat3& A, const Four3& x) {
  return {A[0] * x.x + A[1] * x.y + A[2] * x.z, A[3] * x.x + A[4] * x.y + A[5] * x.z,
          A[6] * x.x + A[7] * x.y + A[8] * x.z};
}
KERNELS_INLINE Four3 operator*(const Four& s, const Four3& a) {
  return {s * a.x, s * a.y, s * a.z};
}

// Cholesky factors of four matrices of N x N, and solutions with them, as in small.hpp; returns
// which are positive definite. What comes of others is undefined.
template <int N>
KERNELS_INLINE auto cholesky(Four* A) {
  auto good = A[0] > Four{};
  for (int j = 0; j < N; ++j) {
    Four d = A[j * N + j];
    for (int k = 0; k < j; ++k) d -= A[j * N + k] * A[j * N + k];
    good &= d > Four{};
    A[j * N + j] = root(d);
    for (int i = j + 1; i < N; ++i) {
      Four s = A[i * N + j];
      for (int k = 0; k < j; ++k) s -= A[i * N + k] * A[j * N + k];
      A[i * N + j] = s / A[j * N + j];
    }
  }
  return good;
}
template <int N>
KERNELS_INLINE void cholesky_solve(const Four* L, Four* b) {
  for (int i = 0; i < N; ++i) {
    for (int k = 0; k < i; ++k) b[i] -= L[i * N + k] * b[k];
    b[i] /= L[i * N + i];
  }
  for (int i = N - 1; i >= 0; --i) {
    for (int k = i + 1; k < N; ++k) b[i] -= L[k * N + i] * b[k];
    b[i] /= L[i * N + i];
  }
}

}  // namespace kernels
