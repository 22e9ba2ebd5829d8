// A moving obstacle's state and its filter, see obstacles/motion_model.py: bearing (2), log depth,
// rate (3), slope (2).

#include <algorithm>
#include <cmath>
#include <vector>

#include "arrays.hpp"
#include "movers.hpp"
#include "small.hpp"

namespace kernels {
namespace {

constexpr int SIZE = 8, CARTESIAN = 9, DEPTH = 2, RATE = 3, SLOPE = 6;

struct Cartesian {  // position, velocity relative to the camera, w, and their derivative
  double at[CARTESIAN], by[CARTESIAN * SIZE];
};

struct Chart {  // the state, and its derivative by position, velocity, w
  double at[SIZE], by[SIZE * CARTESIAN];
};

// C (n, m) = A (n, k) B (k, m).
void multiply(const double* A, const double* B, double* C, int n, int k, int m) {
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < m; ++j) {
      double sum = 0;
      for (int l = 0; l < k; ++l) sum += A[i * k + l] * B[l * m + j];
      C[i * m + j] = sum;
    }
}

// C (n, n) = A (n, k) S (k, k) A^T.
void sandwich(const double* A, const double* S, double* C, int n, int k) {
  std::vector<double> AS(n * k);
  multiply(A, S, AS.data(), n, k, k);
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      double sum = 0;
      for (int l = 0; l < k; ++l) sum += AS[i * k + l] * A[j * k + l];
      C[i * n + j] = sum;
    }
}

Cartesian to_cartesian(const double* mu) {
  Cartesian out{};
  const double depth = std::exp(mu[DEPTH]), A = mu[SLOPE], B = mu[SLOPE + 1];
  const double ray[3] = {mu[0], mu[1], 1.0};
  for (int i = 0; i < 3; ++i) {
    out.at[i] = out.by[i * SIZE + DEPTH] = depth * ray[i];
    out.at[3 + i] = out.by[(3 + i) * SIZE + DEPTH] = depth * mu[RATE + i];
    out.by[(3 + i) * SIZE + RATE + i] = depth;
  }
  for (int i = 0; i < 2; ++i) {
    out.by[i * SIZE + i] = depth;
    out.by[(6 + i) * SIZE + SLOPE + i] = 1;
    out.at[6 + i] = mu[SLOPE + i];
    out.by[8 * SIZE + i] = -mu[SLOPE + i];
    out.by[8 * SIZE + SLOPE + i] = -mu[i];
  }
  out.at[8] = 1 - A * mu[0] - B * mu[1];
  return out;
}

Chart from_cartesian(const double* c) {
  Chart out{};
  const double depth = c[2], ray[3] = {c[0] / depth, c[1] / depth, 1.0};
  const double facing = (c[6] * c[0] + c[7] * c[1] + c[8] * c[2]) / depth;
  for (int i = 0; i < 2; ++i) {
    out.at[i] = ray[i];
    out.by[i * CARTESIAN + i] = 1 / depth;
    out.by[i * CARTESIAN + 2] = -ray[i] / depth;
  }
  out.at[DEPTH] = std::log(depth);
  out.by[DEPTH * CARTESIAN + 2] = 1 / depth;
  for (int i = 0; i < 3; ++i) {
    out.at[RATE + i] = c[3 + i] / depth;
    out.by[(RATE + i) * CARTESIAN + 2] = -c[3 + i] / (depth * depth);
    out.by[(RATE + i) * CARTESIAN + 3 + i] = 1 / depth;
  }
  const double by_ray[3] = {c[6] / depth, c[7] / depth, -(c[6] * ray[0] + c[7] * ray[1]) / depth};
  for (int i = 0; i < 2; ++i) {
    const double slope = c[6 + i] / facing;
    out.at[SLOPE + i] = slope;
    double* row = out.by + (SLOPE + i) * CARTESIAN;
    for (int j = 0; j < 3; ++j) {
      row[j] = -slope / facing * by_ray[j];
      row[6 + j] = ((i == j) - slope * ray[j]) / facing;
    }
  }
  return out;
}

