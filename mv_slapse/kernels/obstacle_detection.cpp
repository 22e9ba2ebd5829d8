// Regions of blocks that move by themselves as observations of obstacles, see
// obstacles/detection.py, and vectors looked for where an obstacle must be, see redetection.py.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>
#include <tuple>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "contact.hpp"
#include "movers.hpp"
#include "small.hpp"

namespace kernels {
namespace {

constexpr int SIZE = 8, DEPTH = 2, RATE = 3, SLOPE = 6;
constexpr double NOWHERE = std::numeric_limits<double>::quiet_NaN();

struct Box {
  double low[2], high[2];
};

Box box_of(const In<double>& x, const In<double>& block) {
  Box out{{HUGE_VAL, HUGE_VAL}, {-HUGE_VAL, -HUGE_VAL}};
  for (py::ssize_t i = 0; i < x.size(); ++i)
    for (int a = 0; a < 2; ++a) {
      out.low[a] = std::min(out.low[a], x(i, a) - block(i, a) / 2);
      out.high[a] = std::max(out.high[a], x(i, a) + block(i, a) / 2);
    }
  return out;
}

struct Region {
  Region(const char* kernel, const py::object& x_, const py::object& block_)
      : x(kernel, "x", x_, {ANY, 2}), block(kernel, "block", block_, {x.size(), 2}) {
    require(x.size() > 0, kernel, "there must be a block");
  }
  const In<double> x, block;
};

py::array_t<double> array(const Box& box) {
  Out<double> out({4});
  for (int a = 0; a < 2; ++a) {
    out[a] = box.low[a];
    out[2 + a] = box.high[a] - box.low[a];
  }
  return out.array();
}

py::array_t<double> region_box(const py::object& x, const py::object& block) {
  const Region region("region_box", x, block);
  return array(box_of(region.x, region.block));
}

// First and last place along an axis that blocks cover thickly enough.
std::pair<double, double> well_covered(const Region& region, int axis, double thinnest,
                                       double sliver) {
  const auto n = region.x.size();
  std::vector<double> first(n), last(n), at;
  double low = HUGE_VAL, high = -HUGE_VAL;
  for (py::ssize_t i = 0; i < n; ++i) {
    const double half = region.block(i, axis) / 2;
    const double from = region.x(i, axis) - half, to = region.x(i, axis) + half;
    // Blocks that were moved may overlap by little, and would cover that little twice.
    const double edge = std::min(0.5 * sliver, 0.25 * (to - from));
    low = std::min(low, from);
    high = std::max(high, to);
    at.push_back(first[i] = from + edge);
    at.push_back(last[i] = to - edge);
  }
  std::sort(at.begin(), at.end());
  at.erase(std::unique(at.begin(), at.end()), at.end());
  std::vector<double> cover(at.size() - 1, 0.0);
  for (std::size_t k = 0; k + 1 < at.size(); ++k)
    for (py::ssize_t i = 0; i < n; ++i)
      if (first[i] <= at[k] && last[i] > at[k]) cover[k] += region.block(i, 1 - axis);
  const double least = thinnest * *std::max_element(cover.begin(), cover.end());
  std::size_t begin = 0, end = cover.size() - 1;
  while (cover[begin] < least) ++begin;
  while (cover[end] < least) --end;
  return {std::max(at[begin] - 0.5 * sliver, low), std::min(at[end + 1] + 0.5 * sliver, high)};
}

py::array_t<double> body_box(const py::object& x, const py::object& block, double thinnest,
                             double sliver) {
  const Region region("body_box", x, block);
  Box out;
  for (int a = 0; a < 2; ++a)
    std::tie(out.low[a], out.high[a]) = well_covered(region, a, thinnest, sliver);
  return array(out);
}

// Least values above others, given one after the other, that fall away from their middle and never
// bend upwards: those of a line from each to the next that it can be drawn to. Infinite ones, of
// which nothing is known, count nothing.
std::vector<double> bulging(const std::vector<double>& values) {
  std::vector<std::size_t> corner;
  const auto slope = [&](std::size_t i, std::size_t k) {
    return (values[k] - values[i]) / static_cast<double>(k - i);
  };
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) continue;
    while (corner.size() > 1 && slope(corner[corner.size() - 2], corner.back()) <=
                                    slope(corner[corner.size() - 2], i))
      corner.pop_back();
    corner.push_back(i);
  }
  std::vector<double> out = values;
  for (std::size_t k = 0; k + 1 < corner.size(); ++k)
    for (auto i = corner[k]; i < corner[k + 1]; ++i)
      out[i] = values[corner[k]] + slope(corner[k], corner[k + 1]) *
                                       static_cast<double>(i - corner[k]);
  return out;
}

