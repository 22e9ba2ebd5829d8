// What stood still a while ago, where it must be now, and what is farther than that; the labels of
// macroblocks. movers/reference_depth.py.

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
constexpr double INFINITE = std::numeric_limits<double>::infinity();
constexpr auto STEP = static_cast<py::ssize_t>(LANES);

// The lattice of macroblocks, those that the border cuts included.
struct Macroblocks {
  Macroblocks(std::int64_t width, std::int64_t height)
      : columns((width + SIZE - 1) / SIZE), rows((height + SIZE - 1) / SIZE) {}

  // The number of the one that holds a pixel, row by row, -1 outside of the picture.
  std::int64_t at(double x, double y) const {
    const double column = (x + 0.5) / SIZE, row = (y + 0.5) / SIZE;
    if (!(column >= 0 && column < columns && row >= 0 && row < rows)) return -1;
    return static_cast<std::int64_t>(row) * columns + static_cast<std::int64_t>(column);
  }

  std::int64_t size() const { return columns * rows; }

  // Calls `visit` with the macroblocks in the picture in and around one.
  template <typename Visit>
  void around(std::int64_t cell, Visit visit) const {
    const auto row = cell / columns, column = cell % columns;
    for (auto r = std::max<std::int64_t>(row - 1, 0); r <= std::min(row + 1, rows - 1); ++r)
      for (auto c = std::max<std::int64_t>(column - 1, 0); c <= std::min(column + 1, columns - 1);
           ++c)
        visit(r * columns + c);
  }

  static constexpr int SIZE = 16;  // px, geometry/blocks.py
  std::int64_t columns, rows;
};

// Writes the stamps of points from `oldest` on, and where they are, X' = R (shrink X) + t, three
// coordinates at a time.
KERNELS_WIDE
void carry(const In<std::int64_t>& stamps, const In<double>& points, std::int64_t oldest,
           const Mat3& R, const Vec3& t, double shrink, std::int64_t* to_stamps,
           double* to_points) {
  const Four x{R[0], R[3], R[6]}, y{R[1], R[4], R[7]}, z{R[2], R[5], R[8]}, way{t[0], t[1], t[2]};
  for (py::ssize_t i = 0; i < stamps.size(); ++i) {
    if (stamps[i] < oldest) continue;
    const double* X = points.data() + 3 * i;
    const Four moved = x * (shrink * X[0]) + y * (shrink * X[1]) + z * (shrink * X[2]) + way;
    std::memcpy(to_points, &moved, 3 * sizeof *to_points);
    to_points += 3;
    *to_stamps++ = stamps[i];
  }
}

// Points (N, 3) and their stamps (N,) in the camera of the next key frame, X' = R X / scale + t,
// without those that are too old by then.
py::tuple carry_points(const py::object& stamps_, const py::object& points_, std::int64_t stamp,
                       std::int64_t oldest, const py::object& R_, const py::object& t_,
                       double shrink) {
  constexpr auto kernel = "carry_points";
  const In<std::int64_t> stamps(kernel, "stamp", stamps_, {ANY});
  const In<double> points(kernel, "X", points_, {stamps.size(), 3});
  const Mat3 R = matrix(kernel, "R", R_);
  const Vec3 t = vector(kernel, "t", t_);
  py::ssize_t kept = 0;
  for (py::ssize_t i = 0; i < stamps.size(); ++i) kept += stamps[i] >= stamp - oldest;
  Out<std::int64_t> to_stamps({kept});
  Out<double> to_points({kept, 3});
  carry(stamps, points, stamp - oldest, R, t, shrink, to_stamps.data(), to_points.data());
  return py::make_tuple(to_stamps.array(), to_points.array());
}

// Points, then the new ones that a key frame shows by rays (N, 3) and inverse depths (N,), but those
// unsure by more than a share of it.
py::tuple note_points(const py::object& stamps_, const py::object& points_, std::int64_t stamp,
                      const py::object& rays_, const py::object& rho_, const py::object& sigma_,
                      double max_spread) {
  constexpr auto kernel = "note_points";
  const In<std::int64_t> stamps(kernel, "stamp", stamps_, {ANY});
  const In<double> points(kernel, "X", points_, {stamps.size(), 3});
  const In<double> rays(kernel, "rays", rays_, {ANY, 3}), rho(kernel, "rho", rho_, {rays.size()}),
      sigma(kernel, "sigma", sigma_, {rays.size()});
  std::vector<py::ssize_t> sure;
  for (py::ssize_t i = 0; i < rho.size(); ++i)
    if (sigma[i] < max_spread * rho[i]) sure.push_back(i);
  const auto before = stamps.size(), all = before + static_cast<py::ssize_t>(sure.size());
  Out<std::int64_t> to_stamps({all});
  Out<double> to_points({all, 3});
  std::copy_n(stamps.data(), before, to_stamps.data());
  std::copy_n(points.data(), 3 * before, to_points.data());
  for (py::ssize_t k = before; k < all; ++k) {
    const auto i = sure[k - before];
    to_stamps[k] = stamp;
    for (int a = 0; a < 3; ++a) to_points(k, a) = rays(i, a) / rho[i];
  }
  return py::make_tuple(to_stamps.array(), to_points.array());
}

