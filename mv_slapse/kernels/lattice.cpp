#include "lattice.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "arrays.hpp"
#include "movers.hpp"

namespace kernels {
namespace {

constexpr double MACROBLOCK = 16;  // px
constexpr double FARTHEST = 2048;  // macroblocks from the picture's corner: the box's limit

// The floor of the library is a call for each number.
int cell_of(double x) {
  const double cell = std::clamp((x + 0.5) / MACROBLOCK, -FARTHEST, FARTHEST);
  const int towards_zero = static_cast<int>(cell);
  return towards_zero - (towards_zero > cell);
}

}  // namespace

Cells::Cells(const double* x, int n) : column(n), row(n) {
  for (int i = 0; i < n; ++i) {
    column[i] = cell_of(x[2 * i]);
    row[i] = cell_of(x[2 * i + 1]);
  }
  for (auto [values, extent] : {std::pair{&column, &columns}, std::pair{&row, &rows}}) {
    if (!n) continue;
    int first = values->front(), last = first;
    for (const int value : *values) first = std::min(first, value), last = std::max(last, value);
    *extent = last - first + 1;
    for (int& value : *values) value -= first;
  }
}

Components::Components(const Cells& cells, int reach)
    : cells_(cells), gap_(2 * reach + 1), latest_(cells.columns), latest_row_(cells.columns),
      stamp_(static_cast<std::size_t>(cells.columns) * cells.rows) {}

int Components::root(int place) {
  while (parent_[place] != place) place = parent_[place] = parent_[parent_[place]];
  return place;
}

void Components::connect(int a, int b) {
  a = root(a), b = root(b);
  parent_[std::max(a, b)] = std::min(a, b);
}

// Sorts some numbers of blocks by their columns or rows, equal ones as they come.
void Components::sort(const std::vector<int>& from, const std::vector<int>& blocks,
                      const std::vector<int>& line, int lines, std::vector<int>& to) {
  begin_.assign(lines + 1, 0);
  for (const int i : blocks) ++begin_[line[i] + 1];
  std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
  to.resize(from.size());
  for (const int i : from) to[begin_[line[blocks[i]]]++] = i;
}

// Row by row each block is connected with the latest one of each column around. What lies around
// its neighbour in the row as well, the neighbour is connected with.
int Components::label(const std::vector<int>& blocks, std::vector<int>& component) {
  const int n = static_cast<int>(blocks.size());
  parent_.resize(n);
  std::iota(parent_.begin(), parent_.end(), 0);
  sort(parent_, blocks, cells_.column, cells_.columns, by_column_);
  sort(by_column_, blocks, cells_.row, cells_.rows, order_);
  std::fill(latest_row_.begin(), latest_row_.end(), -gap_ - 1);
  for (int place = 0, end = 0, row = -1; place < n; ++place) {
    const int block = blocks[order_[place]], column = cells_.column[block];
    int c = std::max(column - gap_, 0);
    if (std::exchange(row, cells_.row[block]) == row && column < end) {
      connect(place, place - 1);
      c = end;
    }
    end = std::min(column + gap_ + 1, cells_.columns);
    for (; c < end; ++c)
      if (row - latest_row_[c] <= gap_) connect(place, latest_[c]);
    latest_[column] = place;
    latest_row_[column] = row;
  }
  component.resize(n);
  number_.resize(n);
  int count = 0;
  for (int place = 0; place < n; ++place) {
    const int first = root(place);
    if (first == place) number_[place] = count++;
    component[order_[place]] = number_[first];
  }
  return count;
}

int Components::count(const std::vector<int>& blocks) {
  ++now_;
  int n = 0;
  for (const int i : blocks)
    if (std::exchange(stamp_[cells_.at(i)], now_) != now_) ++n;
  return n;
}

std::vector<int> Components::large(const std::vector<int>& blocks, int smallest) {
  const int n = label(blocks, component_);
  std::vector<int> cells(n), kept;
  ++now_;
  for (std::size_t i = 0; i < blocks.size(); ++i)
    if (std::exchange(stamp_[cells_.at(blocks[i])], now_) != now_) ++cells[component_[i]];
  for (std::size_t i = 0; i < blocks.size(); ++i)
    if (cells[component_[i]] >= smallest) kept.push_back(blocks[i]);
  return kept;
}

std::vector<int> Components::largest(const std::vector<int>& blocks) {
  const int n = label(blocks, component_);
  std::vector<int> size(n), kept;
  for (const int i : component_) ++size[i];
  const auto most = std::max_element(size.begin(), size.end()) - size.begin();
  for (std::size_t i = 0; i < blocks.size(); ++i)
    if (component_[i] == most) kept.push_back(blocks[i]);
  return kept;
}

namespace {

std::vector<int> all(int n) {
  std::vector<int> blocks(n);
  std::iota(blocks.begin(), blocks.end(), 0);
  return blocks;
}

// The grid of cells (rows, columns) that holds the values (N,) of blocks, -1 elsewhere.
py::array_t<std::int32_t> paint_cells(std::int64_t width, std::int64_t height,
                                      const py::object& x_, const py::object& block_,
                                      const py::object& values_) {
  constexpr auto kernel = "paint_cells";
  const In<double> x(kernel, "x", x_, {ANY, 2}), block(kernel, "block", block_, {x.size(), 2});
  const In<std::int32_t> values(kernel, "values", values_, {x.size()});
  BlockGrid grid(width, height);
  std::vector<std::int64_t> those(x.size());
  std::iota(those.begin(), those.end(), 0);
  grid.paint(x, block, those, [&](std::int64_t i) { return values[i]; });
  Out<std::int32_t> cells({grid.rows(), grid.columns()});
  std::copy_n(grid.data(), grid.size(), cells.data());
  return cells.array();
}

// The values of such a grid at pixels (N, 2), -1 outside.
py::array_t<std::int32_t> look_up_cells(const py::object& grid_, const py::object& x_) {
  constexpr auto kernel = "look_up_cells";
  const In<std::int32_t> grid(kernel, "grid", grid_, {ANY, ANY});
  const In<double> x(kernel, "x", x_, {ANY, 2});
  Out<std::int32_t> values({x.size()});
  const auto at = [](double v, py::ssize_t n) {
    v += 0.5;
    return v >= 0 && v < static_cast<double>(n * BlockGrid::SIZE)
               ? static_cast<py::ssize_t>(v / BlockGrid::SIZE)
               : -1;
  };
  for (py::ssize_t i = 0; i < x.size(); ++i) {
    const auto column = at(x(i, 0), grid.size(1)), row = at(x(i, 1), grid.size(0));
    values[i] = column < 0 || row < 0 ? -1 : grid(row, column);
  }
  return values.array();
}

}  // namespace
}  // namespace kernels

