// What the scene filter takes from a pair's blocks, and what its map says of planes. See
// scene/update.py, scene/noise.py, scene/scale/ratio.py and scene/plane_map.py.

#include <algorithm>
#include <cmath>
#include <limits>

#include "scene.hpp"
#include "two_view_arguments.hpp"

namespace kernels {

namespace {

constexpr int MACROBLOCK = 16;                      // px
constexpr int AROUND = 5;                           // macroblocks across a window
constexpr std::int8_t STATIONARY = 0, MOVING = 1, INFINITE = 2;  // labels of records.Label

// Sums of values by macroblock, and of a window of AROUND macroblocks around each.
class Grid {
 public:
  Grid(int columns, int rows) : columns_(columns), rows_(rows), value_(columns * rows) {}
  double& at(int column, int row) { return value_[row * columns_ + column]; }
  Grid around() const {
    Grid across(columns_, rows_), out(columns_, rows_);
    const int reach = AROUND / 2;
    for (int r = 0; r < rows_; ++r)
      for (int off = -reach; off <= reach; ++off)
        for (int c = std::max(-off, 0); c < columns_ - std::max(off, 0); ++c)
          across.value_[r * columns_ + c] += value_[r * columns_ + c + off];
    for (int r = 0; r < rows_; ++r)
      for (int k = std::max(r - reach, 0); k <= std::min(r + reach, rows_ - 1); ++k)
        for (int c = 0; c < columns_; ++c)
          out.value_[r * columns_ + c] += across.value_[k * columns_ + c];
    return out;
  }

