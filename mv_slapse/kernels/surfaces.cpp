// Stationary planes of a pair: windows of the lattice propose planes, and planes are chosen one
// after another by the blocks that each explains and none before it does. The reasons for the
// rules stand in surfaces/plane_search.py.

#include <algorithm>
#include <cmath>
#include <numeric>

#include "depths.hpp"
#include "lattice.hpp"

namespace kernels {
namespace {

KERNELS_INLINE Four broadcast(double x) { return Four{} + x; }
constexpr int STEP = static_cast<int>(LANES);
constexpr double RIDGE = 10 * std::numeric_limits<double>::epsilon();

struct Policy {
  double cut, max_excess, max_blur, roughness, density, vague, fading;  // of planes
  double least, cap, lean, dependence, reach, upright_gate, noise_least;  // of windows
  double same_gate, min_macroblocks;
  int judged;

  explicit Policy(const py::dict& d)
      : cut(policy(d, "cut")), max_excess(policy(d, "max_excess")),
        max_blur(policy(d, "max_blur")), roughness(policy(d, "roughness")),
        density(policy(d, "density")), vague(policy(d, "vague")), fading(policy(d, "fading")),
        least(policy(d, "least")), cap(policy(d, "cap")), lean(policy(d, "lean")),
        dependence(policy(d, "dependence")), reach(policy(d, "reach")),
        upright_gate(policy(d, "upright_gate")), noise_least(policy(d, "noise_least")),
        same_gate(policy(d, "same_gate")), min_macroblocks(policy(d, "min_macroblocks")),
        judged(static_cast<int>(policy(d, "judged"))) {}
};

// Makes a plane upright where it may be, for what is known of it.
Gaussian upright(const Gaussian& plane, const Vec3& up, const Policy& is) {
  const Vec3 toward = plane.covariance * up;
  const double variance =
      dot(toward, up) + is.lean * is.lean * dot(plane.plane, plane.plane) / is.dependence;
  const double off = dot(plane.plane, up);
  if (!(off * off < is.upright_gate * is.dependence * variance)) return plane;
  Gaussian out = plane;
  for (int i = 0; i < 3; ++i) {
    out.plane[i] -= toward[i] * off / variance;
    for (int j = 0; j < 3; ++j) out.covariance[3 * i + j] -= toward[i] * toward[j] / variance;
  }
  return out;
}

// Squared Mahalanobis distance of two planes, each with its covariance.
double distance(const Gaussian& a, const Gaussian& b) {
  Mat3 sum, information;
  for (int i = 0; i < 9; ++i) sum[i] = a.covariance[i] + b.covariance[i];
  if (!inverse(sum, information)) return INFINITE;
  const Vec3 off = b.plane - a.plane;
  return dot(off, information * off);
}

// Mean of two estimates of a plane, each by its information.
Gaussian fused(const Gaussian& a, const Gaussian& b) {
  Mat3 sum, information;
  for (int i = 0; i < 9; ++i) sum[i] = a.covariance[i] + b.covariance[i];
  if (!inverse(sum, information)) return a;
  const Mat3 gain = a.covariance * information;
  Gaussian out{a.plane + gain * (b.plane - a.plane), {}};
  const Mat3 less = gain * a.covariance;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      out.covariance[3 * i + j] = 0.5 * (a.covariance[3 * i + j] - less[3 * i + j] +
                                         a.covariance[3 * j + i] - less[3 * j + i]);
  return out;
}

struct Run {  // blocks in a row: from first on, before last
  int first, last;
};

// Sums of a plane's equations over four blocks at a time.
struct Sums {
  Four A[6] = {}, b[3] = {};

