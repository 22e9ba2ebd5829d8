// Camera motion of a key frame pair and what each of its blocks then says, [MVO] 4.1 and 4.2.

#include <algorithm>

#include "two_view_arguments.hpp"

namespace kernels {
namespace {

constexpr int N = 5;  // unknowns of a motion: rotation, and two of the direction

// Equations by (w, t) as ones by w and two tangents of t.
void on_tangents(const Equations<6>& of, const Vec3& first, const Vec3& second, double* A,
                 double* b) {
  double lift[6 * N] = {};
  for (int k = 0; k < 3; ++k) {
    lift[N * k + k] = 1;
    lift[N * (3 + k) + 3] = first[k];
    lift[N * (3 + k) + 4] = second[k];
  }
  for (int r = 0; r < N; ++r) {
    b[r] = 0;
    for (int i = 0; i < 6; ++i) b[r] += lift[N * i + r] * of.b[i];
    for (int c = 0; c < N; ++c) {
      double total = 0;
      for (int i = 0; i < 6; ++i)
        for (int j = 0; j < 6; ++j) total += lift[N * i + r] * of.A[6 * i + j] * lift[N * j + c];
      A[N * r + c] = total;
    }
  }
}

struct Policy {  // of the refinement
  const double* widths;  // of the kernel in each step [sigma]
  int steps;
  double settled;  // fall of the sum of robust costs, of one for each block, that ends it
};

// The share of the votes of [MVO] 4.2 that put a block behind the camera, each counting by its
// parallax in standard deviations up to ten: a far block's direction is noise. The vote is the sign
// of (t_xy - x'_prev t_z) . (x_cur - x'_prev), the epipole e = t_xy / t_z kept homogeneous.
KERNELS_WIDE
double behind(const Blocks& blocks, const TwoView& view) {
  double against = 0, all = 0;
  for (std::size_t i = 0; i < blocks.x.size(); i += LANES) {
    const Four3 y = view.R * Four3{load(&blocks.u[i]), load(&blocks.v[i]), Four{} + 1.0};
    const Four yx = y.x / y.z, yy = y.y / y.z;
    const Four gx = view.fx * (load(&blocks.x[i]) - yx), gy = view.fy * (load(&blocks.y[i]) - yy);
    const Four vote = view.fx * (view.t[0] - yx * view.t[2]) * gx +
                      view.fy * (view.t[1] - yy * view.t[2]) * gy;
    const Four parallax = root(gx * gx + gy * gy) / load(&blocks.sigma[i]);
    const Four weight = parallax > 10.0 ? Four{} + 10.0 : parallax;
    const Four opposed = vote > 0.0 ? Four{} : weight;
    for (std::size_t j = 0; j < std::min(LANES, blocks.count - i); ++j)
      all += weight[j], against += opposed[j];
  }
  return against / std::max(all, 1e-9);
}

// Takes the Levenberg-Marquardt step that lowers the robust cost, if one of four does.
double damped_step(const Blocks& blocks, TwoView& view, const Equations<6>& now, double width,
                   double& damping) {
  Vec3 first, second;
  tangent_basis(view.t, first, second);
  double A[N * N], b[N];
  on_tangents(now, first, second, A, b);
  for (int attempt = 0; attempt < 4; ++attempt) {
    double L[N * N], step[N];
    std::copy_n(A, N * N, L);
    std::copy_n(b, N, step);
    for (int k = 0; k < N; ++k) L[N * k + k] += damping * (A[N * k + k] + 1e-9);
    if (cholesky(L, N)) {
      cholesky_solve(L, N, step);
      TwoView trial = view;
      trial.R = rotation_exp({step[0], step[1], step[2]}) * view.R;
      const Vec3 t = view.t + step[3] * first + step[4] * second;
      trial.t = (1 / norm(t)) * t;
      const double cost = epipolar_cost(blocks, trial, width);
      if (cost <= now.cost) {
        view = trial;
        damping *= 0.3;
        return cost;
      }
    }
    damping = std::max(damping * 30, 1e-4);
  }
  return now.cost;
}

// Minimises the Sampson error over rotation and direction, (5) of [MVO], by Levenberg-Marquardt
// with a Geman-McClure kernel whose width shrinks, so that a poor start still finds its support.
void refine(const Blocks& blocks, TwoView& view, const Policy& policy) {
  double damping = 1e-6;
  for (int step = 0; step < policy.steps; ++step) {
    const double width = policy.widths[step], last = policy.widths[policy.steps - 1];
    const auto now = epipolar_terms(blocks, view, width);
    const double cost = damped_step(blocks, view, now, width, damping);
    if (width == last && now.cost - cost < policy.settled * width * width) break;
  }
}

// Covariance (6, 6) of (w, t) at a motion, scaled by what its errors show.
std::array<double, 36> motion_covariance(const TwoView& view, const Equations<6>& at) {
  Vec3 first, second;
  tangent_basis(view.t, first, second);
  double A[N * N], b[N];
  on_tangents(at, first, second, A, b);
  pseudo_inverse(A, N);
  const double scale = std::max(1.0, at.squares / std::max(at.weights - N, 1.0));
  std::array<double, 36> out;
  const auto row = [&](int i, int r) {
    return i < 3 ? double(i == r) : r == 3 ? first[i - 3] : r == 4 ? second[i - 3] : 0.0;
  };
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) {
      double total = 0;
      for (int r = 0; r < N; ++r)
        for (int c = 0; c < N; ++c) total += row(i, r) * A[N * r + c] * row(j, c);
      out[6 * i + j] = scale * total;
    }
  return out;
}

// Fits a rotation alone, with a kernel that shrinks from 8 to 2 sigma; `off` holds the distance of
// each match from where it puts it, in standard deviations, A the normal equations.
void turn(const Blocks& blocks, TwoView& view, int steps, double* off, Mat3& A) {
  double width = 8;
  for (int step = 0; step < steps; ++step, width = std::max(width / 2, 2.0)) {
    A = {};
    Vec3 b{};
    for (std::size_t i = 0; i < blocks.count; ++i) {
      const Vec3 y = view.R * Vec3{blocks.u[i], blocks.v[i], 1};
      const double ix = y[0] / y[2], iy = y[1] / y[2], fx = view.fx, fy = view.fy;
      const double ex = fx * (ix - blocks.x[i]), ey = fy * (iy - blocks.y[i]);
      off[i] = std::sqrt(ex * ex + ey * ey) / blocks.sigma[i];
      // dy = w x y, and the image's change follows by the quotient rule.
      const Vec3 Ju = cross(y, {fx / y[2], 0, -ix * fx / y[2]});
      const Vec3 Jv = cross(y, {0, fy / y[2], -iy * fy / y[2]});
      const double kernel = 1 / (1 + off[i] * off[i] / (width * width));
      const double weight = kernel * kernel / (blocks.sigma[i] * blocks.sigma[i]);
      for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) A[3 * r + c] += weight * (Ju[r] * Ju[c] + Jv[r] * Jv[c]);
        b[r] -= weight * (Ju[r] * ex + Jv[r] * ey);
      }
    }
    Mat3 L = A;
    if (!cholesky(L.data(), 3)) return;
    cholesky_solve(L.data(), 3, b.data());
    view.R = rotation_exp(b) * view.R;
  }
}

