// Regions of blocks that move alike: the moving plane of each, where it lies, how little a still
// surface explains it. movers/moving_plane.py, movers/outlines.py, movers/score.py.

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "arrays.hpp"
#include "lanes.hpp"
#include "movers.hpp"
#include "small.hpp"

namespace kernels {
namespace {

constexpr double INFINITE = std::numeric_limits<double>::infinity();
constexpr int N = 5;  // unknowns of a moving surface: rate (3) and slope (2)

// The place of the value below which a share of n sorted ones lies.
std::size_t place(double share, std::size_t n) {
  return static_cast<std::size_t>(std::nearbyint(share * (n - 1.0)));
}

// That value; they change their order.
double rank(std::vector<double>& values, double share) {
  return nth_smallest(values.data(), values.size(), place(share, values.size()));
}

// Columns of the blocks of all regions, with some more at the end that count nothing.
struct FittedBlocks {
  explicit FittedBlocks(std::size_t n)
      : ray{Column(n + LANES), Column(n + LANES)}, x_prev{Column(n + LANES), Column(n + LANES)},
        sigma(n + LANES, 1.0) {}
  using Column = std::vector<double>;
  Column ray[2], x_prev[2], sigma;
};

// Blocks of one region.
struct Region {
  Region(const FittedBlocks& all, std::size_t begin, std::size_t count)
      : ray{&all.ray[0][begin], &all.ray[1][begin]},
        x_prev{&all.x_prev[0][begin], &all.x_prev[1][begin]}, sigma(&all.sigma[begin]), n(count) {}
  const double *ray[2], *x_prev[2], *sigma;
  std::size_t n;
};

struct Surface {
  double theta[N]{}, centre[2]{}, normal[N * N]{};
  Vec3 rate() const { return {theta[0], theta[1], theta[2]}; }
};

struct FitRules {
  double iterations, converged, inlier, yaw_sigma, upright_sigma;
};

// Errors of four blocks, (11) of [MVO], in standard deviations, and what leads to them.
struct Errors {
  KERNELS_INLINE Errors(const Region& region, std::size_t i, const Surface& s, const Mat3& KR) {
    const double* g = s.theta;
    const Four ray[2] = {load(region.ray[0] + i), load(region.ray[1] + i)};
    for (int a = 0; a < 2; ++a) off[a] = ray[a] - s.centre[a];
    w = 1 + (off[0] * s.theta[3] + off[1] * s.theta[4]);
    const Four3 p = KR * Four3{ray[0] - w * g[0], ray[1] - w * g[1], 1 - w * g[2]};
    const Four sigma = load(region.sigma + i);
    at[0] = p.x / p.z;
    at[1] = p.y / p.z;
    scale = 1 / (p.z * sigma);
    for (int a = 0; a < 2; ++a) error[a] = (load(region.x_prev[a] + i) - at[a]) / sigma;
  }
  KERNELS_INLINE Four squared() const { return error[0] * error[0] + error[1] * error[1]; }
  Four off[2], w, at[2], scale, error[2];
};

KERNELS_WIDE
void squared_errors(const Region& region, const Surface& s, const Mat3& KR, double* squared) {
  for (std::size_t i = 0; i < region.n; i += LANES)
    store(Errors(region, i, s, KR).squared(), squared + i);
}

// Errors of one block and their derivatives by rate and slope: by the first four unknowns, and by
// the last one with the error itself.
struct Row {
  double by[2][4], by_last[2], error[2];
};

// Rows and squared errors of whole lanes of blocks.
KERNELS_WIDE
void rows_of(const Region& region, const Surface& s, const Mat3& KR, Row* rows, double* squared) {
  const Vec3 Kg = KR * s.rate();
  for (std::size_t i = 0; i < region.n; i += LANES) {
    const Errors is(region, i, s, KR);
    store(is.squared(), squared + i);
    Four last[2];
    for (int a = 0; a < 2; ++a) {
      Four by[4];
      for (int k = 0; k < 3; ++k)
        by[k] = -is.w * (KR[3 * a + k] - is.at[a] * KR[6 + k]) * is.scale;
      const Four tilt = -(Kg[a] - is.at[a] * Kg[2]);
      by[3] = tilt * is.off[0] * is.scale;
      last[a] = tilt * is.off[1] * is.scale;
      for (std::size_t j = 0; j < LANES; ++j)
        store(Four{by[0][j], by[1][j], by[2][j], by[3][j]}, rows[i + j].by[a]);
    }
    for (std::size_t j = 0; j < LANES; ++j)
      store(Four{last[0][j], last[1][j], is.error[0][j], is.error[1][j]}, rows[i + j].by_last);
  }
}

// Sums of rows with the weights of Geman and McClure for a width: normal matrix, lower triangle,
// and slope.
KERNELS_WIDE
void add_up(const Row* rows, double* squared, std::size_t n, double width, double* normal,
            double* slope) {
  for (std::size_t i = 0; i < n; i += LANES) {
    const Four share = 1 + load(squared + i) / width;
    store(1 / (share * share), squared + i);
  }
  // Four sums at a time, of which each goes from block to block.
  Four columns[4]{}, last{}, slopes{};
  double corner = 0, slope_last = 0;
  for (std::size_t i = 0; i < n; ++i)
    for (int a = 0; a < 2; ++a) {
      const Four by = load(rows[i].by[a]), weighted = squared[i] * by;
      const double by_last = rows[i].by_last[a], weighted_last = squared[i] * by_last;
      for (int k = 0; k < 4; ++k) columns[k] += weighted * rows[i].by[a][k];
      last += weighted_last * by;
      corner += weighted_last * by_last;
      slopes += weighted * rows[i].error[a];
      slope_last += weighted_last * rows[i].error[a];
    }
  for (int j = 0; j < 4; ++j) {
    for (int k = 0; k <= j; ++k) normal[j * N + k] = columns[k][j];
    normal[4 * N + j] = last[j];
    slope[j] = slopes[j];
  }
  normal[4 * N + 4] = corner;
  slope[4] = slope_last;
}

// Adds the priors: surfaces of vehicles and people are upright, of any yaw; a growth of 1 in a
// pair is beyond any use.
void add_priors(const Vec3& down, const FitRules& rules, const Surface& s, double* normal,
                double* slope) {
  const double yaw = square(1 / rules.yaw_sigma);
  const double row[2] = {(down[0] - down[2] * s.centre[0]) / rules.upright_sigma,
                         (down[1] - down[2] * s.centre[1]) / rules.upright_sigma};
  const double missing =
      -down[2] / rules.upright_sigma - (row[0] * s.theta[3] + row[1] * s.theta[4]);
  normal[3 * N + 3] += yaw;
  slope[3] -= yaw * s.theta[3];
  for (int a = 0; a < 2; ++a) {
    for (int b = 0; b < 2; ++b) normal[(3 + a) * N + 3 + b] += row[a] * row[b];
    slope[3 + a] += row[a] * missing;
  }
  normal[2 * N + 2] += 1;
  slope[2] -= s.theta[2];
}

// Robust Gauss-Newton, (12) of [MVO], with the weights of Geman and McClure: a vector far off
// counts for nothing. While the start is bad the kernel is as wide as what half of them reach.
Surface fitted(const Region& region, const Mat3& KR, const Mat3& R, const Mat3& K_inverse,
               const Vec3& down, const FitRules& rules) {
  Surface s;
  std::vector<double> shift[2], work;
  for (int a = 0; a < 2; ++a) {
    work.assign(region.ray[a], region.ray[a] + region.n);
    // The middle of the range does not move, as a mean does, with a few blocks lost on one side.
    const double low = rank(work, 0.05);
    s.centre[a] = 0.5 * (low + rank(work, 0.95));
    shift[a].resize(region.n);
  }
  for (std::size_t i = 0; i < region.n; ++i) {
    const Vec3 y = R * (K_inverse * Vec3{region.x_prev[0][i], region.x_prev[1][i], 1});
    for (int a = 0; a < 2; ++a) shift[a][i] = region.ray[a][i] - y[a] / y[2];
  }
  for (int a = 0; a < 2; ++a) s.theta[a] = rank(shift[a], 0.5);
  std::vector<Row> rows(region.n + LANES);
  std::vector<double> squared(region.n + LANES);
  for (int step = 0; step < rules.iterations; ++step) {
    rows_of(region, s, KR, rows.data(), squared.data());
    double width = 2 * square(rules.inlier), slope[N], change[N], factor[N * N];
    std::size_t within = 0;
    for (std::size_t i = 0; i < region.n; ++i) within += 4 * squared[i] <= width;
    if (within <= place(0.5, region.n)) {
      work.assign(squared.begin(), squared.begin() + region.n);
      width = std::max(width, 4 * rank(work, 0.5));
    }
    add_up(rows.data(), squared.data(), region.n, width, s.normal, slope);
    add_priors(down, rules, s, s.normal, slope);
    for (int j = 0; j < N; ++j)
      for (int k = 0; k < j; ++k) s.normal[k * N + j] = s.normal[j * N + k];
    std::copy_n(s.normal, N * N, factor);
    std::copy_n(slope, N, change);
    if (!cholesky(factor, N)) break;
    cholesky_solve(factor, N, change);
    double gain = 0;
    for (int j = 0; j < N; ++j) {
      s.theta[j] += change[j];
      gain += change[j] * slope[j];
    }
    if (gain < rules.converged) break;
  }
  return s;
}

py::tuple fit_moving_surfaces(const py::object& x, const py::object& x_prev,
                              const py::object& sigma, const py::object& first,
                              const py::object& camera, const py::object& down_,
                              const py::object& constants) {
  constexpr auto kernel = "fit_moving_surfaces";
  const In<double> at(kernel, "x", x, {ANY, 2}), before(kernel, "x_prev", x_prev, {at.size(), 2}),
      noise(kernel, "sigma", sigma, {at.size()});
  const In<std::int64_t> starts(kernel, "first", first, {ANY});
  const Mat3 K = matrix(kernel, "K", camera.attr("K")), K_inverse = inverse(K),
             R = matrix(kernel, "R", camera.attr("R"));
  const Mat3 KR = K * transposed(R);
  const Vec3 down = vector(kernel, "down", down_);
  const FitRules rules{number(constants, "iterations"), number(constants, "converged"),
                       number(constants, "inlier"), number(constants, "yaw_sigma"),
                       number(constants, "upright_sigma")};
  const auto regions = starts.size();
  check_first(kernel, starts, at.size());
  Out<double> theta({regions, N}), covariance({regions, N, N}), centre({regions, 2}),
      variance({regions});
  Out<bool> inlier({at.size()});
  FittedBlocks blocks(at.size());
  for (py::ssize_t i = 0; i < at.size(); ++i) {
    const Vec3 ray = K_inverse * Vec3{at(i, 0), at(i, 1), 1};
    for (int a = 0; a < 2; ++a) {
      blocks.ray[a][i] = ray[a];
      blocks.x_prev[a][i] = before(i, a);
    }
    blocks.sigma[i] = noise[i];
  }
  std::vector<double> squared(at.size() + LANES);
  for (py::ssize_t r = 0; r < regions; ++r) {
    const auto begin = starts[r], end = r + 1 < regions ? starts[r + 1] : at.size();
    const Region region(blocks, begin, end - begin);
    const Surface s = fitted(region, KR, R, K_inverse, down, rules);
    squared_errors(region, s, KR, squared.data());
    double sum = 0, n = 0;
    for (std::size_t i = 0; i < region.n; ++i) {
      inlier[begin + i] = squared[i] < 2 * square(rules.inlier);
      if (!inlier[begin + i]) continue;
      n += 1;
      sum += squared[i];
    }
    double factor[N * N];
    std::copy_n(s.normal, N * N, factor);
    const bool solvable = cholesky(factor, N);
    // A region of wrong vectors only must not look exact.
    variance[r] = solvable && n >= 0.5 * region.n ? sum / std::max(2 * n - N, 1.0) : INFINITE;
    // Vectors that scatter more than their sigma says widen the covariance; none narrow it.
    const double wider = std::isfinite(variance[r]) ? std::max(variance[r], 1.0) : 1.0;
    for (int j = 0; j < N; ++j) {
      double column[N]{};
      column[j] = 1;
      if (solvable) cholesky_solve(factor, N, column);
      for (int k = 0; k < N; ++k) covariance.data()[(r * N + k) * N + j] = wider * column[k];
      theta(r, j) = s.theta[j];
    }
    centre(r, 0) = s.centre[0];
    centre(r, 1) = s.centre[1];
  }
  return py::make_tuple(theta.array(), covariance.array(), centre.array(), inlier.array(),
                        variance.array());
}

// How many rows a pixel lies below the horizon; infinite where that is unknown.
double below_horizon(const Vec3& ray, const Vec3& level, double focal) {
  return level[1] < 0 ? dot(ray, level) / (level[1] / focal) : INFINITE;
}

struct LandRules {
  double relief, farthest, dependence, iterations;
};

// How much rather a region shows still land at another height than one depth, as chi-square: land
// looks farther than the plane of the road, as a car ahead does, but its inverse depth grows from
// row to row as the road's does, in one proportion. Above the horizon nothing is told.
class Land {
 public:
  explicit Land(const LandRules& rules) : rules_(rules) {}

