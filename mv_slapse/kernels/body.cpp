// Bodies that look farther than the ground they hide, found among blocks that singly tell nothing.
// movers/body.py.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "arrays.hpp"
#include "movers.hpp"

namespace kernels {
namespace {

using Blocks = std::vector<std::int64_t>;

struct BodyRules {
  explicit BodyRules(const py::object& o)
      : depths(number(o, "depths")), nearest(number(o, "nearest")), farthest(number(o, "farthest")),
        body(number(o, "body")), road(number(o, "road")), sharp(number(o, "sharp")),
        usual(number(o, "usual")), most(number(o, "most")), agrees(number(o, "agrees")),
        least(number(o, "least")), beside(number(o, "beside")), above(number(o, "above")),
        widest(number(o, "widest")), many(number(o, "many")), blocks(number(o, "blocks")),
        reach(number(o, "reach")) {}
  double depths, nearest, farthest, body, road, sharp, usual, most, agrees, least, beside, above,
      widest, many, blocks, reach;
};

// Blocks that move along their epipolar lines, below the horizon.
struct Seen {
  const double *x, *rho, *sigma, *under, *foreseen;
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
  Columns(const Seen& seen, std::int64_t width, const BodyRules& rules)
      : seen_(seen), rules_(rules), uneven_(unevenness(seen, rules)),
        columns_((width + BlockGrid::MACROBLOCK - 1) / BlockGrid::MACROBLOCK) {
    double nearest = 0;
    auto lowest = seen.at.front(), highest = lowest;
    ground_.resize(2 * (1 + *std::max_element(seen.at.begin(), seen.at.end())));
    for (const auto i : seen.at) {
      const double* foreseen = &seen.foreseen[2 * i];
      ground_[2 * i] = misfit(seen.rho[i], seen.sigma[i], seen.under[i], uneven_);
      ground_[2 * i + 1] = misfit(foreseen[0], foreseen[1], seen.under[i], uneven_);
      if (seen.under[i] > seen.under[lowest]) lowest = i;
      if (seen.under[i] < seen.under[highest]) highest = i;
      const auto column = static_cast<std::int64_t>(seen.x[2 * i] / BlockGrid::MACROBLOCK);
      columns_[std::min<std::int64_t>(std::max<std::int64_t>(column, 0), columns_.size() - 1)]
          .push_back(i);
      nearest = std::max(nearest, seen.under[i]);
    }
    for (auto& column : columns_)
      std::stable_sort(column.begin(), column.end(), [&](std::int64_t i, std::int64_t k) {
        return seen.x[2 * i + 1] < seen.x[2 * k + 1];
      });
    const double step = std::pow(rules.nearest / rules.farthest, 1 / (rules.depths - 1));
    double depth = rules.farthest * nearest;
    for (int k = 0; k < rules.depths; ++k, depth *= step) depths_.push_back(depth);
    told_.resize(depths_.size() * columns_.size());
    foot_.resize(told_.size());
    // Of the ground's inverse depth from row to row.
    slope_ = (seen.under[lowest] - seen.under[highest]) /
             std::max(seen.x[2 * lowest + 1] - seen.x[2 * highest + 1], 1.0);
    for (std::size_t c = 0; c < columns_.size(); ++c) tell(c);
  }

  // The blocks of the surest body, which is taken out; false: none is left.
  bool next(Blocks& body) {
    double best = 0, depth = 0;
    std::size_t first = 0, last = 0;
    const auto n = columns_.size();
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
          depth = depths_[k];
        }
      }
    if (best < rules_.least) return false;
    take(first, last, depth, body);
    return true;
  }

 private:
  // How much rather a block shows a depth than the ground, log-likelihood, by this pair and those
  // before: what goes away steadily is foreseen too far as well, a wrong vector is not foreseen.
  double gain(std::int64_t i, double depth) const {
    const double *ground = &ground_[2 * i], *foreseen = &seen_.foreseen[2 * i];
    return 0.5 * (ground[0] - misfit(seen_.rho[i], seen_.sigma[i], depth, rules_.body)) +
           0.5 * (ground[1] - misfit(foreseen[0], foreseen[1], depth, rules_.body));
  }

  // Squared error of an inverse depth where another is expected that a surface departs from by a
  // share; at most so much as a wrong vector's.
  double misfit(double rho, double sigma, double expected, double share) const {
    return std::min(square(rho - expected) / (square(sigma) + square(share * expected)),
                    2 * rules_.most);
  }

  // How far a body goes down and up in a column: sums of gains from where ground is as far, to
  // where they are greatest, and the blocks [first, last) until there.
  struct Extent {
    double told;
    std::size_t first, last;
  };

  Extent extent(std::size_t c, double depth) const {
    const auto& column = columns_[c];
    std::size_t crossing = 0;
    while (crossing < column.size() && seen_.under[column[crossing]] <= depth) ++crossing;
    Extent found{0, crossing, crossing};
    double sum = 0;
    for (auto k = crossing; k < column.size() && sum > found.told - rules_.most; ++k) {
      sum += gain(column[k], depth);
      if (sum > found.told) {
        found.told = sum;
        found.last = k + 1;
      }
    }
    double above = 0, first = 0;
    sum = 0;
    for (auto k = crossing; k-- > 0 && sum > above - rules_.most;) {
      sum += gain(column[k], depth);
      if (k + 2 >= crossing) first = sum;
      if (sum > above) {
        above = sum;
        found.first = k;
      }
    }
    // Where ground shows right above that row nothing stands.
    if (first < -rules_.beside) found = {0, crossing, crossing};
    return found;
  }