  KERNELS_INLINE void add(const Four3& ray, const Four& rho, const Four& weight) {
    const Four x = weight * ray.x, y = weight * ray.y, z = weight * ray.z;
    A[0] += x * ray.x, A[1] += x * ray.y, A[2] += x * ray.z;
    A[3] += y * ray.y, A[4] += y * ray.z, A[5] += z * ray.z;
    b[0] -= x * rho, b[1] -= y * rho, b[2] -= z * rho;
  }
  KERNELS_INLINE Equations total() const {
    Equations e;
    e.A = {sum(A[0]), sum(A[1]), sum(A[2]), 0, sum(A[3]), sum(A[4]), 0, 0, sum(A[5])};
    e.b = {sum(b[0]), sum(b[1]), sum(b[2])};
    e.mirror();
    return e;
  }
};

KERNELS_INLINE Four3 rays_at(const Whitened& blocks, int i) {
  return {load(&blocks.ray[0][i]), load(&blocks.ray[1][i]), load(&blocks.ray[2][i])};
}
// 1 for each block from i on that lies before last, 0 for others.
KERNELS_INLINE Four before(int i, int last) {
  static constexpr double ONES[2 * STEP] = {1, 1, 1, 1};
  return load(ONES + STEP - std::min(last - i, STEP));
}

// Tells which blocks from first to last lie within reach of a centre: 1 for each, 0 for others. Of
// those that come in fours with one of them the first ones are listed; returns how many.
KERNELS_WIDE
int find_near(const double* x, const double* y, Run run, const double* centre, double reach,
              double* near, int* fours) {
  const Four none = broadcast(0), far = broadcast(reach);
  int n = 0;
  for (int i = run.first; i < run.last; i += STEP) {
    const Four dx = load(x + i) - centre[0], dy = load(y + i) - centre[1];
    const Four off = larger(larger(dx, -dx), larger(dy, -dy));
    const Four own = off < far ? before(i, run.last) : none;
    store(own, near + i);
    fours[n] = i;
    n += sum(own) > 0;
  }
  return n;
}

// Equations of such blocks, each weighted by its error.
KERNELS_WIDE
Equations equations_near(const Whitened& blocks, const double* near, const int* fours, int n,
                         const Vec3& plane, double softness) {
  Sums sums;
  for (int k = 0; k < n; ++k) {
    const int i = fours[k];
    const Four3 ray = rays_at(blocks, i);
    const Four rho = load(&blocks.rho[i]), error = dot(ray, plane) + rho;
    const Four d = broadcast(1) + error * error * softness;
    sums.add(ray, rho, load(near + i) / (d * d));
  }
  return sums.total();
}

// Leaves a plane's gain to those blocks only, and raises what planes explain together.
KERNELS_WIDE
void explain(const double* near, int first, int last, double* gain, double* explained) {
  for (int i = first; i < last; ++i) {
    gain[i] *= near[i];
    explained[i] = std::max(explained[i], gain[i]);
  }
}

constexpr int WIDEST = 5;  // columns of a window

struct Window {
  std::array<Run, WIDEST> runs;  // of its blocks, one in each column
  int columns, column;           // their number, and the first
  Run fours;                     // numbers of the runs of up to four blocks that make them up
  int count;                     // blocks
  bool is_tall;
  int judged;  // blocks
  Vec3 plane;
  double cost;