  double rather(const double* rho, const double* sigma, const double* under, std::size_t n) {
    rho_ = rho;
    weight_.resize(n);
    shape_.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
      const double weight = 1 / (square(sigma[i]) + square(rules_.relief * rho[i]) + 1e-18);
      weight_[i] = under[i] > 0 ? weight : 0;
      shape_[i] = std::max(under[i], 0.0);
    }
    double share = 0, depth = 0;
    const double land = misfit(share);
    std::fill(shape_.begin(), shape_.end(), 1.0);
    const double body = misfit(depth);
    // Nothing still looks farther than infinity.
    return share > 0 ? std::max(body - land, 0.0) / rules_.dependence : 0;
  }

 private:
  // The capped squared error of the best multiple of a shape, reweighted as of Geman and McClure.
  double misfit(double& scale) {
    own_ = weight_;
    squared_.resize(own_.size());
    double error = 0;
    for (int k = 0; k < rules_.iterations; ++k) {
      double across = 0, length = 0;
      for (std::size_t i = 0; i < own_.size(); ++i) {
        across += own_[i] * rho_[i] * shape_[i];
        length += own_[i] * square(shape_[i]);
      }
      scale = across / std::max(length, 1e-12);
      reweigh(weight_.data(), rho_, shape_.data(), own_.size(), scale, rules_.farthest,
              squared_.data(), own_.data());
      error = 0;
      for (const double squared : squared_) error += squared;
    }
    return error;
  }