 private:
  int columns_, rows_;
  std::vector<double> value_;
};

// The macroblock of each pixel, from the first; `shift` is where in its pixel a centre lies.
struct Cells2 {
  Cells2(const std::vector<double>& x, double shift) : of(x.size()) {
    for (std::size_t i = 0; i < of.size(); ++i) {
      const double scaled = std::clamp((x[i] + shift) / MACROBLOCK, -1000.0, 1000.0);
      const int whole = static_cast<int>(scaled);
      of[i] = whole - (scaled < whole);
    }
    int low[2] = {0, 0}, high[2] = {0, 0};
    for (int axis = 0; axis < 2 && !of.empty(); ++axis) {
      low[axis] = high[axis] = of[axis];
      for (std::size_t i = axis; i < of.size(); i += 2) {
        low[axis] = std::min(low[axis], of[i]);
        high[axis] = std::max(high[axis], of[i]);
      }
    }
    for (std::size_t i = 0; i < of.size(); ++i) of[i] -= low[i % 2];
    columns = high[0] - low[0] + 1;
    rows = high[1] - low[1] + 1;
  }
  std::vector<int> of;
  int columns, rows;
};

// The stationary correspondences that count: rays_cur, rays_prev (M, 3), x_prev (M, 2), sigma,
// plane_id (M,). On no plane a block counts only where it touches no mover and most vectors around
// it are still.
py::tuple stationary_blocks(const py::object& x_cur, const py::object& x_prev,
                            const py::object& sigma, const py::object& label,
                            const py::object& plane_id, const py::object& intrinsics) {
  const char* kernel = "stationary_blocks";
  const In<float> cur(kernel, "x_cur", x_cur, {ANY, 2}, Check::finite);
  const auto n = cur.size();
  const In<float> prev(kernel, "x_prev", x_prev, {n, 2}, Check::finite);
  const In<float> noise(kernel, "sigma", sigma, {n}, Check::finite);
  const In<std::int8_t> of(kernel, "label", label, {n});
  const In<std::int32_t> plane(kernel, "plane_id", plane_id, {n});
  const In<double> K(kernel, "K", intrinsics, {3, 3}, Check::finite);
  std::vector<double> x(cur.data(), cur.data() + 2 * n);
  const Cells2 cells(x, 0.5);
  Grid more(cells.columns, cells.rows);  // how many more are still than not
  std::vector<char> moves((cells.columns + 2) * (cells.rows + 2), 0);
  for (py::ssize_t i = 0; i < n; ++i) {
    const int c = cells.of[2 * i], r = cells.of[2 * i + 1];
    more.at(c, r) += of[i] == STATIONARY || of[i] == INFINITE ? 1 : -1;
    if (of[i] == MOVING)
      for (int k = 0; k < 9; ++k) moves[(r + k / 3) * (cells.columns + 2) + c + k % 3] = 1;
  }
  Grid around = more.around();
  std::vector<py::ssize_t> kept;
  for (py::ssize_t i = 0; i < n; ++i) {
    const int c = cells.of[2 * i], r = cells.of[2 * i + 1];
    const bool stray = moves[(r + 1) * (cells.columns + 2) + c + 1] || around.at(c, r) < 0;
    if ((of[i] == STATIONARY || of[i] == INFINITE) && (plane[i] >= 0 || !stray)) kept.push_back(i);
  }
  const auto m = static_cast<py::ssize_t>(kept.size());
  Out<double> rays_cur({m, 3}), rays_prev({m, 3}), before({m, 2}), spread({m});
  Out<std::int32_t> ids({m});
  const double focal[2] = {K(0, 0), K(1, 1)}, centre[2] = {K(0, 2), K(1, 2)},
               skewness = K(0, 1) / K(0, 0);
  const auto ray = [&](double u, double v, double* to) {
    const double y = (v - centre[1]) / focal[1];
    to[0] = (u - centre[0]) / focal[0] - skewness * y;
    to[1] = y;
    to[2] = 1;
  };
  for (py::ssize_t i = 0; i < m; ++i) {
    const auto k = kept[i];
    ray(cur(k, 0), cur(k, 1), rays_cur.data() + 3 * i);
    ray(prev(k, 0), prev(k, 1), rays_prev.data() + 3 * i);
    before(i, 0) = prev(k, 0);
    before(i, 1) = prev(k, 1);
    spread[i] = noise[k];
    ids[i] = plane[k];
  }
  return py::make_tuple(rays_cur.array(), rays_prev.array(), before.array(), spread.array(),
                        ids.array());
}

// Variance of a mean of errors across epipolar lines over what independent ones would have: each is
// weighed as the update weighs it, products with all errors in the window around add up. Also returns
// the median of their standard deviations.
py::tuple error_dependence(const py::object& rays_cur, const py::object& rays_prev,
                        const py::object& sigma, const py::object& x_prev, const py::object& focal,
                        const py::object& R, const py::object& t, double width) {
  const char* kernel = "error_dependence";
  const PairArrays pair(kernel, rays_cur, rays_prev, sigma);
  const auto n = static_cast<py::ssize_t>(pair.size());
  const In<double> before(kernel, "x_prev", x_prev, {n, 2}, Check::finite);
  require(n > 0 && width > 0, kernel, "there must be errors and a width");
  const auto errors = epipolar_errors(pair.blocks(), two_view(kernel, R, t, focal));
  const Cells2 cells(std::vector<double>(before.data(), before.data() + 2 * n), 0.0);
  Grid total(cells.columns, cells.rows);
  double weights = 0, slopes = 0;
  for (py::ssize_t i = 0; i < n; ++i) {
    const double error = errors[i];
    const double share = error / width * (error / width), bounded = 1 / (1 + share);
    const double weight = bounded * bounded;
    weights += weight;
    slopes += weight - 4 * share * bounded * weight;
    total.at(cells.of[2 * i], cells.of[2 * i + 1]) += weight * error;
  }
  Grid around = total.around();
  double variance = 0;
  for (int r = 0; r < cells.rows; ++r)
    for (int c = 0; c < cells.columns; ++c) variance += total.at(c, r) * around.at(c, r);
  const double slope = std::max(slopes / n, 0.1);  // of errors mostly beyond the kernel
  std::vector<double> spread(pair.sigma.data(), pair.sigma.data() + n);
  return py::make_tuple(variance / n * (weights / n) / (slope * slope), median(spread));
}

struct Slopes {
  double sums[6] = {}, weights = 0;
};

// Weighted sums of what the inverse depths of blocks change by, as shares.
KERNELS_WIDE
Slopes depth_slopes(const Blocks& blocks, const TwoView& view, double max_spread, double relief) {
  const Four one = Four{} + 1.0;
  Slopes out;
  for (std::size_t i = 0; i < blocks.x.size(); i += LANES) {
    const Four3 turned = view.R * Four3{load(&blocks.u[i]), load(&blocks.v[i]), one};
    const Four3 y{turned.x / turned.z, turned.y / turned.z, one};
    const Four gx = (view.t[0] - y.x * view.t[2]) * view.fx;
    const Four gy = (view.t[1] - y.y * view.t[2]) * view.fy;
    const Four square = at_least(gx * gx + gy * gy, 1e-18);
    const Four dx = (load(&blocks.x[i]) - y.x) * view.fx, dy = (load(&blocks.y[i]) - y.y) * view.fy;
    const Four rho = (dx * gx + dy * gy) / square;
    const Four spread = magnitude(1 - rho * view.t[2]) / root(square) * load(&blocks.sigma[i]);
    const auto tells = spread < max_spread * rho;
    const Four weight = 1 / (spread / rho * (spread / rho) + relief * relief);
    // y moves by w x y, and back to z = 1; what a vector in the picture tells by y is v . dy.
    const Four bx = (dx - 2 * rho * gx) / square * view.fx;
    const Four by = (dy - 2 * rho * gy) / square * view.fy;
    const Four px = -gx / square * view.fx - bx * view.t[2];
    const Four py_ = -gy / square * view.fy - by * view.t[2];
    const Four3 by_w = cross(y, Four3{px, py_, -(px * y.x + py_ * y.y)});
    const Four row[6] = {by_w.x, by_w.y, by_w.z, bx, by, -(bx * y.x + by * y.y)};
    Four share[6];
    for (int k = 0; k < 6; ++k) share[k] = weight * row[k] / rho;
    for (std::size_t j = 0; j < std::min(LANES, blocks.count - i); ++j) {
      if (!tells[j]) continue;
      for (int k = 0; k < 6; ++k) out.sums[k] += share[k][j];
      out.weights += weight[j];
    }
  }
  return out;
}

// Derivative (6,) of the mean log of inverse depth by (w, t) of the pair's motion; zeros where no
// depth is sure.
py::array_t<double> depth_slope(const py::object& rays_cur, const py::object& rays_prev,
                                const py::object& sigma, const py::object& focal,
                                const py::object& R, const py::object& t, double max_spread,
                                double relief) {
  const char* kernel = "depth_slope";
  const PairArrays pair(kernel, rays_cur, rays_prev, sigma);
  const Slopes found =
      depth_slopes(pair.blocks(), two_view(kernel, R, t, focal), max_spread, relief);
  Out<double> out({6});
  for (int k = 0; k < 6 && found.weights > 0; ++k) out[k] = found.sums[k] / found.weights;
  return out.array();
}

// Normals (P, 3), depths (P,) and covariances (P, 4, 4) in {W} of the planes of a state, with what
// the gauge (place, covariance (7, 7)) does to them.
py::tuple planes_in_world(const py::object& planes, const py::object& anchors,
                          const py::object& covariance, const py::object& errors,
                          const py::object& place, const py::object& gauge) {
  const char* kernel = "planes_in_world";
  const In<double> plane(kernel, "planes", planes, {ANY, 3}, Check::finite);
  const auto count = plane.size(), n = PLANES + 3 * count;
  const In<double> anchor(kernel, "anchors", anchors, {count, 3}, Check::finite);
  const In<double> P(kernel, "covariance", covariance, {n, n}, Check::finite);
  const In<double> lasting(kernel, "lasting", errors, {n, N_LASTING}, Check::finite);
  const In<double> at(kernel, "place", place, {3}, Check::finite);
  const In<double> common(kernel, "gauge", gauge, {7, 7}, Check::finite);
  Out<double> normals({count, 3}), depths({count}), out({count, 4, 4});
  for (py::ssize_t k = 0; k < count; ++k) {
    const Vec3 p{plane(k, 0), plane(k, 1), plane(k, 2)};
    const Vec3 a{anchor(k, 0), anchor(k, 1), anchor(k, 2)};
    const Vec3 offset = a - Vec3{at[0], at[1], at[2]};
    // The gauge's turn, shift and growth move the anchor's surroundings; the anchor itself stays.
    double J[3][7], S[3][3];
    const Mat3 swing = skew(offset), turn = skew(p);
    Vec3 moves{};
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i) moves[j] -= p[i] * swing[3 * i + j];
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        J[i][j] = p[i] * moves[j] - turn[3 * i + j];
        J[i][3 + j] = p[i] * p[j];
      }
      J[i][6] = p[i] * dot(p, offset) - p[i];
    }
    const auto row = PLANES + 3 * k;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        S[i][j] = P(row + i, row + j);
        for (int l = 0; l < N_LASTING; ++l) S[i][j] += lasting(row + i, l) * lasting(row + j, l);
        for (int l = 0; l < 7; ++l)
          for (int m = 0; m < 7; ++m) S[i][j] += J[i][l] * common(l, m) * J[j][m];
      }
    // (normal, depth) by the plane; n X + d = 0 about the anchor is n X + (d - n anchor) = 0.
    const double depth = 1 / norm(p);
    const Vec3 normal = depth * p;
    double N[4][3];
    for (int j = 0; j < 3; ++j) {
      N[3][j] = -depth * depth * normal[j];
      for (int i = 0; i < 3; ++i) {
        N[i][j] = depth * ((i == j) - normal[i] * normal[j]);
        N[3][j] -= a[i] * N[i][j];
      }
      normals(k, j) = normal[j];
    }
    depths[k] = depth - dot(normal, a);
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j)
        for (int l = 0; l < 3; ++l)
          for (int m = 0; m < 3; ++m)
            out.data()[16 * k + 4 * i + j] += N[i][l] * S[l][m] * N[j][m];
  }
  return py::make_tuple(normals.array(), depths.array(), out.array());
}