// The scale of sigma that errors in standard deviations show: their median within three, over that
// of a Gaussian cut there, so that wrong vectors do not count.
double noise_scale(const Blocks& blocks, const TwoView& view, double scale, std::size_t least) {
  constexpr double CUT = 3, MEDIAN = 0.6724;  // sigma
  const auto error = epipolar_errors(blocks, view);
  std::vector<double> close;
  for (int pass = 0; pass < 3; ++pass) {
    close.resize(blocks.count);
    std::size_t n = 0;
    for (std::size_t i = 0; i < blocks.count; ++i) {
      close[n] = std::abs(error[i]);
      n += close[n] < CUT * scale;
    }
    if (n < least) break;
    close.resize(n);
    scale = std::clamp(median(close) / MEDIAN, 0.3, 4.0);  // beyond it is no noise
  }
  return scale;
}

}  // namespace
}  // namespace kernels

void bind_motion(kernels::py::module_& module) {
  using namespace kernels;
  // -> R (3, 3), t (3,) with the sign that puts most before the camera, covariance (6, 6), mean
  // robust cost, share behind the camera
  module.def("refine_motion", [](const py::object& rays_cur, const py::object& rays_prev,
                                 const py::object& sigma, const py::object& focal,
                                 const py::object& R, const py::object& t,
                                 const py::object& widths, double settled) {
    const char* kernel = "refine_motion";
    const Blocks blocks = PairArrays(kernel, rays_cur, rays_prev, sigma).blocks();
    const In<double> steps(kernel, "widths", widths, {ANY}, Check::finite);
    require(steps.size() > 0, kernel, "widths must hold one width at least");
    TwoView view = two_view(kernel, R, t, focal);
    refine(blocks, view, {steps.data(), static_cast<int>(steps.size()), settled});
    double share = behind(blocks, view);
    if (share > 0.5) {
      view.t = -1.0 * view.t;
      share = behind(blocks, view);
    }
    const double width = steps[steps.size() - 1];
    const auto at = epipolar_terms(blocks, view, width);
    const double n = std::max<double>(1, static_cast<double>(blocks.count));
    return py::make_tuple(matrix_of(view.R, {3, 3}), matrix_of(view.t, {3}),
                          matrix_of(motion_covariance(view, at), {6, 6}),
                          at.cost / (width * width) / n, share);
  });
  // -> share
  module.def("behind", [](const py::object& rays_cur, const py::object& rays_prev,
                          const py::object& sigma, const py::object& focal, const py::object& R,
                          const py::object& t) {
    const char* kernel = "behind";
    return behind(PairArrays(kernel, rays_cur, rays_prev, sigma).blocks(),
                  two_view(kernel, R, t, focal));
  });
  // -> R (3, 3), A (3, 3), off (N,)
  module.def("fit_turn", [](const py::object& rays_cur, const py::object& rays_prev,
                            const py::object& sigma, const py::object& focal,
                            const py::object& R, int steps) {
    const char* kernel = "fit_turn";
    const Blocks blocks = PairArrays(kernel, rays_cur, rays_prev, sigma).blocks();
    TwoView view = two_view(kernel, R, matrix_of(Vec3{}, {3}), focal);
    Out<double> off({static_cast<py::ssize_t>(blocks.count)});
    Mat3 A{};
    turn(blocks, view, steps, off.data(), A);
    return py::make_tuple(matrix_of(view.R, {3, 3}), matrix_of(A, {3, 3}), off.array());
  });
  // -> scale
  module.def("noise_scale", [](const py::object& rays_cur, const py::object& rays_prev,
                               const py::object& sigma, const py::object& focal,
                               const py::object& R, const py::object& t, double scale,
                               std::size_t least) {
    const char* kernel = "noise_scale";
    return noise_scale(PairArrays(kernel, rays_cur, rays_prev, sigma).blocks(),
                       two_view(kernel, R, t, focal), scale, least);
  });
}
