// Correction of the scene filter by all that a key frame pair tells at once, (19) of [SLAPSE]: the
// maximum of the posterior, by relinearised steps. See scene/update.py.

#include <algorithm>
#include <cmath>

#include "lanes.hpp"
#include "scene.hpp"
#include "two_view_arguments.hpp"

namespace kernels {

namespace {

constexpr double FIRST_WIDTH = 6.0, WIDTH = 3.0;  // of the kernel in the first step, and after it
constexpr double SETTLED = 1e-6;                  // change of all errors that ends the steps

using Matrix = std::vector<double>;  // row by row

struct Settings {
  Joint joint;  // without the width
  double focal_sigma, place_bias;
  int iterations;
};

// What is told of m elements of the state: normal equations, and what lasting errors add to them.
struct Information {
  explicit Information(int m) : matrix(m * m), vector(m), lasting(m * N_LASTING) {}
  Matrix matrix, vector, lasting;
};

// The elements of the state that are told of: the planes out of view are many, nothing tells of them.
class Columns {
 public:
  Columns(const Scene& scene, const std::vector<int>& seen, const std::vector<Observation>& told)
      : place_(scene.size(), -1) {
    for (int i = 0; i < 12; ++i) add(i);
    for (int i = MOUNT; i < PLANES; ++i) add(i);
    for (const int k : seen) add_plane(k);
    for (const auto& one : told)
      if (one.plane >= 0) add_plane(one.plane);
  }
  int size() const { return static_cast<int>(of.size()); }
  int operator[](int element) const { return place_[element]; }

  std::vector<int> of;