using Point = std::array<double, 2>;

// Twice the area of a triangle; positive where it turns left.
double area(const Point& a, const Point& b, const Point& c) {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

// Takes out the points that lie well inside the octagon of those farthest out in eight directions.
void drop_inner(std::vector<Point>& points) {
  constexpr double DIRECTIONS[8][2] = {{1, 0},  {1, 1},   {0, 1},  {-1, 1},
                                       {-1, 0}, {-1, -1}, {0, -1}, {1, -1}};
  Point corner[8];
  double most[8];
  std::fill_n(corner, 8, points.front());
  std::fill_n(most, 8, -std::numeric_limits<double>::infinity());
  for (const Point& p : points)
    for (int k = 0; k < 8; ++k) {
      const double far = DIRECTIONS[k][0] * p[0] + DIRECTIONS[k][1] * p[1];
      if (far > most[k]) most[k] = far, corner[k] = p;
    }
  const double least = 1e-9 * (most[0] + most[4]) * (most[2] + most[6]);
  const auto inside = [&](const Point& p) {
    bool in = least > 0;
    for (int k = 0; k < 8; ++k) {
      const Point &a = corner[k], &b = corner[(k + 1) % 8];
      in &= a == b || area(a, b, p) > least;
    }
    return in;
  };
  points.erase(std::remove_if(points.begin(), points.end(), inside), points.end());
}

// Convex hull of points, counter-clockwise (Andrew's monotone chain).
std::vector<Point> convex_hull(std::vector<Point> points) {
  drop_inner(points);
  std::sort(points.begin(), points.end());
  points.erase(std::unique(points.begin(), points.end()), points.end());
  if (points.size() < 3) return points;
  std::vector<Point> hull;
  const auto turns_left = [&](const Point& c) {
    return area(hull[hull.size() - 2], hull.back(), c) > 0;
  };
  for (int side = 0; side < 2; ++side) {
    const std::size_t first = hull.size();
    for (const Point& point : points) {
      while (hull.size() >= first + 2 && !turns_left(point)) hull.pop_back();
      hull.push_back(point);
    }
    hull.pop_back();
    std::reverse(points.begin(), points.end());
  }
  return hull;
}

// Takes the corners out of a convex outline that cut least off, until at most so many are left.
void simplify(std::vector<Point>& hull, std::size_t most) {
  while (hull.size() > most) {
    std::size_t least = 0;
    double smallest = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < hull.size(); ++i) {
      const double cut = area(hull[(i + hull.size() - 1) % hull.size()], hull[i],
                              hull[(i + 1) % hull.size()]);
      if (cut < smallest) smallest = cut, least = i;
    }
    hull.erase(hull.begin() + static_cast<std::ptrdiff_t>(least));
  }
}

