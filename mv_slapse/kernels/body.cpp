// Bodies that look farther than the ground they hide, found among blocks that singly tell nothing.
// movers/body.py.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "arrays.hpp"
#include "blocks.hpp"
#include "movers.hpp"

namespace kernels {
namespace {

using Blocks = std::vector<std::int64_t>;

struct BodyRules {
  explicit BodyRules(const py::object& o)
      : depths(number(o, "depths")), nearest(number(o, "nearest")), farthest(number(o, "farthest")),
        body(number(o, "body")), road(number(o, "road")), sharp(number(o, "sharp")),
        usual(number(o, "usual")), most(number(o, "most")), once(number(o, "once")),
        lasting(number(o, "lasting")), fading(number(o, "fading")), lane(number(o, "lane")),
        agrees(number(o, "agrees")), least(number(o, "least")), beside(number(o, "beside")),
        above(number(o, "above")), widest(number(o, "widest")), many(number(o, "many")),
        blocks(number(o, "blocks")), reach(number(o, "reach")) {}
  double depths, nearest, farthest, body, road, sharp, usual, most, once, lasting, fading, lane,
      agrees, least, beside, above, widest, many, blocks, reach;
};

// Log-likelihoods (D, C) of upright bodies by inverse depth, in a row (D,), and column.
struct Grid {
  std::vector<double> depths, told;
  std::size_t columns() const { return depths.empty() ? 0 : told.size() / depths.size(); }

  // What was told between cells, 0 outside.
  double at(double row, double column) const {
    const auto n = columns();
    if (!(row >= 0 && row <= depths.size() - 1.0 && column >= 0 && column <= n - 1.0)) return 0;
    const auto r = std::min(static_cast<std::size_t>(row), depths.size() - 2);
    const auto c = std::min(static_cast<std::size_t>(column), n - 2);
    const double down = row - r, right = column - c, *cell = &told[r * n + c];
    return (1 - down) * ((1 - right) * cell[0] + right * cell[1]) +
           down * ((1 - right) * cell[n] + right * cell[n + 1]);
  }
};

// Middle of a column of macroblocks [px].
double middle(double column) { return BlockGrid::MACROBLOCK * column + 7.5; }

// The grid of a picture, of inverse depths in units of its baseline, with what the pairs before told
// of bodies on the way ahead. If they stand still, as what drives on steadily seems to, they come
// nearer by the camera's way alone. `before` has inverse depths in units of the camera's height.
Grid carried(const Grid& before, const View& view, const Vec3& ground, double width, double height,
             const BodyRules& rules) {
  const double norm = std::sqrt(dot(ground, ground));
  const auto n = static_cast<std::size_t>(std::ceil(width / BlockGrid::MACROBLOCK));
  Grid grid;
  // Of a camera that looks up the ground lies below the picture.
  const double lowest = -dot(view.inverse_K * Vec3{0.5 * width, height, 1}, ground);
  double depth = rules.farthest * std::max(lowest, 1e-3 * norm);
  const double step = std::pow(rules.nearest / rules.farthest, 1 / (rules.depths - 1));
  for (int k = 0; k < rules.depths; ++k, depth *= step) grid.depths.push_back(depth);
  grid.told.resize(grid.depths.size() * n);
  // Nothing is carried on where the camera does not go ahead, nor from another size of picture.
  if (before.depths.size() != grid.depths.size() || before.columns() != n || n < 2 ||
      !(view.t[2] < 0))
    return grid;
  const double course = view.K[2] + view.K[0] * view.t[0] / view.t[2];
  const double ratio = std::log(before.depths[1] / before.depths[0]);
  const Mat3 back = transposed(view.R);
  for (std::size_t c = 0; c < n; ++c) {
    const double aside = std::abs(middle(c) - course) / view.K[0] * norm;
    const Vec3 ray = view.inverse_K * Vec3{middle(c), view.K[5], 1};
    for (std::size_t k = 0; k < grid.depths.size(); ++k) {
      if (aside / grid.depths[k] > rules.lane) continue;
      Vec3 X;
      for (int a = 0; a < 3; ++a) X[a] = ray[a] / grid.depths[k] - view.t[a];
      const Vec3 P = view.K * (back * X);
      if (!(P[2] > 0)) continue;
      const double row = std::log(1 / (P[2] * norm * before.depths[0])) / ratio;
      const double column = (P[0] / P[2] - middle(0)) / BlockGrid::MACROBLOCK;
      grid.told[k * n + c] = rules.fading * before.at(row, column);
    }
  }
  return grid;
}

// Blocks that move along their epipolar lines, below the horizon.
struct Seen {
  const double *x, *rho, *sigma, *under;
  Blocks at;
};

// The share by which the ground may be farther than the plane that is taken for it: it is known as
// well as what lies below it agrees.
double unevenness(const Seen& seen, const BodyRules& rules) {
  constexpr double HALF_NORMAL = 0.6745;  // median of the absolute value of a standard normal
  std::vector<double> lower(static_cast<std::size_t>(rules.usual), HALF_NORMAL * rules.road);
  for (const auto i : seen.at) {
    const double ratio = seen.rho[i] / seen.under[i];
    if (seen.sigma[i] < rules.sharp * seen.under[i] && ratio > 0 && ratio < 1)
      lower.push_back(1 - ratio);
  }
  return std::max(rules.road, median(lower) / HALF_NORMAL);
}

// Columns of macroblocks and what each tells of an upright body at some depths: that it goes on
// below the row where ground is as far, which ground would hide from there on.
class Columns {
 public:
  Columns(const Seen& seen, const Grid& before, const BodyRules& rules)
      : rules_(rules), blocks_(seen.at.size()), column_(before.columns()), depths_(before.depths),
        told_(before.told), lasting_(told_.size()), foot_(told_.size()) {
    const double uneven = unevenness(seen, rules);
    auto lowest = seen.at.front(), highest = lowest;
    std::vector<std::size_t> at(column_.size()), of(seen.at.size());
    for (std::size_t k = 0; k < seen.at.size(); ++k) {
      const auto i = seen.at[k];
      if (seen.under[i] > seen.under[lowest]) lowest = i;
      if (seen.under[i] < seen.under[highest]) highest = i;
      const auto column = static_cast<std::int64_t>(seen.x[2 * i] / BlockGrid::MACROBLOCK);
      of[k] = std::min<std::int64_t>(std::max<std::int64_t>(column, 0), column_.size() - 1);
      ++at[of[k]];
    }
    for (std::size_t c = 0, begin = 0; c < column_.size(); ++c) {
      column_[c] = {begin, begin + at[c]};
      at[c] = begin;
      begin = column_[c].end;
    }
    for (std::size_t k = 0; k < seen.at.size(); ++k) {
      const auto i = seen.at[k];
      const Shown block{i, seen.x[2 * i + 1], seen.rho[i], square(seen.sigma[i]), seen.under[i], 0};
      // From the top down; they come row by row, mostly.
      auto to = at[of[k]]++;
      for (; to > column_[of[k]].begin && block.y < blocks_[to - 1].y; --to)
        blocks_[to] = blocks_[to - 1];
      blocks_[to] = block;
      blocks_[to].ground = misfit(block, block.under, uneven);
    }
    // Of the ground's inverse depth from row to row.
    slope_ = (seen.under[lowest] - seen.under[highest]) /
             std::max(seen.x[2 * lowest + 1] - seen.x[2 * highest + 1], 1.0);
    for (std::size_t c = 0; c < column_.size(); ++c) tell(c);
  }