 private:
  void add(int element) {
    if (place_[element] >= 0) return;
    place_[element] = size();
    of.push_back(element);
  }
  void add_plane(int k) {
    for (int i = 0; i < 3; ++i) add(PLANES + 3 * k + i);
  }
  std::vector<int> place_;
};

// The first columns, so many times four, of a[m] + factor b[k] C[k, m]; the sums stay in registers.
template <int FOURS>
struct Sums {
  KERNELS_INLINE Sums(const double* a, const double* b, const double* C, int inner, int columns,
                      double factor) {
    for (int f = 0; f < FOURS; ++f) of[f] = load(a + f * LANES);
    for (int k = 0; k < inner; ++k, C += columns) {
      const double weight = factor * b[k];
      if (weight == 0) continue;
      for (int f = 0; f < FOURS; ++f) of[f] += weight * load(C + f * LANES);
    }
  }
  KERNELS_INLINE void write(double* a) const {
    for (int f = 0; f < FOURS; ++f) store(of[f], a + f * LANES);
  }
  Four of[FOURS];
};

// A[:, m] += factor B[:, k] C[k, m] by rows, so that the sums run in the order of k.
KERNELS_WIDE
void multiply_add(const double* B, const double* C, double* A, int rows, int inner, int columns,
                  double factor = 1) {
  constexpr int LANE = LANES;
  const int last = columns - LANE;  // from here on summed first: others may reach into it
  for (int i = 0; i < rows; ++i, B += inner, A += columns) {
    if (last < 0) {
      for (int j = 0; j < columns; ++j) {
        double sum = A[j];
        for (int k = 0; k < inner; ++k) sum += factor * B[k] * C[k * columns + j];
        A[j] = sum;
      }
      continue;
    }
    const Sums<1> end(A + last, B, C + last, inner, columns, factor);
    int j = 0;
    for (; j + 4 * LANE <= columns; j += 4 * LANE)
      Sums<4>(A + j, B, C + j, inner, columns, factor).write(A + j);
    for (; j + 2 * LANE <= columns; j += 2 * LANE)
      Sums<2>(A + j, B, C + j, inner, columns, factor).write(A + j);
    if (j < last) Sums<1>(A + j, B, C + j, inner, columns, factor).write(A + j);
    end.write(A + last);
  }
}

// Solves A X = B in place by Gauss with row pivots; A (m x m), B (m x n). False: A is singular.
KERNELS_WIDE
bool solve(Matrix& A, int m, Matrix& B, int n) {
  for (int k = 0; k < m; ++k) {
    int pivot = k;
    for (int i = k + 1; i < m; ++i)
      if (std::abs(A[i * m + k]) > std::abs(A[pivot * m + k])) pivot = i;
    if (!(std::abs(A[pivot * m + k]) > 0)) return false;
    if (pivot != k) {
      std::swap_ranges(&A[k * m], &A[k * m] + m, &A[pivot * m]);
      std::swap_ranges(&B[k * n], &B[k * n] + n, &B[pivot * n]);
    }
    for (int i = k + 1; i < m; ++i) {
      const double lower = A[i * m + k] /= A[k * m + k];
      if (lower == 0) continue;
      for (int j = k + 1; j < m; ++j) A[i * m + j] -= lower * A[k * m + j];
    }
  }
  for (int k = 0; k < m; ++k) multiply_add(&A[k * m], B.data(), &B[k * n], 1, k, n, -1);
  for (int k = m - 1; k >= 0; --k) {
    const int after = k + 1;
    multiply_add(A.data() + k * m + after, B.data() + after * n, &B[k * n], 1, m - after, n, -1);
    for (int j = 0; j < n; ++j) B[k * n + j] /= A[k * m + k];
  }
  return true;
}

// The derivative (6 + 3 P, m) of (w, t, planes in the camera) by the columns of the state.
Matrix observation_jacobian(const Scene& scene, const RelativeMotion& motion,
                            const std::vector<PlaneInCamera>& in_camera,
                            const std::vector<int>& seen, const Columns& columns) {
  const int m = columns.size();
  Matrix G((6 + 3 * seen.size()) * m), row(scene.size());
  for (int i = 0; i < 6; ++i) {
    std::fill(row.begin(), row.end(), 0.0);
    Vec3 w{}, t{};
    (i < 3 ? w : t)[i % 3] = 1;
    add_by_poses(motion, w, t, row.data());
    for (int j = 0; j < 12; ++j) G[i * m + j] = row[j];
  }
  for (std::size_t k = 0; k < seen.size(); ++k)
    for (int i = 0; i < 3; ++i) {
      double* to = &G[(6 + 3 * k + i) * m];
      for (int j = 0; j < 6; ++j) to[CURRENT + j] = in_camera[k].by_pose.at[i][j];
      for (int j = 0; j < 3; ++j)
        to[columns[PLANES + 3 * seen[k] + j]] = in_camera[k].by_plane[3 * i + j];
    }
  return G;
}

// What each lasting error makes of (w, t, planes), (6 + 3 P, N_LASTING): turn of all vectors, place
// in their blocks that they tell of, and focal length. A place beside the middle displaces all of
// the picture, as if the camera looked the other way by that angle, but for what the picture's size
// makes of second order; a focal length that is too short lets what lies across seem farther so.
Matrix lasting_errors(const RelativeMotion& motion, const std::vector<PlaneInCamera>& in_camera,
                      const Settings& settings, double focal) {
  const double place = settings.place_bias / focal;
  const auto& joint = settings.joint;
  const Vec3 turn = (1 / focal) * Vec3{joint.offset, joint.offset, joint.roll};
  Matrix out((6 + 3 * in_camera.size()) * N_LASTING);
  const auto put = [&](int row, const Mat3& displaced, const Vec3& stretched) {
    for (int i = 0; i < 3; ++i) {
      double* to = &out[(row + i) * N_LASTING];
      to[LASTING_PLACE] = place * displaced[3 * i + 1];
      to[LASTING_PLACE + 1] = -place * displaced[3 * i];
      to[LASTING_FOCAL] = i < 2 ? settings.focal_sigma * stretched[i] : 0.0;
    }
  };
  Mat3 turned = motion.R;
  for (int i = 0; i < 3; ++i) turned[4 * i] -= 1;
  put(0, turned, rotation_log(motion.R));
  put(3, skew(motion.t), motion.t);
  for (std::size_t k = 0; k < in_camera.size(); ++k)
    put(6 + 3 * k, skew(in_camera[k].plane), -1.0 * in_camera[k].plane);
  for (int i = 0; i < 3; ++i) out[i * N_LASTING + LASTING_TURN + i] = turn[i];
  return out;
}

// Adds what the correspondences tell at a state.
void add_pair(const Scene& scene, const std::vector<Blocks>& groups, double fx, double fy,
              const std::vector<int>& seen, const Columns& columns, const Settings& settings,
              double width, Information& told) {
  const auto motion = relative_motion(scene);
  std::vector<PlaneInCamera> in_camera;
  Matrix planes;
  for (const int k : seen) {
    in_camera.push_back(plane_in_camera(scene, k));
    for (const double x : in_camera.back().plane) planes.push_back(x);
  }
  const int r = 6 + 3 * static_cast<int>(seen.size()), m = columns.size();
  Matrix A(r * r), b(r), AG(r * m), AL(r * N_LASTING), GT(m * r);
  Joint joint = settings.joint;
  joint.noise.width = width;
  normal_equations(groups, {motion.R, motion.t, fx, fy}, planes.data(), joint, A.data(), b.data());
  const Matrix G = observation_jacobian(scene, motion, in_camera, seen, columns);
  for (int i = 0; i < r; ++i)
    for (int j = 0; j < m; ++j) GT[j * r + i] = G[i * m + j];
  multiply_add(A.data(), G.data(), AG.data(), r, r, m);
  multiply_add(GT.data(), AG.data(), told.matrix.data(), m, r, m);
  multiply_add(GT.data(), b.data(), told.vector.data(), m, r, 1);
  const Matrix errors = lasting_errors(motion, in_camera, settings, 0.5 * (fx + fy));
  multiply_add(A.data(), errors.data(), AL.data(), r, r, N_LASTING);
  multiply_add(GT.data(), AL.data(), told.lasting.data(), m, r, N_LASTING);
}

// Adds a direct observation at a state, in information form.
void add_observation(const Scene& scene, const Observation& of, const Columns& columns,
                     Information& told) {
  const int n = scene.size(), m = columns.size();
  Matrix H(3 * n);
  double innovation[3];
  const int rows = observe(scene, of, innovation, H.data());
  for (int r = 0; r < rows; ++r)
    for (int i = 0; i < m; ++i) {
      const double weighted = H[r * n + columns.of[i]] / (of.sigma * of.sigma);
      if (weighted == 0) continue;
      for (int j = 0; j < m; ++j) told.matrix[i * m + j] += weighted * H[r * n + columns.of[j]];
      told.vector[i] += weighted * innovation[r];
      for (int j = 0; j < N_LASTING; ++j) told.lasting[i * N_LASTING + j] += weighted * of.lasting[j];
    }
}

// The gain (n, m) of information, P[:, of] (I + M P[of, of])^-1, transposed: (m, n).
Matrix gain_of(const double* P, int n, const Columns& columns, const Information& told) {
  const int m = columns.size();
  Matrix seen(m * m), rows(m * n), part(m * m);
  for (int i = 0; i < m; ++i)
    for (int j = 0; j < m; ++j) part[i * m + j] = P[columns.of[i] * n + columns.of[j]];
  // (I + M P)^T = I + P M, both being symmetric.
  multiply_add(part.data(), told.matrix.data(), seen.data(), m, m, m);
  for (int i = 0; i < m; ++i) seen[i * m + i] += 1;
  for (int i = 0; i < m; ++i) std::copy_n(P + columns.of[i] * n, n, &rows[i * n]);
  if (!solve(seen, m, rows, n)) std::fill(rows.begin(), rows.end(), 0.0);  // tells nothing
  return rows;
}

// P (n, n) and lasting (n, N_LASTING) after the gain: L P L^T + K M K^T with L = I - K M (Joseph).
void correct(const Matrix& gain, const Information& told, const Columns& columns, int n, double* P,
             double* lasting) {
  const int m = columns.size();
  Matrix K(n * m), rows(m * n), MP(m * n), KM(n * m), left(n * m);
  for (int i = 0; i < m; ++i)
    for (int j = 0; j < n; ++j) K[j * m + i] = gain[i * n + j];
  for (int i = 0; i < m; ++i) std::copy_n(P + columns.of[i] * n, n, &rows[i * n]);
  multiply_add(told.matrix.data(), rows.data(), MP.data(), m, m, n);
  multiply_add(K.data(), MP.data(), P, n, m, n, -1);
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < m; ++j) left[i * m + j] = P[i * n + columns.of[j]] - K[i * m + j];
  multiply_add(left.data(), told.matrix.data(), KM.data(), n, m, m);
  multiply_add(KM.data(), gain.data(), P, n, m, n, -1);
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < i; ++j) P[i * n + j] = P[j * n + i] = 0.5 * (P[i * n + j] + P[j * n + i]);
  Matrix known(m * N_LASTING), change = told.lasting;
  for (int i = 0; i < m; ++i)
    std::copy_n(lasting + columns.of[i] * N_LASTING, N_LASTING, &known[i * N_LASTING]);
  multiply_add(told.matrix.data(), known.data(), change.data(), m, m, N_LASTING, -1);
  multiply_add(K.data(), change.data(), lasting, n, m, N_LASTING);
}