struct DepartureRules {
  explicit DepartureRules(const py::object& o)
      : youngest(number(o, "youngest")), well_known(number(o, "well_known")),
        least_seen(number(o, "least_seen")), farther(number(o, "farther")),
        sigmas(number(o, "sigmas")), away(number(o, "away")), stood(number(o, "stood")),
        least_left(number(o, "least_left")), leaving(number(o, "leaving")),
        straying(number(o, "straying")), at_edges(number(o, "at_edges")) {}
  double youngest, well_known, least_seen, farther, sigmas, away, stood, least_left, leaving,
      straying, at_edges;
};

// The median of n numbers, of two the larger; mostly they are few.
double middle(double* from, std::int64_t n) {
  const double last = from[n - 1];
  if (n == 1) return last;
  const auto [low, high] = std::minmax(from[0], from[1]);
  if (n == 2) return high;
  if (n == 3) return std::max(low, std::min(high, last));
  std::nth_element(from, from + n / 2, from + n);
  return from[n / 2];
}

// What inverse depths were seen in macroblocks, and the least in and around them, a while ago.
struct Reference {
  // Depths `seen` in `cell`, both (n,).
  Reference(const Macroblocks& grid, const std::vector<int>& cell, const std::vector<double>& seen,
            double least_seen)
      : inside(grid.size(), UNKNOWN), least(grid.size(), UNKNOWN) {
    std::vector<std::int64_t> end(grid.size() + 1);
    for (const auto k : cell) ++end[k + 1];
    std::partial_sum(end.begin(), end.end(), end.begin());
    std::vector<double> sorted(seen.size());
    for (std::size_t i = 0; i < seen.size(); ++i) sorted[end[cell[i]]++] = seen[i];
    for (std::int64_t k = 0, begin = 0; k < grid.size(); begin = end[k++])
      if (end[k] > begin) {
        // Of all that lies in a macroblock now the median counts.
        inside[k] = middle(&sorted[begin], end[k] - begin);
      }
    surround(grid, least_seen);
  }
  std::vector<double> inside, least;

 private:
  // The least of nine macroblocks, where enough of them are known: along rows, then across them.
  void surround(const Macroblocks& grid, double least_seen) {
    const auto columns = grid.columns, wide = columns + 2;
    std::vector<double> line(wide, INFINITE), across((grid.rows + 2) * columns, INFINITE);
    std::vector<int> known(wide), seen((grid.rows + 2) * columns);
    for (std::int64_t r = 0; r < grid.rows; ++r) {
      for (std::int64_t c = 0; c < columns; ++c) {
        const double own = inside[r * columns + c];
        known[c + 1] = own == own;
        line[c + 1] = std::min(INFINITE, own);  // that where it is unknown, too
      }
      for (std::int64_t c = 0; c < columns; ++c) {
        const auto at = (r + 1) * columns + c;
        across[at] = std::min(std::min(line[c], line[c + 1]), line[c + 2]);
        seen[at] = known[c] + known[c + 1] + known[c + 2];
      }
    }
    for (std::int64_t k = 0; k < grid.size(); ++k)
      if (seen[k] + seen[k + columns] + seen[k + 2 * columns] >= least_seen)
        least[k] = std::min(std::min(across[k], across[k + columns]), across[k + 2 * columns]);
  }
};

