// Which blocks belong to what moves by itself: regions of blocks that move alike, their history,
// what they grow by. movers/regions.py and movers/identity.py.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "arrays.hpp"
#include "lanes.hpp"
#include "movers.hpp"
#include "small.hpp"

namespace kernels {
namespace {

constexpr double UNKNOWN = std::numeric_limits<double>::quiet_NaN();

struct Pair {
  std::int32_t a, b;
};

// Blocks sorted into squares of `reach`, so that neighbours lie in the same one or beside it.
class Squares {
 public:
  Squares(const In<double>& x, const std::vector<std::int32_t>& those, double reach)
      : square_(those.size()), sorted_(those.size()), of_sorted_(those.size()) {
    // What the lens moved out of the picture lies in the squares at its border, or around there.
    const auto index = [reach](double at) {
      return static_cast<std::int32_t>(std::min(2000.0, std::max(1.0, at / reach + 4)));
    };
    std::vector<std::int32_t> column(those.size());
    std::int32_t rows = 0;
    for (std::size_t k = 0; k < those.size(); ++k) {
      column[k] = index(x(those[k], 0));
      square_[k] = index(x(those[k], 1));
      columns_ = std::max(columns_, column[k] + 2);  // one more on each side
      rows = std::max(rows, square_[k] + 2);
    }
    first_.assign(columns_ * rows + 2, 0);  // at first those of the square two before
    for (std::size_t k = 0; k < those.size(); ++k) {
      square_[k] = square_[k] * columns_ + column[k];
      ++first_[square_[k] + 2];
    }
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    for (std::size_t k = 0; k < those.size(); ++k) {
      const auto at = first_[square_[k] + 1]++;
      sorted_[at] = those[k];
      of_sorted_[at] = square_[k];
    }
  }

  const std::vector<std::int32_t>& sorted() const { return sorted_; }

  // Calls `visit` with the place of a block among the sorted and with those of some in the squares
  // in and around its own, [from, to), so that it meets each pair of blocks once.
  template <typename Visit>
  void pairs(Visit visit) const {
    for (std::int32_t at = 0; at < static_cast<std::int32_t>(sorted_.size()); ++at) {
      const auto right = of_sorted_[at] + 1, below = of_sorted_[at] + columns_;
      visit(at, at + 1, first_[right + 1]);
      visit(at, first_[below - 1], first_[below + 2]);
    }
  }

