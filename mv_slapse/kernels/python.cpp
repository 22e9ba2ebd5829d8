// See python.hpp: what numpy's arrays are to the kernels, by way of pybind11.

#include "python.hpp"

#include <pybind11/numpy.h>

#include <algorithm>
#include <unordered_map>

namespace kernels::py {

namespace {

namespace pb = pybind11;

pb::handle dtype_of(Type type) {
  static const pb::handle known[] = {
      pb::dtype::of<bool>().release(),         pb::dtype::of<std::int8_t>().release(),
      pb::dtype::of<std::uint8_t>().release(), pb::dtype::of<std::int32_t>().release(),
      pb::dtype::of<std::int64_t>().release(), pb::dtype::of<float>().release(),
      pb::dtype::of<double>().release()};
  return known[static_cast<int>(type)];
}

}  // namespace

bool is_array(const object& of) { return pb::isinstance<pb::array>(pb::handle(of.ptr())); }

bool has_type(const object& array, Type type) {
  const auto own = pb::reinterpret_borrow<pb::array>(array.ptr()).dtype();
  // Nearly always it is the very object; to compare two of them costs as much as all else here.
  return own.is(dtype_of(type)) || own.equal(dtype_of(type));
}

namespace {

View view_of(pb::array array, bool good) {
  if (!good) array = array.attr("copy")("C");
  View out;
  out.data = array.data();
  out.ndim = static_cast<int>(array.ndim());
  out.shape = array.shape();
  out.row_bytes = out.ndim ? array.strides(0) : 0;
  out.array = object::owned(array.release().ptr());
  return out;
}

}  // namespace

View view(const object& of) {
  auto array = pb::reinterpret_borrow<pb::array>(of.ptr());
  constexpr int good = pb::array::c_style | pb::detail::npy_api::NPY_ARRAY_ALIGNED_;
  return view_of(array, (array.flags() & good) == good);
}

View view_of_rows(const object& of) {
  auto array = pb::reinterpret_borrow<pb::array>(of.ptr());
  return view_of(array, array.ndim() == 2 && array.strides(0) > 0 &&
                            array.strides(1) == array.itemsize());
}

object new_array(Type type, std::initializer_list<ssize_t> shape, void** data) {
  pb::array array(pb::reinterpret_borrow<pb::dtype>(dtype_of(type)), std::vector<ssize_t>(shape));
  *data = array.mutable_data();
  std::fill_n(static_cast<char*>(*data), array.nbytes(), 0);
  return object::owned(array.release().ptr());
}

PyObject* string_of(const char* literal) {
  static std::unordered_map<const char*, PyObject*> known;
  PyObject*& string = known[literal];
  if (!string) string = PyUnicode_InternFromString(literal);
  if (!string) throw error_already_set();
  return string;
}

std::string name_of(Type type) { return pb::str(dtype_of(type)); }

std::string text(const object& of) { return pb::str(pb::handle(of.ptr())); }

void module_::add(const char* name, PyCFunction call, void* function) {
  // Both last as long as the process, as Python asks for.
  auto* method = new PyMethodDef{name, call, METH_FASTCALL | METH_KEYWORDS, nullptr};
  const object self = object::owned(PyCapsule_New(function, nullptr, nullptr));
  const object named = object::owned(PyUnicode_FromString("mv_slapse_kernels"));
  if (PyModule_AddObject(of_, name, PyCFunction_NewEx(method, self.ptr(), named.ptr())) < 0)
    throw pb::error_already_set();
}

}  // namespace kernels::py
