// A grey picture that Python lends, such as the first plane of what FFmpeg has decoded.

#pragma once

#include <optional>
#include <string>
#include <utility>

#include "arrays.hpp"

namespace kernels {

class Picture {  // grey levels, whose rows may be longer than they are wide
 public:
  const int width, height;

  static std::optional<Picture> of(const char* kernel, const char* name, const py::object& array) {
    if (array.is_none()) return {};
    return Picture(kernel, name, array);
  }
  const std::uint8_t* row(int y) const { return data_ + y * view_.row_bytes; }

 private:
  Picture(const char* kernel, const char* name, const py::object& array)
      : Picture(view(kernel, name, array)) {}
  explicit Picture(py::View view)
      : width(static_cast<int>(view.shape[1])), height(static_cast<int>(view.shape[0])),
        view_(std::move(view)), data_(static_cast<const std::uint8_t*>(view_.data)) {}
  static py::View view(const char* kernel, const char* name, const py::object& array) {
    if (!py::is_array(array) || !py::has_type(array, py::type_of<std::uint8_t>()))
      refuse(kernel, std::string(name) + " must be uint8 of shape (N, N, )");
    py::View out = py::view_of_rows(array);
    if (out.ndim != 2 || !out.shape[0] || !out.shape[1])
      refuse(kernel, std::string(name) + " must be a picture with a size");
    return out;
  }

  py::View view_;
  const std::uint8_t* data_;
};

}  // namespace kernels