  // What goes on to the next pair, before a body is taken out.
  const std::vector<double>& lasting() const { return lasting_; }

  // The blocks of the surest body, which is taken out, and what lasts of it; false: none is left.
  bool next(Blocks& body, double& evidence) {
    double best = 0;
    std::size_t first = 0, last = 0, depth = 0;
    const auto n = column_.size();
    for (std::size_t k = 0; k < depths_.size(); ++k)
      for (std::size_t from = 0; from < n; ++from) {
        // From its left end on, no wider than a vehicle that stands so low.
        double sum = 0, foot = 0;
        for (auto c = from; c < n; ++c) {
          sum += told_[k * n + c] - rules_.beside;
          foot = std::max(foot, foot_[k * n + c]);
          if (sum <= 0 || (c + 1 - from) * BlockGrid::MACROBLOCK > rules_.widest * foot) break;
          if (sum <= best) continue;
          best = sum;
          first = from;
          last = c;
          depth = k;
        }
      }
    if (best < rules_.least) return false;
    evidence = 0;
    for (auto c = first; c <= last; ++c) evidence += lasting_[depth * n + c] - rules_.beside;
    take(first, last, depths_[depth], body);
    return true;
  }

 private:
  struct Shown {
    std::int64_t i;
    double y, rho, variance, under, ground;  // its misfit on the ground
  };

  struct Range {
    std::size_t begin, end;
  };

  // How much rather a block shows a depth than the ground, log-likelihood.
  double gain(std::size_t k, double depth) const {
    return 0.5 * (blocks_[k].ground - misfit(blocks_[k], depth, rules_.body));
  }

  // Squared error of an inverse depth where another is expected that a surface departs from by a
  // share; at most so much as a wrong vector's.
  double misfit(const Shown& block, double expected, double share) const {
    return std::min(square(block.rho - expected) / (block.variance + square(share * expected)),
                    2 * rules_.most);
  }