// Where the lower edge of a region lies highest above what spans it from below [px], NaN where
// that is nowhere more than `least` or too near an end. The ground that a vehicle stands on is a
// rectangle, whose near edges bulge towards the camera: where they are hollow two stand there.
double hollow(const py::object& x, const py::object& block, double cell, double least,
              int columns) {
  const Region region("hollow", x, block);
  const Box box = box_of(region.x, region.block);
  const auto n = static_cast<int>(std::nearbyint((box.high[0] - box.low[0]) / cell));
  if (n <= 2 * columns) return NOWHERE;
  std::vector<double> edge(n, -HUGE_VAL), lower(n);
  for (py::ssize_t i = 0; i < region.x.size(); ++i) {
    const double half = region.block(i, 0) / 2, middle = region.x(i, 0) - box.low[0];
    // A block that reaches a little into the next column is not there.
    const int from = std::max(static_cast<int>(std::floor((middle - half) / cell + 0.25)), 0);
    const int to = std::max(static_cast<int>(std::ceil((middle + half) / cell - 0.25)), from + 1);
    for (int k = from; k < std::min(to, n); ++k)
      edge[k] = std::max(edge[k], region.x(i, 1) + region.block(i, 1) / 2);
  }
  // One column that stands out, or lacks its lowest block, says nothing.
  for (int k = 0; k < n; ++k)
    lower[k] = middle(edge[std::max(k - 1, 0)], edge[k], edge[std::min(k + 1, n - 1)]);
  const auto spanned = bulging(lower);
  int deepest = -1, last = -1;
  double most = least;
  for (int k = columns; k < n - columns; ++k) {
    const double gap = spanned[k] - lower[k];
    if (gap > most) {
      most = gap;
      deepest = last = k;
    } else if (deepest >= 0 && gap == most) {
      last = k;
    }
  }
  return deepest < 0 ? NOWHERE : box.low[0] + (0.5 * (deepest + last) + 0.5) * cell;
}

