// A pair's correspondences and its motion as kernels of Python take them.

#pragma once

#include <algorithm>
#include <vector>

#include "arrays.hpp"
#include "two_view.hpp"

namespace kernels {

inline TwoView two_view(const char* kernel, const py::object& R, const py::object& t,
                        const py::object& focal) {
  const In<double> rotation(kernel, "R", R, {3, 3}, Check::finite);
  const In<double> direction(kernel, "t", t, {3}, Check::finite);
  const In<double> f(kernel, "focal", focal, {2}, Check::finite);
  TwoView view;
  std::copy_n(rotation.data(), 9, view.R.begin());
  std::copy_n(direction.data(), 3, view.t.begin());
  view.fx = f[0];
  view.fy = f[1];
  return view;
}

// Rays (N, 3) with last coordinate 1, standard deviations (N,) [px].
struct PairArrays {
  PairArrays(const char* kernel, const py::object& cur, const py::object& prev,
             const py::object& noise)
      : rays_cur(kernel, "rays_cur", cur, {ANY, 3}, Check::finite),
        rays_prev(kernel, "rays_prev", prev, {rays_cur.size(), 3}, Check::finite),
        sigma(kernel, "sigma", noise, {rays_cur.size()}, Check::finite) {
    bool good = true;
    for (py::ssize_t i = 0; i < rays_cur.size(); ++i)
      good &= rays_cur(i, 2) == 1 && rays_prev(i, 2) == 1;
    require(good, kernel, "rays must end with 1");
  }

  Blocks blocks() const {
    Blocks out(size());
    for (std::size_t i = 0; i < size(); ++i) set(out, i, i);
    return out;
  }
  // By the plane that each lies on, of `n_planes`; those on none (-1) first. -2 is left out.
  std::vector<Blocks> groups(const char* kernel, const py::object& index, int n_planes) const {
    const In<std::int64_t> plane(kernel, "index", index, {rays_cur.size()});
    std::vector<std::size_t> count(n_planes + 1);
    for (std::size_t i = 0; i < size(); ++i) {
      require(plane[i] < n_planes, kernel, "index names a plane that is not given");
      if (plane[i] >= -1) ++count[plane[i] + 1];
    }
    std::vector<Blocks> out;
    for (const auto n : count) out.emplace_back(n);
    std::fill(count.begin(), count.end(), 0);
    for (std::size_t i = 0; i < size(); ++i)
      if (plane[i] >= -1) set(out[plane[i] + 1], count[plane[i] + 1]++, i);
    return out;
  }
  void set(Blocks& to, std::size_t at, std::size_t i) const {
    to.set(at, rays_cur(i, 0), rays_cur(i, 1), rays_prev(i, 0), rays_prev(i, 1), sigma[i]);
  }
  std::size_t size() const { return static_cast<std::size_t>(rays_cur.size()); }

  In<double> rays_cur, rays_prev, sigma;
};

// (relief, width, across, along, bias, offset)
inline Joint joint_of(const char* kernel, const py::object& options) {
  const In<double> o(kernel, "options", options, {6}, Check::finite);
  return {{o[0], o[1], o[2], o[3]}, o[4], o[5], o[5]};
}

template <typename T, std::size_t N>
py::array_t<double> matrix_of(const std::array<T, N>& values,
                              std::initializer_list<py::ssize_t> shape) {
  Out<double> out(shape);
  std::copy(values.begin(), values.end(), out.data());
  return out.array();
}

}  // namespace kernels
