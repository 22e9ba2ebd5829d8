// Bodies that look farther than the ground they hide, found among blocks that singly tell nothing.
// movers/body.py.

#include <algorithm>
#include <cmath>
#include <cstdint>
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
        many(number(o, "many")), fine(number(o, "fine")) {}
  double depths, nearest, farthest, body, road, sharp, usual, most, agrees, least, faded, clear,
      many, fine;
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

// Sums over windows of cells for those of some depths that fit a window well.
class Windows {
 public:
  static constexpr int HALF = 2;  // cells to each side, 40 px in all, over which blocks tell

  Windows(const Seen& seen, std::int64_t width, std::int64_t height, const BodyRules& rules)
      : seen_(seen), rules_(rules), grid_(width, height), rows_(grid_.rows()),
        columns_(grid_.columns()), ground_(seen.at.size()) {
    grid_.paint([&](std::int64_t k, int a) { return seen.x[2 * seen.at[k] + a]; },
                [&](std::int64_t k, int a) { return seen.block[2 * seen.at[k] + a]; },
                numbers(seen.at.size()));
    double nearest = 0;
    const double uneven = unevenness(seen, rules);
    for (std::size_t k = 0; k < ground_.size(); ++k) {
      const auto i = seen.at[k];
      nearest = std::max(nearest, seen.under[i]);
      ground_[k] = square(std::max(seen.under[i] - seen.rho[i], 0.0)) /
                   (square(seen.sigma[i]) + square(uneven * seen.under[i]));
    }
    const double step = std::pow(rules.nearest / rules.farthest, 1 / (rules.depths - 1));
    double depth = rules.farthest * nearest;
    for (int k = 0; k < rules.depths; ++k, depth *= step) add(depth);
  }

  // The body of the best window of all; window and body are taken out. False: none is left.
  bool next(Blocks& body) {
    const auto best = std::max_element(
        layers_.begin(), layers_.end(),
        [](const Layer& a, const Layer& b) { return a.largest < b.largest; });
    if (best == layers_.end() || best->largest < rules_.least) return false;
    const auto middle = std::max_element(best->sums.begin(), best->sums.end()) - best->sums.begin();
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
    for (const auto k : largest) {
      body.push_back(seen_.at[grid_.owner(k)]);
      for (auto& layer : layers_)
        around(k, HALF, [&](std::int64_t at) { layer.sums[at] = 0; });
    }
    around(middle, HALF, [&](std::int64_t at) { best->sums[at] = 0; });
    for (auto& layer : layers_)
      layer.largest = *std::max_element(layer.sums.begin(), layer.sums.end());
    std::sort(body.begin(), body.end());
    body.erase(std::unique(body.begin(), body.end()), body.end());
    return true;
  }

 private:
  struct Layer {
    std::vector<double> gains, sums;  // of blocks, of windows around cells
    double largest;
  };

  static double square(double x) { return x * x; }

  static std::vector<std::int64_t> numbers(std::size_t n) {
    std::vector<std::int64_t> all(n);
    for (std::size_t k = 0; k < n; ++k) all[k] = static_cast<std::int64_t>(k);
    return all;
  }

  // How much rather a block shows an inverse depth than the ground, a log-likelihood.
  double gain(std::size_t k, double depth) const {
    const auto i = seen_.at[k];
    const double body = square(seen_.rho[i] - depth) /
                        (square(seen_.sigma[i]) + square(rules_.body * depth));
    if (!(body < square(rules_.agrees))) return 0;
    const double rather =
        std::min(std::max(0.5 * (ground_[k] - body), -rules_.most), rules_.most);
    // Above the row where body and ground are equally far something still may be there.
    return depth < seen_.under[i] ? rather : std::min(rather, 0.0);
  }