// Centres and sizes of the largest connected part of the blocks of a plane; single gaps join.
py::tuple largest_part(const py::object& x_, const py::object& block_, const py::object& plane_id,
                       std::int32_t id, double cell) {
  const char* kernel = "largest_part";
  const In<float> x(kernel, "x", x_, {ANY, 2}, Check::finite);
  const In<std::uint8_t> block(kernel, "block", block_, {x.size(), 2});
  const In<std::int32_t> owner(kernel, "plane_id", plane_id, {x.size()});
  std::vector<py::ssize_t> own;
  for (py::ssize_t i = 0; i < x.size(); ++i)
    if (owner[i] == id) own.push_back(i);
  const std::size_t n = own.size();
  std::vector<std::pair<int, int>> at(n);
  int low[2] = {INT32_MAX, INT32_MAX}, high[2] = {INT32_MIN, INT32_MIN};
  for (std::size_t i = 0; i < n; ++i) {
    const int place[2] = {static_cast<int>(std::floor(x(own[i], 0) / cell)),
                          static_cast<int>(std::floor(x(own[i], 1) / cell))};
    at[i] = {place[0], place[1]};
    for (int a = 0; a < 2; ++a) {
      low[a] = std::min(low[a], place[a]);
      high[a] = std::max(high[a], place[a]);
    }
  }
  std::vector<int> part(n, 0);
  int largest = 0;
  if (n > 1) {
    const int columns = high[0] - low[0] + 3, rows = high[1] - low[1] + 3;
    require(static_cast<double>(columns) * rows < 1e7, kernel, "x reaches too far");
    // A block missing inside a surface must not tear it apart: fill single gaps before joining.
    std::vector<int> grid(columns * rows, 0);
    constexpr int aside[5][2] = {{0, 0}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}};
    for (auto& [c, r] : at) {
      c += 1 - low[0];
      r += 1 - low[1];
      for (const auto& d : aside) grid[(c + d[0]) * rows + r + d[1]] = -1;
    }
    // What lies beyond the region's own cells joins nothing.
    for (int c = 0; c < columns; ++c) grid[c * rows] = grid[c * rows + rows - 1] = 0;
    for (int r = 0; r < rows; ++r) grid[r] = grid[(columns - 1) * rows + r] = 0;
    int parts = 0;
    std::vector<int> open;
    for (int start = 0; start < columns * rows; ++start) {
      if (grid[start] >= 0) continue;
      grid[start] = ++parts;
      open.assign(1, start);
      while (!open.empty()) {
        const int cell_ = open.back();
        open.pop_back();
        for (int dc = -1; dc <= 1; ++dc)
          for (int dr = -1; dr <= 1; ++dr) {
            const int next = cell_ + dc * rows + dr;  // the rim is empty
            if (grid[next] < 0) {
              grid[next] = parts;
              open.push_back(next);
            }
          }
      }
    }
    std::vector<int> count(parts + 1, 0);
    for (std::size_t i = 0; i < n; ++i) ++count[part[i] = grid[at[i].first * rows + at[i].second]];
    largest = static_cast<int>(std::max_element(count.begin(), count.end()) - count.begin());
  }
  std::vector<py::ssize_t> kept;
  for (std::size_t i = 0; i < n; ++i)
    if (part[i] == largest) kept.push_back(own[i]);
  const auto m = static_cast<py::ssize_t>(kept.size());
  Out<double> centre({m, 2}), size({m, 2});
  for (py::ssize_t i = 0; i < m; ++i)
    for (int a = 0; a < 2; ++a) {
      centre(i, a) = x(kept[i], a);
      size(i, a) = block(kept[i], a);
    }
  return py::make_tuple(centre.array(), size.array());
}

std::vector<std::pair<int, int>> cells(const In<double>& x, double size) {
  std::vector<std::pair<int, int>> out(x.size());
  for (py::ssize_t i = 0; i < x.size(); ++i)
    out[i] = {static_cast<int>(std::floor(x(i, 0) / size)),
              static_cast<int>(std::floor(x(i, 1) / size))};
  std::sort(out.begin(), out.end());
  out.erase(std::unique(out.begin(), out.end()), out.end());
  return out;
}

// Share of the cells of the smaller one of two sets of points that both hold.
double shared_cells(const py::object& x, const py::object& other, double size) {
  const char* kernel = "shared_cells";
  const auto a = cells(In<double>(kernel, "x", x, {ANY, 2}, Check::finite), size);
  const auto b = cells(In<double>(kernel, "other", other, {ANY, 2}, Check::finite), size);
  std::vector<std::pair<int, int>> both;
  std::set_intersection(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(both));
  return static_cast<double>(both.size()) /
         static_cast<double>(std::max<std::size_t>(std::min(a.size(), b.size()), 1));
}

Contact contact(const Region& region, double covered) {
  return contact_of(region.x.size(), [&](std::size_t i, int what) {
    return what == 2 ? region.block(i, 1) : region.x(i, what);
  }, covered);
}

void write_edge(const Contact& of, double variance, Out<double>& edge) {
  edge[0] = of.y;
  edge[1] = std::sqrt(3.0) * of.sigma;
  edge[2] = of.sigma / std::max(std::sqrt(variance), 1e-6);
}