  // How far a body goes down and up in a column: sums of gains from where ground is as far, to
  // where they are greatest, and the blocks [first, last) until there.
  struct Extent {
    double told;
    std::size_t first, last;
  };

  // `crossing` is the first block below that row, from which on; above it at most some are told.
  Extent extent(const Range& column, std::size_t crossing, double depth, std::size_t most) const {
    Extent found{0, crossing, crossing};
    double sum = 0;
    for (auto k = crossing; k < column.end && sum > found.told - rules_.most; ++k) {
      sum += gain(k, depth);
      if (k == crossing || sum > found.told) {
        found.told = sum;
        found.last = k + 1;
      }
    }
    double above = 0, first = 0;
    const auto highest = crossing - std::min(crossing - column.begin, most);
    sum = 0;
    for (auto k = crossing; k-- > highest && sum > above - rules_.most;) {
      sum += gain(k, depth);
      if (k + BESIDE >= crossing) first = sum;
      if (sum > above) {
        above = sum;
        found.first = k;
      }
    }
    // Where ground shows right above that row nothing stands.
    if (first < -rules_.beside) found = {first, crossing, crossing};
    return found;
  }

  // Looked for from block k on, one of those above.
  std::size_t crossing(const Range& column, std::size_t k, double depth) const {
    while (k < column.end && blocks_[k].under <= depth) ++k;
    return k;
  }

  void tell(std::size_t c) {
    const Range& column = column_[c];
    auto at = column.begin;
    for (std::size_t k = 0; k < depths_.size(); ++k) {  // from far to near
      at = crossing(column, at, depths_[k]);
      const Extent found = extent(column, at, depths_[k], BESIDE);
      double& told = told_[k * column_.size() + c];
      lasting_[k * column_.size() + c] = std::max(told + std::min(found.told, rules_.lasting), 0.0);
      told = std::max(told + std::min(found.told, rules_.once), 0.0);
      foot_[k * column_.size() + c] =
          found.last > column.begin ? blocks_[found.last - 1].under / slope_ : 0;
    }
  }

  // The blocks of a body in some columns, at the depth that they show; those columns are told of.
  void take(std::size_t first, std::size_t last, double depth, Blocks& body) {
    for (int round = 0; round < 2; ++round) {
      double weight = 0, mean = 0;
      body.clear();
      for (auto c = first; c <= last; ++c) {
        const Range& column = column_[c];
        const auto at = crossing(column, column.begin, depth);
        const auto rows = extent(column, at, depth, blocks_.size());
        for (auto k = rows.first; k < rows.last; ++k) {
          const Shown& block = blocks_[k];
          const double variance = block.variance + square(rules_.body * depth);
          if (square(block.rho - depth) > square(rules_.agrees) * variance ||
              block.under < rules_.above * depth)
            continue;
          body.push_back(block.i);
          weight += 1 / variance;
          mean += block.rho / variance;
        }
      }
      if (body.empty()) break;
      depth = mean / weight;
    }
    std::sort(body.begin(), body.end());
    for (auto c = first; c <= last; ++c) {
      column_[c].end = column_[c].begin;
      for (std::size_t k = 0; k < depths_.size(); ++k) told_[k * column_.size() + c] = 0;
    }
  }

  static constexpr std::size_t BESIDE = 2;  // blocks right above the row where ground is as far

