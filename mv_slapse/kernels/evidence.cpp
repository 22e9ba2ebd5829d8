// From FFmpeg's table of motion vectors to the evidence of a segment, [SLAPSE] III-A.

#include <array>
#include <cstring>
#include <limits>

#include "blocks.hpp"
#include "lanes.hpp"

namespace kernels {
namespace {

constexpr float HALVING = 0.25f;  // px from its prediction, at which the rise of a vector halves
constexpr float HALF = MACROBLOCK / 2.0f;  // px
constexpr int PAST = 0, FUTURE = 1;

// The columns of FrameVectors; direction -1 is PAST.
struct Picture {
  In<float> x, displacement;
  In<std::int8_t> direction;
  In<std::uint8_t> block;
  int columns, rows;  // cells, with a margin of one before and three behind
  int end;            // column beyond the last macroblock
  float rise;         // px, of a vector that equals its prediction; 0: unknown

  Picture(const char* kernel, const py::tuple& frame)
      : x(kernel, "x", field(kernel, frame, 0), {ANY, 2}, Check::finite),
        displacement(kernel, "displacement", frame[1], {x.size(), 2}, Check::finite),
        direction(kernel, "direction", frame[2], {x.size()}),
        block(kernel, "block", frame[3], {x.size(), 2}),
        columns(frame[4].cast<int>() / CELL + 4),
        rows(frame[5].cast<int>() / CELL + 4),
        end(1 + 2 * ((frame[4].cast<int>() + MACROBLOCK - 1) / MACROBLOCK)),
        rise(frame[6].cast<float>()) {
    require(columns >= 4 && rows >= 4, kernel, "the picture's size is negative");
  }

