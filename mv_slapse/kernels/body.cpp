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
        least(number(o, "least")), faded(number(o, "faded")), clear(number(o, "clear")),
        many(number(o, "many")), fine(number(o, "fine")), blocks(number(o, "blocks")),
        reach(number(o, "reach")) {}
  double depths, nearest, farthest, body, road, sharp, usual, most, agrees, least, faded, clear,
      many, fine, blocks, reach;
};

// Blocks that move along their epipolar lines, below the horizon.
struct Seen {
  const double *x, *block, *rho, *sigma, *under;
  Blocks at;  // those that may be of a body
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

// Sums over windows of cells for those of some depths that fit a window well. Log-likelihoods are
// summed in whole steps, so that sums are exact and equal windows are equal on every processor.
class Windows {
 public:
  static constexpr int HALF = 2;  // cells to each side, 40 px in all, over which blocks tell

  Windows(const Seen& seen, std::int64_t width, std::int64_t height, const BodyRules& rules)
      : seen_(seen), rules_(rules), grid_(width, height), rows_(grid_.rows()),
        columns_(grid_.columns()), n_(seen.at.size()), single_(n_), gains_(n_), steps_(n_ + 1) {
    std::vector<std::int64_t> all(n_);
    std::iota(all.begin(), all.end(), 0);
    grid_.paint([&](std::int64_t k, int a) { return seen.x[2 * seen.at[k] + a]; },
                [&](std::int64_t k, int a) { return seen.block[2 * seen.at[k] + a]; }, all);
    double nearest = 0;
    const double uneven = unevenness(seen, rules);
    for (std::size_t k = 0; k < n_; ++k) {
      const auto i = seen.at[k];
      const double rho = seen.rho[i], under = seen.under[i], variance = square(seen.sigma[i]);
      nearest = std::max(nearest, under);
      const double* size = seen.block + 2 * i;
      single_.rho[k] = rho;
      single_.variance[k] = variance;
      single_.under[k] = under;
      single_.ground[k] =
          square(std::max(under - rho, 0.0)) / (variance + square(uneven * under));
      single_.cells[k] = std::max(size[0] * size[1] / (BlockGrid::SIZE * BlockGrid::SIZE), 1.0);
    }
    owners_.assign(grid_.size(), static_cast<std::int32_t>(n_));
    for (std::int64_t cell = 0; cell < grid_.size(); ++cell) {
      if (grid_.owner(cell) < 0) continue;
      owners_[cell] = static_cast<std::int32_t>(grid_.owner(cell));
      first_ = std::min(first_, cell / columns_);
      last_ = cell / columns_;
    }
    across_.assign((rows_ + 2 * HALF) * columns_, 0);
    line_.assign(columns_ + 2 * HALF, 0);
    const double step = std::pow(rules.nearest / rules.farthest, 1 / (rules.depths - 1));
    double depth = rules.farthest * nearest;
    layers_.reserve(static_cast<std::size_t>(rules.depths));
    for (int k = 0; k < rules.depths && last_ >= 0; ++k, depth *= step) add(depth);
  }

  // The body of the best window of all; window and body are taken out. False: none is left.
  bool next(Blocks& body) {
    const auto best = std::max_element(
        layers_.begin(), layers_.end(),
        [](const Layer& a, const Layer& b) { return a.largest < b.largest; });
    if (best == layers_.end() || !reaches(best->largest, rules_.least)) return false;
    const auto middle =
        std::find(best->sums.begin(), best->sums.end(), best->largest) - best->sums.begin();
    std::vector<std::int64_t> largest, part;
    std::vector<char> met(grid_.size());
    std::size_t most = 0;
    // Of the parts that hang together the one counts that covers most of the window.
    around(middle, HALF, [&](std::int64_t seed) {
      if (!is_part(*best, seed) || met[seed]) return;
      part = flooded(*best, seed, met);
      std::size_t inside = 0;
      for (const auto k : part)
        inside += std::abs(k / columns_ - middle / columns_) <= HALF &&
                  std::abs(k % columns_ - middle % columns_) <= HALF;
      if (inside > most) {
        most = inside;
        largest = part;
      }
    });
    body.clear();
    for (const auto k : largest) body.push_back(seen_.at[grid_.owner(k)]);
    around(middle, HALF, [&](std::int64_t at) { best->sums[at] = 0; });
    const auto touched = surroundings(largest);
    for (auto& layer : layers_) {
      bool gone = &layer == &*best;
      for (const auto at : touched) {
        gone |= layer.sums[at] == layer.largest;
        layer.sums[at] = 0;
      }
      if (!gone) continue;
      layer.largest = 0;
      for (const auto sum : layer.sums) layer.largest = layer.largest < sum ? sum : layer.largest;
    }
    std::sort(body.begin(), body.end());
    body.erase(std::unique(body.begin(), body.end()), body.end());
    return true;
  }

