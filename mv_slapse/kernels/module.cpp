// The Python module: every stage adds its kernels to it. A stage is one .cpp file.

#include <pybind11/pybind11.h>

void bind_depth_grid(pybind11::module_& module);
void bind_ground(pybind11::module_& module);
void bind_body(pybind11::module_& module);
void bind_movers(pybind11::module_& module);
void bind_reference_depth(pybind11::module_& module);
void bind_region_score(pybind11::module_& module);
void bind_lattice(pybind11::module_& module);
void bind_obstacle_detection(pybind11::module_& module);
void bind_obstacle_motion(pybind11::module_& module);
void bind_scene(pybind11::module_& module);
void bind_scene_blocks(pybind11::module_& module);
void bind_baseline(pybind11::module_& module);
void bind_joint(pybind11::module_& module);
void bind_motion(pybind11::module_& module);
void bind_observations(pybind11::module_& module);
void bind_chaining(pybind11::module_& module);
void bind_evidence(pybind11::module_& module);
void bind_merging(pybind11::module_& module);
void bind_motion_prior(pybind11::module_& module);
void bind_small(pybind11::module_& module);
void bind_surfaces(pybind11::module_& module);
void bind_two_view(pybind11::module_& module);

PYBIND11_MODULE(mv_slapse_kernels, module) {
  module.doc() = "Kernels of mv_slapse: pure functions of arrays, without state or threads.";
  module.attr("sanitized") = SANITIZED;
  bind_depth_grid(module);
  bind_ground(module);
  bind_body(module);
  bind_movers(module);
  bind_reference_depth(module);
  bind_region_score(module);
  bind_lattice(module);
  bind_obstacle_detection(module);
  bind_obstacle_motion(module);
  bind_scene(module);
  bind_scene_blocks(module);
  bind_baseline(module);
  bind_joint(module);
  bind_motion(module);
  bind_observations(module);
  bind_chaining(module);
  bind_evidence(module);
  bind_merging(module);
  bind_motion_prior(module);
  bind_small(module);
  bind_surfaces(module);
  bind_two_view(module);
}