  static py::object field(const char* kernel, const py::tuple& frame, int i) {
    require(frame.size() == 7, kernel, "a frame has seven entries");
    return frame[i];
  }
  py::ssize_t size() const { return x.size(); }
  bool is(py::ssize_t i, int side) const { return direction[i] == (side == PAST ? -1 : 1); }
  py::ssize_t number(int side) const {
    return std::count(direction.data(), direction.data() + size(), side == PAST ? -1 : 1);
  }
  // Number of the cell at the upper left corner of a block; -1 outside the picture.
  int cell(py::ssize_t i) const {
    const int column = cell_of(x(i, 0), block(i, 0)) + 1, row = cell_of(x(i, 1), block(i, 1)) + 1;
    return column > 0 && column < columns - 1 && row > 0 && row < rows - 1 ? row * columns + column
                                                                           : -1;
  }
};

// Rises [px] of vectors that are so far [px] from their predictions, in place of these.
KERNELS_WIDE void rises(float most, int n, float* away) {
  for (int i = 0; i < n; ++i)
    away[i] = most * static_cast<float>(power_of_two(-away[i] / HALVING));
}

// Way [px] along the column from the middle of each block to where its vector tells of, see
// `prediction.py`; prediction of ITU-T H.264, 8.4.1.3.
std::vector<float> leaning(const Picture& p) {
  std::vector<float> lean(p.size(), 0.0f);
  if (p.rise == 0) return lean;
  constexpr Vec2 NONE{std::numeric_limits<float>::quiet_NaN(), 0};
  constexpr float FARTHEST = 250;  // px, beyond which the rise is nothing
  std::vector<Vec2> table(p.columns * p.rows);
  std::vector<int> cells(p.size()), large, which;
  std::vector<float> away;
  large.reserve(p.size());
  which.reserve(p.size());
  away.reserve(p.size());
  for (py::ssize_t i = 0; i < p.size(); ++i) cells[i] = p.cell(i);
  for (const int side : {PAST, FUTURE}) {
    if (!p.number(side)) continue;
    std::fill(table.begin(), table.end(), NONE);
    large.clear();
    for (py::ssize_t i = 0; i < p.size(); ++i) {
      if (!p.is(i, side) || cells[i] < 0 || !p.block(i, 0) || !p.block(i, 1)) continue;
      table[cells[i]] = at(p.displacement, i);
      if (p.block(i, 0) > CELL || p.block(i, 1) > CELL) large.push_back(static_cast<int>(i));
    }
    for (const auto& [dx, dy] : {std::array{1, 0}, {0, 1}, {1, 1}})
      for (const int i : large)
        if (p.block(i, 0) > CELL * dx && p.block(i, 1) > CELL * dy)
          table[cells[i] + dy * p.columns + dx] = at(p.displacement, i);
    for (py::ssize_t i = 0; i < p.size(); ++i) {
      const int cell = cells[i];
      if (!p.is(i, side) || p.block(i, 0) != MACROBLOCK || p.block(i, 1) != MACROBLOCK || cell < 0)
        continue;
      // To the right of the last macroblock there is none: the one above to the left is taken.
      const bool last = cell % p.columns + 2 >= p.end;
      const Vec2 around[3] = {table[cell - 1], table[cell - p.columns],
                              table[cell - p.columns + (last ? -1 : 2)]};
      Vec2 use[3], only{};
      int there = 0;
      for (int k = 0; k < 3; ++k) {
        const bool has = !std::isnan(around[k].x);
        use[k] = has ? around[k] : Vec2{};
        if (has && there++ == 0) only = around[k];
      }
      const Vec2 median{middle(use[0].x, use[1].x, use[2].x), middle(use[0].y, use[1].y, use[2].y)};
      const Vec2 gap = at(p.displacement, i) - (there == 1 ? only : median);
      const float largest = std::max(std::abs(gap.x), std::abs(gap.y));
      which.push_back(static_cast<int>(i));
      away.push_back(std::min(largest, FARTHEST));
    }
  }
  rises(-p.rise, static_cast<int>(away.size()), away.data());
  for (std::size_t k = 0; k < which.size(); ++k) lean[which[k]] = away[k];
  return lean;
}

// Rows of the two vectors of each block of a B frame that has both, in the order of the cells, and
// whether they agree: nearly uniform motion makes them opposite and as long as the two times.
struct Both {
  py::ssize_t past, future;
  bool good;
};

std::vector<Both> both(const Picture& p, float share, float slack, float tolerance) {
  std::vector<std::array<py::ssize_t, 2>> found(p.columns * p.rows, {-1, -1});
  for (py::ssize_t i = 0; i < p.size(); ++i)
    if (const int cell = p.cell(i); cell >= 0 && p.direction[i] != 0)
      found[cell][p.is(i, PAST) ? PAST : FUTURE] = i;
  std::vector<Both> out;
  out.reserve(p.size());
  for (const auto& [past, future] : found) {
    if (past < 0 || future < 0 || p.block(past, 0) != p.block(future, 0) ||
        p.block(past, 1) != p.block(future, 1))
      continue;
    const Vec2 to_past = at(p.displacement, past);
    const Vec2 vector = to_past - at(p.displacement, future);
    const float bend = length(to_past - share * vector);
    out.push_back({past, future, bend < slack + tolerance * length(vector)});
  }
  return out;
}

// Rows of evidence, whose number is known beforehand.
struct Rows {
  Out<float> x, vector, variance;
  Out<std::uint8_t> block;
  py::ssize_t there = 0;

