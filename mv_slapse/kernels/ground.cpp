// The ground of a pair: its height by the blocks on the camera's way, and its plane. The reasons
// for the rules stand in surfaces/ground.py and surfaces/height.py.

#include <algorithm>
#include <cmath>
#include <numeric>

#include "depths.hpp"
#include "lattice.hpp"

namespace kernels {
namespace {

constexpr double PI = 3.14159265358979323846;

// Rays, inverse depths, their standard deviations and pixels of N blocks.
struct Depths {
  In<double> ray, rho, sigma, x;

  Depths(const char* name, const py::object& rays, const py::object& rhos,
         const py::object& sigmas, const py::object& pixels)
      : ray(name, "rays", rays, {ANY, 3}, Check::finite),
        rho(name, "rho", rhos, {ray.size()}, Check::finite),
        sigma(name, "sigma", sigmas, {ray.size()}, Check::finite),
        x(name, "x", pixels, {ray.size(), 2}, Check::finite) {}
  int size() const { return static_cast<int>(ray.size()); }
  double along(int i, const Vec3& v) const {
    return ray(i, 0) * v[0] + ray(i, 1) * v[1] + ray(i, 2) * v[2];
  }
};

// The corridor before the camera: what rays fall on the way of one unit, and which meet the road.
struct Corridor {
  Vec3 normal, across;
  double wide, least;