  const BodyRules& rules_;
  double slope_ = 0;
  std::vector<Shown> blocks_;  // column by column, from the top down
  std::vector<Range> column_;
  std::vector<double> depths_;
  // (D, C): what this pair and those before tell, and how much of that the next one is told.
  std::vector<double> told_, lasting_;
  std::vector<double> foot_;  // rows below the horizon
};

struct Body {
  Blocks blocks;
  double evidence;
};

// Bodies, the surest first; `grid` is told of them.
std::vector<Body> bodies_of(const Seen& seen, Grid& grid, const BodyRules& rules) {
  std::vector<Body> found;
  if (seen.at.empty()) return found;
  Columns columns(seen, grid, rules);
  grid.told = columns.lasting();
  Body body;
  while (static_cast<double>(found.size()) < rules.many && columns.next(body.blocks, body.evidence))
    found.push_back(body);
  return found;
}

// The median distance of blocks from the nearest of some others.
double distance(const double* x, const Blocks& from, const Blocks& to) {
  std::vector<double> nearest;
  for (const auto i : from) {
    double least = INFINITY;
    for (const auto k : to)
      least = std::min(least, std::hypot(x[2 * i] - x[2 * k], x[2 * i + 1] - x[2 * k + 1]));
    nearest.push_back(least);
  }
  return median(nearest);
}

Blocks without(const Blocks& from, const Blocks& those) {
  Blocks left;
  std::set_difference(from.begin(), from.end(), those.begin(), those.end(),
                      std::back_inserter(left));
  return left;
}

py::tuple with_bodies(const py::object& field, const py::object& view, const py::object& ground_,
                      const py::tuple& size, const py::tuple& before_,
                      const py::object& constants) {
  constexpr auto kernel = "with_bodies";
  const In<double> x(kernel, "x", field.attr("x"), {ANY, 2});
  const auto n = x.size();
  const In<double> rho(kernel, "rho", field.attr("rho"), {n}),
      sigma(kernel, "noise", field.attr("noise"), {n}),
      under(kernel, "under", field.attr("under"), {n});
  const auto of_pair = static_cast<std::int64_t>(number(field, "own"));
  const In<bool> below(kernel, "below", field.attr("below"), {n}),
      fits(kernel, "fits", field.attr("fits"), {n});
  const In<std::int64_t> members(kernel, "members", field.attr("members"), {ANY}),
      first(kernel, "first", field.attr("first"), {ANY});
  check_first(kernel, first, members.size());
  require(size.size() == 2 && before_.size() == 2, kernel, "size and before are pairs");
  const In<double> depths(kernel, "depths", before_[0], {ANY}),
      told(kernel, "told", before_[1], {depths.size(), ANY});
  const BodyRules rules(constants);
  const Vec3 ground = vector(kernel, "ground", ground_);
  Grid grid{{depths.data(), depths.data() + depths.size()},
            {told.data(), told.data() + depths.size() * told.size(1)}};
  grid = carried(grid, View(kernel, view), ground, size[0].cast<double>(), size[1].cast<double>(),
                 rules);
  std::vector<Blocks> others, own;
  for (py::ssize_t r = 0; r < first.size(); ++r) {
    const auto end = r + 1 < first.size() ? first[r + 1] : members.size();
    const Blocks region(members.data() + first[r], members.data() + end);
    double sunk = 0;
    for (const auto i : region) sunk += below[i];
    const bool looks_farther = sunk > 0.5 * static_cast<double>(region.size());
    (looks_farther ? own : others).push_back(region);
  }
  std::vector<double> evidence_of(own.size());
  Seen seen{x.data(), rho.data(), sigma.data(), under.data(), {}};
  for (py::ssize_t i = 0; i < n; ++i)
    if (fits[i] && under[i] > 0) seen.at.push_back(i);
  for (auto& [body, evidence] : bodies_of(seen, grid, rules)) {
    for (const auto& region : others) body = without(body, region);
    if (body.size() < rules.blocks) continue;
    std::vector<Blocks> left;
    Blocks beside;
    for (const auto& region : own) {
      left.push_back(without(region, body));
      beside.insert(beside.end(), left.back().begin(), left.back().end());
    }
    // What surrounds a larger one is no body: its vectors are pulled along.
    if (beside.size() > body.size() && distance(x.data(), body, beside) < rules.reach) continue;
    own.clear();
    std::vector<double> of_left;
    for (std::size_t k = 0; k < left.size(); ++k)
      if (left[k].size() >= rules.blocks) {
        own.push_back(std::move(left[k]));
        of_left.push_back(evidence_of[k]);
      }
    own.push_back(body);
    of_left.push_back(evidence);
    evidence_of = std::move(of_left);
  }
  // Of strips alone, which are no blocks of the pair, nothing could be labelled.
  for (std::size_t k = own.size(); k-- > 0;)
    if (own[k].front() >= of_pair) {
      own.erase(own.begin() + static_cast<std::ptrdiff_t>(k));
      evidence_of.erase(evidence_of.begin() + static_cast<std::ptrdiff_t>(k));
    }
  others.erase(std::remove_if(others.begin(), others.end(),
                              [&](const Blocks& region) { return region.size() < rules.blocks; }),
               others.end());
  Out<double> evidence({static_cast<py::ssize_t>(others.size() + own.size())});
  std::copy(evidence_of.begin(), evidence_of.end(), evidence.data() + others.size());
  others.insert(others.end(), own.begin(), own.end());
  const double norm = std::sqrt(dot(ground, ground));
  for (double& depth : grid.depths) depth /= norm;
  return py::make_tuple(listed(others), evidence.array(), array_of(grid.depths),
                        array_of(grid.told, static_cast<py::ssize_t>(grid.columns())));
}

}  // namespace
}  // namespace kernels

void bind_body(kernels::py::module_& module) { module.def("with_bodies", kernels::with_bodies); }
