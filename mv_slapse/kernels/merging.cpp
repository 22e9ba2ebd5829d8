// A segment's evidence to one vector for each macroblock, [SLAPSE] V-A, and what it lets expect.

#include <optional>

#include "blocks.hpp"
#include "lanes.hpp"

namespace kernels {
namespace {

constexpr int DEPTH = 8;            // pieces of evidence looked at for each macroblock
constexpr float OWN_SHARE = 0.25f;  // of a macroblock, how far evidence inside one lies apart
constexpr float LEAST = 1e-9f;      // in place of a weight of zero as a divisor
constexpr double STANDING = 0.5;    // share of moved vectors below which the camera may stand
constexpr float SLOW = 2;           // px, motion of most below which a far point may have none
constexpr float TYPICAL_VOTES = 5;  // at which a vector is as good as the stream's sigma says
constexpr float VOTES_PER_HALF = 3; // votes that halve the standard deviation

struct Evidence {
  In<float> x, vector, variance;
  In<std::uint8_t> block;

  Evidence(const char* kernel, const py::tuple& columns)
      : x(kernel, "x", column(kernel, columns), {ANY, 2}, Check::finite),
        vector(kernel, "vector", columns[1], {x.size(), 2}, Check::finite),
        variance(kernel, "variance", columns[2], {x.size()}, Check::finite),
        block(kernel, "block", columns[3], {x.size(), 2}) {}

  static py::object column(const char* kernel, const py::tuple& columns) {
    require(columns.size() == 4, kernel, "evidence has four columns");
    return columns[0];
  }
  py::ssize_t size() const { return x.size(); }
  float area(py::ssize_t i) const { return float(block(i, 0)) * float(block(i, 1)); }
};

// How far vectors may differ [px] that a share of a macroblock sets apart.
struct Agreement {
  float slack, tolerance;
  float reach(Vec2 vector) const { return slack + tolerance * length(vector); }
};

struct Cluster {  // weighted mean of the evidence of a macroblock that agrees with its heaviest
  Vec2 x{}, vector{ABSENT, ABSENT};
  float variance = 0, mass = 0, company = 0;
  bool present() const { return mass > 0; }
};

struct Piece {  // of evidence in a macroblock; weight 0: taken by the cluster before
  Vec2 x, vector;
  float weight, variance;
};

// Makes a cluster of what is left of the evidence of a macroblock, and takes it out.
Cluster clustered(Piece* pieces, int n, Agreement within) {
  Cluster out;
  int lead = -1;
  float reach = 0;
  for (int i = 0; i < n; ++i) {
    if (!(pieces[i].weight > 0)) continue;
    const float own = n > 1 ? within.reach(pieces[i].vector) : 1;
    double mass = 0;
    int near = 0;
    for (int j = 0; j < n; ++j)
      if (square(pieces[i].vector - pieces[j].vector) < own * own) {
        mass += pieces[j].weight;
        ++near;
      }
    if (static_cast<float>(mass) > out.mass) {
      out.mass = static_cast<float>(mass);
      lead = i;
      reach = own;
    }
    if (near == n) break;  // none can be heavier
  }
  if (lead < 0) return out;
  const Vec2 leading = pieces[lead].vector;
  const float heaviest = std::max(pieces[lead].weight, LEAST);
  double sum[4] = {}, whole = 0, variance = 0;
  for (int j = 0; j < n; ++j) {
    Piece& piece = pieces[j];
    const double weight = piece.weight;
    if (!(weight > 0) || !(square(leading - piece.vector) < reach * reach)) continue;
    sum[0] += weight * piece.x.x;
    sum[1] += weight * piece.x.y;
    sum[2] += weight * piece.vector.x;
    sum[3] += weight * piece.vector.y;
    variance += weight * weight * piece.variance;
    whole += weight;
    piece.weight = 0;
  }
  const float divisor = std::max(static_cast<float>(whole), LEAST);
  out.x = {static_cast<float>(sum[0]) / divisor, static_cast<float>(sum[1]) / divisor};
  out.vector = {static_cast<float>(sum[2]) / divisor, static_cast<float>(sum[3]) / divisor};
  out.variance = static_cast<float>(variance) / (divisor * divisor);
  out.company = divisor / heaviest - 1;
  return out;
}

// Whether zero vectors are skipped macroblocks rather than measured motion: an encoder short of
// bits skips some, which side by side look like a still picture. Where the camera stands most
// vectors are zero, where it moves slowly all are short.
bool skips(const Evidence& e) {
  py::ssize_t moved = 0, fast = 0;
  for (py::ssize_t i = 0; i < e.size(); ++i) {
    const Vec2 vector = at(e.vector, i);
    moved += !is_zero(vector);
    fast += square(vector) > SLOW * SLOW;
  }
  return moved > STANDING * e.size() && 2 * fast > moved;
}

// Vectors of macroblocks, row by row, in columns that the compiler can take several of at a time.
struct Columns {
  std::vector<float> x, y;

