// Pairs joined to longer ones, and how much parallax they show, see codec/chaining.py.

#include "blocks.hpp"
#include "small.hpp"

namespace kernels {
namespace {

constexpr float STEADY = 0.3f;     // share of a vector by which the one before may differ
constexpr float ENOUGH = 0.25f;    // least weight of the macroblocks around that go on
constexpr int ROUNDS = 4;          // of reweighting
constexpr double FARTHER = 0.7;    // share of the blocks with less parallax than is told
constexpr float NOTHING = 1e-6f;   // in place of a weight of zero as a divisor

struct Pair {
  In<float> x_cur, x_prev, sigma, probability;
  In<std::uint8_t> block;

  Pair(const char* kernel, const py::tuple& columns)
      : x_cur(kernel, "x_cur", column(kernel, columns), {ANY, 2}, Check::finite),
        x_prev(kernel, "x_prev", columns[1], {x_cur.size(), 2}, Check::finite),
        sigma(kernel, "sigma", columns[2], {x_cur.size()}, Check::finite),
        probability(kernel, "probability", columns[3], {x_cur.size()}, Check::finite),
        block(kernel, "block", columns[4], {x_cur.size(), 2}) {}

  static py::object column(const char* kernel, const py::tuple& columns) {
    require(columns.size() == 5, kernel, "a pair has five columns");
    return columns[0];
  }
  py::ssize_t size() const { return x_cur.size(); }
  Vec2 vector(py::ssize_t i) const { return at(x_prev, i) - at(x_cur, i); }
};

struct Sample {
  Vec2 motion{};
  float variance = 0;
  bool known = false;
};

// The row of a pair's correspondence in each macroblock, with a border; -1: none.
class Table {
 public:
  Table(const Pair& pair, int width, int height, float least)
      : pair_(pair), columns_(macroblocks(width) + 2), rows_(macroblocks(height) + 2),
        table_(columns_ * rows_, -1) {
    for (py::ssize_t i = 0; i < pair.size(); ++i)
      if (!(pair.probability[i] < least)) table_[cell(at(pair.x_cur, i))] = static_cast<int>(i);
  }

  // Mean motion at a pixel of the (up to four) macroblocks that surround it. Those count that are
  // much like the nearest, and two on opposite sides of the middle one that agree with it in the
  // mean: on a road vectors grow from row to row by more than vectors may differ.
  Sample sample(Vec2 x, float slack, float tolerance) const {
    Vec2 vector[9];
    float sigma[9], weight[9];
    const int middle = cell(x);
    int lead = 0;
    for (int k = 0; k < 9; ++k) {
      const int row = table_[middle + (k / 3 - 1) * columns_ + k % 3 - 1];
      const Vec2 place = row < 0 ? Vec2{ABSENT, ABSENT} : at(pair_.x_cur, row);
      vector[k] = row < 0 ? Vec2{ABSENT, ABSENT} : pair_.vector(row);
      sigma[k] = row < 0 ? 0 : pair_.sigma[row];
      weight[k] = std::max(1 - std::abs(place.x - x.x) / MACROBLOCK, 0.0f) *
                  std::max(1 - std::abs(place.y - x.y) / MACROBLOCK, 0.0f);
      if (weight[k] > weight[lead]) lead = k;
    }
    const float reach = slack + tolerance * length(vector[lead]);
    for (int k = 0; k < 9; ++k)
      if (weight[k] > 0 && !(length(vector[k] - vector[lead]) < reach) &&
          !(length(0.5f * (vector[k] + vector[8 - k]) - vector[4]) < reach))
        weight[k] = 0;
    Sample out;
    const float whole = sum(weight);
    out.known = whole > ENOUGH;
    double x_sum = 0, y_sum = 0;
    float variance[9];
    for (int k = 0; k < 9; ++k) {
      weight[k] /= std::max(whole, NOTHING);
      x_sum += double(weight[k]) * vector[k].x;
      y_sum += double(weight[k]) * vector[k].y;
      variance[k] = weight[k] * (sigma[k] * sigma[k]);
    }
    out.motion = {static_cast<float>(x_sum), static_cast<float>(y_sum)};
    out.variance = sum(variance);
    return out;
  }