 private:
  std::int32_t columns_ = 0;
  std::vector<std::int32_t> square_, first_, sorted_, of_sorted_;
};

struct RegionRules {
  explicit RegionRules(const py::object& o)
      : reach(number(o, "reach")), alike(number(o, "alike")), alike_share(number(o, "alike_share")),
        alike_grown(number(o, "alike_grown")), own_growth(number(o, "own_growth")),
        alike_short(number(o, "alike_short")),
        repeated(number(o, "repeated")), least(number(o, "least")),
        on_ground(number(o, "on_ground")), below_ground(number(o, "below_ground")),
        fits(number(o, "fits")),
        far(number(o, "far")), resting(number(o, "resting")), receding(number(o, "receding")),
        macroblock(number(o, "macroblock")) {}
  double reach, alike, alike_share, alike_grown, own_growth, alike_short, repeated, least,
      on_ground, below_ground, fits, far, resting, receding, macroblock;
};

// A key frame pair's blocks and its camera's motion.
struct Blocks {
  Blocks(const char* kernel, const py::object& o)
      : x(kernel, "x", o.attr("x"), {ANY, 2}), n(x.size()),
        x_prev(kernel, "x_prev", o.attr("x_prev"), {n, 2}),
        block(kernel, "block", o.attr("block"), {n, 2}),
        sigma(kernel, "sigma", o.attr("sigma"), {n}),
        departure(kernel, "departure", o.attr("departure"), {n}),
        plane(kernel, "plane_id", o.attr("plane_id"), {n}),
        wrong(kernel, "wrong", o.attr("wrong"), {n}) {}
  In<double> x;
  py::ssize_t n;
  In<double> x_prev, block, sigma, departure;
  In<std::int32_t> plane;
  In<bool> wrong;
};

// Columns of blocks that tell which of them cannot belong to an obstacle.
struct Field {
  explicit Field(py::ssize_t n)
      : parallax({n, 2}), rho({n}), noise({n}), under({n}), ground_like({n}), far({n}),
        copied({n}), below({n}), fits({n}), growth(n), length(n) {}
  Out<double> parallax, rho, noise, under;
  Out<bool> ground_like, far, copied, below, fits;
  std::vector<double> growth, length;
};

// Of four blocks from the i-th on, the last one of all again and again.
struct FourBlocks {
  FourBlocks(py::ssize_t i, py::ssize_t n) {
    for (std::size_t j = 0; j < LANES; ++j) at[j] = std::min<py::ssize_t>(i + j, n - 1);
  }
  KERNELS_INLINE Four operator()(const In<double>& of) const {
    return Four{of[at[0]], of[at[1]], of[at[2]], of[at[3]]};
  }
  KERNELS_INLINE Four operator()(const In<double>& of, int a) const {
    return Four{of(at[0], a), of(at[1], a), of(at[2], a), of(at[3], a)};
  }
  std::array<py::ssize_t, LANES> at;
};

// Judges the blocks singly: inverse depth along the epipolar line, whether it is the ground's.
KERNELS_WIDE
void judge_singly(const Blocks& blocks, const View& view, const Vec3& ground, double nearer,
                  const RegionRules& rules, Field& field) {
  const Mat3 K_inverse = view.inverse_K, R = view.R, R_back = transposed(R);
  const Vec3 t = view.t;
  const double focal[2] = {view.K[0], view.K[4]};
  const double shortest = view.drives() ? rules.far : rules.resting;
  const Four one = Four{} + 1;
  for (py::ssize_t i = 0; i < blocks.n; i += LANES) {
    const FourBlocks four(i, blocks.n);
    const Four sigma = four(blocks.sigma);
    const Four3 ray = K_inverse * Four3{four(blocks.x, 0), four(blocks.x, 1), one};
    const Four3 before = K_inverse * Four3{four(blocks.x_prev, 0), four(blocks.x_prev, 1), one};
    const Four3 turned = R * before;
    const Four y[2] = {turned.x / turned.z, turned.y / turned.z};
    const Four g[2] = {(t[0] - y[0] * t[2]) * focal[0], (t[1] - y[1] * t[2]) * focal[1]};
    const Four parallax[2] = {(ray.x - y[0]) * focal[0], (ray.y - y[1]) * focal[1]};
    const Four length = at_least(root(g[0] * g[0] + g[1] * g[1]), 1e-9);
    const Four rho = (parallax[0] * g[0] + parallax[1] * g[1]) / (length * length);
    const Four noise = magnitude(1 - rho * t[2]) / length * sigma;
    // The distance from the epipolar line, (5) of [MVO], in standard deviations.
    const Four3 line = R_back * cross(ray, t);
    const Four across = at_least(hypotenuse(line.x / focal[0], line.y / focal[1]), 1e-12);
    const Four error = magnitude(dot(before, line)) / sigma / across;
    const Four under = -dot(ray, ground), slack = 3 * noise + rules.on_ground * under;
    // The lower rows of a car that starts look as far as the road before it.
    const auto ground_like = (under > 0) & (error < 4) & (rho - under > -slack) &
                             (rho - nearer * under < slack) & (four(blocks.departure) <= 0);
    const Four moved = hypotenuse(parallax[0], parallax[1]);
    const auto far = (under <= 0) & (moved < shortest), fits = error < rules.fits,
               below = rho + 2 * noise < rules.below_ground * under;
    // What moves against the flow shows no depth.
    const Four nearing = at_least(-t[2] * at_least(rho, 0), -rules.receding);
    const Four growth = nearing / (1 + nearing);
    for (std::size_t j = 0; j < LANES; ++j) {
      const auto k = four.at[j];
      for (int a = 0; a < 2; ++a) field.parallax(k, a) = parallax[a][j];
      field.ground_like[k] = ground_like[j];
      field.length[k] = moved[j];
      field.far[k] = far[j];
      field.fits[k] = fits[j];
      field.below[k] = below[j];
      field.growth[k] = growth[j];
      field.rho[k] = rho[j];
      field.noise[k] = noise[j];
      field.under[k] = under[j];
    }
  }
}

// Marks the blocks whose vector nothing still explains and a neighbour repeats.
void mark_copied(const Blocks& blocks, const RegionRules& rules, Field& field) {
  std::vector<std::int32_t> wrong;
  for (py::ssize_t i = 0; i < blocks.n; ++i)
    if (blocks.wrong[i]) wrong.push_back(static_cast<std::int32_t>(i));
  const auto vector = [&](std::int32_t i, int a) { return blocks.x_prev(i, a) - blocks.x(i, a); };
  const Squares squares(blocks.x, wrong, rules.reach);
  squares.pairs([&](std::int32_t at, std::int32_t from, std::int32_t to) {
    const auto i = squares.sorted()[at];
    for (; from < to; ++from) {
      const auto k = squares.sorted()[from];
      bool same = true;
      for (int a = 0; a < 2; ++a)
        same &= std::abs(blocks.x(i, a) - blocks.x(k, a)) <= rules.reach &&
                std::abs(vector(i, a) - vector(k, a)) <= rules.repeated;
      if (same) field.copied[i] = field.copied[k] = true;
    }
  });
}

// A block that is not far, as its neighbours see it.
struct Neighbour {
  double x[2], parallax[2], length, growth;
  std::int32_t i, kind;  // its number, and what it has in common with those it may belong to
};

// Blocks beside each other by the squares they lie in. A car before a facade may move as it does
// for a while: what is a plane stays by itself. A car ahead may move as what is far behind it does;
// but that is not farther than the ground.
std::vector<Neighbour> neighbours(const Blocks& blocks, Field& field, const Squares& squares) {
  std::vector<Neighbour> out;
  out.reserve(squares.sorted().size());
  for (const auto i : squares.sorted())
    out.push_back({{blocks.x(i, 0), blocks.x(i, 1)},
                   {field.parallax(i, 0), field.parallax(i, 1)},
                   field.length[i],
                   field.growth[i],
                   i,
                   2 * blocks.plane[i] + field.below[i]});
  return out;
}

// Pairs of them that may belong together.
std::vector<Pair> near_pairs(const std::vector<Neighbour>& blocks, const Squares& squares,
                             double reach) {
  std::vector<Pair> pairs(4 * blocks.size());
  std::size_t found = 0;
  const double farthest = square(reach);
  squares.pairs([&](std::int32_t at, std::int32_t from, std::int32_t to) {
    if (found + (to - from) > pairs.size()) pairs.resize(2 * found + (to - from));
    const double x = blocks[at].x[0], y = blocks[at].x[1];
    const auto kind = blocks[at].kind;
    for (; from < to; ++from) {
      const Neighbour& other = blocks[from];
      // Each is written and only those near enough are kept: nothing to mispredict.
      pairs[found] = {at, from};
      found += (kind == other.kind) &
               (square(x - other.x[0]) + square(y - other.x[1]) <= farthest);
    }
  });
  pairs.resize(found);
  return pairs;
}

// Pairs of neighbours whose vectors are alike, as far as they grow with what comes near.
std::vector<Pair> alike(const Blocks& blocks, Field& field, bool drives,
                        const RegionRules& rules) {
  std::vector<std::int32_t> near;
  for (py::ssize_t i = 0; i < blocks.n; ++i)
    if (!field.far[i]) near.push_back(static_cast<std::int32_t>(i));
  const Squares squares(blocks.x, near, rules.reach);
  const auto beside = neighbours(blocks, field, squares);
  auto pairs = near_pairs(beside, squares, rules.reach);
  // Where all vectors are short a pixel would join the whole scene.
  const double slack =
      rules.alike * std::min(std::max(rules.alike_short * median(field.length), 0.5), 1.0);
  // How far vectors differ but for what grows with the distance of their blocks.
  const auto left_of = [](const Neighbour& a, const Neighbour& b, double share) {
    double sum = 0;
    for (int k = 0; k < 2; ++k)
      sum += square(a.parallax[k] - b.parallax[k] - share * (a.x[k] - b.x[k]));
    return std::sqrt(sum);
  };
  std::vector<Pair> unlike(pairs.size());
  std::size_t kept = 0, others = 0;
  for (const auto [k, l] : pairs) {
    const Neighbour &a = beside[k], &b = beside[l];
    const bool same =
        left_of(a, b, 0) < slack + rules.alike_share * std::max(a.length, b.length);
    pairs[kept] = unlike[others] = {k, l};
    kept += same;
    others += !same;
  }
  unlike.resize(others);
  for (const auto [k, l] : unlike) {
    const Neighbour &a = beside[k], &b = beside[l];
    double share = std::abs(a.growth) < std::abs(b.growth) ? a.growth : b.growth;
    if (!drives) {
      // What comes near a standing camera grows by itself: its vectors part as its blocks lie.
      double along = 0, apart = 1e-9;
      for (int axis = 0; axis < 2; ++axis) {
        const double off = a.x[axis] - b.x[axis];
        along += (a.parallax[axis] - b.parallax[axis]) * off;
        apart += square(off);
      }
      share = std::min(std::max(along / apart, 0.0), rules.own_growth);
    }
    if (left_of(a, b, share) < slack + rules.alike_grown * std::max(a.length, b.length))
      pairs[kept++] = {k, l};
  }
  pairs.resize(kept);
  // What has left where it stood is no part of what stands there, behind it or above it.
  std::vector<int> sign(beside.size()), left;
  for (std::size_t k = 0; k < beside.size(); ++k) {
    const double departure = blocks.departure[beside[k].i];
    sign[k] = (departure > 0) - (departure < 0);
  }
  left = sign;
  for (const auto& [a, b] : pairs) {
    left[a] += sign[b];
    left[b] += sign[a];
  }
  // Those of a pair belong together where both stay or both have left, and neither is the ground.
  std::vector<std::uint8_t> part(beside.size());
  for (std::size_t k = 0; k < beside.size(); ++k)
    part[k] = field.ground_like[beside[k].i] ? 0 : left[k] > 0 ? 2 : 1;
  kept = 0;
  for (const auto [a, b] : pairs) {
    const bool together = part[a] & part[b];
    pairs[kept] = {beside[a].i, beside[b].i};
    kept += together;
  }
  pairs.resize(kept);
  return pairs;
}

std::int32_t root(std::vector<std::int32_t>& parent, std::int32_t i) {
  while (parent[i] != i) i = parent[i] = parent[parent[i]];
  return i;
}

// Connected sets of blocks that do not move as the ground does, by rising first block; returns
// their blocks and their starts.
py::tuple connected(const Blocks& blocks, Field& field, const std::vector<Pair>& pairs,
                    const RegionRules& rules) {
  std::vector<std::int32_t> parent(blocks.n);
  std::vector<std::int64_t> size(blocks.n), at(blocks.n, -1), start;
  std::vector<double> area(blocks.n);
  std::iota(parent.begin(), parent.end(), 0);
  for (const auto& [a, b] : pairs) {
    if (parent[a] == parent[b]) continue;
    const auto one = root(parent, a), other = root(parent, b);
    parent[std::max(one, other)] = std::min(one, other);
  }
  // No parent comes after its children.
  for (auto& of : parent) of = parent[of];
  const auto counts = [&](py::ssize_t i) { return !field.ground_like[i] && !field.far[i]; };
  for (py::ssize_t i = 0; i < blocks.n; ++i)
    if (counts(i)) {
      const auto first = parent[i];
      size[first] += 1;
      area[first] += blocks.block(i, 0) * blocks.block(i, 1) / square(rules.macroblock);
    }
  std::int64_t total = 0;
  for (py::ssize_t i = 0; i < blocks.n; ++i)
    if (size[i] >= rules.least && area[i] >= rules.least - 0.5) {
      at[i] = total;
      start.push_back(total);
      total += size[i];
    }
  Out<std::int64_t> members({total}), first({static_cast<py::ssize_t>(start.size())});
  std::copy(start.begin(), start.end(), first.data());
  for (py::ssize_t i = 0; i < blocks.n; ++i)
    if (counts(i))
      if (auto& next = at[parent[i]]; next >= 0) members[next++] = i;
  return py::make_tuple(members.array(), first.array());
}

py::tuple moving_regions(const py::object& blocks_, const py::object& view_,
                         const py::object& ground, double nearer, const py::object& constants) {
  constexpr auto kernel = "moving_regions";
  const Blocks blocks(kernel, blocks_);
  const View view(kernel, view_);
  const RegionRules rules(constants);
  Field field(blocks.n);
  judge_singly(blocks, view, vector(kernel, "ground", ground), nearer, rules, field);
  mark_copied(blocks, rules, field);
  const auto pairs = alike(blocks, field, view.drives(), rules);
  const auto parts = connected(blocks, field, pairs, rules);
  return py::make_tuple(field.parallax.array(), field.rho.array(), field.noise.array(),
                        field.under.array(), field.ground_like.array(), field.far.array(),
                        field.copied.array(), field.below.array(), field.fits.array(), parts[0],
                        parts[1]);
}

// Log-likelihoods that regions have left where they stood. Where a mover was taken for something
// still the road is farther afterwards, too; but there nothing rises from it.
py::array_t<double> departed(const py::object& departure, const py::object& rho,
                             const py::object& under, const py::object& members_,
                             const py::object& first_, const py::object& constants) {
  constexpr auto kernel = "departed";
  const In<double> own(kernel, "departure", departure, {ANY}),
      depth(kernel, "rho", rho, {own.size()}),
      ground(kernel, "under", under, {own.size()});
  const In<std::int64_t> members(kernel, "members", members_, {ANY}),
      first(kernel, "first", first_, {ANY});
  check_first(kernel, first, members.size());
  const double on_ground = number(constants, "on_ground"), share = number(constants, "rising"),
               least = number(constants, "rising_blocks");
  Out<double> likelihood({first.size()});
  for (py::ssize_t r = 0; r < first.size(); ++r) {
    const auto end = r + 1 < first.size() ? first[r + 1] : members.size();
    double off_road = 0, left = 0;
    for (auto k = first[r]; k < end; ++k) {
      const auto i = members[k];
      likelihood[r] += own[i];
      left += own[i] > 0;
      off_road += own[i] > 0 && std::abs(depth[i] - ground[i]) > on_ground * ground[i];
    }
    if (off_road < std::max(share * left, least)) likelihood[r] = std::min(likelihood[r], 0.0);
  }
  return likelihood.array();
}

// A table (N, 2) whose entries can be written over.
struct Table {
  explicit Table(const In<double>& from) : values(from.data(), from.data() + 2 * from.size()) {}
  double& operator()(std::int64_t i, int a) { return values[2 * i + a]; }
  double operator()(std::int64_t i, int a) const { return values[2 * i + a]; }
  std::vector<double> values;
};

// Blocks of past pairs, movers/identity.py's Memory, as they are at a later key frame.
struct Remembered {
  Remembered(const char* kernel, const py::object& o, std::int64_t stamp, double width,
             double height, std::int64_t lifetime)
      : x(In<double>(kernel, "x", o.attr("x"), {ANY, 2})), n(x.values.size() / 2),
        velocity(kernel, "velocity", o.attr("velocity"), {n, 2}),
        block_(kernel, "block", o.attr("block"), {n, 2}), block(block_),
        score(kernel, "score", o.attr("score"), {n}), left(kernel, "left", o.attr("left"), {n}),
        id(kernel, "id", o.attr("id"), {n}), seen(kernel, "seen", o.attr("seen"), {n}) {
    if (o.attr("stamp").is_none()) return;
    const auto own = o.attr("stamp").cast<std::int64_t>();
    if (stamp < own) return;
    const double seconds = static_cast<double>(stamp - own) / 1e9;
    for (std::int64_t i = 0; i < n; ++i) {
      for (int a = 0; a < 2; ++a) x(i, a) += velocity(i, a) * seconds;
      if (stamp - seen[i] < lifetime && x(i, 0) >= -0.5 && x(i, 0) < width - 0.5 &&
          x(i, 1) >= -0.5 && x(i, 1) < height - 0.5)
        there.push_back(i);
    }
  }
  Table x;
  py::ssize_t n;
  In<double> velocity, block_;
  Table block;
  In<double> score, left;
  In<std::int64_t> id, seen;
  std::vector<std::int64_t> there;  // those that are known and in the picture
};

// What blocks were in the pair before: score, departure, mover; nan and -1 where that is unknown.
py::tuple inherited(const py::object& memory, std::int64_t stamp, std::int64_t width,
                    std::int64_t height, const py::object& x_prev, std::int64_t lifetime) {
  constexpr auto kernel = "inherited";
  const Remembered old(kernel, memory, stamp, width, height, lifetime);
  const In<double> from(kernel, "x_prev", x_prev, {ANY, 2});
  BlockGrid cells(width, height);
  cells.paint(old.x, old.block, old.there);
  Out<double> score({from.size()}), left({from.size()});
  Out<std::int64_t> id({from.size()});
  for (py::ssize_t i = 0; i < from.size(); ++i) {
    const auto source = cells(from(i, 0), from(i, 1));
    score[i] = source < 0 ? UNKNOWN : old.score[source];
    left[i] = source < 0 ? UNKNOWN : old.left[source];
    id[i] = source < 0 ? -1 : old.id[source];
  }
  return py::make_tuple(score.array(), left.array(), id.array());
}

// The columns of a Memory after a pair: blocks without a vector go on, those with one hide them.
py::tuple remembered(const py::object& memory, std::int64_t stamp, std::int64_t width,
                     std::int64_t height, const py::object& now_, double seconds, double fading,
                     std::int64_t lifetime) {
  constexpr auto kernel = "remembered";
  const Remembered old(kernel, memory, stamp, width, height, lifetime);
  const In<double> x(kernel, "x", now_.attr("x"), {ANY, 2});
  const auto n = x.size();
  const In<double> x_prev(kernel, "x_prev", now_.attr("x_prev"), {n, 2}),
      block(kernel, "block", now_.attr("block"), {n, 2}),
      score(kernel, "score", now_.attr("score"), {n}), left(kernel, "left", now_.attr("left"), {n});
  const In<std::int64_t> id(kernel, "id", now_.attr("id"), {n});
  BlockGrid cells(width, height);
  std::vector<std::int64_t> all(n), kept;
  std::iota(all.begin(), all.end(), 0);
  cells.paint(x, block, all);
  for (const auto i : old.there)
    if (cells(old.x(i, 0), old.x(i, 1)) < 0) kept.push_back(i);
  const auto before = static_cast<py::ssize_t>(kept.size()), total = before + n;
  Out<double> to_x({total, 2}), to_block({total, 2}), to_velocity({total, 2}), to_score({total}),
      to_left({total});
  Out<std::int64_t> to_id({total}), to_seen({total});
  for (py::ssize_t k = 0; k < total; ++k) {
    const bool was = k < before;
    const auto i = was ? kept[k] : k - before;
    for (int a = 0; a < 2; ++a) {
      to_x(k, a) = was ? old.x(i, a) : x(i, a);
      to_block(k, a) = was ? old.block(i, a) : block(i, a);
      to_velocity(k, a) = was ? old.velocity(i, a) : (x(i, a) - x_prev(i, a)) / seconds;
    }
    to_score[k] = was ? fading * old.score[i] : score[i];
    to_left[k] = was ? fading * old.left[i] : left[i];
    to_id[k] = was ? old.id[i] : id[i];
    to_seen[k] = was ? old.seen[i] : stamp;
  }
  return py::make_tuple(to_x.array(), to_block.array(), to_velocity.array(), to_score.array(),
                        to_left.array(), to_id.array(), to_seen.array());
}

// What a region of `of` blocks was, by the known values of some: the mean of their upper half, or of
// all where less than a `part` is above zero, for most of it stood still then. 0 where less than a
// third is known. Values change their order.
double value_before(std::vector<double>& known, std::size_t of, double part) {
  if (3 * known.size() < of) return 0;
  std::size_t above = 0;
  for (const double value : known) above += value > 0;
  const bool stood = static_cast<double>(above) < part * static_cast<double>(known.size());
  const std::size_t first = stood ? 0 : known.size() / 2;
  if (first) nth_smallest(known.data(), known.size(), first);
  std::sort(known.begin() + first, known.end());
  double sum = 0;
  for (auto i = first; i < known.size(); ++i) sum += known[i];
  return sum / static_cast<double>(known.size() - first);
}

// The value that most are, the lower one of two, and how often it occurs; they are sorted.
std::pair<std::int64_t, std::size_t> majority(std::vector<std::int64_t>& values) {
  std::sort(values.begin(), values.end());
  std::pair<std::int64_t, std::size_t> most{-1, 0};
  for (std::size_t i = 0, end; i < values.size(); i = end) {
    for (end = i; end < values.size() && values[end] == values[i];) ++end;
    if (end - i > most.second) most = {values[i], end - i};
  }
  return most;
}

struct HistoryRules {
  double fading, part, same_plane;
};

// Sums the scores of regions over pairs and tells whom each continues: total and departed score
// (R,), (R,), id of the mover or the stationary plane that it was (R,), whether that was called
// moving (R,), and the new scores of all blocks (N,), (N,). What is in no region this time is not
// forgotten at once.
py::tuple histories(const py::object& regions, const py::object& scores_, const py::object& leaves_,
                    const py::object& before, const py::object& plane_id, std::int64_t ground,
                    const py::object& constants) {
  constexpr auto kernel = "histories";
  const In<std::int64_t> members(kernel, "members", regions.attr("members"), {ANY}),
      first(kernel, "first", regions.attr("first"), {ANY});
  check_first(kernel, first, members.size());
  const In<bool> ground_like(kernel, "ground_like", regions.attr("ground_like"), {ANY});
  const auto n = ground_like.size(), R = first.size();
  const In<double> now(kernel, "scores", scores_, {R}), leaves(kernel, "leaves", leaves_, {R}),
      score(kernel, "score", before.attr("score"), {n}),
      left(kernel, "left", before.attr("left"), {n});
  const In<std::int64_t> id(kernel, "id", before.attr("id"), {n});
  const In<std::int32_t> plane(kernel, "plane_id", plane_id, {n});
  const HistoryRules rules{number(constants, "fading"), number(constants, "part"),
                           number(constants, "same_plane")};
  Out<double> total({R}), gone({R}), to_score({n}), to_left({n});
  Out<std::int64_t> known({R});
  Out<bool> moved({R});
  for (py::ssize_t i = 0; i < n; ++i) {
    to_score[i] = std::isnan(score[i]) || ground_like[i] ? 0 : rules.fading * score[i];
    to_left[i] = std::isnan(left[i]) ? 0 : rules.fading * left[i];
  }
  std::vector<double> scores, departures;
  std::vector<std::int64_t> ids, planes;
  for (py::ssize_t r = 0; r < R; ++r) {
    const auto end = r + 1 < R ? first[r + 1] : members.size();
    scores.clear(), departures.clear(), ids.clear(), planes.clear();
    for (auto k = first[r]; k < end; ++k) {
      const auto i = members[k];
      if (!std::isnan(score[i])) scores.push_back(score[i]);
      if (!std::isnan(left[i])) departures.push_back(left[i]);
      if (id[i] >= 0) ids.push_back(id[i]);
      planes.push_back(plane[i]);
    }
    const auto size = static_cast<std::size_t>(end - first[r]);
    total[r] = now[r] + rules.fading * value_before(scores, size, rules.part);
    gone[r] = std::max(leaves[r] + rules.fading * value_before(departures, size, rules.part), 0.0);
    known[r] = 3 * ids.size() >= size ? majority(ids).first : -1;
    moved[r] = known[r] >= 0;
    if (known[r] < 0) {
      // A parked car that starts keeps its plane's id.
      const auto [own, count] = majority(planes);
      if (own >= 0 && own != ground && static_cast<double>(count) >= rules.same_plane * size) {
        const auto all = std::count(plane.data(), plane.data() + n, own);
        if (static_cast<double>(count) >= rules.same_plane * all) known[r] = own;
      }
    }
    for (auto k = first[r]; k < end; ++k) {
      to_score[members[k]] = total[r];
      to_left[members[k]] = gone[r];
    }
  }
  return py::make_tuple(total.array(), gone.array(), known.array(), moved.array(),
                        to_score.array(), to_left.array());
}

struct GrowthRules {
  double alike, alike_share, alike_beside, inside, macroblock;
};

// Adds to each moving region the blocks in and around it that move with its plane, (11) of [MVO],
// and not with the ground. Returns the regions' blocks, one after the other, and their starts.
py::tuple grown(const py::object& blocks_, const py::object& regions, const py::object& moving_,
                const py::object& products_, const py::object& view_,
                const py::object& constants) {
  constexpr auto kernel = "grown";
  const Blocks blocks(kernel, blocks_);
  const In<double> parallax(kernel, "parallax", regions.attr("parallax"), {blocks.n, 2});
  const In<bool> ground_like(kernel, "ground_like", regions.attr("ground_like"), {blocks.n}),
      far(kernel, "far", regions.attr("far"), {blocks.n});
  const In<std::int64_t> members(kernel, "members", regions.attr("members"), {ANY}),
      first(kernel, "first", regions.attr("first"), {ANY}),
      moving(kernel, "moving", moving_, {ANY});
  check_first(kernel, first, members.size());
  const In<double> products(kernel, "products", products_, {moving.size(), 3, 3});
  const View view(kernel, view_);
  const GrowthRules rules{number(constants, "alike"), number(constants, "alike_share"),
                          number(constants, "alike_beside"), number(constants, "inside"),
                          number(constants, "macroblock")};
  std::vector<char> free(blocks.n);
  std::vector<std::vector<std::int64_t>> result;
  const auto end_of = [&](std::int64_t r) {
    return r + 1 < first.size() ? first[r + 1] : members.size();
  };
  for (py::ssize_t i = 0; i < blocks.n; ++i) free[i] = !ground_like[i];
  for (py::ssize_t m = 0; m < moving.size(); ++m) {
    require(moving[m] >= 0 && moving[m] < first.size(), kernel, "moving must number regions");
    for (auto k = first[moving[m]]; k < end_of(moving[m]); ++k) free[members[k]] = false;
  }
  for (py::ssize_t m = 0; m < moving.size(); ++m) {
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    result.emplace_back();
    for (auto k = first[moving[m]]; k < end_of(moving[m]); ++k) {
      result.back().push_back(members[k]);
      for (int a = 0; a < 2; ++a) {
        low[a] = std::min(low[a], blocks.x(members[k], a));
        high[a] = std::max(high[a], blocks.x(members[k], a));
      }
    }
    Mat3 motion = IDENTITY;
    for (int i = 0; i < 9; ++i) motion[i] += products.data()[9 * m + i];
    const Mat3 H = view.K * (transposed(view.R) * (motion * view.inverse_K));
    // Of a car ahead the part near the horizon is never clearly farther than the ground.
    const double beyond = rules.macroblock, top = low[1] - beyond -
                                                  0.5 * (high[1] - low[1] + 2 * beyond);
    for (py::ssize_t i = 0; i < blocks.n; ++i) {
      const double at[2] = {blocks.x(i, 0), blocks.x(i, 1)};
      if (!free[i] || at[0] < low[0] - beyond || at[0] > high[0] + beyond || at[1] < top ||
          at[1] > high[1] + beyond)
        continue;
      const bool within =
          at[0] >= low[0] && at[0] <= high[0] && at[1] >= low[1] && at[1] <= high[1];
      const Vec3 p = H * Vec3{at[0], at[1], 1};
      const double error = std::hypot(p[0] / p[2] - blocks.x_prev(i, 0),
                                      p[1] / p[2] - blocks.x_prev(i, 1));
      const double length = std::hypot(parallax(i, 0), parallax(i, 1));
      // What a vehicle encloses is part of it, also where its vector is wrong or another face's.
      // Beside it a pixel would join all that hardly moves.
      const double pixel =
          within ? rules.alike : std::min(std::max(rules.alike_beside * length, 0.5), rules.alike);
      const double slack = (within ? rules.inside : 1.0) * (pixel + rules.alike_share * length);
      // What is far behind a car ahead moves as it does, too.
      if ((error < slack && (within || !far[i])) || (within && blocks.wrong[i])) {
        free[i] = false;
        result.back().push_back(i);
      }
    }
  }
  return listed(result);
}

}  // namespace
}  // namespace kernels

void bind_movers(kernels::py::module_& module) {
  using namespace kernels;
  module.def("moving_regions", moving_regions);
  module.def("departed", departed);
  module.def("inherited", inherited);
  module.def("remembered", remembered);
  module.def("histories", histories);
  module.def("grown", grown);
}