  // Capped squared errors, and what blocks count by them.
  KERNELS_WIDE
  static void reweigh(const double* weight, const double* rho, const double* shape, std::size_t n,
                      double scale, double farthest, double* __restrict squared,
                      double* __restrict own) {
    for (std::size_t i = 0; i < n; ++i) {
      const double error = weight[i] * square(rho[i] - scale * shape[i]);
      own[i] = weight[i] / square(1 + error / farthest);
      squared[i] = std::min(error, farthest);
    }
  }

  const LandRules rules_;
  const double* rho_ = nullptr;
  std::vector<double> weight_, shape_, own_, squared_;
};

// How many different ones there are among some values that are not negative.
std::int64_t count_different(const std::vector<std::int64_t>& values,
                             std::vector<std::int64_t>& table) {
  std::size_t size = 1;
  while (size < 2 * values.size()) size *= 2;
  table.assign(size, -1);
  std::int64_t found = 0;
  for (const auto value : values) {
    auto at = static_cast<std::uint64_t>(value) * 0x9E3779B97F4A7C15u >> 32 & (size - 1);
    while (table[at] >= 0 && table[at] != value) at = (at + 1) & (size - 1);
    found += table[at] < 0;
    table[at] = value;
  }
  return found;
}

py::tuple region_outlines(const py::object& regions, const py::object& K_,
                          const py::object& ground_, const py::object& level_,
                          const py::object& constants) {
  constexpr auto kernel = "region_outlines";
  const In<double> all_x(kernel, "x", regions.attr("x"), {ANY, 2});
  const auto all = all_x.size();
  const In<double> x_prev(kernel, "x_prev", regions.attr("x_prev"), {all, 2}),
      all_block(kernel, "block", regions.attr("block"), {all, 2}),
      parallax(kernel, "parallax", regions.attr("parallax"), {all, 2}),
      all_rho(kernel, "rho", regions.attr("rho"), {all}),
      noise(kernel, "noise", regions.attr("noise"), {all});
  const In<std::int64_t> members(kernel, "members", regions.attr("members"), {ANY}),
      first(kernel, "first", regions.attr("first"), {ANY});
  const auto n = members.size();
  check_first(kernel, first, n);
  std::vector<double> rho(n), sigma(n);
  for (py::ssize_t i = 0; i < n; ++i) {
    require(members[i] >= 0 && members[i] < all, kernel, "members must be blocks");
    rho[i] = all_rho[members[i]];
    sigma[i] = noise[members[i]];
  }
  const auto x = [&](py::ssize_t i, int a) { return all_x(members[i], a); };
  const auto block = [&](py::ssize_t i, int a) { return all_block(members[i], a); };
  const auto shift = [&](py::ssize_t i, int a) { return x_prev(members[i], a) - x(i, a); };
  // The part of the vector that the camera's rotation makes.
  const auto turn = [&](py::ssize_t i, int a) { return shift(i, a) + parallax(members[i], a); };
  const Mat3 K = matrix(kernel, "K", K_), K_inverse = inverse(K);
  const Vec3 ground = vector(kernel, "ground", ground_), level = vector(kernel, "level", level_);
  const double covered = number(constants, "covered"), macroblock = number(constants, "macroblock"),
               foot_height = number(constants, "foot_height"),
               repeated = number(constants, "repeated");
  const LandRules rules{number(constants, "relief"), number(constants, "farthest"),
                        number(constants, "dependence"), number(constants, "iterations")};
  const auto R = first.size();
  Out<double> low({R, 2}), high({R, 2}), foot({R, 2}), drop({R}), under({R}), filled({R}),
      near({R}), land({R}), turned({R, 2});
  Out<std::int64_t> kinds({R});
  std::vector<double> bottom, each(n);
  Land land_of(rules);
  for (py::ssize_t i = 0; i < n; ++i)
    each[i] = -dot(K_inverse * Vec3{x(i, 0), x(i, 1), 1}, ground);
  std::vector<std::int64_t> keys, table;
  for (py::ssize_t r = 0; r < R; ++r) {
    const auto begin = first[r], end = r + 1 < R ? first[r + 1] : n;
    bottom.clear();
    keys.clear();
    const auto count = static_cast<double>(end - begin);
    double area = 0, least[2] = {INFINITE, INFINITE}, most[2] = {-INFINITE, -INFINITE},
           mean_turn[2] = {}, lowermost = -INFINITE, edge = -INFINITE;
    for (auto i = begin; i < end; ++i) {
      bottom.push_back(x(i, 1) + 0.5 * block(i, 1));
      edge = std::max(edge, std::min(lowermost, bottom.back()));
      lowermost = std::max(lowermost, bottom.back());
      area += block(i, 0) * block(i, 1);
      std::int64_t key = 0;
      for (int a = 0; a < 2; ++a) {
        least[a] = std::min(least[a], x(i, a));
        most[a] = std::max(most[a], x(i, a));
        mean_turn[a] += turn(i, a) / count;
        key = key * 65536 + (std::llrint(shift(i, a) / repeated) & 65535);
      }
      keys.push_back(key);
    }
    for (int a = 0; a < 2; ++a) {
      low(r, a) = least[a];
      high(r, a) = most[a];
      turned(r, a) = mean_turn[a];
    }
    // A single block below all others is taken for a stray, as in contact.hpp.
    if (end - begin < 2) edge = lowermost;
    double across = 0, lowest = 0, lower = 0, tall = 0;
    for (auto i = begin; i < end; ++i) {
      if (bottom[i - begin] >= edge - 0.5) {
        across += x(i, 0);
        tall += block(i, 1);
        lowest += 1;
      }
      if (bottom[i - begin] > edge - foot_height) {
        near[r] += rho[i];
        lower += 1;
      }
    }
    near[r] /= lower;
    foot(r, 0) = across / lowest;
    foot(r, 1) = edge - (0.5 - covered) * tall / lowest;
    const Vec3 ray = K_inverse * Vec3{foot(r, 0), foot(r, 1), 1};
    drop[r] = below_horizon(ray, level, K[4]);
    under[r] = -dot(ray, ground);
    filled[r] = area / ((high(r, 0) - low(r, 0) + macroblock) *
                        (high(r, 1) - low(r, 1) + macroblock));
    land[r] = land_of.rather(&rho[begin], &sigma[begin], &each[begin], end - begin);
    kinds[r] = count_different(keys, table);
  }
  return py::make_tuple(low.array(), high.array(), foot.array(), drop.array(), under.array(),
                        filled.array(), near.array(), land.array(), kinds.array(), turned.array());
}

// Columns of all blocks of the picture, as of movers/regions.py.
struct SeenBlocks {
  SeenBlocks(const char* kernel, const py::object& seen)
      : x(kernel, "x", seen.attr("x"), {ANY, 2}),
        rho(kernel, "rho", seen.attr("rho"), {x.size()}),
        sigma(kernel, "noise", seen.attr("noise"), {x.size()}),
        under(kernel, "under", seen.attr("under"), {x.size()}),
        copied(kernel, "copied", seen.attr("copied"), {x.size()}) {
    for (py::ssize_t i = 0; i < x.size(); ++i) {
      share_copied += copied[i];
      first = std::min(first, x(i, 0));
      last = std::max(last, x(i, 0));
    }
    share_copied /= std::max<double>(x.size(), 1);
  }
  In<double> x, rho, sigma, under;
  In<bool> copied;
  double share_copied = 0, first = INFINITE, last = -INFINITE;
};

// Columns of regions, movers/outlines.py's Outlines.
struct RegionOutlines {
  RegionOutlines(const char* kernel, const py::object& o)
      : low(kernel, "low", o.attr("low"), {ANY, 2}),
        high(kernel, "high", o.attr("high"), {low.size(), 2}),
        foot(kernel, "foot", o.attr("foot"), {low.size(), 2}),
        drop(kernel, "drop", o.attr("drop"), {low.size()}),
        under(kernel, "under", o.attr("under"), {low.size()}),
        filled(kernel, "filled", o.attr("filled"), {low.size()}),
        rho(kernel, "rho", o.attr("rho"), {low.size()}),
        land(kernel, "land", o.attr("land"), {low.size()}),
        turned(kernel, "turned", o.attr("turned"), {low.size(), 2}),
        limit(kernel, "limit", o.attr("limit"), {3}),
        kinds(kernel, "kinds", o.attr("kinds"), {low.size()}) {}
  In<double> low, high, foot, drop, under, filled, rho, land, turned, limit;
  In<std::int64_t> kinds;
};

struct ScoreRules {
  explicit ScoreRules(const py::object& o)
      : bias(number(o, "bias")), least_drop(number(o, "least_drop")),
        foot_sigma(number(o, "foot_sigma")), edge_sigma(number(o, "edge_sigma")),
        ground_sigma(number(o, "ground_sigma")), bank_sigma(number(o, "bank_sigma")),
        lowest_part(number(o, "lowest_part")), least_filled(number(o, "least_filled")),
        relief(number(o, "relief")), wide(number(o, "wide")), pull(number(o, "pull")),
        least_ratio(number(o, "least_ratio")), clearance(number(o, "clearance")),
        outlier(number(o, "outlier")), underbody(number(o, "underbody")),
        least_reach(number(o, "least_reach")), half_covered(number(o, "half_covered")),
        shown(number(o, "shown")), unseen(number(o, "unseen")), no_land(number(o, "no_land")),
        dependence(number(o, "dependence")), around(number(o, "around")), few(number(o, "few")),
        least_copied(number(o, "least_copied")), credit(number(o, "credit")),
        border(number(o, "border")), together(number(o, "together")),
        bodies(number(o, "bodies")), copied(number(o, "copied")), step(number(o, "step")),
        back(number(o, "back")), macroblock(number(o, "macroblock")) {}
  double bias, least_drop, foot_sigma, edge_sigma, ground_sigma, bank_sigma, lowest_part,
      least_filled, relief, wide, pull, least_ratio, clearance, outlier, underbody, least_reach,
      half_covered, shown, unseen, no_land, dependence, around, few, least_copied, credit, border,
      together, bodies, copied, step, back, macroblock;
};

class Judge {
 public:
  Judge(const char* kernel, const py::object& outlines, const py::object& blocks,
        const py::object& constants)
      : o(kernel, outlines), seen(kernel, blocks), c(constants) {}
  const RegionOutlines o;
  const SeenBlocks seen;
  const ScoreRules c;