  explicit Rows(py::ssize_t n) : x({n, 2}), vector({n, 2}), variance({n}), block({n, 2}) {}
  void add(Vec2 place, Vec2 way, float var, const Picture& p, py::ssize_t i) {
    x(there, 0) = place.x, x(there, 1) = place.y;
    vector(there, 0) = way.x, vector(there, 1) = way.y;
    variance[there] = var;
    block(there, 0) = p.block(i, 0), block(there, 1) = p.block(i, 1);
    ++there;
  }
  py::tuple arrays() const {
    return py::make_tuple(x.array(), vector.array(), variance.array(), block.array());
  }
};

py::tuple direct(const py::tuple& frame) {
  const Picture p("direct", frame);
  const auto lean = leaning(p);
  Rows out(p.number(PAST));
  for (py::ssize_t i = 0; i < p.size(); ++i)
    if (p.is(i, PAST))
      out.add({p.x(i, 0), p.x(i, 1) + lean[i]}, at(p.displacement, i), 1, p, i);
  return out.arrays();
}

py::tuple indirect(const py::tuple& frame, float share, float slack, float tolerance) {
  const Picture p("indirect", frame);
  const auto lean = leaning(p);
  const std::vector<Both> pairs = both(p, share, slack, tolerance);
  Rows out(std::count_if(pairs.begin(), pairs.end(), [](const Both& pair) { return pair.good; }));
  for (const auto& [past, future, good] : pairs) {
    if (!good) continue;
    const Vec2 to_future = at(p.displacement, future);
    const Vec2 place{p.x(past, 0), p.x(past, 1) + 0.5f * (lean[past] + lean[future])};
    out.add(place + to_future, at(p.displacement, past) - to_future, 2, p, past);
  }
  return out.arrays();
}

// The vectors of a B frame to its past, and those to its future turned round, without bent ones.
py::tuple halves(const py::tuple& frame, float share, float slack, float tolerance) {
  const Picture p("halves", frame);
  const auto lean = leaning(p);
  std::vector<bool> wrong(p.size(), false);
  py::ssize_t bent = 0;  // one to each side
  for (const auto& [past, future, good] : both(p, share, slack, tolerance)) {
    bent += !good;
    if (!good) wrong[past] = wrong[future] = true;
  }
  Rows first(p.number(PAST) - bent), second(p.number(FUTURE) - bent);
  for (py::ssize_t i = 0; i < p.size(); ++i) {
    if (wrong[i]) continue;
    // Each block is all that its macroblock has, and stays in it.
    const Vec2 place{p.x(i, 0), p.x(i, 1) + std::max(lean[i], -HALF)};
    const Vec2 way = at(p.displacement, i);
    if (p.is(i, PAST)) first.add(place, way, 1, p, i);
    if (p.is(i, FUTURE)) second.add(place + way, {-way.x, -way.y}, 1, p, i);
  }
  return py::make_tuple(first.arrays(), second.arrays());
}

// Columns of FrameVectors from the bytes of FFmpeg's AVMotionVector rows.
py::tuple motion_vectors(const py::object& exported) {
  struct Row {  // libavutil/motion_vector.h
    std::int32_t source;
    std::uint8_t w, h;
    std::int16_t src_x, src_y, dst_x, dst_y;
    std::uint64_t flags;
    std::int32_t motion_x, motion_y;
    std::uint16_t motion_scale;
  };
  static_assert(sizeof(Row) == 40);
  const In<std::uint8_t> bytes("motion_vectors", "exported", exported, {ANY});
  require(bytes.size() % sizeof(Row) == 0, "motion_vectors", "a row has 40 bytes");
  const auto n = static_cast<py::ssize_t>(bytes.size() / sizeof(Row));
  Out<float> x({n, 2}), displacement({n, 2});
  Out<std::int8_t> direction({n});
  Out<std::uint8_t> block({n, 2});
  for (py::ssize_t i = 0; i < n; ++i) {
    Row row;
    std::memcpy(&row, bytes.data() + i * sizeof(Row), sizeof(Row));
    const float scale = std::max<float>(row.motion_scale, 1);
    x(i, 0) = row.dst_x - 0.5f;
    x(i, 1) = row.dst_y - 0.5f;
    displacement(i, 0) = static_cast<float>(row.motion_x) / scale;
    displacement(i, 1) = static_cast<float>(row.motion_y) / scale;
    direction[i] = (row.source > 0) - (row.source < 0);
    block(i, 0) = row.w;
    block(i, 1) = row.h;
  }
  return py::make_tuple(x.array(), displacement.array(), direction.array(), block.array());
}

}  // namespace
}  // namespace kernels

void bind_evidence(kernels::py::module_& module) {
  using namespace kernels;
  module.def("motion_vectors", motion_vectors);
  module.def("leaning", [](const py::tuple& frame) {
    return array_of(leaning(Picture("leaning", frame)));
  });
  module.def("direct", direct);
  module.def("indirect", indirect);
  module.def("halves", halves);
}