 private:
  // What single blocks tell at any depth; `cells` is how many they cover.
  struct Single {
    explicit Single(std::size_t n) : rho(n), variance(n), under(n), ground(n), cells(n) {}
    std::vector<double> rho, variance, under, ground, cells;
  };

  struct Layer {
    std::vector<char> clear;         // blocks that are of the body, if there is one
    std::vector<std::int32_t> sums;  // of windows around cells, in steps
    std::int32_t largest;
  };

  static double square(double x) { return x * x; }

  // The nearest whole number, the even one of two, as std::nearbyint for less than 2^51.
  static double rounded(double x) {
    constexpr double SHIFT = 6755399441055744.0;  // 1.5 * 2^52: there doubles are whole numbers
    return (x + SHIFT) - SHIFT;
  }

  bool reaches(std::int32_t sum, double likelihood) const {
    return sum >= rules_.fine * likelihood;
  }

  // How much rather blocks show an inverse depth than the ground, log-likelihoods.
  void gains_at(double depth) {
    const double shape = square(rules_.body * depth), agrees = square(rules_.agrees),
                 most = rules_.most, least = -rules_.most;
    const double *rho = single_.rho.data(), *variance = single_.variance.data(),
                 *under = single_.under.data(), *ground = single_.ground.data();
    double* gains = gains_.data();
    for (std::size_t k = 0; k < n_; ++k) {
      const double off = rho[k] - depth, body = off * off / (variance[k] + shape);
      double rather = 0.5 * (ground[k] - body);
      rather = rather < least ? least : rather;
      // Above the row where body and ground are equally far something still may be there.
      const double limit = depth < under[k] ? most : 0;
      rather = limit < rather ? limit : rather;
      gains[k] = body < agrees ? rather : 0;
    }
  }

  // Adds the windows of a depth, where one of them can tell of a body.
  void add(double depth) {
    gains_at(depth);
    double all = 0;
    for (const double gain : gains_) all += std::max(gain, 0.0);
    if (all < rules_.least) return;
    for (std::size_t k = 0; k < n_; ++k)
      steps_[k] = static_cast<std::int32_t>(
          rounded(rules_.fine * gains_[k] / single_.cells[k]));
    // Rows of sums begin HALF rows above the picture.
    for (auto row = first_; row <= last_; ++row) {
      const std::int32_t* owners = &owners_[row * columns_];
      std::int32_t *line = line_.data(), *across = &across_[(row + HALF) * columns_];
      for (std::int64_t k = 0; k < columns_; ++k) line[k + HALF] = steps_[owners[k]];
      for (std::int64_t k = 0; k < columns_; ++k)
        across[k] = line[k] + line[k + 1] + line[k + 2] + line[k + 3] + line[k + 4];
    }
    const auto top = std::max<std::int64_t>(first_ - HALF, 0),
               bottom = std::min(last_ + HALF, rows_ - 1);
    down_.resize((bottom - top + 1) * columns_);
    std::int32_t largest = 0;
    for (auto row = top; row <= bottom; ++row) {
      const std::int32_t* from = &across_[row * columns_];
      std::int32_t* to = &down_[(row - top) * columns_];
      for (std::int64_t k = 0; k < columns_; ++k) {
        to[k] = from[k] + from[k + columns_] + from[k + 2 * columns_] + from[k + 3 * columns_] +
                from[k + 4 * columns_];
        largest = largest < to[k] ? to[k] : largest;
      }
    }
    if (!reaches(largest, rules_.least)) return;
    Layer layer{std::vector<char>(n_), std::vector<std::int32_t>(grid_.size()), largest};
    for (std::size_t k = 0; k < n_; ++k) layer.clear[k] = gains_[k] > rules_.clear;
    std::copy(down_.begin(), down_.end(), layer.sums.begin() + top * columns_);
    layers_.push_back(std::move(layer));
  }