template <int n>
std::array<double, n> values(const char* kernel, const char* name, const py::object& object) {
  const In<double> view(kernel, name, object, {n}, Check::finite);
  std::array<double, n> out;
  std::copy_n(view.data(), n, out.begin());
  return out;
}

py::array_t<double> array(const double* of, std::initializer_list<py::ssize_t> shape) {
  Out<double> out(shape);
  py::ssize_t size = 1;
  for (const auto length : shape) size *= length;
  std::copy_n(of, size, out.data());
  return out.array();
}

py::tuple obstacle_to_cartesian(const py::object& mu) {
  const auto of = to_cartesian(values<SIZE>("obstacle_to_cartesian", "mu", mu).data());
  return py::make_tuple(array(of.at, {CARTESIAN}), array(of.by, {CARTESIAN, SIZE}));
}

py::tuple obstacle_from_cartesian(const py::object& cartesian) {
  const auto of = from_cartesian(
      values<CARTESIAN>("obstacle_from_cartesian", "cartesian", cartesian).data());
  return py::make_tuple(array(of.at, {SIZE}), array(of.by, {SIZE, CARTESIAN}));
}

// step: R, t, dt, before, before_covariance of CameraStep; policy: acceleration [unit/s^2], how long
// it lasts [s], noise of the slope [1/sqrt(s)] -> mu, F, Q or None where it passes behind the camera
py::object predict_obstacle(const py::object& mu_, const py::tuple& step, const py::object& after_,
                            const py::object& after_covariance, double acceleration, double lasts,
                            double slope_noise) {
  const char* kernel = "predict_obstacle";
  require(step.size() == 5, kernel, "step must hold R, t, dt, before, before_covariance");
  const auto mu = values<SIZE>(kernel, "mu", mu_);
  const Mat3 R = matrix(kernel, "R", step[0]);
  const Vec3 t = vector(kernel, "t", step[1]), seen = vector(kernel, "before", step[3]);
  const double dt = step[2].cast<double>();
  const Vec3 after = vector(kernel, "after", after_);
  const Mat3 known = R * matrix(kernel, "before_covariance", step[4]) * transposed(R);
  const Mat3 newer = matrix(kernel, "after_covariance", after_covariance);
  const auto old = to_cartesian(mu.data());
  const double* c = old.at;
  const Vec3 velocity = R * (Vec3{c[3], c[4], c[5]} - seen);
  const Vec3 position = R * Vec3{c[0], c[1], c[2]} + t + dt * velocity;
  const Vec3 relative = velocity + after, w = R * Vec3{c[6], c[7], c[8]};
  constexpr double least = 0.05;  // share of its depth that it keeps, and at which it is seen
  if (position[2] <= least * c[2] || dot(w, position) <= least * position[2]) return py::none();
  double moved[CARTESIAN];
  for (int i = 0; i < 3; ++i) {
    moved[i] = position[i];
    moved[3 + i] = relative[i];
    moved[6 + i] = w[i];
  }
  const auto now = from_cartesian(moved);
  double linear[CARTESIAN * CARTESIAN] = {}, noise[CARTESIAN * CARTESIAN] = {};
  const double density = 2 * lasts * acceleration * acceleration;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const double r = R[3 * i + j], k = known[3 * i + j], p = i == j ? density : 0;
      for (int b = 0; b < 3; ++b) linear[(3 * b + i) * CARTESIAN + 3 * b + j] = r;
      linear[i * CARTESIAN + 3 + j] = dt * r;
      noise[i * CARTESIAN + j] = p * dt * dt * dt / 3 + dt * dt * k;
      noise[i * CARTESIAN + 3 + j] = noise[(3 + i) * CARTESIAN + j] = p * dt * dt / 2 + dt * k;
      noise[(3 + i) * CARTESIAN + 3 + j] = p * dt + k + newer[3 * i + j];
    }
  Out<double> F({SIZE, SIZE}), Q({SIZE, SIZE});
  double between[SIZE * CARTESIAN];
  multiply(now.by, linear, between, SIZE, CARTESIAN, CARTESIAN);
  multiply(between, old.by, F.data(), SIZE, CARTESIAN, SIZE);
  sandwich(now.by, noise, Q.data(), SIZE, CARTESIAN);
  for (int i = SLOPE; i < SIZE; ++i) Q(i, i) += slope_noise * slope_noise * dt;
  return py::make_tuple(array(now.at, {SIZE}), F.array(), Q.array());
}

