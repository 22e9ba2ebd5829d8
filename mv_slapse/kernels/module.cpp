// The Python module: every stage adds its kernels to it. A stage is one .cpp file.

#include <pybind11/pybind11.h>

void bind_ground(pybind11::module_& module);
void bind_lattice(pybind11::module_& module);
void bind_small(pybind11::module_& module);
void bind_surfaces(pybind11::module_& module);

PYBIND11_MODULE(mv_slapse_kernels, module) {
  module.doc() = "Kernels of mv_slapse: pure functions of arrays, without state or threads.";
  module.attr("sanitized") = SANITIZED;
  bind_ground(module);
  bind_lattice(module);
  bind_small(module);
  bind_surfaces(module);
}