// How well a box shows the ray of the middle of what it surrounds: two variances.
void bearing_variance(const In<double>& block, const Box& box, const Mat3& K, const double* size,
                      double cell, double outline_share, double cut_share, double* variance) {
  for (int a = 0; a < 2; ++a) {
    double largest = 0;
    for (py::ssize_t i = 0; i < block.size(); ++i) largest = std::max(largest, block(i, a));
    const bool cut = box.low[a] < cell / 2 || box.high[a] > size[a] - cell / 2;
    const double error = (cut ? cut_share : outline_share) * (box.high[a] - box.low[a]);
    variance[a] = (largest * largest / 12 + error * error) / (K[4 * a] * K[4 * a]);
  }
}

py::array_t<double> bearing_covariance(const py::object& box_, const py::object& block_,
                                       const py::object& K, const py::object& size_,
                                       const py::object& shares_) {
  const char* kernel = "bearing_covariance";
  const In<double> box(kernel, "box", box_, {4}), block(kernel, "block", block_, {ANY, 2});
  const In<double> size(kernel, "size", size_, {2}), shares(kernel, "shares", shares_, {3});
  double variance[2];
  bearing_variance(block, {{box[0], box[1]}, {box[0] + box[2], box[1] + box[3]}},
                   matrix(kernel, "K", K), size.data(), shares[0], shares[1], shares[2], variance);
  Out<double> out({2, 2});
  out(0, 0) = variance[0];
  out(1, 1) = variance[1];
  return out.array();
}

// State of a moving plane (n / d, t_d), given in baselines, about the middle of its blocks.
// view: K, t_cur_from_prev, dt, size, baseline; shares: macroblock [px], outline, cut; limits: slope, covered
// -> z (8,), R (8, 8), edge (3,) or None where it is behind the camera, or seen edge-on
py::object region_state(const py::object& plane_, const py::object& displacement,
                        const py::object& covariance_, const py::object& x,
                        const py::object& block, const py::tuple& view, const py::object& shares_,
                        double slope_limit, double covered) {
  const char* kernel = "region_state";
  const Region region(kernel, x, block);
  require(view.size() == 5, kernel, "view must hold K, t, dt, size, baseline");
  const In<double> plane(kernel, "plane", plane_, {3}), t_d(kernel, "t_d", displacement, {3});
  const In<double> covariance(kernel, "covariance", covariance_, {6, 6});
  const In<double> size(kernel, "size", view[3], {2}), shares(kernel, "shares", shares_, {3});
  const Mat3 K = matrix(kernel, "K", view[0]);
  const Vec3 t = vector(kernel, "t", view[1]);
  const double dt = view[2].cast<double>(), unit = view[4].cast<double>();
  const Box box = box_of(region.x, region.block);
  const double middle[2] = {(box.low[0] + box.high[0]) / 2, (box.low[1] + box.high[1]) / 2};
  double ray[3] = {0, 0, 1};
  ray_of(K, middle, ray);
  const double rho = -(plane[0] * ray[0] + plane[1] * ray[1] + plane[2] * ray[2]) / unit;
  bool finite = rho > 1e-9;
  for (int i = 0; i < 36; ++i) finite &= std::isfinite(covariance[i]);
  const double slope[2] = {-plane[0] / unit / rho, -plane[1] / unit / rho};
  if (!finite || std::abs(slope[0]) > slope_limit || std::abs(slope[1]) > slope_limit)
    return py::none();
  Out<double> z({SIZE}), R({SIZE, SIZE}), edge({3});
  z[0] = ray[0];
  z[1] = ray[1];
  z[DEPTH] = -std::log(rho);
  double J[6][6] = {};  // of log depth, rate, slope by plane and t_d
  for (int j = 0; j < 3; ++j) {
    const double relative = t[j] - unit * t_d[j];
    z[RATE + j] = rho * relative / dt;
    J[0][j] = ray[j] / (rho * unit);
    for (int k = 0; k < 3; ++k) J[1 + j][k] = -relative * ray[k] / (dt * unit);
    J[1 + j][3 + j] = -rho * unit / dt;
    for (int k = 0; k < 2; ++k) J[4 + k][j] = (slope[k] * ray[j] - (k == j)) / (rho * unit);
  }
  z[SLOPE] = slope[0];
  z[SLOPE + 1] = slope[1];
  for (int i = 0; i < 6; ++i) {
    double row[6] = {};
    for (int l = 0; l < 6; ++l)
      for (int k = 0; k < 6; ++k) row[k] += J[i][l] * covariance(l, k);
    for (int j = 0; j < 6; ++j)
      for (int k = 0; k < 6; ++k) R(2 + i, 2 + j) += row[k] * J[j][k];
  }
  double variance[2];
  bearing_variance(region.block, box, K, size.data(), shares[0], shares[1], shares[2], variance);
  for (int a = 0; a < 2; ++a) R(a, a) = variance[a];
  write_edge(contact(region, covered), R(DEPTH, DEPTH), edge);
  return py::make_tuple(z.array(), R.array(), edge.array());
}