// -> position, velocity, covariance (6, 6) in the world in camera axes
py::tuple obstacle_motion(const py::object& mu, const py::object& P_, const py::object& scene_,
                          const py::object& scene_covariance) {
  const char* kernel = "obstacle_motion";
  const In<double> P(kernel, "P", P_, {SIZE, SIZE}, Check::finite);
  const Vec3 scene = vector(kernel, "scene", scene_);
  const Mat3 wrong = matrix(kernel, "scene_covariance", scene_covariance);
  const auto of = to_cartesian(values<SIZE>(kernel, "mu", mu).data());
  Out<double> covariance({6, 6});
  sandwich(of.by, P.data(), covariance.data(), 6, SIZE);
  double velocity[3];
  for (int i = 0; i < 3; ++i) {
    velocity[i] = of.at[3 + i] - scene[i];
    for (int j = 0; j < 3; ++j) covariance(3 + i, 3 + j) += wrong[3 * i + j];
  }
  return py::make_tuple(array(of.at, {3}), array(velocity, {3}), covariance.array());
}

// An obstacle as it is published, in {W}. view: K, R_world_from_cam, t_world_from_cam, velocity and
// covariance of the scene; point: how far the middle of what is seen is from that of the surface, as
// a share of its depth; foot: row [px] and sigma of the log of the depth it tells, ground, and the
// covariance of its normal, or None -> plane, position, velocity, covariance (6, 6), corners (4, 3)
py::tuple obstacle_in_world(const py::object& mu_, const py::object& P_, const py::object& extent_,
                            const py::tuple& view, double point, const py::object& foot_) {
  const char* kernel = "obstacle_in_world";
  const In<double> P(kernel, "P", P_, {SIZE, SIZE}, Check::finite);
  const In<double> extent(kernel, "extent", extent_, {4}, Check::finite);
  require(view.size() == 5, kernel, "view must hold K, R, t, velocity, covariance");
  const Mat3 K = matrix(kernel, "K", view[0]), R = matrix(kernel, "R", view[1]);
  const Vec3 t = vector(kernel, "t", view[2]), scene = vector(kernel, "velocity", view[3]);
  const Mat3 wrong = matrix(kernel, "covariance", view[4]);
  const auto mu = values<SIZE>(kernel, "mu", mu_);
  const auto of = to_cartesian(mu.data());
  const double depth = std::exp(mu[DEPTH]), spread = point * depth * point * depth;
  double C[36], turn[36] = {};
  sandwich(of.by, P.data(), C, 6, SIZE);
  // What is wrong all the time: the middle of what is seen is not that of the surface, what a block
  // shows of a vehicle's foot is the same from pair to pair, the ground is as wrong as the map says.
  double share = 0;
  if (!foot_.is_none()) {
    const auto foot = foot_.cast<py::tuple>();
    require(foot.size() == 4, kernel, "foot must hold row, sigma, ground, covariance");
    const Vec3 ground = vector(kernel, "ground", foot[2]), normal = (1 / norm(ground)) * ground;
    const Vec3 ray{mu[0], (foot[0].cast<double>() - K[5]) / K[4], 1};
    const double facing = dot(normal, ray), sigma = foot[1].cast<double>();
    share = sigma * sigma + dot(ray, matrix(kernel, "normal's covariance", foot[3]) * ray) /
                                std::max(facing * facing, 1e-6);
  }
  double along[6];
  for (int i = 0; i < 3; ++i) {
    along[i] = of.at[i];
    along[3 + i] = of.at[3 + i];
  }
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) C[6 * i + j] += share * along[i] * along[j];
  for (int i = 0; i < 3; ++i) {
    C[7 * i] += spread;
    for (int j = 0; j < 3; ++j) {
      C[6 * (3 + i) + 3 + j] += wrong[3 * i + j] + spread * mu[RATE + i] * mu[RATE + j];
      turn[6 * i + j] = turn[6 * (3 + i) + 3 + j] = R[3 * i + j];
    }
  }
  Out<double> covariance({6, 6}), corners({4, 3});
  sandwich(turn, C, covariance.data(), 6, 6);
  const Vec3 position = R * Vec3{of.at[0], of.at[1], of.at[2]} + t;
  const Vec3 velocity = R * (Vec3{of.at[3], of.at[4], of.at[5]} - scene);
  const Vec3 turned = (-1 / depth) * (R * Vec3{of.at[6], of.at[7], of.at[8]});
  // A plane through the world's origin has no n / d there: keep it far from infinite.
  const double scale = 1 - dot(turned, t);
  const Vec3 plane = (1 / std::copysign(std::max(std::abs(scale), 1e-6), scale)) * turned;
  constexpr double reach[4][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  for (int i = 0; i < 4; ++i) {
    const double y = (extent[1] + reach[i][1] * extent[3] - K[5]) / K[4];
    const double x = (extent[0] + reach[i][0] * extent[2] - K[2]) / K[0] - K[1] / K[0] * y;
    const double nearer = 1 + (x - mu[0]) * mu[SLOPE] + (y - mu[1]) * mu[SLOPE + 1];
    const double far = depth / std::min(std::max(nearer, 0.5), 2.0);
    const Vec3 corner = R * (far * Vec3{x, y, 1}) + t;
    for (int k = 0; k < 3; ++k) corners(i, k) = corner[k];
  }
  return py::make_tuple(array(plane.data(), {3}), array(position.data(), {3}),
                        array(velocity.data(), {3}), covariance.array(), corners.array());
}