  Corridor(const Vec3& up, const Vec3& course, const py::dict& is)
      : normal(up), across(cross(up, course)), wide(policy(is, "corridor")),
        least(policy(is, "min_drop")) {
    across = (1 / norm(across)) * across;
  }
  double drop(const Depths& depths, int i) const { return -depths.along(i, normal); }
  bool holds(const Depths& depths, int i, double falls) const {
    return falls > least && std::abs(depths.along(i, across)) < wide * falls;
  }
};

// Marks the blocks that rise from the road: with the one above or below them they are likelier
// upright, of one depth, than level.
void mark_bodies(const Depths& depths, const std::vector<double>& drop,
                 const std::vector<int>& known, const py::dict& is, std::vector<char>& body) {
  const double size = policy(is, "macroblock"), beside = policy(is, "beside") * size,
               low = policy(is, "above_least") * size, high = policy(is, "above_most") * size,
               relief = policy(is, "body_relief"), stray = policy(is, "stray"),
               sure = policy(is, "upright_sure");
  const int n = static_cast<int>(known.size());
  std::vector<double> pixels(2 * known.size()), x(n), y(n);
  for (int k = 0; k < n; ++k)
    for (int j = 0; j < 2; ++j) pixels[2 * k + j] = depths.x(known[k], j);
  const Cells cells(pixels.data(), n);
  const int reach = static_cast<int>(std::ceil(high / size)),
            wide = static_cast<int>(std::ceil(beside / size));
  std::vector<int> begin(static_cast<std::size_t>(cells.columns) * cells.rows + 1), member(n);
  for (int k = 0; k < n; ++k) ++begin[cells.at(k) + 1];
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  std::vector<int> next(begin);
  for (int k = 0; k < n; ++k) {
    const int place = next[cells.at(k)]++;
    member[place] = known[k];
    x[place] = pixels[2 * k];
    y[place] = pixels[2 * k + 1];
  }
  for (int k = 0; k < n; ++k) {
    const int upper = known[k];
    const double x_upper = pixels[2 * k], y_upper = pixels[2 * k + 1];
    const int first = std::max(cells.column[k] - wide, 0),
              last = std::min(cells.column[k] + wide, cells.columns - 1);
    for (int row = cells.row[k]; row <= std::min(cells.row[k] + reach, cells.rows - 1); ++row)
      for (int m = begin[row * cells.columns + first]; m < begin[row * cells.columns + last + 1];
           ++m) {
        const double aside = std::abs(x[m] - x_upper), up = y[m] - y_upper;
        if (!((aside <= beside) & (up >= low) & (up <= high))) continue;
        const int lower = member[m];
        if (body[lower] && body[upper]) continue;
        const double a = depths.rho[upper], b = depths.rho[lower];
        const double rough = relief * std::max(a, b);
        const double variance = depths.sigma[lower] * depths.sigma[lower] +
                                depths.sigma[upper] * depths.sigma[upper] + rough * rough;
        const double level = a - b * drop[upper] / drop[lower], upright = a - b;
        if (sure >= 1 && std::abs(upright) >= std::abs(level)) continue;  // level is likelier
        if (std::exp(-0.5 * upright * upright / variance) + stray >
            sure * (std::exp(-0.5 * level * level / variance) + stray))
          body[lower] = body[upper] = 1;
      }
  }
}

// Which blocks (N,) lie on the camera's way and may be road, which lie in its corridor, what each
// ray falls (N,), the largest height that the scene allows, and the scene's median parallax.
py::tuple find_way(const py::object& rays, const py::object& rho, const py::object& sigma,
                   const py::object& x, const py::object& inlier, const py::object& unsupported,
                   const py::object& parallax, const py::object& normal, const py::object& course,
                   double turn, const py::dict& is) {
  const char* name = "find_way";
  const Depths depths(name, rays, rho, sigma, x);
  const int n = depths.size();
  const In<bool> fits(name, "inlier", inlier, {n}), lone(name, "unsupported", unsupported, {n});
  const In<double> length(name, "parallax", parallax, {n}, Check::finite);
  const Corridor road(vector3(name, "normal", normal), vector3(name, "course", course), is);
  const double blur = policy(is, "max_blur"), around = policy(is, "around");
  std::vector<double> drop(n), distance, lengths;
  std::vector<char> body(n);
  std::vector<int> known;
  for (auto* values : {&distance, &lengths}) values->reserve(n);
  known.reserve(n);
  for (int i = 0; i < n; ++i) {
    drop[i] = road.drop(depths, i);
    if (!fits[i] || !(depths.rho[i] > 0)) continue;
    if (drop[i] > road.least) known.push_back(i);
    if (lone[i]) continue;
    lengths.push_back(length[i]);
    if (depths.sigma[i] < blur * depths.rho[i]) distance.push_back(1 / depths.rho[i]);
  }
  mark_bodies(depths, drop, known, is, body);
  Out<bool> way({n}), ahead({n});
  Out<double> falls({n});
  for (int i = 0; i < n; ++i) {
    falls[i] = drop[i];
    ahead[i] = road.holds(depths, i, drop[i]);
    way[i] = ahead[i] && depths.rho[i] > turn / around && !body[i];
  }
  const double ceiling = static_cast<double>(distance.size()) >= policy(is, "min_depths")
                             ? median(distance) : policy(is, "most");
  return py::make_tuple(way.array(), ahead.array(), falls.array(), ceiling,
                        lengths.empty() ? 0.0 : median(lengths));
}

// How many pixels lie less than `apart` from one along both axes; columns end with LANES that do
// not.
KERNELS_WIDE
double count_near(const std::vector<double>& x, const std::vector<double>& y, std::size_t one,
                  double apart) {
  Four count = {};
  const Four none = {}, each = none + 1, far = none + apart;
  for (std::size_t i = 0; i + LANES < x.size(); i += LANES) {
    const Four dx = load(&x[i]) - x[one], dy = load(&y[i]) - y[one];
    count += larger(larger(dx, -dx), larger(dy, -dy)) < far ? each : none;
  }
  return sum(count);
}

// What a block of a road tells of a height: it lies this deep where the camera is one unit high.
struct Told {
  double falls, depth, variance, rough, blurred;  // the latter two: squared shares of the depth
  double right, stray, share;  // that it is right, the density where it is not, and its weight