  explicit Columns(int n) : x(n, ABSENT), y(n, ABSENT) {}
  void set(int i, Vec2 value) { x[i] = value.x, y[i] = value.y; }
};

// How many of the eight macroblocks around speak for the vectors of those from `first` to before
// `last`; each gives at most one vote, that of its vector which agrees best. What comes near grows
// from block to block: two on opposite sides then speak together for what lies half-way between.
KERNELS_WIDE void count(const Columns (&voter)[2], const Columns& centre, int columns, int first,
                        int last, Agreement beside, float* __restrict votes) {
  const float *__restrict x0 = voter[0].x.data(), *__restrict y0 = voter[0].y.data();
  const float *__restrict x1 = voter[1].x.data(), *__restrict y1 = voter[1].y.data();
  const float *__restrict cx = centre.x.data(), *__restrict cy = centre.y.data();
  for (int i = first; i < last; ++i) {
    const Vec2 own{cx[i], cy[i]};
    const float reach = beside.reach(own), scale = 1 / (reach * reach);
    // By value: with references GCC takes one macroblock at a time.
    const auto least = [](float a, float b) { return a < b ? a : b; };
    const auto most = [](float a, float b) { return a > b ? a : b; };
    const auto speaks = [&](int side) __attribute__((always_inline)) {
      const Vec2 a{x0[i + side], y0[i + side]}, b{x0[i - side], y0[i - side]};
      const Vec2 c{x1[i + side], y1[i + side]}, d{x1[i - side], y1[i - side]};
      const float near = least(square(a - own), square(c - own));
      const float opposite = least(square(b - own), square(d - own));
      const float apart = most(1 - near * scale, 0) + most(1 - opposite * scale, 0);
      const Vec2 half = 0.5f * (a + b);
      return most(apart, 2 - 2 * (square(half - own) * scale));  // `apart` is not negative
    };
    votes[i] = 0.0f + speaks(-columns - 1) + speaks(-columns) + speaks(-columns + 1) + speaks(-1);
  }
}

// The grid of macroblocks with a border in which there is nothing.
struct Grid {
  int columns, rows;
  std::vector<Cluster> cluster[2];
  Columns voter[2], centre[2];