KERNELS_WIDE
Reference reference(const Macroblocks& grid, const In<std::int64_t>& stamps,
                    const In<double>& points, const Mat3& K, std::int64_t stamp,
                    const DepartureRules& rules) {
  const auto is_old = [&](py::ssize_t i) {
    return static_cast<double>(stamp - stamps[i]) >= rules.youngest;
  };
  auto n = stamps.size();
  while (n && !is_old(n - 1)) --n;  // the last are the newest, mostly
  const Four none = {}, columns = none + static_cast<double>(grid.columns),
             rows = none + static_cast<double>(grid.rows);
  const int wide = static_cast<int>(grid.columns);
  std::vector<int> cells(n + 1);
  std::vector<double> depths(n + 1);
  std::size_t known = 0;
  for (py::ssize_t i = 0; i < n; i += STEP) {
    const double *a = points.data() + 3 * i, *b = points.data() + 3 * std::min(i + 1, n - 1),
                 *c = points.data() + 3 * std::min(i + 2, n - 1),
                 *d = points.data() + 3 * std::min(i + 3, n - 1);
    const Four3 X{{a[0], b[0], c[0], d[0]}, {a[1], b[1], c[1], d[1]}, {a[2], b[2], c[2], d[2]}};
    const auto many = std::min(n - i, STEP);
    const Four3 x = K * X;
    const Four u = (x.x / x.z + 0.5) / Macroblocks::SIZE, v = (x.y / x.z + 0.5) / Macroblocks::SIZE;
    const auto seen = (X.z > none) & (u >= none) & (u < columns) & (v >= none) & (v < rows);
    const Four column = seen ? u : none, row = seen ? v : none, depth = 1 / X.z;
    for (py::ssize_t k = 0; k < many; ++k) {
      cells[known] = static_cast<int>(row[k]) * wide + static_cast<int>(column[k]);
      depths[known] = depth[k];
      known += (seen[k] != 0) & is_old(i + k);
    }
  }
  cells.resize(known);
  depths.resize(known);
  return Reference(grid, cells, depths, rules.least_seen);
}

// How much rather blocks (N,) have left where they stood than not, log-likelihoods.
py::array_t<double> departures(const py::object& past, const py::object& depths,
                               const py::object& ground_, const py::object& K_, std::int64_t stamp,
                               std::int64_t width, std::int64_t height,
                               const py::object& constants) {
  constexpr auto kernel = "departures";
  const In<std::int64_t> stamps(kernel, "stamp", past.attr("stamp"), {ANY});
  const In<double> points(kernel, "X", past.attr("X"), {stamps.size(), 3});
  const In<double> x(kernel, "x", depths.attr("x"), {ANY, 2});
  const auto n = x.size();
  const In<double> rays(kernel, "rays", depths.attr("rays"), {n, 3}),
      rho(kernel, "rho", depths.attr("rho"), {n}),
      sigma(kernel, "sigma", depths.attr("sigma"), {n});
  const DepartureRules rules(constants);
  const Vec3 ground = vector(kernel, "ground", ground_);
  const Macroblocks grid(width, height);
  const auto seen =
      reference(grid, stamps, points, matrix(kernel, "K", K_), stamp, rules);
  std::vector<std::int64_t> cell(n);
  std::vector<double> inside(n, UNKNOWN), sure(n);
  std::vector<char> left(n), beside(n);  // beside: farther than all that was seen around, too
  for (py::ssize_t i = 0; i < n; ++i) {
    cell[i] = grid.at(x(i, 0), x(i, 1));
    if (cell[i] < 0 || !(sigma[i] < rules.well_known * rho[i])) continue;
    sure[i] = rules.farther + rules.sigmas * sigma[i] / rho[i];
    const double own = seen.inside[cell[i]], least = seen.least[cell[i]];
    // Near things outgrow what was seen of them: between its points the farthest around counts.
    const bool known = !std::isnan(own);
    if (!known && std::isnan(least)) continue;
    const double far = std::log((known ? own : least) / rho[i]);
    if (known) inside[i] = far;
    beside[i] = least / rho[i] > 1;
    const double under = -dot({rays(i, 0), rays(i, 1), rays(i, 2)}, ground);
    // No vehicle stood below the ground.
    left[i] = far > sure[i] && far < rules.away && rho[i] * std::exp(far) > rules.stood * under;
  }
  // What departs is a body: some of it lies well within, and much of it beside.
  const auto among = [&](const std::vector<char>& those, double enough) {
    std::vector<char> held(grid.size()), some(n);
    for (py::ssize_t i = 0; i < n; ++i)
      if (those[i]) held[cell[i]] = true;
    for (py::ssize_t i = 0; i < n; ++i) {
      if (!left[i]) continue;
      double count = 0;
      grid.around(cell[i], [&](std::int64_t k) { count += held[k]; });
      some[i] = count >= enough;
    }
    return some;
  };
  std::vector<char> within(n);
  for (py::ssize_t i = 0; i < n; ++i) within[i] = left[i] && beside[i];
  left = among(within, 1);
  left = among(left, rules.least_left);
  Out<double> likelihood({n});
  const double stays = std::log((1 - rules.leaving) / (1 - rules.straying)),
               well_within = std::log(rules.leaving / rules.straying),
               at_edges = std::log(rules.leaving / rules.at_edges);
  for (py::ssize_t i = 0; i < n; ++i) {
    if (left[i]) likelihood[i] = beside[i] ? well_within : at_edges;
    if (inside[i] < sure[i])
      likelihood[i] += stays * std::min(std::max((sure[i] - inside[i]) / (sure[i] - rules.farther),
                                                 0.0), 1.0);
  }
  return likelihood.array();
}