  // Adds the log-likelihoods of heights; columns end with LANES numbers, which may be changed.
  KERNELS_WIDE
  void add_to(std::vector<double>& sums, const std::vector<double>& heights) const {
    const Four none = {}, each = none + 1, nothing = none + share * std::log(1 - right);
    for (std::size_t g = 0; g + LANES < heights.size(); g += LANES) {
      const Four expected = falls * load(&heights[g]);
      const Four all = variance + rough * expected * expected, miss = depth - expected;
      const Four squared = miss * miss / all;
      const Four known = all > blurred * expected * expected ? none : each;
      // Beyond 8 sigma the density is below rounding.
      const Four far = squared > none + 64 ? known : none;
      const Four near = known - far;
      store(load(&sums[g]) + (far > none ? nothing : none), &sums[g]);
      if (sum(near) == 0) continue;
      for (std::size_t k = 0; k < LANES; ++k) {
        if (near[k] == 0) continue;
        const double density = std::exp(-0.5 * squared[k]) * expected[k] /
                               (std::sqrt(2 * PI) * std::sqrt(all[k]));
        sums[g + k] += share * std::log(1 - right + right * density / stray);
      }
    }
  }
};

// A belief of log(height) on a grid (G,) after blocks of a road, right and wrong ones; what one
// tells counts less the more blocks lie about it.
py::object see_height(const py::object& belief, const py::object& grid, const py::object& rho,
                      const py::object& sigma, const py::object& x, const py::object& drop,
                      const py::object& error, const py::object& pixel, const py::object& parallax,
                      const py::object& way, double tilt, double least, double ceiling,
                      const py::dict& is) {
  const char* name = "see_height";
  const In<double> prior(name, "belief", belief, {ANY}, Check::finite);
  const auto cells = prior.size();
  const In<double> logs(name, "grid", grid, {cells}, Check::finite);
  const In<double> depth(name, "rho", rho, {ANY}, Check::finite);
  const auto n = depth.size();
  const In<double> blur(name, "sigma", sigma, {n}, Check::finite);
  const In<double> pixels(name, "x", x, {n, 2}, Check::finite);
  const In<double> falls(name, "drop", drop, {n}, Check::finite);
  const In<double> off(name, "error", error, {n}), noise(name, "pixel", pixel, {n});
  const In<double> length(name, "parallax", parallax, {n});
  const In<bool> on_way(name, "way", way, {n});
  const double gate = policy(is, "gate"), isotropy = policy(is, "isotropy"),
               relief = policy(is, "relief"), blurred = policy(is, "blurred"),
               apart = policy(is, "apart"), sites = policy(is, "sites");
  std::vector<int> possible;
  std::vector<double> wrong, passing;  // log(length) of wrong vectors, and how many pass for right
  double total = 0;
  for (int i = 0; i < n; ++i) {
    if (!on_way[i] || !(length[i] > least)) continue;
    if (std::abs(off[i]) < gate && depth[i] > 0) possible.push_back(i);
    if (!(std::abs(off[i]) > gate)) continue;
    const double chance = std::asin(std::min(gate * noise[i] / length[i], 1.0)) / PI;
    passing.push_back(chance / (1 - 2 * std::min(chance, 0.4)));
    wrong.push_back(std::log(length[i]));
    total += passing.back();
  }
  if (possible.empty()) return py::none();
  const double right = std::clamp(1 - total / static_cast<double>(possible.size()),
                                  policy(is, "right_least"), policy(is, "right_most"));
  std::vector<double> heights(cells + LANES), sums(cells + LANES), columns, rows;
  for (const int i : possible) {
    columns.push_back(pixels(i, 0));
    rows.push_back(pixels(i, 1));
  }
  for (auto* places : {&columns, &rows}) places->resize(possible.size() + LANES, INFINITE);
  for (py::ssize_t g = 0; g < cells; ++g) heights[g] = std::exp(-logs[g]);
  // Neighbours err together, so that of many blocks some tell as much as all.
  const std::size_t every = 1 + possible.size() / static_cast<std::size_t>(policy(is, "asked"));
  for (std::size_t k = 0; k < possible.size(); k += every) {
    const int i = possible[k];
    double stray = 1.0 / 6;  // one more of any length, over the six units that lengths have
    const double log_length = std::log(length[i]);
    for (std::size_t j = 0; j < wrong.size(); ++j) {
      const double gap = (log_length - wrong[j]) / isotropy;
      stray += std::exp(-0.5 * gap * gap) / (std::sqrt(2 * PI) * isotropy) * passing[j];
    }
    stray /= total + 1;
    const double share =
        static_cast<double>(every) / (sites * count_near(columns, rows, k, apart));
    const double rough = std::hypot(relief, tilt / falls[i]);
    const Told told{falls[i], depth[i], blur[i] * blur[i], rough * rough, blurred * blurred,
                    right, stray, share};
    told.add_to(sums, heights);
  }
  const double highest = std::log(ceiling);
  double most = -INFINITE;
  for (py::ssize_t g = 0; g < cells; ++g) {
    sums[g] = logs[g] < highest ? sums[g] + std::log(prior[g]) : -INFINITE;
    most = std::max(most, sums[g]);
  }
  Out<double> after({cells});
  double all = 0;
  for (py::ssize_t g = 0; g < cells; ++g) {
    after[g] = std::isfinite(most) ? std::exp(sums[g] - most) : 1.0;
    all += after[g];
  }
  for (py::ssize_t g = 0; g < cells; ++g) after[g] /= all;
  return after.array();
}

// A belief (G,) in the next baseline: moved by log_ratio, spread by sigma, both in steps, and
// mixed with a share `leak` of knowing nothing.
py::array_t<double> move_height(const py::object& belief, double steps, double width,
                                double leak) {
  const In<double> was("move_height", "belief", belief, {ANY}, Check::finite);
  const int n = static_cast<int>(was.size()), reach = static_cast<int>(std::ceil(3 * width));
  std::vector<double> moved(n), kernel(2 * reach + 1);
  for (int i = 0; i < n; ++i) {
    const double at = i + steps;
    const int low = static_cast<int>(std::floor(std::clamp(at, -1.0, static_cast<double>(n))));
    const double part = at - low;
    if (low >= 0 && low + 1 < n) moved[i] = was[low] * (1 - part) + was[low + 1] * part;
    if (low == n - 1 && part == 0) moved[i] = was[low];
  }
  double total = 0;
  for (int k = -reach; k <= reach; ++k)
    total += kernel[k + reach] = std::exp(-0.5 * (k / width) * (k / width));
  Out<double> after({n});
  double left = 0;
  for (int i = 0; i < n; ++i) {
    for (int k = std::max(-reach, i - n + 1); k <= std::min(reach, i); ++k)
      after[i] += moved[i - k] * kernel[k + reach] / total;
    left += after[i];
  }
  for (int i = 0; i < n; ++i)
    after[i] = (1 - leak) * after[i] + (1 - (1 - leak) * left) / n;
  return after.array();
}

// What is expected of the ground: unit normal, its deviation [rad], 1 / d, deviation of log(d).
struct Prior {
  Vec3 normal;
  double tilt, inverse_depth, spread;