  Grid(int width, int height)
      : columns(macroblocks(width) + 2), rows(macroblocks(height) + 2),
        voter{Columns(columns * rows), Columns(columns * rows)},
        centre{Columns(columns * rows), Columns(columns * rows)} {
    for (auto& clusters : cluster) clusters.resize(columns * rows);
  }
  int cell(Vec2 x) const {  // -1 outside the picture
    const int column = macroblock_of(x.x) + 1, row = macroblock_of(x.y) + 1;
    return column > 0 && column < columns - 1 && row > 0 && row < rows - 1 ? row * columns + column
                                                                           : -1;
  }
  void fill(const Evidence& e, float heavy, Agreement within) {
    std::vector<int> cells(e.size()), number(columns * rows, 0), first(columns * rows, 0);
    for (py::ssize_t i = 0; i < e.size(); ++i)
      if ((cells[i] = cell(at(e.x, i))) >= 0 && number[cells[i]]++ == DEPTH) {
        number[cells[i]] = DEPTH;
        cells[i] = -1;
      }
    for (int at = 1; at < columns * rows; ++at) first[at] = first[at - 1] + number[at - 1];
    std::vector<Piece> pieces(e.size());
    std::vector<int> next = first;
    for (py::ssize_t i = 0; i < e.size(); ++i) {
      if (cells[i] < 0) continue;
      const float area = e.area(i) / (MACROBLOCK * MACROBLOCK);
      pieces[next[cells[i]]++] = {at(e.x, i), at(e.vector, i),
                                  (e.variance[i] < 2 ? heavy : 1) * area, e.variance[i] / area};
    }
    const bool skip = skips(e);
    for (int cell = 0; cell < columns * rows; ++cell)
      for (int k = 0; k < std::min(number[cell], 2); ++k) {
        const Cluster& found = cluster[k][cell] =
            clustered(pieces.data() + first[cell], number[cell], within);
        if (!found.present()) break;
        centre[k].set(cell, found.vector);
        if (!(skip && is_zero(found.vector))) voter[k].set(cell, found.vector);
      }
  }
  // Votes of the eight macroblocks around for the first or the second cluster of each; any where
  // there is none.
  std::vector<float> votes(int k, Agreement beside) const {
    std::vector<float> out(columns * rows);
    count(voter, centre[k], columns, columns + 1, columns * (rows - 1) - 1, beside, out.data());
    return out;
  }
};

struct Prior {
  float votes, slack, tolerance;
  // How much a vector expected by the pairs before speaks for one, in votes.
  float support(Vec2 vector, Vec2 expected) const {
    const float reach = slack + tolerance * length(expected);
    return votes * std::max(1 - square(vector - expected) / (reach * reach), 0.0f);
  }
};

// Makes the variances of vectors more (or less) than Lemma 2 says of right ones. Measured
// against true epipolar lines (KITTI and a rendered garage, MPEG-2 and H.264), the standard
// deviation halves for each three macroblocks around that agree, and falls with the fourth root
// of the pieces of evidence that agree inside the macroblock, beyond what averaging explains.
KERNELS_WIDE void doubt(int n, const float* __restrict votes, const float* __restrict company,
                        float* __restrict variance) {
  for (int i = 0; i < n; ++i) {
    const float halvings = 2 * (TYPICAL_VOTES - votes[i]) / VOTES_PER_HALF;
    variance[i] *= static_cast<float>(power_of_two(halvings)) / std::sqrt(1 + company[i]);
  }
}

py::tuple merge(const py::tuple& columns, int width, int height, const py::object& expected,
                py::kwargs options) {
  const char* name = "merge";
  const Evidence e(name, columns);
  require(width > 0 && height > 0, name, "the picture has no size");
  const auto option = [&](const char* key) { return options[key].cast<double>(); };
  const auto number = [&](const char* key) { return static_cast<float>(option(key)); };
  const float slack = number("slack");
  const Agreement within{slack, static_cast<float>(OWN_SHARE * option("tolerance"))};
  const Agreement beside{slack, number("tolerance")};
  const Prior prior{number("prior_votes"), number("prior_slack"), number("prior_tolerance")};
  const float least = number("min_support");
  Grid grid(width, height);
  std::optional<In<float>> field;
  if (!expected.is_none())
    field.emplace(name, "field", expected,
                  std::initializer_list<py::ssize_t>{grid.rows - 2, grid.columns - 2, 2},
                  Check::finite);
  grid.fill(e, number("direct_weight"), within);
  const std::vector<float> heard[2] = {grid.votes(0, beside), grid.votes(1, beside)};
  struct Chosen {
    const Cluster* cluster;
    float votes;
    bool lone;
  };
  std::vector<Chosen> chosen;
  chosen.reserve(grid.columns * grid.rows);
  for (int row = 1; row < grid.rows - 1; ++row)
    for (int column = 1; column < grid.columns - 1; ++column) {
      const int cell = row * grid.columns + column;
      const Cluster* best = nullptr;
      float support = 0, votes = 0;
      for (int k = 0; k < 2; ++k) {
        const Cluster& own = grid.cluster[k][cell];
        if (!own.present()) continue;
        const float speak = heard[k][cell] + std::min(own.company, 1.0f);
        const int inside = (row - 1) * (grid.columns - 2) + column - 1;
        const float all = speak + (field ? prior.support(own.vector, at(*field, inside)) : 0.0f);
        if (!best || all > support) {
          best = &own;
          support = all;
          votes = speak;
        }
      }
      if (!best || (support < least && is_zero(best->vector))) continue;
      chosen.push_back({best, votes, support < least});
    }
  const auto n = static_cast<py::ssize_t>(chosen.size());
  Out<float> x({n, 2}), vector({n, 2}), variance({n});
  Out<bool> lone({n});
  std::vector<float> votes(n), company(n);
  for (py::ssize_t i = 0; i < n; ++i) {
    const Cluster& best = *chosen[i].cluster;
    x(i, 0) = best.x.x, x(i, 1) = best.x.y;
    vector(i, 0) = best.vector.x, vector(i, 1) = best.vector.y;
    variance[i] = best.variance;
    company[i] = best.company;
    votes[i] = chosen[i].votes;
    lone[i] = chosen[i].lone;
  }
  doubt(static_cast<int>(n), votes.data(), company.data(), variance.data());
  return py::make_tuple(x.array(), vector.array(), variance.array(), lone.array());
}

// Share of the vectors, by their areas, that the supported ones of a merged pair bear out; of the
// direct ones where there are any, else of the indirect ones; and whether there are direct ones.
py::tuple borne_out(const py::tuple& columns, const py::tuple& pair, int width, int height,
                    float slack, double tolerance) {
  const Evidence e("borne_out", columns);
  require(width > 0 && height > 0, "borne_out", "the picture has no size");
  const int columns_ = macroblocks(width), rows = macroblocks(height);
  const auto field = field_of("borne_out", pair, columns_, rows);
  const Agreement within{slack, static_cast<float>(OWN_SHARE * tolerance)};
  std::int64_t right = 0, all = 0, direct_right = 0, direct_all = 0;
  bool direct = false;
  for (py::ssize_t i = 0; i < e.size(); ++i) {
    const Vec2 vector = at(e.vector, i);
    const Vec2 merged = field[nearest_macroblock(at(e.x, i), columns_, rows)];
    const float reach = within.reach(vector);
    const int area = e.block(i, 0) * e.block(i, 1);
    const int agrees = square(vector - merged) < reach * reach ? area : 0;
    const bool is_direct = e.variance[i] < 2;
    all += area;
    right += agrees;
    direct_all += is_direct ? area : 0;
    direct_right += is_direct ? agrees : 0;
    direct |= is_direct;
  }
  if (direct) all = direct_all, right = direct_right;
  return py::make_tuple(static_cast<float>(right) / static_cast<float>(all), direct);
}

}  // namespace

}  // namespace kernels

void bind_merging(kernels::py::module_& module) {
  using namespace kernels;
  module.def("merge", merge);
  module.def("borne_out", borne_out);
}