  double width(py::ssize_t r) const { return o.high(r, 0) - o.low(r, 0) + c.macroblock; }
  double height(py::ssize_t r) const { return o.high(r, 1) - o.low(r, 1) + c.macroblock; }

  // Whether a region is no larger than a vehicle.
  bool may_be_vehicle(py::ssize_t r) const {
    const double drop = std::max(o.drop[r], 1.0);
    return width(r) <= drop * o.limit[0] && height(r) <= drop * o.limit[1];
  }

  // Whether it is as high as a vehicle's part or a person may be.
  bool may_hover(py::ssize_t r) const {
    const double share = height(r) / std::max(o.drop[r], 1.0);
    return share >= c.lowest_part && share <= o.limit[1];
  }

  // The score that the vectors of a region deserve, which may all be wrong: short of bits an
  // encoder goes on with the vector beside, over whole shadows.
  double credible(py::ssize_t r) const {
    const double reach[2] = {std::max(0.5 * width(r), c.around),
                             std::max(0.5 * height(r), c.around)};
    double copied = 0, n = 0;
    for (py::ssize_t i = 0; i < seen.x.size(); ++i) {
      bool inside = true, near = true;
      for (int a = 0; a < 2; ++a) {
        const double at = seen.x(i, a);
        inside &= at >= o.low(r, a) && at <= o.high(r, a);
        near &= at >= o.low(r, a) - reach[a] && at <= o.high(r, a) + reach[a];
      }
      if (!near || inside) continue;
      n += 1;
      copied += seen.copied[i];
    }
    copied = (copied + c.few * seen.share_copied) / (n + c.few);
    copied = std::min(std::max(copied, std::max(seen.share_copied, c.least_copied)), 1.0);
    return c.credit * static_cast<double>(o.kinds[r]) * square(1 - copied) / copied;
  }