  // Squared Mahalanobis distance of a plane; what faces down is far off.
  double distance(const Vec3& plane) const {
    const double length = norm(plane);
    const double angle = std::acos(std::clamp(dot(plane, normal) / length, -1.0, 1.0)) / tilt;
    const double size = std::isinf(spread) ? 0 : std::log(length / inverse_depth) / spread;
    return angle * angle + size * size;
  }
  // Mean and information about a plane; the latter counts for `dependence` blocks.
  Gaussian information(const Vec3& plane, double dependence) const {
    const double length = norm(plane), known = inverse_depth * spread;
    const double radial = std::isinf(spread) ? 0 : 1 / (known * known);
    const double tangential = 1 / (length * tilt * length * tilt);
    Gaussian out{(std::isinf(spread) ? length : inverse_depth) * normal, {}};
    for (int i = 0; i < 9; ++i) {
      const double along = normal[i / 3] * normal[i % 3];
      out.covariance[i] = dependence * (tangential * (IDENTITY[i] - along) + radial * along);
    }
    return out;
  }
};

// Planes that blocks propose: level ones through one block, then tilted ones through three that
// lie within a radius of each other. Draws (T, 10) are uniform in 0 to 1.
std::vector<Vec3> proposals(const Depths& depths, const std::vector<int>& sample,
                            const Prior& prior, double radius, const In<double>& draws) {
  const int n = static_cast<int>(sample.size());
  std::vector<int> order(sample);
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return depths.x(a, 0) < depths.x(b, 0); });
  std::vector<double> sorted;
  for (const int i : order) sorted.push_back(depths.x(i, 0));
  std::vector<std::pair<int, int>> beside(depths.size());  // of the order: who lies near in x
  for (int k = 0, low = 0, high = 0; k < n; ++k) {
    while (sorted[low] < sorted[k] - radius) ++low;
    while (high < n && sorted[high] <= sorted[k] + radius) ++high;
    beside[order[k]] = {low, high};
  }
  std::vector<Vec3> out;
  for (py::ssize_t trial = 0; trial < draws.size(); ++trial) {
    const int i = sample[static_cast<int>(draws(trial, 0) * n)];
    out.push_back((-depths.rho[i] / depths.along(i, prior.normal)) * prior.normal);
  }
  for (py::ssize_t trial = 0; trial < draws.size(); ++trial) {
    const int first = sample[static_cast<int>(draws(trial, 1) * n)];
    const auto [low, high] = beside[first];
    int triple[3] = {first, -1, -1}, far[2], found = 1, missed = 0;
    for (int k = 2; k < 10 && found < 3; ++k) {
      const int other = order[low + static_cast<int>(draws(trial, k) * (high - low))];
      if (std::abs(depths.x(other, 1) - depths.x(first, 1)) <= radius)
        triple[found++] = other;
      else if (missed < 2)
        far[missed++] = other;
    }
    for (int k = 0; found < 3; ++k) triple[found++] = far[k];
    Vec3 row[3];
    for (int k = 0; k < 3; ++k)
      row[k] = {depths.ray(triple[k], 0), depths.ray(triple[k], 1), depths.ray(triple[k], 2)};
    const Vec3 a = cross(row[1], row[2]), b = cross(row[2], row[0]), c = cross(row[0], row[1]);
    const double determinant = dot(row[0], a);
    if (!(std::abs(determinant) > 1e-6)) continue;  // three rays in a plane
    out.push_back((-1 / determinant) * (depths.rho[triple[0]] * a + depths.rho[triple[1]] * b +
                                        depths.rho[triple[2]] * c));
  }
  return out;
}