// Moves e (n,) to the maximum of the posterior and updates P and lasting.
void update(const Scene& prior, const std::vector<Blocks>& groups, double fx, double fy,
            const std::vector<int>& seen, const std::vector<Observation>& observations,
            const Settings& settings, Matrix& e, double* P, double* lasting) {
  const Columns columns(prior, seen, observations);
  const int n = prior.size(), m = columns.size();
  Information told(m);
  Matrix gain;
  for (int step = 0; step < settings.iterations; ++step) {
    const Scene scene = moved(prior, e.data());
    told = Information(m);
    if (!groups.empty())
      add_pair(scene, groups, fx, fy, seen, columns, settings, step ? WIDTH : FIRST_WIDTH, told);
    for (const auto& one : observations) add_observation(scene, one, columns, told);
    gain = gain_of(P, n, columns, told);
    Matrix right = told.vector, at(m), next(n);
    for (int i = 0; i < m; ++i) at[i] = e[columns.of[i]];
    multiply_add(told.matrix.data(), at.data(), right.data(), m, m, 1);
    multiply_add(right.data(), gain.data(), next.data(), 1, m, n);
    double change = 0;
    for (int j = 0; j < n; ++j) change = std::fmax(change, std::abs(next[j] - e[j]));
    e.swap(next);
    if (change < SETTLED) break;
  }
  correct(gain, told, columns, n, P, lasting);
}