// C (8, 8) = J R J^T.
void transformed(const double (&J)[SIZE][SIZE], const In<double>& R, Out<double>& C) {
  for (int i = 0; i < SIZE; ++i) {
    double row[SIZE] = {};
    for (int l = 0; l < SIZE; ++l)
      for (int k = 0; k < SIZE; ++k) row[k] += J[i][l] * R(l, k);
    for (int j = 0; j < SIZE; ++j)
      for (int k = 0; k < SIZE; ++k) C(i, j) += row[k] * J[j][k];
  }
}

// A plane's state about another ray of it. -> z, R
py::tuple state_about(const py::object& z_, const py::object& R_, const py::object& centre_) {
  const char* kernel = "state_about";
  const In<double> z(kernel, "z", z_, {SIZE}), R(kernel, "R", R_, {SIZE, SIZE});
  const In<double> centre(kernel, "centre", centre_, {2});
  const double offset[2] = {centre[0] - z[0], centre[1] - z[1]};
  // A plane that is seen edge-on tells nothing of what lies beside it.
  const double w =
      std::min(std::max(1 + z[SLOPE] * offset[0] + z[SLOPE + 1] * offset[1], 0.5), 2.0);
  double J[SIZE][SIZE] = {};
  Out<double> mean({SIZE}), covariance({SIZE, SIZE});
  J[DEPTH][DEPTH] = 1;
  mean[DEPTH] = z[DEPTH] - std::log(w);
  for (int a = 0; a < 2; ++a) {
    J[a][a] = 1;
    mean[a] = centre[a];
    mean[SLOPE + a] = z[SLOPE + a] / w;
    J[DEPTH][SLOPE + a] = -offset[a] / w;
    for (int b = 0; b < 2; ++b)
      J[SLOPE + a][SLOPE + b] = (a == b) / w - z[SLOPE + a] * offset[b] / (w * w);
    for (int i = 0; i < 3; ++i) J[RATE + i][SLOPE + a] = z[RATE + i] * offset[a];
  }
  for (int i = 0; i < 3; ++i) {
    mean[RATE + i] = w * z[RATE + i];
    J[RATE + i][RATE + i] = w;
  }
  transformed(J, R, covariance);
  return py::make_tuple(mean.array(), covariance.array());
}