// Blocks of a sample by column; columns end with LANES zeros.
struct Sample {
  std::vector<double> ray[3], rho, sigma;
  std::size_t n;

  Sample(const Depths& depths, const std::vector<int>& which) : n(which.size()) {
    for (auto* column : {&ray[0], &ray[1], &ray[2], &rho, &sigma}) column->resize(n + LANES);
    for (std::size_t k = 0; k < n; ++k) {
      for (int j = 0; j < 3; ++j) ray[j][k] = depths.ray(which[k], j);
      rho[k] = depths.rho[which[k]];
      sigma[k] = depths.sigma[which[k]];
    }
  }
};

// A sum and the blocks' squared errors on a plane, each at most `cap` and that much where a block
// is blurred; as soon as it is not less than `most`, it is enough.
KERNELS_WIDE
double capped_errors(const Sample& blocks, const Vec3& plane, double blur, double cap, double sum,
                     double most) {
  const Four bound = Four{} + cap;
  for (std::size_t i = 0; i < blocks.n && sum < most; i += LANES) {
    const Four3 ray{load(&blocks.ray[0][i]), load(&blocks.ray[1][i]), load(&blocks.ray[2][i])};
    const Four should = -dot(ray, plane), sigma = load(&blocks.sigma[i]);
    const Four error = (load(&blocks.rho[i]) - should) / sigma, square = error * error;
    const Four part = (sigma > blur * should) | (bound < square) ? bound : square;
    for (std::size_t k = 0; k < std::min(LANES, blocks.n - i); ++k) sum += part[k];
  }
  return sum;
}

// How many positive values at most differ by less than a share.
int most_alike(std::vector<double> values, double share) {
  for (double& value : values) value = std::log(value);
  std::sort(values.begin(), values.end());
  std::size_t most = 0, last = 0;
  for (std::size_t first = 0; first < values.size(); ++first) {
    while (last < values.size() && values[last] < values[first] + share) ++last;
    most = std::max(most, last - first);
  }
  return static_cast<int>(most);
}