 private:
  int cell(Vec2 x) const {
    return std::clamp(macroblock_of(x.y) + 1, 1, rows_ - 2) * columns_ +
           std::clamp(macroblock_of(x.x) + 1, 1, columns_ - 2);
  }
  static float sum(const float* v) {  // in the order in which numpy adds nine numbers
    return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7])) + v[8];
  }

  const Pair& pair_;
  int columns_, rows_;
  std::vector<int> table_;
};

// Rows of the newer pair that go on in the older one, with where they came from, the standard
// deviation and the probability of that.
py::tuple chain(const py::tuple& newer, const py::tuple& older, int width, int height, float slack,
                float tolerance) {
  const char* name = "chain";
  const Pair now(name, newer), then(name, older);
  require(width > 0 && height > 0, name, "the picture has no size");
  const float least = least_supported(now.probability);
  const Table supported(then, width, height, least_supported(then.probability));
  const Table all(then, width, height, 0);
  std::vector<Sample> samples(now.size());
  bool some = false;
  for (py::ssize_t i = 0; i < now.size(); ++i) {
    const bool lone = now.probability[i] < least;
    samples[i] = (lone ? all : supported).sample(at(now.x_prev, i), slack, tolerance);
    // A lone one is moved on by lone ones too, if it goes on as before.
    if (const Vec2 vector = now.vector(i); lone)
      samples[i].known &= length(samples[i].motion - vector) < slack + STEADY * length(vector);
    some |= samples[i].known && !lone;
  }
  double mean = 0;
  for (py::ssize_t i = 0; i < then.size(); ++i) mean += then.probability[i];
  const float before = then.size() ? static_cast<float>(mean / double(then.size())) : 1.0f;
  std::vector<float> x_cur, x_prev, sigma, probability;
  std::vector<std::uint8_t> block;
  block.reserve(2 * now.size());
  for (auto* column : {&x_cur, &x_prev, &sigma, &probability}) column->reserve(2 * now.size());
  for (py::ssize_t i = 0; i < now.size() && some; ++i) {  // else none would be lone any more
    if (!samples[i].known) continue;
    const Vec2 from = at(now.x_prev, i) + samples[i].motion;
    x_cur.insert(x_cur.end(), {now.x_cur(i, 0), now.x_cur(i, 1)});
    x_prev.insert(x_prev.end(), {from.x, from.y});
    sigma.push_back(std::sqrt(now.sigma[i] * now.sigma[i] + samples[i].variance));
    probability.push_back(now.probability[i] * before);
    block.insert(block.end(), {now.block(i, 0), now.block(i, 1)});
  }
  return py::make_tuple(array_of(x_cur, 2), array_of(x_prev, 2), array_of(sigma),
                        array_of(probability), array_of(block, 2));
}

// Median length [px] of the vectors of a pair; of those that others support where it says so.
double median_flow(const py::object& cur, const py::object& prev, const py::object& chances) {
  const char* name = "median_flow";
  const In<float> x_cur(name, "x_cur", cur, {ANY, 2}, Check::finite);
  const In<float> x_prev(name, "x_prev", prev, {x_cur.size(), 2}, Check::finite);
  const In<float> probability(name, "probability", chances, {x_cur.size()}, Check::finite);
  const float least = least_supported(probability);
  std::vector<float> flow;
  flow.reserve(x_cur.size());
  for (py::ssize_t i = 0; i < x_cur.size(); ++i)
    if (!(probability[i] < least)) flow.push_back(length(at(x_prev, i) - at(x_cur, i)));
  return flow.empty() ? 0 : median(flow);
}

// Fit of three parameters to motions, weighted; zero where nothing fixes them.
class Fit {
 public:
  void add(const double (&du)[3], const double (&dv)[3], double u, double v, double weight) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) normal_[3 * i + j] += weight * (du[i] * du[j] + dv[i] * dv[j]);
      right_[i] += weight * (du[i] * u + dv[i] * v);
    }
  }
  Vec3 solve() {
    if (!cholesky(normal_.data(), 3)) return {};
    cholesky_solve(normal_.data(), 3, right_.data());
    return right_;
  }

 private:
  Mat3 normal_{};
  Vec3 right_{};
};