void bind_lattice(kernels::py::module_& module) {
  using namespace kernels;
  module.def("paint_cells", paint_cells);
  module.def("look_up_cells", look_up_cells);
  // Number (N,) of the connected component of each pixel (N, 2).
  module.def("components", [](const py::object& x, int reach) {
    const In<double> pixels("components", "x", x, {ANY, 2}, Check::finite);
    require(reach >= 0, "components", "reach must not be negative");
    const Cells cells(pixels.data(), static_cast<int>(pixels.size()));
    std::vector<int> component;
    Components(cells, reach).label(all(cells.size()), component);
    Out<std::int64_t> out({pixels.size()});
    std::copy(component.begin(), component.end(), out.data());
    return out.array();
  });
  // Mask (N,) of the pixels in components of at least `smallest` macroblocks.
  module.def("largest_components", [](const py::object& x, int smallest, int reach) {
    const In<double> pixels("largest_components", "x", x, {ANY, 2}, Check::finite);
    require(reach >= 0, "largest_components", "reach must not be negative");
    const Cells cells(pixels.data(), static_cast<int>(pixels.size()));
    Out<bool> out({pixels.size()});
    for (const int i : Components(cells, reach).large(all(cells.size()), smallest)) out[i] = true;
    return out.array();
  });
  // Of items in numbered cells (N,) the one of each cell with the largest `worth` (N,), of equal
  // ones that with the least `noise` (N,): their rows, in order. Cell -1 is none.
  module.def("best_of_cells", [](const py::object& cell_, int n_cells, const py::object& worth_,
                                 const py::object& noise_) {
    const char* kernel = "best_of_cells";
    const In<std::int64_t> cell(kernel, "cell", cell_, {ANY});
    const In<double> worth(kernel, "worth", worth_, {cell.size()}, Check::finite);
    const In<double> noise(kernel, "noise", noise_, {cell.size()}, Check::finite);
    std::vector<py::ssize_t> best(std::max(n_cells, 0), -1);
    for (py::ssize_t i = 0; i < cell.size(); ++i) {
      require(cell[i] < n_cells, kernel, "a cell is not one of them");
      if (cell[i] < 0) continue;
      py::ssize_t& now = best[cell[i]];
      if (now < 0 || worth[i] > worth[now] || (worth[i] == worth[now] && noise[i] < noise[now]))
        now = i;
    }
    best.erase(std::remove(best.begin(), best.end(), -1), best.end());
    std::sort(best.begin(), best.end());
    Out<std::int64_t> rows({static_cast<py::ssize_t>(best.size())});
    std::copy(best.begin(), best.end(), rows.data());
    return rows.array();
  });
  // In how many macroblocks pixels (N, 2) lie.
  module.def("count_macroblocks", [](const py::object& x) {
    const In<double> pixels("count_macroblocks", "x", x, {ANY, 2}, Check::finite);
    const Cells cells(pixels.data(), static_cast<int>(pixels.size()));
    return Components(cells).count(all(cells.size()));
  });
}