// The convex outline (M, 3) in {W} of where the rays of a plane's blocks meet it and of an older
// outline (L, 3), of at most so many corners. `pose` is R (9), t (3); blocks beyond `farthest`
// plane depths do not count.
py::array_t<double> plane_outline(const py::object& x_cur, const py::object& plane_id,
                                  std::int32_t id, const py::object& intrinsics,
                                  const py::object& pose, const py::object& values,
                                  const py::object& old, double farthest, std::size_t most) {
  const char* kernel = "plane_outline";
  const In<float> x(kernel, "x_cur", x_cur, {ANY, 2}, Check::finite);
  const In<std::int32_t> of(kernel, "plane_id", plane_id, {x.size()});
  const In<double> K(kernel, "K", intrinsics, {3, 3}, Check::finite);
  const In<double> camera(kernel, "pose", pose, {12}, Check::finite);
  const In<double> given(kernel, "plane", values, {2, 3}, Check::finite);
  const In<double> before(kernel, "old", old, {ANY, 3}, Check::finite);
  Mat3 R;
  std::copy_n(camera.data(), 9, R.begin());
  const Vec3 t{camera[9], camera[10], camera[11]}, plane{given[0], given[1], given[2]};
  const Vec3 anchor{given[3], given[4], given[5]};
  const double depth = 1 / norm(plane), above = 1 + dot(plane, t - anchor);
  const Vec3 normal = depth * plane, origin = anchor - depth * normal;
  Vec3 first, second;
  tangent_basis(normal, first, second);
  std::vector<Point> points;
  const auto add = [&](const Vec3& X) {
    points.push_back({dot(X - origin, first), dot(X - origin, second)});
  };
  for (py::ssize_t i = 0; i < before.size(); ++i)
    add({before(i, 0), before(i, 1), before(i, 2)});
  for (py::ssize_t i = 0; i < x.size(); ++i) {
    if (of[i] != id) continue;
    const double v = (x(i, 1) - K(1, 2)) / K(1, 1);
    const Vec3 toward = R * Vec3{(x(i, 0) - K(0, 2)) / K(0, 0) - K(0, 1) / K(0, 0) * v, v, 1};
    const double reach = -above / dot(toward, plane);
    if (reach > 0 && reach < farthest * std::abs(above) * depth) add(t + reach * toward);
  }
  const bool enough = points.size() >= 3;
  if (enough) {
    points = convex_hull(std::move(points));
    simplify(points, most);
  }
  Out<double> out({enough ? static_cast<py::ssize_t>(points.size()) : before.size(), 3});
  for (py::ssize_t i = 0; i < out.array().shape(0); ++i)
    for (int j = 0; j < 3; ++j)
      out(i, j) = enough ? origin[j] + points[i][0] * first[j] + points[i][1] * second[j]
                         : before(i, j);
  return out.array();
}

}  // namespace
}  // namespace kernels

void bind_scene_blocks(kernels::py::module_& module) {
  module.def("stationary_blocks", kernels::stationary_blocks);
  module.def("error_dependence", kernels::error_dependence);
  module.def("depth_slope", kernels::depth_slope);
  module.def("planes_in_world", kernels::planes_in_world);
  module.def("plane_outline", kernels::plane_outline);
}