  // How far below the horizon a body ends that stands `drop` below it: the ground shows below the
  // body of what is near; of what is far, shadow and wheels hide it.
  double body_end(py::ssize_t r, double drop) const {
    return drop - std::max(c.underbody * height(r) - c.macroblock, 0.0);
  }

  // Squared distance of a region from all that stands on the ground.
  double hovers(py::ssize_t r, double at_foot, double sigma) const {
    const double ratio = at_foot / o.under[r];
    const double above = std::max(std::log(body_end(r, ratio * o.drop[r]) / o.drop[r]), 0.0);
    // Where the ground is seen below it is known: only the edge is not.
    const double spread = std::sqrt(square(c.edge_sigma / o.drop[r]) + square(c.ground_sigma) +
                                    square(sigma / at_foot) + square(c.clearance));
    return std::min(square(above / spread) - 1, ground_below(r, ratio));
  }

  // How much rather a region goes on above than the ground does, as chi-square: of a car ahead
  // only the lower part looks farther than the ground. A bank beyond a ditch shows one depth, too,
  // but it does not end within the picture.
  double body_above(py::ssize_t r) const {
    if (o.low(r, 0) < seen.first + c.border || o.high(r, 0) > seen.last - c.border) return 0;
    const double highest = o.foot(r, 1) - o.limit[1] * o.drop[r], near = o.rho[r];
    double sum = 0;
    for (py::ssize_t i = 0; i < seen.x.size(); ++i) {
      const double under = seen.under[i];
      if (!(std::abs(seen.x(i, 0) - o.foot(r, 0)) < 0.5 * width(r)) || !(under > 0) ||
          !(seen.x(i, 1) < o.low(r, 1) - c.macroblock / 2) || !(seen.x(i, 1) > highest))
        continue;
      sum += rather(i, near);
    }
    return 2 * sum / c.dependence;
  }

