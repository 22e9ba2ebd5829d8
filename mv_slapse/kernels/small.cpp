// The small algebra of small.hpp as kernels of its own, for the comparison with numpy.

#include "small.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "arrays.hpp"

namespace kernels {
namespace {

constexpr int MOST = 12;  // unknowns of a system that kernels solve

Mat3 matrix(const char* kernel, const py::object& A) {
  const In<double> view(kernel, "A", A, {3, 3}, Check::finite);
  Mat3 out;
  std::copy_n(view.data(), 9, out.begin());
  return out;
}

template <std::size_t N>
py::array_t<double> array(const std::array<double, N>& values) {
  Out<double> out = N == 9 ? Out<double>({3, 3}) : Out<double>({static_cast<py::ssize_t>(N)});
  std::copy(values.begin(), values.end(), out.data());
  return out.array();
}

// Copies A and b, factorises and solves; None where the factorisation fails.
template <typename Factor, typename Solve>
py::object solved(const char* kernel, const py::object& A, const py::object& b, Factor factor,
                  Solve solve) {
  const In<double> left(kernel, "A", A, {ANY, ANY}, Check::finite);
  const auto n = left.size();
  require(n == left.size(1) && n <= MOST, kernel, "A must be square, of at most 12 rows");
  const In<double> right(kernel, "b", b, {n}, Check::finite);
  double work[MOST * MOST];
  std::copy_n(left.data(), n * n, work);
  Out<double> x({n});
  std::copy_n(right.data(), n, x.data());
  if (!factor(work, static_cast<int>(n))) return py::none();
  solve(work, static_cast<int>(n), x.data());
  return x.array();
}

// Whether a symmetric matrix is a covariance, but for rounding: no eigenvalue of its correlations
// lies farther below zero.
bool is_covariance(const py::object& P_, double rounding) {
  constexpr auto kernel = "is_covariance";
  const In<double> P(kernel, "P", P_, {ANY, ANY});
  const auto n = P.size();
  require(n == P.size(1), kernel, "P must be square");
  std::vector<double> unit(n), correlation(n * n);
  for (py::ssize_t i = 0; i < n; ++i) unit[i] = P(i, i) > 0 ? std::sqrt(P(i, i)) : 1.0;
  for (py::ssize_t i = 0; i < n; ++i)
    for (py::ssize_t j = 0; j < n; ++j)
      correlation[i * n + j] = P(i, j) / unit[i] / unit[j] + (i == j ? rounding : 0.0);
  return cholesky(correlation.data(), static_cast<int>(n));
}

}  // namespace
}  // namespace kernels

void bind_small(kernels::py::module_& module) {
  using namespace kernels;
  module.def("rotation_exp", [](const py::object& w) {
    const In<double> v("rotation_exp", "w", w, {3}, Check::finite);
    return array(rotation_exp({v[0], v[1], v[2]}));
  });
  module.def("rotation_log",
             [](const py::object& A) { return array(rotation_log(matrix("rotation_log", A))); });
  module.def("eigen_symmetric", [](const py::object& A) {
    Vec3 values;
    Mat3 vectors;
    eigen_symmetric(matrix("eigen_symmetric", A), values, vectors);
    return py::make_tuple(array(values), array(vectors));
  });
  module.def("cholesky_solve", [](const py::object& A, const py::object& b) {
    return solved("cholesky_solve", A, b, cholesky, cholesky_solve);
  });
  module.def("is_covariance", is_covariance);
  module.def("ldlt_solve", [](const py::object& A, const py::object& b) {
    return solved("ldlt_solve", A, b, ldlt, ldlt_solve);
  });
}
