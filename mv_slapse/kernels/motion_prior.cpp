// The motion field of the pairs before, as the expectation for the next one, see codec/prior.py.

#include <optional>

#include "blocks.hpp"

namespace kernels {
namespace {

constexpr float FORGET = 0.5f;  // share of the older field that stays where there is a newer one
constexpr double BESIDE = 0.5, ALONE = 0.1;  // weight of the older field, with and without a newer
constexpr int SPREAD[] = {1, 3, 7, 15};  // macroblocks to each side, windows that fill holes
constexpr float TRIM[] = {64, 24, 12, 12};   // px, about the shift
constexpr py::ssize_t SAMPLE = 600, FEWEST = 20;  // vectors that are enough to find the shift

// Velocity (rows, columns, 2) [px/s] after a pair; of the finest window that has any.
py::array_t<float> prior_update(const py::tuple& pair, const py::object& before, int width,
                                int height, float seconds) {
  const char* name = "prior_update";
  require(width > 0 && height > 0, name, "the picture has no size");
  const int columns = macroblocks(width), rows = macroblocks(height), n = columns * rows;
  const std::vector<Vec2> field = field_of(name, pair, columns, rows);
  // Sums over all macroblocks above and to the left, so that a window costs four look-ups.
  struct Sum {
    double x, y, weight;
  };
  std::vector<Sum> sums((columns + 1) * (rows + 1), Sum{});
  std::optional<In<float>> known;
  const std::initializer_list<py::ssize_t> shape{rows, columns, 2};
  if (!before.is_none()) known.emplace(name, "before", before, shape, Check::finite);
  const float* older = known ? known->data() : nullptr;
  for (int i = 0; i < n; ++i) {
    const bool here = !std::isnan(field[i].x);
    float x = here ? field[i].x / seconds : 0, y = here ? field[i].y / seconds : 0, weight = here;
    if (older) {
      const double share = here ? BESIDE : ALONE;
      x = static_cast<float>(x + double(FORGET * older[2 * i]) * share);
      y = static_cast<float>(y + double(FORGET * older[2 * i + 1]) * share);
      weight += FORGET * static_cast<float>(share);
    }
    const int at = (i / columns + 1) * (columns + 1) + i % columns + 1;
    const Sum &left = sums[at - 1], &above = sums[at - columns - 1], &both = sums[at - columns - 2];
    sums[at] = {x + left.x + above.x - both.x, y + left.y + above.y - both.y,
                weight + left.weight + above.weight - both.weight};
  }
  Out<float> out({rows, columns, 2});
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column)
      for (const int side : SPREAD) {
        const int top = std::max(row - side, 0), bottom = std::min(row + side + 1, rows);
        const int first = std::max(column - side, 0), last = std::min(column + side + 1, columns);
        const Sum &a = sums[top * (columns + 1) + first], &b = sums[top * (columns + 1) + last];
        const Sum &c = sums[bottom * (columns + 1) + first], &d = sums[bottom * (columns + 1) + last];
        const double weight = d.weight - b.weight - c.weight + a.weight;
        if (!(weight > 0.9)) continue;  // one macroblock with a vector
        out[2 * (row * columns + column)] = static_cast<float>((d.x - b.x - c.x + a.x) / weight);
        out[2 * (row * columns + column) + 1] = static_cast<float>((d.y - b.y - c.y + a.y) / weight);
        break;
      }
  return out.array();
}

// Vectors (rows, columns, 2) [px] that a velocity lets expect, moved by the shift that most of the
// vectors at hand show: a turn of the camera moves the whole picture.
py::array_t<float> prior_field(const py::object& velocities, float seconds, const py::object& places,
                               const py::object& vectors) {
  const char* name = "prior_field";
  const In<float> velocity(name, "velocity", velocities, {ANY, ANY, 2}, Check::finite);
  const In<float> x(name, "x", places, {ANY, 2}, Check::finite);
  const In<float> vector(name, "vector", vectors, {x.size(), 2}, Check::finite);
  const auto rows = velocity.size(0), columns = velocity.size(1);
  require(rows && columns, name, "the field is empty");
  std::vector<Vec2> gap;
  gap.reserve(2 * SAMPLE);
  for (py::ssize_t i = 0; i < x.size(); i += std::max<py::ssize_t>(x.size() / SAMPLE, 1))
    gap.push_back(at(vector, i) -
                  seconds * at(velocity, nearest_macroblock(at(x, i), columns, rows)));
  Vec2 shift{};
  std::vector<float> near[2];
  for (auto& values : near) values.reserve(gap.size());
  std::vector<std::uint8_t> inside(gap.size(), 0), before;
  for (const float width : TRIM) {
    before = inside;
    for (std::size_t i = 0; i < gap.size(); ++i)
      inside[i] = std::abs(gap[i].x - shift.x) < width && std::abs(gap[i].y - shift.y) < width;
    if (inside == before) continue;  // the same vectors have the same medians
    near[0].clear();
    near[1].clear();
    for (std::size_t i = 0; i < gap.size(); ++i)
      if (inside[i]) {
        near[0].push_back(gap[i].x);
        near[1].push_back(gap[i].y);
      }
    if (static_cast<py::ssize_t>(near[0].size()) < FEWEST) break;
    shift = {median(near[0]), median(near[1])};
  }
  Out<float> out({rows, columns, 2});
  for (py::ssize_t i = 0; i < rows * columns; ++i) {
    out[2 * i] = seconds * velocity[2 * i] + shift.x;
    out[2 * i + 1] = seconds * velocity[2 * i + 1] + shift.y;
  }
  return out.array();
}

}  // namespace
}  // namespace kernels

void bind_motion_prior(kernels::py::module_& module) {
  using namespace kernels;
  module.def("prior_update", prior_update);
  module.def("prior_field", prior_field);
}