  // How much rather blocks from one column to another look as far as `near` or farther than as near
  // as the ground or nearer, as chi-square: those above the foot of a region that would hide them.
  double looks_farther(py::ssize_t r, double near, double from, double to) const {
    double evidence = 0;
    for (py::ssize_t i = 0; i < seen.x.size(); ++i) {
      const double under = seen.under[i];
      if (!(seen.x(i, 0) > from) || !(seen.x(i, 0) < to) || !(under > near) ||
          !(seen.x(i, 1) < o.foot(r, 1)))
        continue;
      const double rho = seen.rho[i], sigma = std::hypot(seen.sigma[i], c.ground_sigma * under);
      evidence += std::log(normal(std::max(rho - near, 0.0) / sigma) + c.outlier) -
                  std::log(normal(std::max(under - rho, 0.0) / sigma) + c.outlier);
    }
    return 2 * evidence / c.dependence;
  }

  // The same of a region itself, as far as the ground is seen on both sides of it: land that hides
  // its own foot looks farther, too, but it does not end there.
  double looks_farther(py::ssize_t r, double near) const {
    const double left = o.low(r, 0) - c.macroblock / 2, right = o.high(r, 0) + c.macroblock / 2,
                 beside = c.around, own = looks_farther(r, near, left, right);
    if (own <= 0) return own;
    // Near the horizon vectors tell little: its lower half is what ground must show beside.
    const double low = std::max(near, 0.5 * o.under[r]);
    const double sides = std::max(looks_farther(r, low, left - beside, left),
                                  looks_farther(r, low, right, right + beside));
    return std::min(own, std::max(c.unseen - sides, 0.0));
  }

