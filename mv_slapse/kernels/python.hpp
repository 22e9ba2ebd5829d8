// The little of Python that kernels need: objects, tuples, dicts, new arrays, functions. Its names
// are those of pybind11, which costs five seconds of compilation a file; only python.cpp and
// module.cpp include that.

#pragma once

#include <Python.h>

#include <cstdint>
#include <initializer_list>
#include <new>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace kernels::py {

using ssize_t = Py_ssize_t;

struct value_error : std::runtime_error {
  using std::runtime_error::runtime_error;
};
struct error_already_set {};  // Python has been told of it

// The string of a literal, made once for each place that names it.
PyObject* string_of(const char* literal);

class object {
 public:
  object() = default;
  object(const object& other) : of_(other.of_) { Py_XINCREF(of_); }
  object(object&& other) noexcept : of_(std::exchange(other.of_, nullptr)) {}
  object& operator=(object other) noexcept {
    std::swap(of_, other.of_);
    return *this;
  }
  ~object() { Py_XDECREF(of_); }

  // Takes over a new reference, such as Python's functions return, or ends the kernel.
  static object owned(PyObject* of) {
    if (!of) throw error_already_set();
    object out;
    out.of_ = of;
    return out;
  }
  static object borrowed(PyObject* of) {
    Py_XINCREF(of);
    return owned(of);
  }

  PyObject* ptr() const { return of_; }
  PyObject* release() { return std::exchange(of_, nullptr); }
  bool is_none() const { return of_ == Py_None; }
  object attr(const char* name) const { return owned(PyObject_GetAttr(of_, string_of(name))); }
  template <typename T>
  T cast() const;

 private:
  PyObject* of_ = nullptr;
};

inline object none() { return object::borrowed(Py_None); }

struct tuple : object {
  explicit tuple(object of) : object(std::move(of)) {
    if (!PyTuple_Check(ptr())) throw value_error("an argument must be a tuple");
  }
  ssize_t size() const { return PyTuple_GET_SIZE(ptr()); }
  object operator[](ssize_t i) const { return borrowed(PyTuple_GetItem(ptr(), i)); }
};

struct list : object {
  explicit list(object of) : object(std::move(of)) {
    if (!PyList_Check(ptr())) throw value_error("an argument must be a list");
  }
  ssize_t size() const { return PyList_GET_SIZE(ptr()); }
  object operator[](ssize_t i) const { return borrowed(PyList_GetItem(ptr(), i)); }
};

struct dict : object {
  explicit dict(object of) : object(std::move(of)) {
    if (!PyDict_Check(ptr())) throw value_error("an argument must be a dict");
  }
  object operator[](const char* key) const {
    PyObject* item = PyDict_GetItemWithError(ptr(), string_of(key));
    if (item) return borrowed(item);
    if (PyErr_Occurred()) throw error_already_set();
    throw value_error(std::string("no constant ") + key);
  }
};

struct kwargs : dict {
  using dict::dict;
};

// What arrays hold, and an array as the kernels see it.
enum class Type { boolean, int8, uint8, int32, int64, float32, float64 };
template <typename T>
constexpr Type type_of() {
  if constexpr (std::is_same_v<T, bool>) return Type::boolean;
  else if constexpr (std::is_same_v<T, std::int8_t>) return Type::int8;
  else if constexpr (std::is_same_v<T, std::uint8_t>) return Type::uint8;
  else if constexpr (std::is_same_v<T, std::int32_t>) return Type::int32;
  else if constexpr (std::is_same_v<T, std::int64_t>) return Type::int64;
  else if constexpr (std::is_same_v<T, float>) return Type::float32;
  else {
    static_assert(std::is_same_v<T, double>, "kernels have no arrays of that");
    return Type::float64;
  }
}

struct View {
  object array;  // contiguous: itself, or a copy
  const void* data = nullptr;
  int ndim = 0;
  const ssize_t* shape = nullptr;
  ssize_t row_bytes = 0;  // from the beginning of one row to that of the next
};

bool is_array(const object& of);
bool has_type(const object& array, Type type);
View view(const object& array);
View view_of_rows(const object& array);  // of two axes; between its rows there may be other bytes
object new_array(Type type, std::initializer_list<ssize_t> shape, void** data);  // zeros
std::string name_of(Type type);
std::string text(const object& of);

template <typename T>
struct array_t : object {
  explicit array_t(object of) : object(std::move(of)) {}
  ssize_t shape(int axis) const { return view(*this).shape[axis]; }
};

