// Small dense algebra in double precision: vectors of 3, matrices of 3 x 3, symmetric systems of
// up to 12 unknowns. All sums run in index order, so that results are the same everywhere.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

namespace kernels {

using Vec3 = std::array<double, 3>;
using Mat3 = std::array<double, 9>;  // row by row

constexpr Mat3 IDENTITY{1, 0, 0, 0, 1, 0, 0, 0, 1};

inline Vec3 operator+(const Vec3& a, const Vec3& b) {
  return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}
inline Vec3 operator-(const Vec3& a, const Vec3& b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
inline Vec3 operator*(double s, const Vec3& a) { return {s * a[0], s * a[1], s * a[2]}; }
inline double dot(const Vec3& a, const Vec3& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
inline double norm(const Vec3& a) { return std::sqrt(dot(a, a)); }
inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

inline Vec3 operator*(const Mat3& A, const Vec3& x) {
  return {A[0] * x[0] + A[1] * x[1] + A[2] * x[2], A[3] * x[0] + A[4] * x[1] + A[5] * x[2],
          A[6] * x[0] + A[7] * x[1] + A[8] * x[2]};
}
inline Mat3 operator*(const Mat3& A, const Mat3& B) {
  Mat3 C;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      C[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
  return C;
}
inline Mat3 transposed(const Mat3& A) {
  return {A[0], A[3], A[6], A[1], A[4], A[7], A[2], A[5], A[8]};
}
// The matrix of the cross product: skew(a) b = a x b.
inline Mat3 skew(const Vec3& a) {
  return {0, -a[2], a[1], a[2], 0, -a[0], -a[1], a[0], 0};
}

// Rotation of a rotation vector [rad], Rodrigues' formula; a series where the angle is small.
inline Mat3 rotation_exp(const Vec3& w) {
  const double square = dot(w, w), angle = std::sqrt(square);
  const bool small = square < 1e-8;  // rad^2: the next terms lie below 1e-16
  const double a = small ? 1 - square / 6 : std::sin(angle) / angle;
  const double b = small ? 0.5 - square / 24 : (1 - std::cos(angle)) / square;
  const Mat3 W = skew(w), WW = W * W;
  Mat3 R = IDENTITY;
  for (int i = 0; i < 9; ++i) R[i] += a * W[i] + b * WW[i];
  return R;
}

// The one of three values between the others.
template <typename T>
T middle(T a, T b, T c) {
  return std::max(std::min(a, b), std::min(std::max(a, b), c));
}

// What lies at a place of n values, at least one, once they are sorted; as after std::nth_element
// those before it are no greater. Values move without branches, which a processor mispredicts.
template <typename T>
T nth_smallest(T* from, std::size_t n, std::size_t at) {
  const auto move_ahead = [&](const auto& belongs) {
    std::size_t moved = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const T value = from[i];
      from[i] = from[moved];
      from[moved] = value;
      moved += belongs(value);
    }
    return moved;
  };
  while (n > 1) {
    const T a = from[0], b = from[n / 2], c = from[n - 1];
    const T pivot = middle(a, b, c);
    const auto less = move_ahead([pivot](T value) { return value < pivot; });
    if (at < less) {
      n = less;
      continue;
    }
    from += less, n -= less, at -= less;
    if (less) continue;
    const auto equal = move_ahead([pivot](T value) { return !(pivot < value); });
    if (at < equal) return pivot;
    from += equal, n -= equal, at -= equal;
  }
  return *from;
}

// Median of values: the mean of the two in the middle of an even number, 0 of none.
template <typename T>
T median(std::vector<T> values) {
  const auto n = values.size();
  if (!n) return 0;
  const T middle = nth_smallest(values.data(), n, n / 2);
  return n % 2 ? middle : (*std::max_element(values.data(), values.data() + n / 2) + middle) / 2;
}

// Eigenvalues in rising order and eigenvectors (columns) of a symmetric matrix, by Jacobi rotations.
inline void eigen_symmetric(const Mat3& symmetric, Vec3& values, Mat3& vectors) {
  Mat3 A = symmetric;
  vectors = IDENTITY;
  for (int sweep = 0; sweep < 16; ++sweep) {  // six are enough for double precision
    const double off = std::abs(A[1]) + std::abs(A[2]) + std::abs(A[5]);
    if (off <= 1e-300) break;
    for (int p = 0; p < 2; ++p)
      for (int q = p + 1; q < 3; ++q) {
        const double apq = A[3 * p + q];
        if (apq == 0) continue;
        const double theta = 0.5 * (A[4 * q] - A[4 * p]) / apq;
        const double t = (theta < 0 ? -1 : 1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
        const double c = 1 / std::sqrt(t * t + 1), s = t * c;
        for (int k = 0; k < 3; ++k) {
          const double kp = A[3 * k + p], kq = A[3 * k + q];
          A[3 * k + p] = c * kp - s * kq;
          A[3 * k + q] = s * kp + c * kq;
        }
        for (int k = 0; k < 3; ++k) {
          const double pk = A[3 * p + k], qk = A[3 * q + k];
          A[3 * p + k] = c * pk - s * qk;
          A[3 * q + k] = s * pk + c * qk;
        }
        A[3 * p + q] = A[3 * q + p] = 0;
        for (int k = 0; k < 3; ++k) {
          const double kp = vectors[3 * k + p], kq = vectors[3 * k + q];
          vectors[3 * k + p] = c * kp - s * kq;
          vectors[3 * k + q] = s * kp + c * kq;
        }
      }
  }
  values = {A[0], A[4], A[8]};
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 2 - i; ++j)
      if (values[j] > values[j + 1]) {
        std::swap(values[j], values[j + 1]);
        for (int k = 0; k < 3; ++k) std::swap(vectors[3 * k + j], vectors[3 * k + j + 1]);
      }
}

// Rotation vector [rad] of a rotation; by the eigenvector of R + R^T where it turns by nearly pi.
inline Vec3 rotation_log(const Mat3& R) {
  const Vec3 axial{0.5 * (R[7] - R[5]), 0.5 * (R[2] - R[6]), 0.5 * (R[3] - R[1])};
  const double sine = norm(axial), cosine = 0.5 * (R[0] + R[4] + R[8] - 1);
  const double angle = std::atan2(sine, cosine);
  if (sine > 1e-4) return (angle / sine) * axial;  // rad
  if (cosine > 0) return (1 + sine * sine / 6) * axial;
  Mat3 S;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) S[3 * i + j] = R[3 * i + j] + R[3 * j + i];
  Vec3 values;
  Mat3 vectors;
  eigen_symmetric(S, values, vectors);
  const Vec3 axis{vectors[2], vectors[5], vectors[8]};
  return (dot(axis, axial) < 0 ? -angle : angle) * axis;
}

// Cholesky factor of a symmetric positive definite matrix of n x n, in place in the lower triangle;
// false where it is not positive definite (its contents are then undefined).
inline bool cholesky(double* A, int n) {
  for (int j = 0; j < n; ++j) {
    double d = A[j * n + j];
    for (int k = 0; k < j; ++k) d -= A[j * n + k] * A[j * n + k];
    if (!(d > 0)) return false;  // also NaN
    A[j * n + j] = std::sqrt(d);
    for (int i = j + 1; i < n; ++i) {
      double s = A[i * n + j];
      for (int k = 0; k < j; ++k) s -= A[i * n + k] * A[j * n + k];
      A[i * n + j] = s / A[j * n + j];
    }
  }
  return true;
}

// Solution of L L^T x = b, in place, with the factor of `cholesky`.
inline void cholesky_solve(const double* L, int n, double* b) {
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < i; ++k) b[i] -= L[i * n + k] * b[k];
    b[i] /= L[i * n + i];
  }
  for (int i = n - 1; i >= 0; --i) {
    for (int k = i + 1; k < n; ++k) b[i] -= L[k * n + i] * b[k];
    b[i] /= L[i * n + i];
  }
}