// The smallest squared distance, over all depths, of "it stands still".
double still_distance(const py::object& mu_, const py::object& P_, const py::object& scene_,
                      const py::object& scene_covariance, double nearer) {
  const char* kernel = "still_distance";
  constexpr int steps = 40;        // to either side
  constexpr double farthest = 4;   // standard deviations
  const auto mu = values<SIZE>(kernel, "mu", mu_);
  const In<double> P(kernel, "P", P_, {SIZE, SIZE}, Check::finite);
  const Vec3 scene = vector(kernel, "scene", scene_);
  const Mat3 wrong = matrix(kernel, "scene_covariance", scene_covariance);
  const double speed = std::max(norm(scene), 1e-12);
  const Vec3 ahead = (1 / speed) * scene;
  const double along = dot(ahead, wrong * ahead);
  const double variance = P(DEPTH, DEPTH) + along / (speed * speed);
  double best = HUGE_VAL;
  for (int k = -steps; k <= steps; ++k) {
    const double sigma = std::sqrt(variance + (k < 0 ? nearer * nearer : 0));
    const double offset = farthest * k / steps * sigma;
    const double inverse_depth = std::exp(-(mu[DEPTH] + offset));
    double S[9], error[3], solved[3];
    for (int i = 0; i < 3; ++i) {
      const double gain = P(RATE + i, DEPTH) / variance;
      error[i] = solved[i] = mu[RATE + i] + offset * gain - inverse_depth * scene[i];
      for (int j = 0; j < 3; ++j)
        S[3 * i + j] = P(RATE + i, RATE + j) - gain * P(RATE + j, DEPTH) +
                       inverse_depth * inverse_depth *
                           (wrong[3 * i + j] - along * ahead[i] * ahead[j]);
    }
    if (!ldlt(S, 3)) continue;
    ldlt_solve(S, 3, solved);
    double distance = offset / sigma * (offset / sigma);
    for (int i = 0; i < 3; ++i) distance += error[i] * solved[i];
    best = std::min(best, distance);
  }
  return best;
}