  // Adds the windows of a depth, where one of them can tell of a body.
  void add(double depth) {
    std::vector<double> gains(seen_.at.size());
    double all = 0;
    for (std::size_t k = 0; k < gains.size(); ++k) {
      gains[k] = gain(k, depth);
      all += std::max(gains[k], 0.0);
    }
    if (all < rules_.least) return;
    std::vector<double> steps(gains.size());
    for (std::size_t k = 0; k < gains.size(); ++k) {
      const double* size = seen_.block + 2 * seen_.at[k];
      const double cells =
          std::max(size[0] * size[1] / (BlockGrid::SIZE * BlockGrid::SIZE), 1.0);
      // In steps, so that sums are exact and equal windows are equal on every processor.
      steps[k] = std::nearbyint(rules_.fine * gains[k] / cells) / rules_.fine;
    }
    Layer layer{std::move(gains), std::vector<double>(grid_.size()), 0};
    std::vector<double> line(columns_ + 2 * HALF), across(columns_);
    for (std::int64_t row = 0; row < rows_; ++row) {
      bool some = false;
      for (std::int64_t k = 0; k < columns_; ++k) {
        const auto owner = grid_.owner(row * columns_ + k);
        line[k + HALF] = owner < 0 ? 0 : steps[owner];
        some |= owner >= 0;
      }
      if (!some) continue;
      for (std::int64_t k = 0; k < columns_; ++k)
        across[k] = line[k] + line[k + 1] + line[k + 2] + line[k + 3] + line[k + 4];
      for (auto r = std::max<std::int64_t>(row - HALF, 0); r <= std::min(row + HALF, rows_ - 1);
           ++r)
        for (std::int64_t k = 0; k < columns_; ++k) layer.sums[r * columns_ + k] += across[k];
    }
    layer.largest = *std::max_element(layer.sums.begin(), layer.sums.end());
    if (layer.largest >= rules_.least) layers_.push_back(std::move(layer));
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

  bool is_part(const Layer& layer, std::int64_t cell) const {
    const auto owner = grid_.owner(cell);
    return owner >= 0 && layer.gains[owner] > rules_.clear && layer.sums[cell] >= rules_.faded;
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
  std::vector<double> ground_;
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

py::tuple with_bodies(const py::object& field, const py::object& members_, const py::object& first_,
                      std::int64_t width, std::int64_t height, std::int64_t least, double reach,
                      const py::object& constants) {
  constexpr auto kernel = "with_bodies";
  const In<double> x(kernel, "x", field.attr("x"), {ANY, 2});
  const auto n = x.size();
  const In<double> block(kernel, "block", field.attr("block"), {n, 2}),
      rho(kernel, "rho", field.attr("rho"), {n}), sigma(kernel, "sigma", field.attr("sigma"), {n}),
      under(kernel, "under", field.attr("under"), {n});
  const In<bool> below(kernel, "below", field.attr("below"), {n}),
      fits(kernel, "fits", field.attr("fits"), {n});
  const In<std::int64_t> members(kernel, "members", members_, {ANY}),
      first(kernel, "first", first_, {ANY});
  check_first(kernel, first, members.size());
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
  for (const auto& body : bodies_of(seen, width, height, BodyRules(constants))) {
    if (static_cast<std::int64_t>(body.size()) < least) continue;
    std::vector<Blocks> left;
    Blocks beside;
    for (const auto& region : own) {
      left.push_back(without(region, body));
      beside.insert(beside.end(), left.back().begin(), left.back().end());
    }
    // What surrounds a larger one is no body: its vectors are pulled along.
    if (beside.size() > body.size() && distance(x.data(), body, beside) < reach) continue;
    own.clear();
    for (auto& region : left)
      if (static_cast<std::int64_t>(region.size()) >= least) own.push_back(std::move(region));
    own.push_back(body);
  }
  others.insert(others.end(), own.begin(), own.end());
  return listed(others);
}

}  // namespace
}  // namespace kernels

void bind_body(pybind11::module_& module) { module.def("with_bodies", kernels::with_bodies); }