// Covariance with what all vectors have in common. view: K, R_cur_from_prev, rotation_covariance,
// dt; policy: bias [px], macroblock [px], shares of turn and shape -> R (8, 8)
py::array_t<double> blurred_rate(const py::object& z_, const py::object& R_, double height,
                                 const py::tuple& view, const py::object& policy_) {
  const char* kernel = "blurred_rate";
  const In<double> z(kernel, "z", z_, {SIZE}, Check::finite), R(kernel, "R", R_, {SIZE, SIZE});
  const In<double> policy(kernel, "policy", policy_, {4});
  require(view.size() == 4, kernel, "view must hold K, R, rotation_covariance, dt");
  const Mat3 K = matrix(kernel, "K", view[0]), turned = matrix(kernel, "R", view[1]);
  const Mat3 unsure = matrix(kernel, "rotation_covariance", view[2]);
  const double dt = view[3].cast<double>(), bias = policy[0], x = z[0], y = z[1];
  const Vec3 back = transposed(turned) * Vec3{x, y, 1};
  const double shift[2] = {policy[2] * (back[0] / back[2] - x),
                           policy[2] * (back[1] / back[2] - y)};
  const double error = std::hypot(bias, std::hypot(K[0] * shift[0], K[4] * shift[1]));
  const double growth = error / std::max(0.5 * height, policy[1] / 2);
  const Mat3 turn{-x * y, 1 + x * x, -y, -1 - y * y, x * y, x, 0, 0, 0};
  Mat3 shared = turn * unsure * transposed(turn);
  for (int i = 0; i < 2; ++i) {
    shared[4 * i] += bias / K[4 * i] * (bias / K[4 * i]);
    for (int j = 0; j < 2; ++j) shared[3 * i + j] += shift[i] * shift[j];
  }
  shared[8] += growth * growth;
  Out<double> out({SIZE, SIZE});
  std::copy_n(R.data(), SIZE * SIZE, out.data());
  const double square = z[3] * z[3] + z[4] * z[4] + z[5] * z[5];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      out(RATE + i, RATE + j) +=
          shared[3 * i + j] / (dt * dt) + (i == j ? policy[3] * policy[3] * square : 0);
  return out.array();
}

// State with the depth of the ground under a region's lower edge, see contact.hpp. policy: covered, macroblock [px], rows of the picture [px],
// sigma of a hidden contact -> z, R, edge (3,) or None where the edge lies at the horizon or above
py::object depth_from_ground(const py::object& z_, const py::object& R_, const py::object& x,
                             const py::object& block, const py::object& K_,
                             const py::object& ground_, const py::object& policy_) {
  const char* kernel = "depth_from_ground";
  const Region region(kernel, x, block);
  const In<double> z(kernel, "z", z_, {SIZE}), R(kernel, "R", R_, {SIZE, SIZE});
  const In<double> policy(kernel, "policy", policy_, {4});
  const Mat3 K = matrix(kernel, "K", K_);
  const Vec3 ground = vector(kernel, "ground", ground_);
  const Contact foot = contact(region, policy[0]);
  const ContactDepth found = contact_depth(ground, foot, K, &z[SLOPE], z.data());
  if (!found.tells) return py::none();
  double J[SIZE][SIZE] = {};
  for (int i = 0; i < SIZE; ++i) J[i][i] = i != DEPTH;
  for (int a = 0; a < 2; ++a) J[DEPTH][SLOPE + a] = found.by_slope[a];
  Out<double> mean({SIZE}), covariance({SIZE, SIZE}), edge({3});
  std::copy_n(z.data(), SIZE, mean.data());
  mean[DEPTH] = found.value;
  transformed(J, R, covariance);
  const bool hidden = foot.y + policy[1] > policy[2];
  covariance(DEPTH, DEPTH) += found.sigma * found.sigma + (hidden ? policy[3] * policy[3] : 0);
  write_edge(foot, found.sigma * found.sigma, edge);
  return py::make_tuple(mean.array(), covariance.array(), edge.array());
}