  const Run* begin() const { return runs.data(); }
  const Run* end() const { return runs.data() + columns; }
};

// Sums over a window's blocks, each weighted by its error on a plane, or all alike.
KERNELS_INLINE Sums sums_in(const Whitened& blocks, const Run* fours, const Window& window,
                            bool alike, const Vec3& plane, double softness) {
  Sums sums;
  for (int k = window.fours.first; k < window.fours.last; ++k) {
    const int i = fours[k].first;
    const Four3 ray = rays_at(blocks, i);
    const Four rho = load(&blocks.rho[i]), error = dot(ray, plane) + rho;
    const Four d = broadcast(1) + error * error * softness, own = before(i, fours[k].last);
    sums.add(ray, rho, alike ? own : own / (d * d));
  }
  return sums;
}

// Fits planes robustly to up to four windows. Tall ones are taken for walls, with normals across
// up, which two columns of the basis span: three columns of macroblocks know no slant.
KERNELS_WIDE
void fit_windows(const Whitened& blocks, const Run* fours, Window* windows, int n,
                 const Mat3& basis, double softness) {
  Four A[9] = {}, b[3] = {}, plane[3] = {};
  auto good = broadcast(0) == broadcast(0);
  for (int step = 0; step < 3; ++step) {
    double upper[6][LANES], right[3][LANES];
    for (int j = 0; j < STEP; ++j) {  // the last one fills the lanes that are left
      const Window& window = windows[std::min(j, n - 1)];
      const Vec3 before{plane[0][j], plane[1][j], plane[2][j]};
      const Sums sums = step ? sums_in(blocks, fours, window, false, before, softness)
                             : sums_in(blocks, fours, window, true, before, softness);
      for (int k = 0; k < 6; ++k) upper[k][j] = sum(sums.A[k]);
      for (int k = 0; k < 3; ++k) right[k][j] = sum(sums.b[k]);
    }
    Four now[6], L[9];
    for (int k = 0; k < 6; ++k) now[k] = load(upper[k]);
    const Four more = RIDGE * (now[0] + now[3] + now[5]) + broadcast(1e-12);
    for (const int k : {0, 3, 5}) now[k] += more;
    for (int i = 0, k = 0; i < 3; ++i)
      for (int j = i; j < 3; ++j, ++k) A[3 * i + j] = A[3 * j + i] = good ? now[k] : A[3 * i + j];
    for (int i = 0; i < 3; ++i) plane[i] = b[i] = good ? load(right[i]) : b[i];
    for (int k = 0; k < 9; ++k) L[k] = A[k];
    good &= cholesky<3>(L);
    cholesky_solve<3>(L, plane);
    for (Four& x : plane) x = good ? x : broadcast(0);
  }
  if (windows[n - 1].is_tall) {
    Four wall[4], c[2];
    for (int i = 0; i < 2; ++i) {
      const Vec3 u{basis[i], basis[3 + i], basis[6 + i]};
      Four Au[3];
      for (int k = 0; k < 3; ++k)
        Au[k] = A[3 * k] * u[0] + A[3 * k + 1] * u[1] + A[3 * k + 2] * u[2];
      for (int j = 0; j < 2; ++j)
        wall[2 * i + j] = Au[0] * basis[j] + Au[1] * basis[3 + j] + Au[2] * basis[6 + j];
      c[i] = b[0] * u[0] + b[1] * u[1] + b[2] * u[2];
    }
    good = cholesky<2>(wall);
    cholesky_solve<2>(wall, c);
    for (int i = 0; i < 3; ++i)
      plane[i] = good ? basis[3 * i] * c[0] + basis[3 * i + 1] * c[1] : broadcast(0);
  }
  for (int j = 0; j < n; ++j) windows[j].plane = {plane[0][j], plane[1][j], plane[2][j]};
}

// Sum of the squared errors of a window's blocks on its plane, each at most ``cap``.
KERNELS_WIDE
double capped_errors(const Whitened& blocks, const Run* fours, const Window& window, double cap) {
  Four total = broadcast(0);
  const Four most = broadcast(cap);
  for (int k = window.fours.first; k < window.fours.last; ++k) {
    const int i = fours[k].first;
    const Four error = dot(rays_at(blocks, i), window.plane) + load(&blocks.rho[i]);
    const Four square = error * error;
    total += before(i, fours[k].last) * (square < most ? square : most);
  }
  return sum(total);
}

// Writes the squared errors of a window's blocks on its plane, and up to three numbers more;
// returns their end.
KERNELS_WIDE
double* squared_errors(const Whitened& blocks, const Run* fours, const Window& window,
                       double* out) {
  for (int k = window.fours.first; k < window.fours.last; ++k) {
    const int i = fours[k].first;
    const Four error = dot(rays_at(blocks, i), window.plane) + load(&blocks.rho[i]);
    store(error * error, out);
    out += fours[k].last - i;
  }
  return out;
}

// Gives a window's number to those of its blocks that are known for a larger cost so far.
KERNELS_WIDE
void judge_by(const Run* fours, const Window& window, double number, double cost, double* least,
           double* best) {
  for (int k = window.fours.first; k < window.fours.last; ++k) {
    const int i = fours[k].first;
    const Four was = load(least + i);
    const auto better = (before(i, fours[k].last) > broadcast(0)) & (broadcast(cost) < was);
    store(better ? broadcast(cost) : was, least + i);
    store(better ? broadcast(number) : load(best + i), best + i);
  }
}

// Squared errors of blocks on a plane.
KERNELS_WIDE
void squared_errors(const Whitened& blocks, int first, int last, const Vec3& plane, double* out) {
  for (int i = first; i < last; i += STEP) {
    const Four error = load(&blocks.ray[0][i]) * plane[0] + load(&blocks.ray[1][i]) * plane[1] +
                       load(&blocks.ray[2][i]) * plane[2] + load(&blocks.rho[i]);
    store(error * error, out + i);
  }
}

// Sum of what gains have more than is taken already; both end with LANES zeros.
KERNELS_WIDE
double sum_of_more(const double* gain, const double* taken, int first, int last) {
  Four total = broadcast(0);
  for (int i = first / STEP * STEP; i < last; i += STEP) {  // each block in its lane
    const Four more = load(gain + i) - load(taken + i);
    total += more > broadcast(0) ? more : broadcast(0);
  }
  return sum(total);
}

struct Track {
  Gaussian now;
  int before, seen;  // number of the known plane that it continues, or -1
  std::vector<double> gain;
  int first = 0, last = 0;  // blocks in columns near the window that proposes it
};

// Numbers of blocks sorted by column of macroblocks, then by row, and the cells of all in that order.
struct Sorted {
  std::vector<int> order;
  Cells cells;
};

// Sharp stationary blocks, ordered by column of macroblocks and row, their windows, and what
// planes explain of them.
class Search {
 public:
  Search(const Policy& is, const Vec3& up, Sorted sorted, const double* rays, const double* rho,
         const double* sigma, const double* pixels);
  bool look();
  std::vector<Track> chosen(const std::vector<Gaussian>& known, const std::vector<int>& seen,
                            int room);
  Gaussian fit(const std::vector<int>& part, const Vec3& plane) const;
  const std::vector<std::vector<int>>& parts() const { return parts_; }
  const std::vector<int>& order() const { return order_; }

 private:
  void tile(int wide, int high, bool is_tall);
  void judge();
  void gain_of(const Vec3& plane, std::vector<double>& gain);
  void gain_of(const Vec3& plane, int first, int last, std::vector<double>& gain);
  std::vector<int> together(const std::vector<double>& gain);
  void see_again(const std::vector<Gaussian>& known, const std::vector<int>& seen);
  void find_new(int room);
  Gaussian grown(const Window& window, int fours) const;
  int first_from(int column) const {
    return cell_begin_[std::clamp(column, 0, cells_.columns) * cells_.rows];
  }
  bool settled(Track& track, std::vector<int>& part);
  void share_out(const std::vector<Gaussian>& known, const std::vector<int>& seen, bool again);
  double more(const std::vector<int>& part, const std::vector<double>& gain) const;
  bool is_plane(const Track& track, const std::vector<int>& part);
  double share_of_outline(const std::vector<int>& part);
  double least_gain() const { return 1.4 * is_.max_excess * is_.min_macroblocks; }

