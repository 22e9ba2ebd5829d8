// Checked views of numpy arrays. A kernel takes `In<float> x{"merge", "x", object, {ANY, 2}}` for
// each argument: a wrong one raises ValueError with the names of kernel and argument. Only arrays
// that are not contiguous are copied; a wrong type is an error at the border, no slow call.

#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <string>
#include <type_traits>

namespace kernels {

namespace py = pybind11;

constexpr py::ssize_t ANY = -1;  // a length that the kernel takes as it comes
enum class Check { none, finite };

[[noreturn]] inline void refuse(const char* kernel, const std::string& what) {
  throw py::value_error(std::string(kernel) + ": " + what);
}

// Ends a kernel whose arguments contradict each other, such as two columns of unlike length.
inline void require(bool good, const char* kernel, const char* what) {
  if (!good) refuse(kernel, what);
}

// A read-only array of T with a given number of axes.
template <typename T>
class In {
 public:
  In(const char* kernel, const char* name, const py::object& object,
     std::initializer_list<py::ssize_t> shape, Check check = Check::none) {
    if (!py::isinstance<py::array>(object)) refuse(kernel, says(name, shape, "is no numpy array"));
    array_ = py::reinterpret_borrow<py::array>(object);
    // Nearly always it is the very object; to compare two of them costs as much as all else here.
    const py::dtype own = array_.dtype(), wanted = py::dtype::of<T>();
    if (!own.is(wanted) && !own.equal(wanted))
      refuse(kernel, says(name, shape, "has dtype " + std::string(py::str(array_.dtype()))));
    if (!fits(shape))
      refuse(kernel, says(name, shape, "has shape " + std::string(py::str(array_.attr("shape")))));
    constexpr int good = py::array::c_style | py::detail::npy_api::NPY_ARRAY_ALIGNED_;
    if ((array_.flags() & good) != good)
      array_ = py::array_t<T, py::array::c_style | py::array::forcecast>::ensure(
          array_.attr("copy")("C"));
    data_ = static_cast<const T*>(array_.data());
    columns_ = array_.ndim() > 1 ? array_.shape(1) : 1;
    if constexpr (std::is_floating_point_v<T>)
      if (check == Check::finite) {
        bool finite = true;  // without a way out, so that the compiler can take several at a time
        for (py::ssize_t i = 0, n = array_.size(); i < n; ++i) finite &= std::isfinite(data_[i]);
        if (!finite) refuse(kernel, says(name, shape, "is not finite"));
      }
  }

  const T& operator[](py::ssize_t i) const { return data_[i]; }
  const T& operator()(py::ssize_t i, py::ssize_t j) const { return data_[i * columns_ + j]; }
  const T* data() const { return data_; }
  py::ssize_t size(int axis = 0) const { return array_.shape(axis); }

 private:
  bool fits(std::initializer_list<py::ssize_t> shape) const {
    if (array_.ndim() != static_cast<py::ssize_t>(shape.size())) return false;
    int axis = 0;
    for (const auto length : shape)
      if (const auto is = array_.shape(axis++); length != ANY && length != is) return false;
    return true;
  }

  static std::string says(const char* name, std::initializer_list<py::ssize_t> shape,
                          const std::string& what) {
    std::string text = std::string(name) + " " + what + "; it must be " +
                       std::string(py::str(py::dtype::of<T>())) + " of shape (";
    for (const auto length : shape) text += (length == ANY ? "N" : std::to_string(length)) + ", ";
    return text + ")";
  }

  py::array array_;
  const T* data_;
  py::ssize_t columns_;  // looked up once: asking the array for it costs more than the access
};

// A new array of T for results, zeros at first.
template <typename T>
class Out {
 public:
  explicit Out(std::initializer_list<py::ssize_t> shape)
      : array_(std::vector<py::ssize_t>(shape)), data_(array_.mutable_data()),
        columns_(array_.ndim() > 1 ? array_.shape(1) : 1) {
    std::fill(data_, data_ + array_.size(), T{});
  }

  T& operator[](py::ssize_t i) { return data_[i]; }
  T& operator()(py::ssize_t i, py::ssize_t j) { return data_[i * columns_ + j]; }
  T* data() { return data_; }
  const py::array_t<T>& array() const { return array_; }

 private:
  py::array_t<T> array_;
  T* data_;
  py::ssize_t columns_;
};

}  // namespace kernels