// For each row of costs (N, M) the column that the cheapest assignment gives it, -1 for none: the
// Hungarian method, by shortest augmenting paths. The lesser of N and M are assigned.
py::array_t<std::int64_t> cheapest_assignment(const py::object& cost_) {
  const In<double> cost("cheapest_assignment", "cost", cost_, {ANY, ANY}, Check::finite);
  const bool wide = cost.size(0) <= cost.size(1);
  const auto n = std::min(cost.size(0), cost.size(1)), m = std::max(cost.size(0), cost.size(1));
  // Prices of rows and columns, the row that has each column, from 1; 0 is none.
  std::vector<double> u(n + 1, 0.0), v(m + 1, 0.0);
  std::vector<py::ssize_t> owner(m + 1, 0), from(m + 1, 0);
  for (py::ssize_t row = 1; row <= n; ++row) {
    std::vector<double> least(m + 1, HUGE_VAL);
    std::vector<char> used(m + 1, 0);
    py::ssize_t column = 0;
    owner[0] = row;
    do {
      used[column] = 1;
      const auto i = owner[column];
      double step = HUGE_VAL;
      py::ssize_t next = 0;
      for (py::ssize_t j = 1; j <= m; ++j) {
        if (used[j]) continue;
        const double left = (wide ? cost(i - 1, j - 1) : cost(j - 1, i - 1)) - u[i] - v[j];
        if (left < least[j]) {
          least[j] = left;
          from[j] = column;
        }
        if (least[j] < step) {
          step = least[j];
          next = j;
        }
      }
      for (py::ssize_t j = 0; j <= m; ++j) {
        if (used[j]) {
          u[owner[j]] += step;
          v[j] -= step;
        } else {
          least[j] -= step;
        }
      }
      column = next;
    } while (owner[column]);
    for (; column; column = from[column]) owner[column] = owner[from[column]];
  }
  Out<std::int64_t> out({cost.size(0)});
  for (py::ssize_t i = 0; i < cost.size(0); ++i) out[i] = -1;
  for (py::ssize_t j = 1; j <= m; ++j)
    if (owner[j]) out[wide ? owner[j] - 1 : j - 1] = wide ? j - 1 : owner[j] - 1;
  return out.array();
}

// Error of each block [px] where a surface moves by (rate, slope), and its derivative by the rate.
struct Motions {
  Motions(py::ssize_t n) : error(2 * n), J(6 * n) {}
  std::vector<double> error, J;
};

void transfer(const double* theta, const double* centre, const In<double>& rays,
              const In<double>& target, const Mat3& KR, Motions& out) {
  const Vec3 g{theta[0], theta[1], theta[2]};
  for (py::ssize_t i = 0; i < rays.size(); ++i) {
    const double w = 1 + (rays(i, 0) - centre[0]) * theta[3] + (rays(i, 1) - centre[1]) * theta[4];
    const Vec3 x = KR * (Vec3{rays(i, 0), rays(i, 1), rays(i, 2)} - w * g);
    for (int a = 0; a < 2; ++a) {
      const double at = x[a] / x[2];
      out.error[2 * i + a] = target(i, a) - at;
      for (int k = 0; k < 3; ++k)
        out.J[6 * i + 3 * a + k] = (-w * KR[3 * a + k] + at * w * KR[6 + k]) / x[2];
    }
  }
}