  const Policy& is_;
  const Vec3 up_;
  std::vector<int> order_;
  Whitened blocks_;
  std::vector<double> x_, y_, squared_, capped_, taken_, inside_;  // capped_: sums up to each block
  std::vector<double> bound_;  // of each block's squared error on a plane that is near to it
  Cells cells_;
  Components components_;
  std::vector<int> cell_begin_;  // of each cell, by columns: first block in it or after it
  std::vector<Window> windows_;
  std::vector<Run> fours_;  // of windows, each of up to four blocks in a row
  std::vector<int> best_, judges_, asked_, near_;
  int now_ = 0;
  std::vector<double> gain_of_;
  std::vector<unsigned char> outline_, wider_;
  std::vector<Track> found_;
  std::vector<std::vector<int>> parts_;
};

Sorted by_column(const std::vector<int>& sharp, const double* pixels) {
  std::vector<double> x;
  x.reserve(2 * sharp.size());
  for (const int i : sharp) x.insert(x.end(), {pixels[2 * i], pixels[2 * i + 1]});
  const int n = static_cast<int>(sharp.size());
  Cells cells(x.data(), n);
  std::vector<int> next(cells.columns * cells.rows + 1, 0);
  const auto cell = [&](int i) { return cells.column[i] * cells.rows + cells.row[i]; };
  for (int i = 0; i < n; ++i) ++next[cell(i) + 1];
  std::partial_sum(next.begin(), next.end(), next.begin());
  std::vector<int> order(n), column(n), row(n);
  for (int i = 0; i < n; ++i) {
    const int place = next[cell(i)]++;
    order[place] = sharp[i];
    column[place] = cells.column[i];
    row[place] = cells.row[i];
  }
  cells.column = std::move(column);
  cells.row = std::move(row);
  return {std::move(order), std::move(cells)};
}

Search::Search(const Policy& is, const Vec3& up, Sorted sorted, const double* rays,
               const double* rho, const double* sigma, const double* pixels)
    : is_(is), up_(up), order_(std::move(sorted.order)), cells_(std::move(sorted.cells)),
      components_(cells_) {
  const int n = static_cast<int>(order_.size());
  blocks_.resize(n);
  for (auto* column : {&x_, &y_, &squared_, &capped_, &taken_, &inside_})
    column->assign(n + STEP, 0.0);
  for (int i = 0; i < n; ++i) {
    const int from = order_[i];
    for (int j = 0; j < 3; ++j) blocks_.ray[j][i] = rays[3 * from + j] / sigma[from];
    blocks_.rho[i] = rho[from] / sigma[from];
    x_[i] = pixels[2 * from];
    y_[i] = pixels[2 * from + 1];
  }
  cell_begin_.assign(cells_.columns * cells_.rows + 1, 0);
  for (int i = 0; i < n; ++i) ++cell_begin_[cells_.column[i] * cells_.rows + cells_.row[i] + 1];
  std::partial_sum(cell_begin_.begin(), cell_begin_.end(), cell_begin_.begin());
}

// Lays windows that overlap by half, and keeps those that hold enough blocks.
void Search::tile(int wide, int high, bool is_tall) {
  const int across = wide / 2, down = high / 2;
  for (int j = 0; j * down < cells_.rows; ++j)
    for (int i = 0; i * across < cells_.columns; ++i) {
      const int row = j * down, bottom = std::min(j * down + high, cells_.rows);
      Window window{};
      window.column = i * across;
      window.is_tall = is_tall;
      for (int c = i * across; c < std::min(i * across + wide, cells_.columns); ++c) {
        const Run run{cell_begin_[c * cells_.rows + row], cell_begin_[c * cells_.rows + bottom]};
        window.runs[window.columns++] = run;
        window.count += run.last - run.first;
      }
      if (window.count < is_.least) continue;
      window.fours.first = static_cast<int>(fours_.size());
      for (const Run& run : window)
        for (int k = run.first; k < run.last; k += STEP) {
          Run& four = fours_.emplace_back();
          four.first = k;
          four.last = std::min(k + STEP, run.last);
        }
      window.fours.last = static_cast<int>(fours_.size());
      windows_.push_back(window);
    }
}

// Lays windows and fits planes to them; false where no window holds enough blocks.
bool Search::look() {
  tile(WIDEST, 5, false);
  const std::size_t level = windows_.size();
  tile(3, 9, true);
  if (windows_.empty()) return false;
  Vec3 values;
  Mat3 across, basis;
  for (int i = 0; i < 9; ++i) across[i] = IDENTITY[i] - up_[i / 3] * up_[i % 3];
  eigen_symmetric(across, values, across);
  for (int i = 0; i < 3; ++i) {
    basis[3 * i] = across[3 * i + 1];
    basis[3 * i + 1] = across[3 * i + 2];
  }
  for (std::size_t i = 0, end; i < windows_.size(); i = end) {  // four of a kind at a time
    end = std::min(i + LANES, i < level ? level : windows_.size());
    fit_windows(blocks_, fours_.data(), &windows_[i], static_cast<int>(end - i), basis,
                1 / is_.cap);
  }
  const auto counts = [&](const Window& window) {
    return !window.is_tall && !(window.count < 1.5 * is_.least);
  };
  int n = 0;
  for (const Window& window : windows_) n += counts(window) ? window.count : 0;
  std::vector<double> squared(n + STEP);
  double* last = squared.data();
  for (const Window& window : windows_)
    if (counts(window)) last = squared_errors(blocks_, fours_.data(), window, last);
  double noise = 1;
  if (n) {
    const double middle = nth_smallest(squared.data(), n, n / 2);
    const double below =
        n % 2 ? middle : *std::max_element(squared.data(), squared.data() + n / 2);
    noise = std::clamp(std::sqrt(0.5 * (below + middle) * is_.noise_least), 1.0, 4.0);
  }
  for (auto* column : {&blocks_.ray[0], &blocks_.ray[1], &blocks_.ray[2], &blocks_.rho})
    for (double& value : *column) value /= noise;
  judge();
  return true;
}

// Lets each block be judged by the window around it whose own plane fits best.
void Search::judge() {
  std::vector<double> least(blocks_.n + STEP, INFINITE), best(blocks_.n + STEP, -1.0);
  for (std::size_t w = 0; w < windows_.size(); ++w) {
    Window& window = windows_[w];
    window.cost = capped_errors(blocks_, fours_.data(), window, is_.cap) / window.count;
    const double total = window.cost + 3.0 / window.count;  // of a plane's degrees of freedom
    judge_by(fours_.data(), window, static_cast<double>(w), total, least.data(), best.data());
  }
  best_.assign(best.begin(), best.end() - STEP);
  near_.assign(blocks_.n + 1, 0);
  for (const int w : best_) bound_.push_back(w < 0 ? 0 : is_.cut * is_.cut);
  for (const int w : best_)
    if (w >= 0 && ++windows_[w].judged == is_.judged) judges_.push_back(w);
  gain_of_.assign(windows_.size(), 0.0);
  asked_.assign(windows_.size(), 0);
}

// How well a plane explains each block, from 0 to max_excess or more: how little worse than the
// own plane of the window that judges it, where it is near to the block itself.
void Search::gain_of(const Vec3& plane, std::vector<double>& gain) {
  gain_of(plane, 0, blocks_.n, gain);
}

// The same of blocks from first to last only, and 0 of others.
void Search::gain_of(const Vec3& plane, int first, int last, std::vector<double>& gain) {
  gain.assign(blocks_.n + STEP, 0.0);
  if (first >= last) return;
  // The windows that judge them reach beyond.
  const int begin = first_from(cells_.column[first] - WIDEST),
            end = first_from(cells_.column[last - 1] + WIDEST + 1);
  squared_errors(blocks_, begin, end, plane, squared_.data());
  int n = 0;
  double sum = capped_[begin] = 0;
  const double cap = is_.cap;
  const auto sum_up = [&](int from, int to) {
    for (int i = from; i < to; ++i) capped_[i + 1] = sum += std::min(squared_[i], cap);
  };
  sum_up(begin, first);
  for (int i = first; i < last; ++i) {
    capped_[i + 1] = sum += std::min(squared_[i], cap);
    near_[n] = i;
    n += squared_[i] < bound_[i];
  }
  sum_up(last, end);
  ++now_;
  for (int k = 0; k < n; ++k) {
    const int w = best_[near_[k]];
    if (std::exchange(asked_[w], now_) != now_) {
      const Window& window = windows_[w];
      double total = 0;
      for (const Run& run : window) total += capped_[run.last] - capped_[run.first];
      gain_of_[w] = std::max(is_.max_excess - (total / window.count - window.cost), 0.0);
    }
    gain[near_[k]] = gain_of_[w];
  }
}

// The largest connected part of what a plane explains better than others do; empty: no plane's.
std::vector<int> Search::together(const std::vector<double>& gain) {
  std::vector<int> better;
  for (int i = 0; i < blocks_.n; ++i)
    if (gain[i] > taken_[i]) better.push_back(i);
  if (static_cast<int>(better.size()) < is_.least) return {};
  better = components_.largest(better);
  if (static_cast<int>(better.size()) < is_.least) better.clear();
  return better;
}

// A plane of some blocks, with its covariance; their common errors count.
Gaussian Search::fit(const std::vector<int>& part, const Vec3& plane) const {
  Gaussian out = upright(refined(blocks_, part, plane, 0.25, 2), up_, is_);
  for (double& value : out.covariance) value *= is_.dependence;
  return out;
}

double Search::more(const std::vector<int>& part, const std::vector<double>& gain) const {
  double sum = 0;
  for (const int i : part) sum += gain[i] - taken_[i];
  return sum;
}

// Finds known planes, the longest known first.
void Search::see_again(const std::vector<Gaussian>& known, const std::vector<int>& seen) {
  std::vector<int> order(known.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return seen[a] > seen[b]; });
  for (const int before : order) {
    Track track{known[before], before, seen[before], {}, 0, blocks_.n};
    gain_of(track.now.plane, track.gain);
    std::vector<int> part;
    for (int step = 0; step < 2; ++step) {
      part = together(track.gain);
      if (part.empty()) break;
      const Gaussian fitted = fit(part, track.now.plane);
      if (!(distance(known[before], fitted) < is_.same_gate)) {
        part.clear();
        break;
      }
      track.now = fused(known[before], fitted);
      track.seen = seen[before] + 1;
      gain_of(track.now.plane, track.gain);
    }
    std::vector<int> kept;
    for (const int i : part)
      if (track.gain[i] > taken_[i]) kept.push_back(i);
    if (more(kept, track.gain) < 0.5 * least_gain()) continue;
    for (const int i : kept) taken_[i] = track.gain[i];
    found_.push_back(std::move(track));
  }
}

// Fits a window's plane to all blocks in reach, so that it settles on a whole surface.
Gaussian Search::grown(const Window& window, int fours) const {
  Gaussian out{window.plane, {}};
  for (const double softness : {0.25, 1.0, 1.0}) {
    Equations e =
        equations_near(blocks_, inside_.data(), near_.data(), fours, out.plane, softness);
    e.ridge(RIDGE);
    if (!inverse(e.A, out.covariance)) break;
    out.plane = out.covariance * e.b;
    out = upright(out, up_, is_);
  }
  return out;
}

// Fits a plane to the connected blocks that it explains best, and again.
bool Search::settled(Track& track, std::vector<int>& part) {
  for (int step = 0; step < 2; ++step) {
    part = together(track.gain);
    if (part.empty()) return false;
    track.now = fit(part, track.now.plane);
    gain_of(track.now.plane, track.gain);
  }
  part = together(track.gain);
  return more(part, track.gain) >= least_gain();
}

// Finds new planes, the one that explains most first: windows that judge enough blocks propose,
// unless what is known or proposed already explains half of their own.
void Search::find_new(int room) {
  if (room <= 0) return;
  std::vector<Track> proposed;
  std::vector<double> explained = taken_;  // by known planes and those proposed so far
  const int reach = static_cast<int>(is_.reach / 16) + 1;
  for (const int w : judges_) {
    const Window& window = windows_[w];
    int vacant = 0;
    for (const Run& run : window)
      vacant += static_cast<int>(std::count(&explained[run.first], &explained[run.last], 0.0));
    if (2 * vacant <= window.count) continue;
    double centre[2] = {};
    for (const Run& run : window)
      for (int k = run.first; k < run.last; ++k) centre[0] += x_[k], centre[1] += y_[k];
    for (double& mean : centre) mean /= window.count;
    const int first = first_from(window.column - reach),
              last = first_from(window.column + WIDEST + reach);
    const int fours = find_near(x_.data(), y_.data(), {first, last}, centre, is_.reach,
                                inside_.data(), near_.data());
    Track track{grown(window, fours), -1, 1, {}, first, last};
    gain_of(track.now.plane, first, last, track.gain);
    explain(inside_.data(), first, last, track.gain.data(), explained.data());
    proposed.push_back(std::move(track));
  }
  const std::size_t before = found_.size();
  for (int trial = 0; trial < 2 * room && found_.size() - before < static_cast<std::size_t>(room);
       ++trial) {
    Track* best = nullptr;
    double most = least_gain();
    for (Track& track : proposed) {
      if (track.gain.empty()) continue;
      const double more = sum_of_more(track.gain.data(), taken_.data(), track.first, track.last);
      if (more > most || (!best && more == most)) {
        most = more;
        best = &track;
      }
    }
    if (!best) break;
    Track track = std::move(*best);
    best->gain.clear();
    std::vector<int> part;
    if (!settled(track, part)) continue;
    for (const int i : part) taken_[i] = std::max(track.gain[i], taken_[i]);
    found_.push_back(std::move(track));
  }
}

// Gives each block to the plane that explains it best, and fits the planes again.
void Search::share_out(const std::vector<Gaussian>& known, const std::vector<int>& seen,
                       bool again) {
  std::vector<std::vector<int>> own(found_.size());
  for (int i = 0; i < blocks_.n; ++i) {
    double most = 0;
    int owner = -1;
    for (std::size_t j = 0; j < found_.size(); ++j)
      if (found_[j].gain[i] > most) {
        most = found_[j].gain[i];
        owner = static_cast<int>(j);
      }
    if (owner >= 0) own[owner].push_back(i);
  }
  parts_.assign(found_.size(), {});
  for (std::size_t j = 0; j < found_.size(); ++j) {
    Track& track = found_[j];
    const double least = is_.least;
    if (own[j].size() >= least) parts_[j] = components_.largest(own[j]);
    if (parts_[j].size() < least) parts_[j].clear();
    if (parts_[j].empty()) continue;
    track.now = fit(parts_[j], track.now.plane);
    if (track.before >= 0) {
      track.now = fused(known[track.before], track.now);
      track.seen = seen[track.before] + 1;
    }
    if (again) gain_of(track.now.plane, track.gain);
  }
}

// Which share of the blocks in a plane's outline is its own; the outline has no gaps of a cell.
double Search::share_of_outline(const std::vector<int>& part) {
  const int wide = cells_.columns + 4, high = cells_.rows + 4;
  outline_.assign(wide * high, 0);
  const auto cell = [&](int i) { return (cells_.row[i] + 2) * wide + cells_.column[i] + 2; };
  int top = high, bottom = 0, left = wide, right = 0;  // the part and a cell around
  for (const int i : part) {
    outline_[cell(i)] = 1;
    top = std::min(top, cells_.row[i] + 1), bottom = std::max(bottom, cells_.row[i] + 3);
    left = std::min(left, cells_.column[i] + 1), right = std::max(right, cells_.column[i] + 3);
  }
  for (const bool grow : {true, false}) {  // dilation, then erosion, by 3 x 3 cells
    wider_.assign(wide * high, 0);
    for (int r = top; r <= bottom; ++r)
      for (int k = r * wide + left; k <= r * wide + right; ++k) {
        int near = 0;
        for (const int row : {-wide, 0, wide})
          near += outline_[k + row - 1] + outline_[k + row] + outline_[k + row + 1];
        wider_[k] = grow ? near > 0 : near == 9;
      }
    outline_.swap(wider_);
  }
  int inside = 0;
  for (int i = 0; i < blocks_.n; ++i) inside += outline_[cell(i)];
  int own = 0;
  for (const int i : part) own += outline_[cell(i)];
  return inside ? static_cast<double>(own) / inside : 0.0;
}

// Tells whether what remains of a plane is one: large, dense and well known.
bool Search::is_plane(const Track& track, const std::vector<int>& part) {
  const double least = is_.min_macroblocks * (track.before < 0 ? 1.0 : is_.fading);
  return components_.count(part) >= least &&
         std::sqrt(trace(track.now.covariance)) < is_.vague * norm(track.now.plane) &&
         share_of_outline(part) >= is_.density;
}

std::vector<Track> Search::chosen(const std::vector<Gaussian>& known,
                                  const std::vector<int>& seen, int room) {
  see_again(known, seen);
  find_new(room - static_cast<int>(found_.size()));
  if (!found_.empty())
    for (const bool again : {true, false}) share_out(known, seen, again);
  std::vector<Track> kept;
  std::vector<std::vector<int>> parts;
  for (std::size_t i = 0; i < found_.size(); ++i)
    if (is_plane(found_[i], parts_[i])) {
      kept.push_back(std::move(found_[i]));
      parts.push_back(std::move(parts_[i]));
    }
  parts_ = std::move(parts);
  return kept;
}

// Planes (K, 3) with covariances (K, 3, 3).
struct Planes {
  In<double> plane, covariance;