// Finds the ground among free blocks: (plane, covariance, member (N,)), or None.
py::object find_ground(const py::object& rays, const py::object& rho, const py::object& sigma,
                       const py::object& x, const py::object& free, const py::object& lone,
                       const py::object& normal, const py::tuple& expected,
                       const py::object& draws, const py::dict& is) {
  const char* name = "find_ground";
  const Depths depths(name, rays, rho, sigma, x);
  const int n = depths.size();
  const In<bool> may(name, "free", free, {n}), shown(name, "lone", lone, {n});
  const In<double> drawn(name, "draws", draws, {ANY, 10}, Check::finite);
  const Prior prior{vector3(name, "normal", normal), expected[0].cast<double>(),
                    expected[1].cast<double>(), expected[2].cast<double>()};
  const bool known = prior.spread < policy(is, "sure");
  const double least = std::floor(policy(is, "min_macroblocks") / (known ? 4 : 1));
  const double blur = policy(is, "max_blur"), cut = policy(is, "cut");
  const Corridor corridor(prior.normal, {0, 0, 1}, is);
  std::vector<int> sample;
  for (int i = 0; i < n; ++i)
    if (may[i] && depths.rho[i] > 0 && corridor.holds(depths, i, corridor.drop(depths, i)))
      sample.push_back(i);
  const Cells cells(depths.x.data(), n);
  Components components(cells);
  if (sample.empty() || components.count(sample) < least) return py::none();
  const auto expects = [&](int i, const Vec3& plane) { return -depths.along(i, plane); };
  // Least truncated squared error, in outliers, with the prior's distance.
  const Sample columns(depths, sample);
  Vec3 plane{};
  double cost = INFINITE;
  for (const Vec3& proposed : proposals(depths, sample, prior, 4 * policy(is, "radius"), drawn)) {
    const double away = prior.distance(proposed);
    if (!(away < 9)) continue;  // 3 sigma
    const double sum =
        capped_errors(columns, proposed, blur, cut * cut, away * cut * cut, cost);
    if (sum < cost) {
      cost = sum;
      plane = proposed;
    }
  }
  if (std::isinf(cost)) return py::none();
  const auto is_sharp = [&](int i) {
    return depths.sigma[i] < blur * std::max(expects(i, plane), 1e-9);
  };
  Gaussian fit{};
  for (int round = 0; round < 2; ++round) {
    std::vector<int> sharp, number;
    for (const int i : sample)
      if (is_sharp(i)) sharp.push_back(i);
    if (components.count(sharp) < least) return py::none();
    Whitened blocks;
    blocks.resize(static_cast<int>(sharp.size()));
    for (int k = 0; k < blocks.n; ++k) {
      for (int j = 0; j < 3; ++j) blocks.ray[j][k] = depths.ray(sharp[k], j) / depths.sigma[sharp[k]];
      blocks.rho[k] = depths.rho[sharp[k]] / depths.sigma[sharp[k]];
      number.push_back(k);
    }
    const Gaussian before = prior.information(plane, policy(is, "ground_dependence"));
    fit = refined(blocks, number, plane, 0.25, 5, &before);
    plane = fit.plane;
  }
  std::vector<int> agree;
  std::vector<double> below;
  int disagree = 0;
  Out<bool> member({n});
  for (const int i : sample) {
    const double should = expects(i, plane), error = (depths.rho[i] - should) / depths.sigma[i];
    if (error < -cut) below.push_back(depths.rho[i] / should);
    disagree += std::abs(error) > cut;
    if (!is_sharp(i) || !(std::abs(error) < cut)) continue;
    agree.push_back(i);
    member[i] = shown[i];
  }
  const int smallest = static_cast<int>(policy(is, "min_macroblocks")) / 4;
  for (const int i : components.large(agree, smallest)) member[i] = true;
  std::vector<int> own;
  for (const int i : agree)
    if (member[i]) own.push_back(i);
  const int speaks = known ? most_alike(below, policy(is, "alike")) : disagree;
  if (components.count(own) < least || speaks > static_cast<int>(own.size()) ||
      prior.distance(plane) > 9)
    return py::none();
  Out<double> found({3}), covariance({3, 3});
  std::copy(plane.begin(), plane.end(), found.data());
  std::copy(fit.covariance.begin(), fit.covariance.end(), covariance.data());
  return py::make_tuple(found.array(), covariance.array(), member.array());
}

}  // namespace
}  // namespace kernels

void bind_ground(kernels::py::module_& module) {
  using namespace kernels;
  // Which of the known blocks (N,), that fall by `drop` (N,), rise from the road.
  module.def("on_bodies", [](const py::object& rays, const py::object& rho,
                             const py::object& sigma, const py::object& x, const py::object& drop,
                             const py::object& known, const py::dict& is) {
    const Depths depths("on_bodies", rays, rho, sigma, x);
    const int n = depths.size();
    const In<double> falls("on_bodies", "drop", drop, {n}, Check::finite);
    const In<bool> may("on_bodies", "known", known, {n});
    std::vector<int> which;
    for (int i = 0; i < n; ++i)
      if (may[i] && depths.rho[i] > 0) which.push_back(i);
    std::vector<char> body(n);
    mark_bodies(depths, std::vector<double>(falls.data(), falls.data() + n), which, is, body);
    Out<bool> out({n});
    std::copy(body.begin(), body.end(), out.data());
    return out.array();
  });
  module.def("find_way", find_way);
  module.def("see_height", see_height);
  module.def("move_height", move_height);
  module.def("find_ground", find_ground);
}