// LDL^T factor of a symmetric, possibly indefinite matrix of n x n, without pivoting: D on the
// diagonal, L below it; false where a pivot vanishes against the matrix.
inline bool ldlt(double* A, int n) {
  double largest = 0;
  for (int i = 0; i < n * n; ++i) largest = std::fmax(largest, std::abs(A[i]));
  for (int j = 0; j < n; ++j) {
    double d = A[j * n + j];
    for (int k = 0; k < j; ++k) d -= A[j * n + k] * A[j * n + k] * A[k * n + k];
    if (!(std::abs(d) > 1e-14 * largest)) return false;  // share: double precision has 1e-16
    A[j * n + j] = d;
    for (int i = j + 1; i < n; ++i) {
      double s = A[i * n + j];
      for (int k = 0; k < j; ++k) s -= A[i * n + k] * A[j * n + k] * A[k * n + k];
      A[i * n + j] = s / d;
    }
  }
  return true;
}

// Solution of L D L^T x = b, in place, with the factor of `ldlt`.
inline void ldlt_solve(const double* A, int n, double* b) {
  for (int i = 0; i < n; ++i)
    for (int k = 0; k < i; ++k) b[i] -= A[i * n + k] * b[k];
  for (int i = 0; i < n; ++i) b[i] /= A[i * n + i];
  for (int i = n - 1; i >= 0; --i)
    for (int k = i + 1; k < n; ++k) b[i] -= A[k * n + i] * b[k];
}