Scene scene_of(const char* kernel, const py::object& camera, const py::object& planes,
               const py::object& anchors) {
  const In<double> c(kernel, "camera", camera, {29}, Check::finite);
  const In<double> p(kernel, "planes", planes, {ANY, 3}, Check::finite);
  const In<double> a(kernel, "anchors", anchors, {p.size(), 3}, Check::finite);
  Scene scene;
  std::copy_n(c.data(), 9, scene.previous.R.begin());
  std::copy_n(c.data() + 9, 3, scene.previous.t.begin());
  std::copy_n(c.data() + 12, 9, scene.current.R.begin());
  std::copy_n(c.data() + 21, 3, scene.current.t.begin());
  std::copy_n(c.data() + 24, 3, scene.mount.begin());
  scene.depth_scale = c[27];
  scene.heave = c[28];
  for (py::ssize_t k = 0; k < p.size(); ++k) {
    scene.planes.push_back({p(k, 0), p(k, 1), p(k, 2)});
    scene.anchors.push_back({a(k, 0), a(k, 1), a(k, 2)});
  }
  return scene;
}

// A row: kind, plane, value, sigma, lasting, R (9), t (3), slope (6); see Observation.
std::vector<Observation> observations_of(const char* kernel, const py::object& rows,
                                         const Scene& scene) {
  constexpr int WIDTH = 4 + N_LASTING + 18;
  const In<double> given(kernel, "observations", rows, {ANY, WIDTH}, Check::finite);
  std::vector<Observation> out(given.size());
  for (std::size_t k = 0; k < out.size(); ++k) {
    const double* row = given.data() + WIDTH * k;
    require(row[0] >= 0 && row[0] <= static_cast<int>(Kind::depth_ratio), kernel,
            "observations name a kind that there is not");
    require(row[1] < static_cast<double>(scene.planes.size()) && row[3] > 0, kernel,
            "observations name a plane that there is not, or no noise");
    auto& one = out[k];
    one.kind = static_cast<Kind>(static_cast<int>(row[0]));
    one.plane = static_cast<int>(row[1]);
    require(one.plane >= 0 || one.kind >= Kind::level_course, kernel,
            "an observation of a plane must name it");
    one.value = row[2];
    one.sigma = row[3];
    std::copy_n(row + 4, N_LASTING, one.lasting);
    const double* depths = row + 4 + N_LASTING;
    std::copy_n(depths, 9, one.R.begin());
    std::copy_n(depths + 9, 3, one.t.begin());
    std::copy_n(depths + 12, 6, one.slope);
  }
  return out;
}