  // How much rather the ground is seen where a region would hide it, as chi-square. What stands
  // still and looks `ratio` times nearer than the ground at its foot reaches down to where the
  // ground is as near. What is seen there shows the ground's depth or the region's; what is nearer
  // than both is no ground. A block that a body in the air covers in part shows the body. What looks
  // farther than the road may stand on land that is seen to lie lower.
  double ground_below(py::ssize_t r, double ratio) const {
    const double drop = o.drop[r];
    if (!std::isfinite(drop)) return 0;
    const double reach =
        std::max((ratio > 1 ? body_end(r, ratio * drop) : ratio * drop) - drop, c.least_reach);
    double evidence = 0, roads = 0;
    std::vector<py::ssize_t> place;
    for (py::ssize_t i = 0; i < seen.x.size(); ++i) {
      const double below = seen.x(i, 1) - o.foot(r, 1), under = seen.under[i];
      if (!(std::abs(seen.x(i, 0) - o.foot(r, 0)) < 0.5 * width(r)) || !(below > 0) ||
          !(below < reach))
        continue;
      place.push_back(i);
      const double near = ratio * (ratio > 1 ? o.under[r] : under);
      const double sigma = std::hypot(seen.sigma[i], c.ground_sigma * std::max(under, near));
      const double nearest =
          ratio > 1 && near > under ? std::min(seen.rho[i], near) : seen.rho[i];
      const double body = std::exp(-0.5 * square((nearest - near) / sigma));
      const double covered = ratio > 1 ? std::exp(-below / c.half_covered) : 0;
      const double road = likely(i, under, sigma);
      evidence += std::log(road + covered * body + c.outlier) - std::log(body + c.outlier);
      roads += road > body;
    }
    if (ratio < 1) evidence -= sunk(place, ratio);
    evidence *= 2 / c.dependence;
    // The road must show itself on some of the place.
    const double shown = roads * square(c.macroblock) / (width(r) * reach);
    return evidence > 0 ? evidence * std::min(shown / c.shown, 1.0) : evidence;
  }

 private:
  // How much rather blocks show land lower than the plane of the road, log-likelihood: it looks
  // farther in one proportion, at least `ratio`. It is as rare as a wrong vector.
  double sunk(const std::vector<py::ssize_t>& place, double ratio) const {
    std::vector<double> ratios;
    for (const auto i : place) ratios.push_back(seen.rho[i] / seen.under[i]);
    const double share = std::min(std::max(median(ratios), ratio), 1.0);
    double land = std::log(c.outlier);
    for (const auto i : place) land += rather(i, share * seen.under[i]);
    return std::max(land, 0.0);
  }

  // How much rather a block shows an inverse depth than the ground's, log-likelihood.
  double rather(py::ssize_t i, double near) const {
    const double under = seen.under[i];
    const double sigma = std::hypot(seen.sigma[i], c.ground_sigma * std::max(under, near));
    return std::log(likely(i, near, sigma) + c.outlier) -
           std::log(likely(i, under, sigma) + c.outlier);
  }

  static double normal(double x) { return std::exp(-0.5 * square(x)); }