// Moore-Penrose inverse of a symmetric positive semidefinite matrix of n x n, in place: by the
// Cholesky factor or, where that fails, by the eigenvectors of Jacobi rotations.
inline void pseudo_inverse(double* A, int n) {
  std::vector<double> L(A, A + n * n), column(n);
  bool regular = cholesky(L.data(), n);
  for (int k = 0; regular && k < n; ++k)  // of a pivot, rounding leaves 1e-15
    regular = L[n * k + k] * L[n * k + k] > 1e-12 * A[n * k + k];
  if (regular) {
    for (int c = 0; c < n; ++c) {
      std::fill(column.begin(), column.end(), 0.0);
      column[c] = 1;
      cholesky_solve(L.data(), n, column.data());
      for (int r = 0; r < n; ++r) A[n * r + c] = column[r];
    }
    return;
  }
  std::vector<double> V(n * n, 0.0), inverse(n);
  for (int k = 0; k < n; ++k) V[n * k + k] = 1;
  for (int sweep = 0; sweep < 30; ++sweep) {  // ten are enough for double precision
    double off = 0, on = 0;
    for (int p = 0; p < n; ++p) {
      on += A[n * p + p] * A[n * p + p];
      for (int q = p + 1; q < n; ++q) off += A[n * p + q] * A[n * p + q];
    }
    if (!(off > 1e-32 * on)) break;
    for (int p = 0; p < n; ++p)
      for (int q = p + 1; q < n; ++q) {
        if (A[n * p + q] == 0) continue;
        const double theta = 0.5 * (A[n * q + q] - A[n * p + p]) / A[n * p + q];
        const double t = (theta < 0 ? -1 : 1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
        const double c = 1 / std::sqrt(t * t + 1), s = t * c;
        const auto turn = [c, s](double& a, double& b) {
          const double old = a;
          a = c * old - s * b;
          b = s * old + c * b;
        };
        for (int k = 0; k < n; ++k) turn(A[n * k + p], A[n * k + q]);
        for (int k = 0; k < n; ++k) turn(A[n * p + k], A[n * q + k]);
        for (int k = 0; k < n; ++k) turn(V[n * k + p], V[n * k + q]);
      }
  }
  double largest = 0;
  for (int k = 0; k < n; ++k) largest = std::max(largest, std::abs(A[n * k + k]));
  for (int k = 0; k < n; ++k) {
    const double value = A[n * k + k];
    inverse[k] = std::abs(value) > 1e-15 * largest ? 1 / value : 0;
  }
  for (int r = 0; r < n; ++r)
    for (int c = 0; c < n; ++c) {
      double total = 0;
      for (int k = 0; k < n; ++k) total += V[n * r + k] * inverse[k] * V[n * c + k];
      A[n * r + c] = total;
    }
}

}  // namespace kernels