  void tell(std::size_t c) {
    for (std::size_t k = 0; k < depths_.size(); ++k) {
      const auto found = columns_[c].empty() ? Extent{0, 0, 0} : extent(c, depths_[k]);
      told_[k * columns_.size() + c] = found.told;
      foot_[k * columns_.size() + c] =
          found.told > 0 ? seen_.under[columns_[c][found.last - 1]] / slope_ : 0;
    }
  }

  // The blocks of a body in some columns, at the depth that they show; rows they cover are told of.
  void take(std::size_t first, std::size_t last, double depth, Blocks& body) {
    for (int round = 0; round < 2; ++round) {
      double weight = 0, mean = 0;
      body.clear();
      for (auto c = first; c <= last; ++c) {
        const auto rows = extent(c, depth);
        for (auto k = rows.first; k < rows.last; ++k) {
          const auto i = columns_[c][k];
          const double variance = square(seen_.sigma[i]) + square(rules_.body * depth);
          if (square(seen_.rho[i] - depth) > square(rules_.agrees) * variance ||
              seen_.under[i] < rules_.above * depth)
            continue;
          body.push_back(i);
          weight += 1 / variance;
          mean += seen_.rho[i] / variance;
        }
      }
      if (body.empty()) break;
      depth = mean / weight;
    }
    std::sort(body.begin(), body.end());
    for (auto c = first; c <= last; ++c) {
      const auto rows = extent(c, depth);
      auto& column = columns_[c];
      column.erase(column.begin() + rows.first, column.begin() + rows.last);
      column.erase(std::remove_if(column.begin(), column.end(), [&](std::int64_t i) {
                     return std::binary_search(body.begin(), body.end(), i);
                   }), column.end());
      tell(c);
      // What is left of a column told of tells no more than it did.
      for (std::size_t k = 0; k < depths_.size(); ++k)
        if (rows.last == rows.first) told_[k * columns_.size() + c] = 0;
    }
  }

  const Seen& seen_;
  const BodyRules& rules_;
  double uneven_, slope_ = 0;
  std::vector<double> ground_;  // misfit of each block on the ground: as shown, as foreseen
  std::vector<Blocks> columns_;  // from the top down
  std::vector<double> depths_, told_;
  std::vector<double> foot_;  // rows below the horizon
};

std::vector<Blocks> bodies_of(const Seen& seen, std::int64_t width, const BodyRules& rules) {
  std::vector<Blocks> found;
  if (seen.at.empty()) return found;
  Columns columns(seen, width, rules);
  Blocks body;
  while (static_cast<double>(found.size()) < rules.many && columns.next(body))
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

py::tuple with_bodies(const py::object& field, std::int64_t width, const py::object& constants) {
  constexpr auto kernel = "with_bodies";
  const In<double> x(kernel, "x", field.attr("x"), {ANY, 2});
  const auto n = x.size();
  const In<double> rho(kernel, "rho", field.attr("rho"), {n}), sigma(kernel, "noise", field.attr("noise"), {n}),
      foreseen(kernel, "foreseen", field.attr("foreseen"), {n, 2}),
      under(kernel, "under", field.attr("under"), {n});
  const In<bool> below(kernel, "below", field.attr("below"), {n}),
      fits(kernel, "fits", field.attr("fits"), {n});
  const In<std::int64_t> members(kernel, "members", field.attr("members"), {ANY}),
      first(kernel, "first", field.attr("first"), {ANY});
  check_first(kernel, first, members.size());
  const BodyRules rules(constants);
  std::vector<Blocks> others, own;
  for (py::ssize_t r = 0; r < first.size(); ++r) {
    const auto end = r + 1 < first.size() ? first[r + 1] : members.size();
    const Blocks region(members.data() + first[r], members.data() + end);
    double sunk = 0;
    for (const auto i : region) sunk += below[i];
    const bool looks_farther = sunk > 0.5 * static_cast<double>(region.size());
    (looks_farther ? own : others).push_back(region);
  }
  Seen seen{x.data(), rho.data(), sigma.data(), under.data(), foreseen.data(), {}};
  for (py::ssize_t i = 0; i < n; ++i)
    if (fits[i] && under[i] > 0) seen.at.push_back(i);
  for (const auto& body : bodies_of(seen, width, rules)) {
    if (body.size() < rules.blocks) continue;
    for (auto& region : others) region = without(region, body);
    std::vector<Blocks> left;
    Blocks beside;
    for (const auto& region : own) {
      left.push_back(without(region, body));
      beside.insert(beside.end(), left.back().begin(), left.back().end());
    }
    // What surrounds a larger one is no body: its vectors are pulled along.
    if (beside.size() > body.size() && distance(x.data(), body, beside) < rules.reach) continue;
    own.clear();
    for (auto& region : left)
      if (region.size() >= rules.blocks) own.push_back(std::move(region));
    own.push_back(body);
  }
  others.erase(std::remove_if(others.begin(), others.end(),
                              [&](const Blocks& region) { return region.size() < rules.blocks; }),
               others.end());
  others.insert(others.end(), own.begin(), own.end());
  return listed(others);
}

}  // namespace
}  // namespace kernels

void bind_body(kernels::py::module_& module) { module.def("with_bodies", kernels::with_bodies); }