py::array_t<double> copied(const Matrix& values) {
  Out<double> out({static_cast<py::ssize_t>(values.size())});
  std::copy(values.begin(), values.end(), out.data());
  return out.array();
}

// options: relief, across, along, bias, offset, roll, focal_sigma, place_bias, iterations.
py::tuple scene_update(const py::object& camera, const py::object& planes,
                       const py::object& anchors, const py::object& covariance,
                       const py::object& errors, const py::object& start, const py::object& pair,
                       const py::object& seen, const py::object& observations,
                       const py::object& options) {
  const char* kernel = "scene_update";
  const Scene scene = scene_of(kernel, camera, planes, anchors);
  const int n = scene.size();
  const In<double> given(kernel, "covariance", covariance, {n, n}, Check::finite);
  const In<double> before(kernel, "lasting", errors, {n, N_LASTING}, Check::finite);
  const In<double> first(kernel, "start", start, {n}, Check::finite);
  const In<double> o(kernel, "options", options, {9}, Check::finite);
  const In<std::int64_t> ids(kernel, "seen", seen, {ANY});
  const Settings settings{{{o[0], 0.0, o[1], o[2]}, o[3], o[4], o[5]}, o[6], o[7],
                          static_cast<int>(o[8])};
  require(settings.iterations > 0, kernel, "options name no iteration");
  std::vector<int> at;
  for (py::ssize_t i = 0; i < ids.size(); ++i) {
    require(ids[i] >= 0 && ids[i] < static_cast<std::int64_t>(scene.planes.size()), kernel,
            "seen names a plane that there is not");
    at.push_back(static_cast<int>(ids[i]));
  }
  std::vector<Blocks> groups;
  double fx = 1, fy = 1;
  if (!pair.is_none()) {
    const auto columns = pair.cast<py::tuple>();
    require(columns.size() == 5, kernel, "pair must be rays_cur, rays_prev, sigma, index, focal");
    const PairArrays arrays(kernel, columns[0], columns[1], columns[2]);
    const In<double> focal(kernel, "focal", columns[4], {2}, Check::finite);
    fx = focal[0];
    fy = focal[1];
    groups = arrays.groups(kernel, columns[3], static_cast<int>(at.size()));
  }
  Matrix e(first.data(), first.data() + n);
  Out<double> P({n, n}), lasting({n, N_LASTING});
  std::copy_n(given.data(), n * n, P.data());
  std::copy_n(before.data(), n * N_LASTING, lasting.data());
  update(scene, groups, fx, fy, at, observations_of(kernel, observations, scene), settings, e,
         P.data(), lasting.data());
  return py::make_tuple(copied(e), P.array(), lasting.array());
}

py::tuple scene_observe(const py::object& camera, const py::object& planes,
                        const py::object& anchors, const py::object& observation) {
  const char* kernel = "scene_observe";
  const Scene scene = scene_of(kernel, camera, planes, anchors);
  const auto of = observations_of(kernel, observation, scene);
  require(of.size() == 1, kernel, "observations must be one row");
  Matrix innovation(3), H(3 * scene.size());
  const int rows = observe(scene, of[0], innovation.data(), H.data());
  Out<double> difference({rows}), by_state({rows, scene.size()});
  std::copy_n(innovation.data(), rows, difference.data());
  std::copy_n(H.data(), rows * scene.size(), by_state.data());
  return py::make_tuple(difference.array(), by_state.array());
}