  template <typename Visit>
  void around(std::int64_t cell, std::int64_t reach, Visit visit) const {
    const auto row = cell / columns_, column = cell % columns_;
    for (auto r = std::max<std::int64_t>(row - reach, 0); r <= std::min(row + reach, rows_ - 1);
         ++r)
      for (auto c = std::max<std::int64_t>(column - reach, 0);
           c <= std::min(column + reach, columns_ - 1); ++c)
        visit(r * columns_ + c);
  }

  // The cells of all windows that hold one of some cells.
  std::vector<std::int64_t> surroundings(const std::vector<std::int64_t>& cells) const {
    std::vector<char> met(grid_.size());
    std::vector<std::int64_t> result;
    for (const auto cell : cells)
      around(cell, HALF, [&](std::int64_t at) {
        if (!met[at]) result.push_back(at);
        met[at] = true;
      });
    return result;
  }

  bool is_part(const Layer& layer, std::int64_t cell) const {
    const auto owner = grid_.owner(cell);
    return owner >= 0 && layer.clear[owner] && reaches(layer.sums[cell], rules_.faded);
  }

  std::vector<std::int64_t> flooded(const Layer& layer, std::int64_t seed,
                                    std::vector<char>& met) const {
    std::vector<std::int64_t> part{seed};
    met[seed] = true;
    for (std::size_t i = 0; i < part.size(); ++i)
      around(part[i], 1, [&](std::int64_t k) {
        if (met[k] || !is_part(layer, k)) return;
        met[k] = true;
        part.push_back(k);
      });
    return part;
  }

  const Seen& seen_;
  const BodyRules& rules_;
  BlockGrid grid_;
  std::int64_t rows_, columns_;
  std::size_t n_;
  Single single_;
  std::vector<double> gains_;
  std::vector<std::int32_t> steps_;  // gains of a cell, 0 of none behind the last
  std::vector<std::int32_t> owners_, line_, across_, down_;
  std::int64_t first_ = std::numeric_limits<std::int64_t>::max(), last_ = -1;  // rows with blocks
  std::vector<Layer> layers_;
};

std::vector<Blocks> bodies_of(const Seen& seen, std::int64_t width, std::int64_t height,
                              const BodyRules& rules) {
  std::vector<Blocks> found;
  if (seen.at.empty()) return found;
  Windows windows(seen, width, height, rules);
  Blocks body;
  while (static_cast<double>(found.size()) < rules.many && windows.next(body))
    if (!body.empty()) found.push_back(body);
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

py::tuple with_bodies(const py::object& field, std::int64_t width, std::int64_t height,
                      const py::object& constants) {
  constexpr auto kernel = "with_bodies";
  const In<double> x(kernel, "x", field.attr("x"), {ANY, 2});
  const auto n = x.size();
  const In<double> block(kernel, "block", field.attr("block"), {n, 2}),
      rho(kernel, "rho", field.attr("rho"), {n}), sigma(kernel, "noise", field.attr("noise"), {n}),
      under(kernel, "under", field.attr("under"), {n});
  const In<bool> below(kernel, "below", field.attr("below"), {n}),
      fits(kernel, "fits", field.attr("fits"), {n});
  const In<std::int64_t> members(kernel, "members", field.attr("members"), {ANY}),
      first(kernel, "first", field.attr("first"), {ANY});
  check_first(kernel, first, members.size());
  const BodyRules rules(constants);
  std::vector<Blocks> others, own;
  std::vector<char> free(n);
  for (py::ssize_t i = 0; i < n; ++i) free[i] = fits[i] && under[i] > 0;
  for (py::ssize_t r = 0; r < first.size(); ++r) {
    const auto end = r + 1 < first.size() ? first[r + 1] : members.size();
    const Blocks region(members.data() + first[r], members.data() + end);
    double sunk = 0;
    for (const auto i : region) sunk += below[i];
    const bool looks_farther = sunk > 0.5 * static_cast<double>(region.size());
    (looks_farther ? own : others).push_back(region);
    if (!looks_farther)
      for (const auto i : region) free[i] = false;
  }
  Seen seen{x.data(), block.data(), rho.data(), sigma.data(), under.data(), {}};
  for (py::ssize_t i = 0; i < n; ++i)
    if (free[i]) seen.at.push_back(i);
  for (const auto& body : bodies_of(seen, width, height, rules)) {
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
    for (auto& region : left)
      if (region.size() >= rules.blocks) own.push_back(std::move(region));
    own.push_back(body);
  }
  others.insert(others.end(), own.begin(), own.end());
  return listed(others);
}

}  // namespace
}  // namespace kernels

void bind_body(kernels::py::module_& module) { module.def("with_bodies", kernels::with_bodies); }