  double likely(py::ssize_t i, double rho, double sigma) const {
    return normal((seen.rho[i] - rho) / sigma);
  }
};

// Columns of the moving planes of regions, movers/moving_plane.py's Surfaces.
struct MovingSurfaces {
  MovingSurfaces(const char* kernel, const py::object& fit, py::ssize_t R)
      : theta(kernel, "theta", fit.attr("theta"), {R, N}),
        covariance(kernel, "covariance", fit.attr("covariance"), {R, N, N}),
        centre(kernel, "centre", fit.attr("centre"), {R, 2}),
        variance(kernel, "variance", fit.attr("variance"), {R}) {}
  In<double> theta, covariance, centre, variance;
};

// Covariance of a region's rate with what its vectors err alike.
Mat3 rate_covariance(const double* own, const double* rate, const double* centre,
                     const RegionOutlines& o, py::ssize_t r, const Judge& judge, const Mat3& K,
                     const ScoreRules& c) {
  const double width = judge.width(r), height = judge.height(r);
  // Vectors show the parallax at the centre and the growth: an error of that goes along the ray.
  const double growth = c.bias / (0.5 * std::min(width, height));
  const double ray[3] = {centre[0] * growth, centre[1] * growth, growth};
  // A surface that is not one plane shifts its rate by a share of it.
  const double shape = square(c.relief * std::sqrt(square(rate[0]) + square(rate[1]) +
                                                   square(rate[2])) *
                              std::min(1.0, std::max(width, height) / c.wide));
  // Where a road has no texture its vectors lag behind a turn, or run ahead of it, all alike.
  const double lag[3] = {c.pull * o.turned(r, 0) / K[0], c.pull * o.turned(r, 1) / K[4], 0};
  Mat3 C;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      C[3 * i + j] = own[i * N + j] + lag[i] * lag[j] + ray[i] * ray[j];
  for (int i = 0; i < 3; ++i) C[4 * i] += shape + (i < 2 ? square(c.bias / K[4 * i]) : 0.0);
  return C;
}

// How little all that is still explains a region by its vectors of one pair, and that it follows the
// ground or hovers over it: its score before it is bounded.
double moves(py::ssize_t r, const MovingSurfaces& fit, const Judge& judge, const View& view,
             bool known_ground) {
  const RegionOutlines& o = judge.o;
  const ScoreRules& c = judge.c;
  const Vec3& t = view.t;
  const Mat3& K = view.K;
  const bool drives = view.drives();
  const double *own = fit.covariance.data() + r * N * N, *centre = fit.centre.data() + 2 * r;
  const Vec3 rate{fit.theta(r, 0), fit.theta(r, 1), fit.theta(r, 2)};
  const Mat3 W = inverse(rate_covariance(own, rate.data(), centre, o, r, judge, K, c));
  const double information = std::max(dot(W * t, t), 1e-12);
  const double apparent = dot(rate, W * t) / information;
  const Vec3 error = rate - std::max(apparent, 0.0) * t;
  double distance = dot(W * error, error) - 3;
  // The apparent inverse depth at the foot.
  const double drop = o.drop[r], under = o.under[r];
  const Vec3 ray = view.inverse_K * Vec3{o.foot(r, 0), o.foot(r, 1), 1};
  const double off[2] = {ray[0] - centre[0], ray[1] - centre[1]};
  const double relative = 1 + (off[0] * fit.theta(r, 3) + off[1] * fit.theta(r, 4));
  double tilt = 0;
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 2; ++j) tilt += own[(3 + i) * N + 3 + j] * off[i] * off[j];
  const double foot = apparent * std::min(std::max(relative, 0.5), 2.0);
  const double sigma = std::hypot(1 / std::sqrt(information),
                                  std::abs(apparent) * std::sqrt(std::max(tilt, 0.0)));
  const bool stands = under > 0 && drives;
  // A hedge along the road is no plane: its foot is nearer than the plane of the whole says.
  // What is larger than a vehicle is a building, and the ground is not where it should be.
  if (stands && judge.may_be_vehicle(r)) {
    const double aside = std::abs(o.foot(r, 0) - K[2]) * K[4] / K[0];
    const double share = std::sqrt((square(c.foot_sigma) + square(c.bank_sigma * aside)) /
                                       square(std::max(drop, 1.0)) +
                                   square(c.ground_sigma));
    const double farthest = std::max(foot, o.rho[r]), near = std::max(farthest, 0.0);
    const double lacking = std::max(under - farthest, 0.0) / std::hypot(sigma, share * under);
    const double most = std::min(std::max(c.no_land - o.land[r], 0.0),
                                 std::max(c.unseen + judge.ground_below(r, near / under), 0.0));
    const double by_foot = square(lacking) - 1,
                 by_rows = most > 0 ? judge.looks_farther(r, near) : 0;
    // That a car ahead follows the lines of what stands still tells nothing of it.
    const double lines = std::max(distance, 0.0);
    if (by_foot > 0) distance += std::min(by_foot, most);
    if (by_rows > 0) distance = std::max(distance, lines + std::min(by_rows, most));
  }
  const double at_foot = std::min(foot, o.rho[r]);
  // The road's own wrong vectors are short: low or scattered, they are no vehicle.
  if (std::isfinite(drop) && distance > 0) {
    if (judge.height(r) < o.limit[2] * drop)
      distance = std::min(distance, std::max(judge.body_above(r), 0.0));
    if (o.filled[r] < c.least_filled) distance = std::min(distance, 0.0);
  }
  if (stands && known_ground && judge.may_hover(r) && at_foot >= c.least_ratio * under) {
    const double hovers = judge.hovers(r, at_foot, sigma);
    // An oncoming car follows the lines of what stands still: that it does tells nothing then.
    distance = hovers + (hovers > 0 ? std::max(distance, 0.0) : distance);
  }
  // Nothing that a robot could meet ends above the horizon, higher than its camera: what a
  // mover's score came to by mistake is taken back.
  if (drop < c.least_drop) distance = c.back;
  return distance;
}

py::tuple region_scores(const py::object& fit_, const py::object& outlines, const py::object& view_,
                        const py::object& seen, bool known_ground, const py::tuple& told,
                        const py::object& constants) {
  constexpr auto kernel = "region_scores";
  const Judge judge(kernel, outlines, seen, constants);
  const ScoreRules& c = judge.c;
  const auto R = judge.o.low.size();
  const MovingSurfaces fit(kernel, fit_, R);
  const View view(kernel, view_);
  require(told.size() == 2, kernel, "told are two");
  const In<double> likelihood(kernel, "likelihood", told[0], {R}),
      evidence(kernel, "evidence", told[1], {R});
  Out<double> now({R}), gone({R}), lasting({R});
  for (py::ssize_t r = 0; r < R; ++r) {
    if (!std::isfinite(fit.variance[r])) continue;
    // Above the horizon nothing is known; nor does a building leave.
    const bool able = judge.may_be_vehicle(r) && judge.o.drop[r] >= c.least_drop;
    const double distance = moves(r, fit, judge, view, known_ground),
                 left = able ? 2 * likelihood[r] / c.together : c.back;
    const double most = std::max(distance, left) > 0 ? judge.credible(r) : 0;
    const auto bounded = [&](double score) {
      return std::min(std::max(std::min(score, most), c.back), c.step);
    };
    now[r] = bounded(distance);
    gone[r] = bounded(left);
    if (now[r] > 0 && evidence[r] > 0)
      lasting[r] = std::min(c.bodies * evidence[r], c.copied * most);
  }
  return py::make_tuple(now.array(), gone.array(), lasting.array());
}

}  // namespace
}  // namespace kernels

void bind_region_score(kernels::py::module_& module) {
  using namespace kernels;
  module.def("fit_moving_surfaces", fit_moving_surfaces);
  module.def("region_outlines", region_outlines);
  module.def("region_scores", region_scores);
}