template <typename T>
T object::cast() const {
  if constexpr (std::is_base_of_v<object, T>) {
    if constexpr (std::is_same_v<object, T>) return *this;
    else return T(*this);
  } else if constexpr (std::is_same_v<T, bool>) {
    const int truth = PyObject_IsTrue(of_);
    if (truth < 0) throw error_already_set();
    return truth;
  } else if constexpr (std::is_floating_point_v<T>) {
    const double value = PyFloat_AsDouble(of_);
    if (value == -1 && PyErr_Occurred()) throw error_already_set();
    return static_cast<T>(value);
  } else {
    static_assert(std::is_integral_v<T>, "kernels take no such argument");
    const auto value = PyLong_AsLongLong(of_);
    if (value == -1 && PyErr_Occurred()) throw error_already_set();
    if ((std::is_unsigned_v<T> && value < 0) ||
        static_cast<long long>(static_cast<T>(value)) != value)
      throw value_error("a number is out of range");
    return static_cast<T>(value);
  }
}

template <typename T>
object made(T&& value) {
  using Plain = std::decay_t<T>;
  if constexpr (std::is_base_of_v<object, Plain>) return std::forward<T>(value);
  else if constexpr (std::is_same_v<Plain, bool>) return object::borrowed(value ? Py_True : Py_False);
  else if constexpr (std::is_floating_point_v<Plain>)
    return object::owned(PyFloat_FromDouble(value));
  else return object::owned(PyLong_FromLongLong(value));
}

template <typename... T>
tuple make_tuple(T&&... values) {
  object out = object::owned(PyTuple_New(sizeof...(T)));
  ssize_t i = 0;
  (PyTuple_SET_ITEM(out.ptr(), i++, made(std::forward<T>(values)).release()), ...);
  return tuple(std::move(out));
}

// Calls a kernel for Python: takes the arguments from it, and gives it result or exception.
template <typename Result, typename... Args>
struct Call {
  using Function = Result (*)(Args...);
  static constexpr bool keywords =
      (std::is_same_v<std::decay_t<Args>, kwargs> || ...);  // the last one, if any
  static constexpr ssize_t positions = sizeof...(Args) - keywords;

  template <typename T>
  static auto argument(PyObject* const* given, ssize_t i, const object& named) {
    if constexpr (std::is_same_v<T, kwargs>) return kwargs(named);
    else return object::borrowed(given[i]).template cast<T>();
  }

  template <std::size_t... I>
  static object called(Function function, PyObject* const* given, const object& named,
                       std::index_sequence<I...>) {
    return made(function(argument<std::decay_t<Args>>(given, I, named)...));
  }

  static PyObject* from_python(PyObject* self, PyObject* const* given, ssize_t number,
                               PyObject* names) {
    const ssize_t by_name = names ? PyTuple_GET_SIZE(names) : 0;
    if (number != positions || (by_name && !keywords)) {
      PyErr_Format(PyExc_TypeError, "the kernel takes %zd arguments by position, not %zd",
                   positions, number + (keywords ? 0 : by_name));
      return nullptr;
    }
    try {
      object named = keywords ? object::owned(PyDict_New()) : object();
      for (ssize_t i = 0; keywords && i < by_name; ++i)
        if (PyDict_SetItem(named.ptr(), PyTuple_GET_ITEM(names, i), given[number + i]) < 0)
          throw error_already_set();
      const auto function = reinterpret_cast<Function>(PyCapsule_GetPointer(self, nullptr));
      return called(function, given, named, std::index_sequence_for<Args...>()).release();
    } catch (const error_already_set&) {
    } catch (const value_error& error) {
      PyErr_SetString(PyExc_ValueError, error.what());
    } catch (const std::bad_alloc&) {
      PyErr_NoMemory();
    } catch (const std::exception& error) {
      PyErr_SetString(PyExc_RuntimeError, error.what());
    }
    return nullptr;
  }
};

class module_ {
 public:
  explicit module_(PyObject* of) : of_(of) {}

  template <typename Function>
  void def(const char* name, Function function) {
    bind(name, +function);  // a lambda becomes a pointer
  }

 private:
  template <typename Result, typename... Args>
  void bind(const char* name, Result (*function)(Args...)) {
    add(name, reinterpret_cast<PyCFunction>(
                  reinterpret_cast<void (*)()>(Call<Result, Args...>::from_python)),
        reinterpret_cast<void*>(function));
  }
  void add(const char* name, PyCFunction call, void* function);

  PyObject* of_;
};

}  // namespace kernels::py