  Planes(const char* kernel, const py::object& planes, const py::object& covariances)
      : plane(kernel, "planes", planes, {ANY, 3}, Check::finite),
        covariance(kernel, "covariances", covariances, {plane.size(), 3, 3}, Check::finite) {}
  Gaussian operator[](py::ssize_t i) const {
    return {{plane(i, 0), plane(i, 1), plane(i, 2)}, matrix3(covariance.data() + 9 * i)};
  }
};

void write(const Gaussian& from, py::ssize_t i, Out<double>& plane, Out<double>& covariance) {
  std::copy(from.plane.begin(), from.plane.end(), plane.data() + 3 * i);
  std::copy(from.covariance.begin(), from.covariance.end(), covariance.data() + 9 * i);
}

// Finds known planes again, then new ones. Returns of P planes: the number of the known plane or
// -1 (P,), pairs that have shown it (P,), its estimate over all pairs (P, 3), (P, 3, 3) and from
// this pair, and its blocks (P, N).
py::tuple find_planes(const py::object& rays, const py::object& rho, const py::object& sigma,
                      const py::object& x, const py::object& free, const py::object& planes,
                      const py::object& covariances, const py::object& seen, const py::object& up,
                      int room, const py::dict& constants) {
  const char* name = "find_planes";
  const In<double> ray(name, "rays", rays, {ANY, 3}, Check::finite);
  const auto n = ray.size();
  const In<double> depth(name, "rho", rho, {n}, Check::finite);
  const In<double> blur(name, "sigma", sigma, {n}, Check::finite);
  const In<double> pixels(name, "x", x, {n, 2}, Check::finite);
  const In<bool> may(name, "free", free, {n});
  const Planes before(name, planes, covariances);
  const auto k = before.plane.size();
  const In<std::int64_t> times(name, "seen", seen, {k});
  const Policy is(constants);
  std::vector<int> sharp, pairs(times.data(), times.data() + k);
  std::vector<double> noise(n);
  for (int i = 0; i < n; ++i) {
    if (!may[i] || !(blur[i] < is.max_blur * depth[i])) continue;
    noise[i] = std::hypot(blur[i], is.roughness * depth[i]) + 1e-9;
    if (noise[i] < is.max_blur * depth[i]) sharp.push_back(i);
  }
  std::vector<Gaussian> known;
  for (py::ssize_t i = 0; i < k; ++i) known.push_back(before[i]);
  Search search(is, vector3(name, "up", up), by_column(sharp, pixels.data()), ray.data(),
                depth.data(), noise.data(), pixels.data());
  std::vector<Track> found;
  if (static_cast<double>(sharp.size()) >= is.min_macroblocks && search.look())
    found = search.chosen(known, pairs, room);
  const auto p = static_cast<py::ssize_t>(found.size());
  Out<std::int64_t> source({p}), shown({p});
  Out<double> plane({p, 3}), covariance({p, 3, 3}), own({p, 3}), own_covariance({p, 3, 3});
  Out<bool> member({p, n});
  for (py::ssize_t i = 0; i < p; ++i) {
    source[i] = found[i].before;
    shown[i] = found[i].seen;
    write(found[i].now, i, plane, covariance);
    write(search.fit(search.parts()[i], found[i].now.plane), i, own, own_covariance);
    for (const int block : search.parts()[i]) member(i, search.order()[block]) = true;
  }
  return py::make_tuple(source.array(), shown.array(), plane.array(), covariance.array(),
                        own.array(), own_covariance.array(), member.array());
}

// Planes n / d after X_cur = R X_prev + t, |t| = 1 = exp(log_ratio) old baselines: planes (K, 3),
// covariances (K, 3, 3), and whether the camera is still before each (K,). `wobble` (K,) is the
// change that a fit does not tell, as a share.
py::tuple predict_planes(const py::object& planes, const py::object& covariances,
                         const py::object& R, const py::object& t, double log_ratio,
                         double ratio_sigma, const py::object& wobble) {
  const char* name = "predict_planes";
  const Planes before(name, planes, covariances);
  const auto k = before.plane.size();
  const Mat3 turn = matrix3(In<double>(name, "R", R, {3, 3}, Check::finite).data());
  const Vec3 way = vector3(name, "t", t);
  const In<double> change(name, "wobble", wobble, {k}, Check::finite);
  const double scale = std::exp(log_ratio);
  Out<double> plane({k, 3}), covariance({k, 3, 3});
  Out<bool> good({k});
  for (py::ssize_t i = 0; i < k; ++i) {
    const Gaussian was = before[i];
    const Vec3 rotated = scale * (turn * was.plane), row = transposed(turn) * way;
    const double nearer = 1 - dot(rotated, way);
    good[i] = nearer > 0;
    if (!good[i]) continue;
    const Vec3 now = (1 / nearer) * rotated;
    Mat3 J;
    for (int a = 0; a < 9; ++a)
      J[a] = scale * (turn[a] / nearer + rotated[a / 3] * row[a % 3] / (nearer * nearer));
    Mat3 S = J * was.covariance * transposed(J);
    for (int a = 0; a < 9; ++a)
      S[a] += ratio_sigma * ratio_sigma * now[a / 3] * now[a % 3] +
              change[i] * change[i] * dot(now, now) * IDENTITY[a];
    write({now, S}, i, plane, covariance);
  }
  return py::make_tuple(plane.array(), covariance.array(), good.array());
}

}  // namespace
}  // namespace kernels

void bind_surfaces(kernels::py::module_& module) {
  using namespace kernels;
  module.def("find_planes", find_planes);
  module.def("predict_planes", predict_planes);
  // Squared Mahalanobis distance (K,) of planes from another one, and the means with it.
  module.def("compare_planes", [](const py::object& planes, const py::object& covariances,
                                  const py::object& plane, const py::object& covariance) {
    const Planes each("compare_planes", planes, covariances);
    const Gaussian other{vector3("compare_planes", "plane", plane),
                         matrix3(In<double>("compare_planes", "covariance", covariance, {3, 3},
                                            Check::finite).data())};
    const auto k = each.plane.size();
    Out<double> off({k}), mean({k, 3}), less({k, 3, 3});
    for (py::ssize_t i = 0; i < k; ++i) {
      off[i] = distance(each[i], other);
      write(fused(each[i], other), i, mean, less);
    }
    return py::make_tuple(off.array(), mean.array(), less.array());
  });
}
