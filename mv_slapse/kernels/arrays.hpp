// Checked views of numpy arrays. A kernel takes `In<float> x{"merge", "x", object, {ANY, 2}}` for
// each argument: a wrong one raises ValueError with the names of kernel and argument. Only arrays
// that are not contiguous are copied; a wrong type is an error at the border, no slow call.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <string>
#include <type_traits>
#include <utility>

#include "python.hpp"

namespace kernels {

constexpr py::ssize_t ANY = -1;  // a length that the kernel takes as it comes
enum class Check { none, finite };

[[noreturn]] inline void refuse(const char* kernel, const std::string& what) {
  throw py::value_error(std::string(kernel) + ": " + what);
}

// Ends a kernel whose arguments contradict each other, such as two columns of unlike length.
inline void require(bool good, const char* kernel, const char* what) {
  if (!good) refuse(kernel, what);
}

// A named constant of policy, which Python holds.
inline double policy(const py::dict& constants, const char* name) {
  return constants[name].cast<double>();
}

// Whether there is no NaN and nothing infinite among n numbers: each of those times zero is NaN, and
// sums of zeros side by side are what the compiler takes several of at a time.
template <typename T>
bool all_finite(const T* from, py::ssize_t n) {
  constexpr py::ssize_t SIDE_BY_SIDE = 8;
  T sums[SIDE_BY_SIDE] = {};
  py::ssize_t i = 0;
  for (; i + SIDE_BY_SIDE <= n; i += SIDE_BY_SIDE)
    for (py::ssize_t j = 0; j < SIDE_BY_SIDE; ++j) sums[j] += from[i + j] * T{0};
  for (; i < n; ++i) sums[0] += from[i] * T{0};
  T sum{};
  for (const T part : sums) sum += part;
  return sum == T{0};
}

// A read-only array of T with a given number of axes.
template <typename T>
class In {
 public:
  In(const char* kernel, const char* name, const py::object& object,
     std::initializer_list<py::ssize_t> shape, Check check = Check::none) {
    if (!py::is_array(object)) refuse(kernel, says(name, shape, "is no numpy array"));
    if (!py::has_type(object, py::type_of<T>()))
      refuse(kernel, says(name, shape, "has dtype " + py::text(object.attr("dtype"))));
    view_ = py::view(object);
    if (!fits(shape))
      refuse(kernel, says(name, shape, "has shape " + py::text(object.attr("shape"))));
    data_ = static_cast<const T*>(view_.data);
    columns_ = view_.ndim > 1 ? view_.shape[1] : 1;
    if constexpr (std::is_floating_point_v<T>)
      if (check == Check::finite) {
        if (!all_finite(data_, count())) refuse(kernel, says(name, shape, "is not finite"));
      }
  }

  const T& operator[](py::ssize_t i) const { return data_[i]; }
  const T& operator()(py::ssize_t i, py::ssize_t j) const { return data_[i * columns_ + j]; }
  const T* data() const { return data_; }
  py::ssize_t size(int axis = 0) const { return view_.shape[axis]; }

 private:
  bool fits(std::initializer_list<py::ssize_t> shape) const {
    if (view_.ndim != static_cast<int>(shape.size())) return false;
    int axis = 0;
    for (const auto length : shape)
      if (const auto is = view_.shape[axis++]; length != ANY && length != is) return false;
    return true;
  }

  py::ssize_t count() const {
    py::ssize_t out = 1;
    for (int axis = 0; axis < view_.ndim; ++axis) out *= view_.shape[axis];
    return out;
  }

  static std::string says(const char* name, std::initializer_list<py::ssize_t> shape,
                          const std::string& what) {
    std::string text = std::string(name) + " " + what + "; it must be " +
                       py::name_of(py::type_of<T>()) + " of shape (";
    for (const auto length : shape) text += (length == ANY ? "N" : std::to_string(length)) + ", ";
    return text + ")";
  }

  py::View view_;
  const T* data_;
  py::ssize_t columns_;  // looked up once: asking the array for it costs more than the access
};

// A new array of T for results, zeros at first.
template <typename T>
class Out {
 public:
  explicit Out(std::initializer_list<py::ssize_t> shape) : array_(made(shape, &data_)) {
    columns_ = shape.size() > 1 ? shape.begin()[1] : 1;
  }

  T& operator[](py::ssize_t i) { return data_[i]; }
  T& operator()(py::ssize_t i, py::ssize_t j) { return data_[i * columns_ + j]; }
  T* data() { return data_; }
  const py::array_t<T>& array() const { return array_; }

 private:
  static py::array_t<T> made(std::initializer_list<py::ssize_t> shape, T** data) {
    void* begin;
    py::array_t<T> out(py::new_array(py::type_of<T>(), shape, &begin));
    *data = static_cast<T*>(begin);
    return out;
  }

  T* data_;
  py::array_t<T> array_;
  py::ssize_t columns_;
};

}  // namespace kernels