// Squared distances (K,) of planes seen, in baselines, from those predicted; see scene/gating.py.
py::array_t<double> scene_distances(const py::object& camera, const py::object& planes,
                                    const py::object& anchors, const py::object& covariance,
                                    const py::object& which, const py::object& shown,
                                    const py::object& noise) {
  const char* kernel = "scene_distances";
  const Scene scene = scene_of(kernel, camera, planes, anchors);
  const int n = scene.size();
  const In<double> P(kernel, "covariance", covariance, {n, n}, Check::finite);
  const In<std::int64_t> of(kernel, "which", which, {ANY});
  const In<double> plane(kernel, "shown", shown, {of.size(), 3}, Check::finite);
  const In<double> R(kernel, "noise", noise, {of.size(), 9}, Check::finite);
  const auto motion = relative_motion(scene);
  const double length = norm(motion.t);
  Out<double> out({of.size()});
  for (py::ssize_t k = 0; k < of.size(); ++k) {
    require(of[k] >= 0 && of[k] < static_cast<std::int64_t>(scene.planes.size()), kernel,
            "which names a plane that there is not");
    out[k] = HUGE_VAL;
    if (length < 1e-9) continue;
    const auto in_camera = plane_in_camera(scene, static_cast<int>(of[k]));
    // The observation is plane_in_camera * |t|, by 15 elements of the state.
    double H[3][15] = {}, HP[3][15] = {}, S[9], difference[3];
    int at[15];
    for (int j = 0; j < 12; ++j) at[j] = j;
    for (int j = 0; j < 3; ++j) at[12 + j] = PLANES + 3 * static_cast<int>(of[k]) + j;
    for (int i = 0; i < 3; ++i) {
      add_by_poses(motion, {}, (in_camera.plane[i] / length) * motion.t, H[i]);
      for (int j = 0; j < 6; ++j) H[i][CURRENT + j] += length * in_camera.by_pose.at[i][j];
      for (int j = 0; j < 3; ++j) H[i][12 + j] = length * in_camera.by_plane[3 * i + j];
      difference[i] = plane(k, i) - length * in_camera.plane[i];
      for (int j = 0; j < 15; ++j)
        for (int l = 0; l < 15; ++l) HP[i][l] += H[i][j] * P(at[j], at[l]);
    }
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        S[3 * i + j] = R(k, 3 * i + j);
        for (int l = 0; l < 15; ++l) S[3 * i + j] += HP[i][l] * H[j][l];
      }
    double solved[3] = {difference[0], difference[1], difference[2]};
    if (!cholesky(S, 3)) continue;
    cholesky_solve(S, 3, solved);
    out[k] = difference[0] * solved[0] + difference[1] * solved[1] + difference[2] * solved[2];
  }
  return out.array();
}

// Prediction of a filter whose transition F is the identity but for some rows: P and lasting after
// it, with the noise Q of those rows.
py::tuple predict_rows(const py::object& covariance, const py::object& errors,
                       const py::object& rows, const py::object& transition,
                       const py::object& noise) {
  const char* kernel = "predict_rows";
  const In<double> before(kernel, "covariance", covariance, {ANY, ANY}, Check::finite);
  const auto n = before.size();
  const In<double> known(kernel, "lasting", errors, {n, ANY}, Check::finite);
  const In<std::int64_t> at(kernel, "rows", rows, {ANY});
  const auto r = at.size(), l = known.size(1);
  const In<double> F(kernel, "transition", transition, {r, n}, Check::finite);
  const In<double> Q(kernel, "noise", noise, {r, r}, Check::finite);
  require(before.size(1) == n, kernel, "covariance must be square");
  Out<double> P({n, n}), lasting({n, l});
  std::copy_n(before.data(), n * n, P.data());
  std::copy_n(known.data(), n * l, lasting.data());
  Matrix FP(r * n), FL(r * l);
  multiply_add(F.data(), before.data(), FP.data(), r, n, n);
  multiply_add(F.data(), known.data(), FL.data(), r, n, l);
  for (py::ssize_t i = 0; i < r; ++i) {
    require(at[i] >= 0 && at[i] < n, kernel, "rows name an element that there is not");
    for (py::ssize_t j = 0; j < n; ++j) P(at[i], j) = P(j, at[i]) = FP[i * n + j];
    for (py::ssize_t j = 0; j < l; ++j) lasting(at[i], j) = FL[i * l + j];
  }
  for (py::ssize_t i = 0; i < r; ++i)
    for (py::ssize_t k = 0; k <= i; ++k) {
      double value = 0.5 * (Q(i, k) + Q(k, i));
      for (py::ssize_t j = 0; j < n; ++j) value += FP[i * n + j] * F(k, j);
      P(at[i], at[k]) = P(at[k], at[i]) = value;
    }
  return py::make_tuple(P.array(), lasting.array());
}

}  // namespace
}  // namespace kernels

void bind_scene(kernels::py::module_& module) {
  module.def("scene_update", kernels::scene_update);
  module.def("scene_observe", kernels::scene_observe);
  module.def("scene_distances", kernels::scene_distances);
  module.def("predict_rows", kernels::predict_rows);
}