// Label and plane of each macroblock by the area of the partitions in it; -1 where none votes. Of
// equal votes the lower label, and the lower plane, wins.
py::tuple vote_macroblocks(const py::object& x_, const py::object& block_, const py::object& label_,
                           const py::object& plane_, std::int64_t width, std::int64_t height,
                           std::int64_t unknown) {
  constexpr auto kernel = "vote_macroblocks";
  constexpr int LABELS = 3;
  const In<float> x(kernel, "x", x_, {ANY, 2});
  const auto n = x.size();
  const In<std::uint8_t> block(kernel, "block", block_, {n, 2});
  const In<std::int8_t> label(kernel, "label", label_, {n});
  const In<std::int32_t> plane(kernel, "plane_id", plane_, {n});
  const Macroblocks grid(width, height);
  struct Vote {
    std::int64_t cell;
    std::int32_t plane;
    double area;
  };
  std::vector<double> votes(grid.size() * LABELS);
  std::vector<std::int64_t> cell(n, -1);
  const auto area = [&](py::ssize_t i) { return static_cast<double>(block(i, 0)) * block(i, 1); };
  for (py::ssize_t i = 0; i < n; ++i) {
    if (label[i] == unknown || label[i] < 0 || label[i] >= LABELS) continue;
    cell[i] = grid.at(x(i, 0), x(i, 1));
    if (cell[i] >= 0) votes[cell[i] * LABELS + label[i]] += area(i);
  }
  Out<std::int8_t> winner({grid.size()});
  Out<std::int32_t> plane_of({grid.size()});
  for (std::int64_t k = 0; k < grid.size(); ++k) {
    const auto own = votes.begin() + k * LABELS, best = std::max_element(own, own + LABELS);
    winner[k] = static_cast<std::int8_t>(*best > 0 ? best - own : -1);
    plane_of[k] = -1;
  }
  // Most macroblocks have votes for one plane alone; those of the others are sorted to be counted.
  std::vector<char> voted(grid.size()), several(grid.size());
  const auto won = [&](py::ssize_t i) { return cell[i] >= 0 && label[i] == winner[cell[i]]; };
  for (py::ssize_t i = 0; i < n; ++i) {
    if (!won(i)) continue;
    if (!voted[cell[i]]) plane_of[cell[i]] = plane[i];
    voted[cell[i]] = true;
    several[cell[i]] |= plane_of[cell[i]] != plane[i];
  }
  std::vector<Vote> split;
  for (py::ssize_t i = 0; i < n; ++i)
    if (won(i) && several[cell[i]]) split.push_back({cell[i], plane[i], area(i)});
  std::sort(split.begin(), split.end(), [](const Vote& a, const Vote& b) {
    return a.cell != b.cell ? a.cell < b.cell : a.plane < b.plane;
  });
  double most = 0;
  for (std::size_t i = 0, end; i < split.size(); i = end) {
    if (i == 0 || split[i - 1].cell != split[i].cell) most = 0;
    double sum = 0;
    for (end = i; end < split.size() && split[end].cell == split[i].cell &&
                  split[end].plane == split[i].plane;
         ++end)
      sum += split[end].area;
    if (sum > most) {
      most = sum;
      plane_of[split[i].cell] = split[i].plane;
    }
  }
  return py::make_tuple(winner.array(), plane_of.array());
}

}  // namespace
}  // namespace kernels

void bind_reference_depth(kernels::py::module_& module) {
  using namespace kernels;
  module.def("carry_points", carry_points);
  module.def("note_points", note_points);
  module.def("departures", departures);
  module.def("vote_macroblocks", vote_macroblocks);
}