struct Point {
  double u, v;        // where it is now, normalised, or macroblocks from the mean
  Vec3 ray;           // where it was
  double left_u, left_v, weight;
};

// Quantile FARTHER of what is left of the motions, between the two nearest.
double farther(const std::vector<Point>& points) {
  std::vector<double> left;
  left.reserve(points.size());
  for (const Point& p : points) left.push_back(std::sqrt(p.left_u * p.left_u + p.left_v * p.left_v));
  const double place = FARTHER * double(left.size() - 1);
  const auto below = static_cast<std::size_t>(place);
  const double share = place - double(below);
  std::nth_element(left.begin(), left.begin() + below, left.end());
  const double low = left[below];
  const double high = below + 1 < left.size() ? *std::min_element(left.begin() + below + 1, left.end())
                                              : low;
  return low + share * (high - low);
}

// Length [px] of what the rotation that explains most leaves of the motions of ideal pixels, by
// Cauchy weights; without K shift and turn of the picture stand for the rotation.
double parallax(const py::object& cur, const py::object& prev, const py::object& calibration) {
  const char* name = "parallax";
  const In<double> x_cur(name, "x_cur", cur, {ANY, 2}, Check::finite);
  const In<double> x_prev(name, "x_prev", prev, {x_cur.size(), 2}, Check::finite);
  const auto n = x_cur.size();
  require(n > 0, name, "there are no correspondences");
  const bool turns = !calibration.is_none();
  Mat3 K{MACROBLOCK, 0, 0, 0, MACROBLOCK, 0, 0, 0, 1};
  if (turns) {
    const In<double> given(name, "K", calibration, {3, 3}, Check::finite);
    std::copy_n(given.data(), 9, K.begin());
    require(K[0] > 0 && K[4] > 0, name, "K has no focal length");
  } else {
    for (py::ssize_t i = 0; i < n; ++i) {
      K[2] += x_cur(i, 0) / double(n);
      K[5] += x_cur(i, 1) / double(n);
    }
  }
  const double focal = K[0];
  const auto ray = [&](const In<double>& x, py::ssize_t i) {
    const double v = (x(i, 1) - K[5]) / K[4];
    return Vec3{(x(i, 0) - K[2]) / K[0] - K[1] / K[0] * v, v, 1};
  };
  std::vector<Point> points(n);
  const auto leave = [&](Point& p) {
    p.left_u = focal * (p.ray[0] / p.ray[2] - p.u);
    p.left_v = focal * (p.ray[1] / p.ray[2] - p.v);
  };
  for (py::ssize_t i = 0; i < n; ++i) {
    const Vec3 now = ray(x_cur, i);
    points[i] = {now[0], now[1], ray(x_prev, i), 0, 0, 1};
    leave(points[i]);
  }
  for (int round = 0; round < ROUNDS; ++round) {
    Fit fit;
    for (const Point& p : points) {
      if (turns)
        fit.add({p.u * p.v, -(1 + p.u * p.u), p.v}, {1 + p.v * p.v, -p.u * p.v, -p.u},
                p.left_u / focal, p.left_v / focal, p.weight);
      else
        fit.add({1, 0, -p.v}, {0, 1, p.u}, p.ray[0] - p.u, p.ray[1] - p.v, p.weight);
    }
    const Vec3 found = fit.solve();
    const Mat3 R = rotation_exp(found);
    for (Point& p : points) {
      if (turns) {
        p.ray = R * p.ray;
        leave(p);
      } else {
        p.left_u = focal * (p.ray[0] - p.u - found[0] + p.v * found[2]);
        p.left_v = focal * (p.ray[1] - p.v - found[1] - p.u * found[2]);
      }
      p.weight = 1 / (1 + p.left_u * p.left_u + p.left_v * p.left_v);
    }
  }
  return farther(points);
}

}  // namespace
}  // namespace kernels

void bind_chaining(kernels::py::module_& module) {
  using namespace kernels;
  module.def("chain", chain);
  module.def("median_flow", median_flow);
  module.def("parallax", parallax);
}