// An observation z of some elements of a state, with what the two together do not know, factorised.
struct Observed {
  Observed(const char* kernel, const py::object& mu_, const py::object& P_, const py::object& z_,
           const py::object& R_, const py::object& rows_)
      : mu(kernel, "mu", mu_, {ANY}, Check::finite), P(kernel, "P", P_, {mu.size(), mu.size()},
        Check::finite), z(kernel, "z", z_, {mu.size()}, Check::finite),
        R(kernel, "R", R_, {mu.size(), mu.size()}, Check::finite),
        rows(kernel, "rows", rows_, {ANY}), m(static_cast<int>(rows.size())), S(m * m),
        innovation(m) {
    for (int i = 0; i < m; ++i)
      require(rows[i] >= 0 && rows[i] < mu.size(), kernel, "rows name no element");
    for (int i = 0; i < m; ++i) {
      innovation[i] = z[rows[i]] - mu[rows[i]];
      for (int j = 0; j < m; ++j) S[i * m + j] = P(rows[i], rows[j]) + R(rows[i], rows[j]);
    }
    require(ldlt(S.data(), m), kernel, "P + R must have an inverse");
  }

  const In<double> mu, P, z, R;
  const In<std::int64_t> rows;
  const int m;
  std::vector<double> S, innovation;
};

double element_distance(const py::object& mu, const py::object& P, const py::object& z,
                        const py::object& R, const py::object& rows) {
  const Observed of("element_distance", mu, P, z, R, rows);
  auto solved = of.innovation;
  ldlt_solve(of.S.data(), of.m, solved.data());
  double distance = 0;
  for (int i = 0; i < of.m; ++i) distance += of.innovation[i] * solved[i];
  return distance;
}

// Kalman update by some elements; Joseph form. -> mu, P
py::tuple correct_elements(const py::object& mu, const py::object& P, const py::object& z,
                           const py::object& R, const py::object& rows) {
  const Observed of("correct_elements", mu, P, z, R, rows);
  const int n = static_cast<int>(of.mu.size()), m = of.m;
  std::vector<double> K(n * m), I_KH(n * n, 0.0), noise(m * m);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < m; ++j) K[i * m + j] = of.P(of.rows[j], i);
    ldlt_solve(of.S.data(), m, &K[i * m]);
    I_KH[i * n + i] = 1;
    for (int j = 0; j < m; ++j) I_KH[i * n + of.rows[j]] -= K[i * m + j];
  }
  for (int i = 0; i < m; ++i)
    for (int j = 0; j < m; ++j) noise[i * m + j] = of.R(of.rows[i], of.rows[j]);
  std::vector<double> left(n * n), right(n * n);
  sandwich(I_KH.data(), of.P.data(), left.data(), n, n);
  sandwich(K.data(), noise.data(), right.data(), n, m);
  Out<double> mean({n}), covariance({n, n});
  for (int i = 0; i < n; ++i) {
    mean[i] = of.mu[i];
    for (int j = 0; j < m; ++j) mean[i] += K[i * m + j] * of.innovation[j];
    for (int j = 0; j < n; ++j)
      covariance(i, j) = 0.5 * ((left[i * n + j] + left[j * n + i]) +
                                (right[i * n + j] + right[j * n + i]));
  }
  return py::make_tuple(mean.array(), covariance.array());
}

}  // namespace
}  // namespace kernels

void bind_obstacle_motion(kernels::py::module_& module) {
  using namespace kernels;
  module.def("obstacle_to_cartesian", obstacle_to_cartesian);
  module.def("obstacle_from_cartesian", obstacle_from_cartesian);
  module.def("predict_obstacle", predict_obstacle);
  module.def("obstacle_motion", obstacle_motion);
  module.def("obstacle_in_world", obstacle_in_world);
  module.def("still_distance", still_distance);
  module.def("element_distance", element_distance);
  module.def("correct_elements", correct_elements);
}
