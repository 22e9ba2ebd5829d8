// Joint re-estimation of camera motion and stationary planes, (10) of [MVO].

#include <algorithm>

#include "two_view_arguments.hpp"

namespace kernels {
namespace {

struct Known {  // what is expected of a plane beforehand
  int plane;
  Vec3 mean;
  Mat3 information;
};

struct Problem {
  const std::vector<Blocks>& groups;
  const std::vector<Known>& known;
  Joint joint;
  int size() const { return 5 + 3 * (static_cast<int>(groups.size()) - 1); }
};

struct State {
  TwoView view;
  std::vector<double> planes;
};

struct Tangent {  // normal equations by (w, two tangents of t, planes)
  std::vector<double> A, b;
  Vec3 first, second;
  double cost;
};

// Column c of (w, t, planes) as a sum over (w, two tangents, planes): calls with index and factor.
template <typename Each>
void over(const Tangent& at, int full, Each each) {
  if (full < 3) {
    each(full, 1.0);
  } else if (full < 6) {
    each(3, at.first[full - 3]);
    each(4, at.second[full - 3]);
  } else {
    each(full - 1, 1.0);
  }
}

Tangent equations(const Problem& problem, const State& at) {
  const int n = problem.size(), full = n + 1;
  std::vector<double> A(full * full), b(full);
  Tangent out;
  out.cost = normal_equations(problem.groups, at.view, at.planes.data(), problem.joint, A.data(),
                              b.data());
  for (const auto& known : problem.known) {
    const int first = 6 + 3 * known.plane;
    const double* plane = &at.planes[3 * known.plane];
    const Vec3 off{known.mean[0] - plane[0], known.mean[1] - plane[1], known.mean[2] - plane[2]};
    const Vec3 pull = known.information * off;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c)
        A[(first + r) * full + first + c] += known.information[3 * r + c];
      b[first + r] += pull[r];
    }
    out.cost += dot(off, pull);
  }
  tangent_basis(at.view.t, out.first, out.second);
  out.A.assign(n * n, 0.0);
  out.b.assign(n, 0.0);
  for (int i = 0; i < full; ++i)
    over(out, i, [&](int r, double left) {
      out.b[r] += left * b[i];
      for (int j = 0; j < full; ++j)
        over(out, j, [&](int c, double right) {
          out.A[r * n + c] += left * A[i * full + j] * right;
        });
    });
  return out;
}

State moved(const State& from, const Tangent& at, const std::vector<double>& step) {
  State out = from;
  out.view.R = rotation_exp({step[0], step[1], step[2]}) * from.view.R;
  const Vec3 t = from.view.t + step[3] * at.first + step[4] * at.second;
  out.view.t = (1 / norm(t)) * t;
  for (std::size_t k = 0; k < out.planes.size(); ++k) out.planes[k] += step[5 + k];
  return out;
}

// Gauss-Newton with Levenberg-Marquardt damping; returns the equations at the end.
Tangent reestimate(const Problem& problem, State& state, int steps) {
  const int n = problem.size();
  double damping = 1e-6;
  Tangent now = equations(problem, state);
  for (int step = 0; step < steps; ++step) {
    std::vector<double> L = now.A, d = now.b;
    for (int k = 0; k < n; ++k) L[n * k + k] += damping * (now.A[n * k + k] + 1e-12);
    bool lower = cholesky(L.data(), n);
    if (lower) {
      cholesky_solve(L.data(), n, d.data());
      State trial = moved(state, now, d);
      Tangent next = equations(problem, trial);
      lower = next.cost <= now.cost;
      if (lower) {
        const bool converged = now.cost - next.cost < 1e-4 * now.cost;
        state = std::move(trial);
        now = std::move(next);
        damping *= 0.1;
        if (converged) break;
      }
    }
    if (!lower) damping = std::max(damping * 100, 1e-3);
  }
  return now;
}

std::vector<Known> known_of(const char* kernel, const py::list& expected, int n_planes) {
  std::vector<Known> out;
  for (py::ssize_t i = 0; i < expected.size(); ++i) {
    const auto of = expected[i].cast<py::tuple>();
    const In<double> mean(kernel, "expected mean", of[1], {3}, Check::finite);
    const In<double> information(kernel, "expected information", of[2], {3, 3}, Check::finite);
    Known known;
    known.plane = of[0].cast<int>();
    require(known.plane >= 0 && known.plane < n_planes, kernel, "expected names no plane");
    std::copy_n(mean.data(), 3, known.mean.begin());
    std::copy_n(information.data(), 9, known.information.begin());
    out.push_back(known);
  }
  return out;
}

}  // namespace
}  // namespace kernels

void bind_joint(kernels::py::module_& module) {
  using namespace kernels;
  // options as in normal_equations; expected: [(plane, mean (3,), information (3, 3))]
  // -> R (3, 3), t (3,), planes (P, 3), covariance (6 + 3 P, 6 + 3 P) of (w, t, planes)
  module.def("reestimate", [](const py::object& rays_cur, const py::object& rays_prev,
                              const py::object& sigma, const py::object& focal,
                              const py::object& R, const py::object& t, const py::object& index,
                              const py::object& planes, const py::object& options,
                              const py::list& expected, int steps) {
    const char* kernel = "reestimate";
    const PairArrays pair(kernel, rays_cur, rays_prev, sigma);
    const In<double> start(kernel, "planes", planes, {ANY, 3}, Check::finite);
    const int n_planes = static_cast<int>(start.size()), n = 5 + 3 * n_planes, full = n + 1;
    const auto groups = pair.groups(kernel, index, n_planes);
    const auto known = known_of(kernel, expected, n_planes);
    const Problem problem{groups, known, joint_of(kernel, options)};
    State state{two_view(kernel, R, t, focal), {start.data(), start.data() + 3 * n_planes}};
    Tangent end = reestimate(problem, state, steps);
    pseudo_inverse(end.A.data(), n);
    Out<double> covariance({full, full}), out({n_planes, 3});
    for (int i = 0; i < full; ++i)
      over(end, i, [&](int r, double left) {
        for (int j = 0; j < full; ++j)
          over(end, j, [&](int c, double right) {
            covariance(i, j) += left * end.A[r * n + c] * right;
          });
      });
    std::copy(state.planes.begin(), state.planes.end(), out.data());
    return py::make_tuple(matrix_of(state.view.R, {3, 3}), matrix_of(state.view.t, {3}),
                          out.array(), covariance.array());
  });
}