// The rate (3,) of an obstacle by the blocks where it must be, reweighted. view: K,
// R_cur_from_prev; policy: limit of a squared distance, share of the prediction that counts as
// seen, iterations, of these with a wider kernel -> rate dt (3,), covariance (3, 3), near, own
// (N,) bool
py::tuple redetect_rate(const py::object& mu_, const py::object& prior_, const py::object& rays_,
                        const py::object& target_, const py::object& variance_, double dt,
                        const py::tuple& view, const py::tuple& policy) {
  const char* kernel = "redetect_rate";
  const In<double> mu(kernel, "mu", mu_, {SIZE}, Check::finite);
  const In<double> rays(kernel, "rays", rays_, {ANY, 3}, Check::finite);
  const auto n = rays.size();
  const In<double> target(kernel, "target", target_, {n, 2}, Check::finite);
  const In<double> variance(kernel, "variance", variance_, {n}, Check::finite);
  const Mat3 prior = matrix(kernel, "prior", prior_);
  require(view.size() == 2 && policy.size() == 4, kernel, "view or policy is too short");
  const Mat3 KR = matrix(kernel, "K", view[0]) * transposed(matrix(kernel, "R", view[1]));
  const double limit = policy[0].cast<double>();
  const int iterations = policy[2].cast<int>(), coarse = policy[3].cast<int>();
  Mat3 weak = inverse(prior);
  for (auto& value : weak) value *= policy[1].cast<double>();
  double theta[5] = {dt * mu[3], dt * mu[4], dt * mu[5], mu[6], mu[7]};
  Motions at(n);
  transfer(theta, mu.data(), rays, target, KR, at);
  Out<bool> near({n}), own({n});
  bool any = false;
  for (py::ssize_t i = 0; i < n; ++i) {
    double S[4], JP[6];
    const double *J = &at.J[6 * i], *e = &at.error[2 * i];
    for (int a = 0; a < 2; ++a)
      for (int k = 0; k < 3; ++k)
        JP[3 * a + k] = J[3 * a] * prior[k] + J[3 * a + 1] * prior[3 + k] +
                        J[3 * a + 2] * prior[6 + k];
    for (int a = 0; a < 2; ++a)
      for (int b = 0; b < 2; ++b)
        S[2 * a + b] = JP[3 * a] * J[3 * b] + JP[3 * a + 1] * J[3 * b + 1] +
                       JP[3 * a + 2] * J[3 * b + 2] + (a == b ? variance[i] : 0);
    const double squared = (S[3] * e[0] * e[0] - (S[1] + S[2]) * e[0] * e[1] + S[0] * e[1] * e[1]) /
                           (S[0] * S[3] - S[1] * S[2]);
    near[i] = squared < limit;
    any |= near[i];
  }
  const auto squared_at = [&](py::ssize_t i) {
    return (at.error[2 * i] * at.error[2 * i] + at.error[2 * i + 1] * at.error[2 * i + 1]) /
           variance[i];
  };
  // Adds a block to the normal equations with a weight.
  const auto add = [&](py::ssize_t i, double weight, Mat3& A, Vec3& b) {
    for (int a = 0; a < 2; ++a)
      for (int k = 0; k < 3; ++k) {
        const double left = weight * at.J[6 * i + 3 * a + k];
        b[k] += left * at.error[2 * i + a];
        for (int l = 0; l < 3; ++l) A[3 * k + l] += left * at.J[6 * i + 3 * a + l];
      }
  };
  for (int step = 0; step < (any ? iterations : 0); ++step) {
    double width = limit;
    if (step < coarse) {  // while the start is bad: twice as wide as half of the blocks reach
      std::vector<double> of;
      for (py::ssize_t i = 0; i < n; ++i)
        if (near[i]) of.push_back(squared_at(i));
      width = std::max(limit, 4 * median(of));
    }
    Mat3 A = weak;
    Vec3 b{0, 0, 0};
    for (py::ssize_t i = 0; i < n; ++i)
      if (near[i]) {
        const double off = 1 + squared_at(i) / width;
        add(i, 1 / (off * off) / variance[i], A, b);
      }
    const Vec3 change = inverse(A) * b;
    for (int k = 0; k < 3; ++k) theta[k] += change[k];
    transfer(theta, mu.data(), rays, target, KR, at);
  }
  Mat3 information = weak;
  Vec3 unused{0, 0, 0};
  double sum = 0;
  int number = 0;
  for (py::ssize_t i = 0; i < n; ++i)
    if ((own[i] = near[i] && squared_at(i) < limit)) {
      add(i, 1 / variance[i], information, unused);
      sum += squared_at(i);
      ++number;
    }
  const double spread = std::max(sum / std::max(2 * number - 3, 1), 1.0);
  Out<double> rate({3}), found({3, 3});
  for (int k = 0; k < 3; ++k) rate[k] = theta[k];
  const Mat3 unsure = inverse(information);
  for (int k = 0; k < 9; ++k) found[k] = spread * unsure[k];
  return py::make_tuple(rate.array(), found.array(), near.array(), own.array());
}

}  // namespace
}  // namespace kernels

void bind_obstacle_detection(kernels::py::module_& module) {
  using namespace kernels;
  module.def("region_box", region_box);
  module.def("body_box", body_box);
  module.def("hollow", hollow);
  module.def("largest_part", largest_part);
  module.def("shared_cells", shared_cells);
  module.def("bearing_covariance", bearing_covariance);
  module.def("region_state", region_state);
  module.def("state_about", state_about);
  module.def("blurred_rate", blurred_rate);
  module.def("depth_from_ground", depth_from_ground);
  module.def("cheapest_assignment", cheapest_assignment);
  module.def("redetect_rate", redetect_rate);
}
