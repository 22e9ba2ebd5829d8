// The lattice of macroblocks: cells of pixels, connected components, counts.

#pragma once

#include <vector>

namespace kernels {

// Columns and rows of the macroblocks in which n pixels lie, from 0, and the size of their box.
struct Cells {
  std::vector<int> column, row;
  int columns = 0, rows = 0;

  // x: (n, 2) pixels, finite. Far off any picture cells end, so that the box stays small.
  Cells(const double* x, int n);
  int size() const { return static_cast<int>(column.size()); }
  int at(int block) const { return row[block] * columns + column[block]; }
};

// Finds connected components of parts of the same cells; it keeps its scratch memory.
class Components {
 public:
  explicit Components(const Cells& cells, int reach = 1);

  // Numbers the components of some blocks, in the order of their first cells, row by row; blocks
  // are connected over gaps of up to 2 reach cells. Writes a number for each and returns how many.
  int label(const std::vector<int>& blocks, std::vector<int>& component);
  // How many cells some blocks lie in.
  int count(const std::vector<int>& blocks);
  // Those of some blocks in components of at least `smallest` cells.
  std::vector<int> large(const std::vector<int>& blocks, int smallest);
  // The component of most blocks, the first of equal ones; empty of none.
  std::vector<int> largest(const std::vector<int>& blocks);

 private:
  int root(int place);
  void connect(int a, int b);
  void sort(const std::vector<int>& from, const std::vector<int>& blocks,
            const std::vector<int>& line, int lines, std::vector<int>& to);

  const Cells& cells_;
  const int gap_;  // cells from one to another that it is connected with
  std::vector<int> latest_, latest_row_;  // of each column: the last block's place in the order
  std::vector<int> stamp_, component_, number_, parent_, begin_, by_column_, order_;
  int now_ = 0;
};

}  // namespace kernels
