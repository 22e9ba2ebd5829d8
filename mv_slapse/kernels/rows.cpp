// Rows of the columns of a record, by their numbers: all with one call. Numpy takes column by column
// and calls a function for each row.

#include "arrays.hpp"

namespace kernels {
namespace {

template <typename T>
py::object taken(const char* kernel, const py::object& column, const In<std::int64_t>& rows,
                 py::ssize_t n) {
  const py::View from = py::view(column);
  require(from.ndim > 0 && from.ndim < 4 && from.shape[0] == n, kernel,
          "columns must have one to three axes, and as many rows as each other");
  const py::ssize_t m = rows.size(), high = from.ndim > 1 ? from.shape[1] : 1,
                    deep = from.ndim > 2 ? from.shape[2] : 1, width = high * deep;
  Out<T> out = from.ndim == 1   ? Out<T>({m})
               : from.ndim == 2 ? Out<T>({m, high})
                                : Out<T>({m, high, deep});
  const T* values = static_cast<const T*>(from.data);
  T* to = out.data();
  const auto copy = [&](py::ssize_t of) {
    for (py::ssize_t i = 0; i < m; ++i)
      for (py::ssize_t k = 0; k < of; ++k) to[i * of + k] = values[rows[i] * of + k];
  };
  switch (width) {  // whose moves the compiler writes out
    case 1: copy(1); break;
    case 2: copy(2); break;
    case 3: copy(3); break;
    default: copy(width);
  }
  return out.array();
}

py::object taken(const char* kernel, const py::object& column, const In<std::int64_t>& rows,
                 py::ssize_t n) {
  if (py::has_type(column, py::Type::float64)) return taken<double>(kernel, column, rows, n);
  if (py::has_type(column, py::Type::float32)) return taken<float>(kernel, column, rows, n);
  if (py::has_type(column, py::Type::boolean)) return taken<bool>(kernel, column, rows, n);
  if (py::has_type(column, py::Type::int8)) return taken<std::int8_t>(kernel, column, rows, n);
  if (py::has_type(column, py::Type::uint8)) return taken<std::uint8_t>(kernel, column, rows, n);
  if (py::has_type(column, py::Type::int32)) return taken<std::int32_t>(kernel, column, rows, n);
  if (py::has_type(column, py::Type::int64)) return taken<std::int64_t>(kernel, column, rows, n);
  refuse(kernel, "a column has dtype " + py::text(column.attr("dtype")));
}

py::tuple take_rows(const py::tuple& columns, const py::object& numbers) {
  constexpr auto kernel = "take_rows";
  const In<std::int64_t> rows(kernel, "rows", numbers, {ANY});
  require(columns.size() > 0, kernel, "there must be a column");
  for (py::ssize_t k = 0; k < columns.size(); ++k)
    require(py::is_array(columns[k]), kernel, "a column is no numpy array");
  const py::View first = py::view(columns[0]);
  require(first.ndim > 0, kernel, "a column has no rows");
  const auto n = first.shape[0];
  bool there = true;
  for (py::ssize_t i = 0; i < rows.size(); ++i) there &= rows[i] >= 0 && rows[i] < n;
  require(there, kernel, "a row is not there");
  const py::object out = py::object::owned(PyTuple_New(columns.size()));
  for (py::ssize_t k = 0; k < columns.size(); ++k)
    PyTuple_SET_ITEM(out.ptr(), k, taken(kernel, columns[k], rows, n).release());
  return py::tuple(out);
}

}  // namespace
}  // namespace kernels

void bind_rows(kernels::py::module_& module) { module.def("take_rows", kernels::take_rows); }
