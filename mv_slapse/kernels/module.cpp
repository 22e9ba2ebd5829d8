// The Python module: every stage adds its kernels to it. A stage is one .cpp file.

#include <pybind11/pybind11.h>

#include "python.hpp"

void bind_block_map(kernels::py::module_& module);
void bind_ground(kernels::py::module_& module);
void bind_body(kernels::py::module_& module);
void bind_movers(kernels::py::module_& module);
void bind_moving_plane(kernels::py::module_& module);
void bind_reference_depth(kernels::py::module_& module);
void bind_region_score(kernels::py::module_& module);
void bind_lattice(kernels::py::module_& module);
void bind_obstacle_detection(kernels::py::module_& module);
void bind_obstacle_motion(kernels::py::module_& module);
void bind_rows(kernels::py::module_& module);
void bind_scene(kernels::py::module_& module);
void bind_scene_blocks(kernels::py::module_& module);
void bind_joint(kernels::py::module_& module);
void bind_motion(kernels::py::module_& module);
void bind_observations(kernels::py::module_& module);
void bind_chaining(kernels::py::module_& module);
void bind_evidence(kernels::py::module_& module);
void bind_merging(kernels::py::module_& module);
void bind_motion_prior(kernels::py::module_& module);
void bind_silhouettes(kernels::py::module_& module);
void bind_small(kernels::py::module_& module);
void bind_strips(kernels::py::module_& module);
void bind_strip_depths(kernels::py::module_& module);
void bind_surfaces(kernels::py::module_& module);
void bind_texture(kernels::py::module_& module);
void bind_two_view(kernels::py::module_& module);

PYBIND11_MODULE(mv_slapse_kernels, made) {
  made.doc() = "Kernels of mv_slapse: pure functions of arrays, without state or threads.";
  made.attr("sanitized") = SANITIZED;
  kernels::py::module_ module(made.ptr());
  bind_block_map(module);
  bind_ground(module);
  bind_body(module);
  bind_movers(module);
  bind_moving_plane(module);
  bind_reference_depth(module);
  bind_region_score(module);
  bind_lattice(module);
  bind_obstacle_detection(module);
  bind_obstacle_motion(module);
  bind_rows(module);
  bind_scene(module);
  bind_scene_blocks(module);
  bind_joint(module);
  bind_motion(module);
  bind_observations(module);
  bind_chaining(module);
  bind_evidence(module);
  bind_merging(module);
  bind_motion_prior(module);
  bind_silhouettes(module);
  bind_small(module);
  bind_strips(module);
  bind_strip_depths(module);
  bind_surfaces(module);
  bind_texture(module);
  bind_two_view(module);
}
