// What each block of a pair says of itself once the camera's motion is known, [MVO] 4.2.

#include <algorithm>

#include "two_view_arguments.hpp"

namespace kernels {
namespace {

struct Bounds {
  double epsilon_f;  // largest epipolar error of an inlier, (3) [sigma]
  double epsilon_m;  // smallest parallax of a block not at infinity, (7) [px]
  double relief;     // of a surface about its plane, as a share of depth
};

struct Columns {  // of all blocks; see BlockObservations
  explicit Columns(py::ssize_t n)
      : error({n}), rho({n}), sigma_rho({n}), blur({n}), parallax({n}), inlier({n}),
        at_infinity({n}), backward({n}), has_depth({n}) {}

  Out<double> error, rho, sigma_rho, blur, parallax;
  Out<bool> inlier, at_infinity, backward, has_depth;
};

struct Depth {
  double rho, per_pixel;  // inverse depth, and |d rho / d x_prev| along the epipolar line
  double flow_x, flow_y;  // parallax without rotation, (6) [px]
};

// rho (t_xy - y t_z) = x_cur - y, y = R x_prev / z, solved along the epipolar line; the epipole has
// none.
inline Depth depth(const TwoView& view, double x, double y, const Vec3& prev) {
  const Vec3 d = view.R * prev, &t = view.t;
  const double dx = d[0] / d[2], dy = d[1] / d[2];
  const double gx = (t[0] - dx * t[2]) * view.fx, gy = (t[1] - dy * t[2]) * view.fy;
  const double length = std::max(std::sqrt(gx * gx + gy * gy), 1e-9);
  Depth out;
  out.flow_x = (x - dx) * view.fx;
  out.flow_y = (y - dy) * view.fy;
  out.rho = (out.flow_x * gx + out.flow_y * gy) / (length * length);
  out.per_pixel = std::abs(1 - out.rho * t[2]) / length;
  return out;
}

KERNELS_WIDE
void judge(const Blocks& blocks, const TwoView& view, const Bounds& bounds, Columns& out) {
  const auto error = epipolar_errors(blocks, view);
  const double fx = view.fx, fy = view.fy;
  const Vec3& t = view.t;
  for (std::size_t i = 0; i < blocks.x.size(); i += LANES) {
    const Four x = load(&blocks.x[i]), y = load(&blocks.y[i]), sigma = load(&blocks.sigma[i]);
    const Four3 d = view.R * Four3{load(&blocks.u[i]), load(&blocks.v[i]), Four{} + 1.0};
    const Four inverse = 1.0 / d.z, dx = d.x * inverse, dy = d.y * inverse;
    const Four flow_x = (x - dx) * fx, flow_y = (y - dy) * fy;
    // As in `depth`.
    const Four gx = (t[0] - dx * t[2]) * fx, gy = (t[1] - dy * t[2]) * fy;
    const Four square = at_least(gx * gx + gy * gy, 1e-18);
    const Four rho = (flow_x * gx + flow_y * gy) / square, ahead = 1.0 - rho * t[2];
    const Four blur = (ahead < 0.0 ? -ahead : ahead) / root(square) * sigma;
    const Four rough = bounds.relief * rho;
    const Four columns[4] = {rho, root(blur * blur + rough * rough), blur,
                             root(flow_x * flow_x + flow_y * flow_y)};
    for (std::size_t j = 0; j < std::min(LANES, blocks.count - i); ++j) {
      const auto at = static_cast<py::ssize_t>(i + j);
      out.error[at] = error[at];
      out.rho[at] = columns[0][j];
      out.sigma_rho[at] = columns[1][j];
      out.blur[at] = columns[2][j];
      out.parallax[at] = columns[3][j];
    }
  }
  for (std::size_t i = 0; i < blocks.count; ++i) {  // without branches
    const auto at = static_cast<py::ssize_t>(i);
    const bool inlier = std::abs(error[at]) < bounds.epsilon_f;
    const bool near = out.parallax[at] >= bounds.epsilon_m;
    out.inlier[at] = inlier;
    out.at_infinity[at] = inlier & !near;
    out.backward[at] = inlier & near & (out.rho[at] < -3 * out.blur[at]);
    out.has_depth[at] = inlier & near & (out.rho[at] > 0);
  }
}

}  // namespace
}  // namespace kernels

void bind_observations(kernels::py::module_& module) {
  using namespace kernels;
  // bounds (3,): see Bounds -> columns, see BlockObservations
  module.def("observe_blocks", [](const py::object& rays_cur, const py::object& rays_prev,
                                  const py::object& sigma, const py::object& focal,
                                  const py::object& R, const py::object& t,
                                  const py::object& bounds) {
    const char* kernel = "observe_blocks";
    const Blocks blocks = PairArrays(kernel, rays_cur, rays_prev, sigma).blocks();
    const In<double> of(kernel, "bounds", bounds, {3}, Check::finite);
    Columns out(static_cast<py::ssize_t>(blocks.count));
    judge(blocks, two_view(kernel, R, t, focal), {of[0], of[1], of[2]}, out);
    return py::make_tuple(out.error.array(), out.rho.array(), out.sigma_rho.array(),
                          out.blur.array(), out.parallax.array(), out.inlier.array(),
                          out.at_infinity.array(), out.backward.array(), out.has_depth.array());
  });
  // Of rays of any length -> error (N,) [px]
  module.def("epipolar_error", [](const py::object& rays_cur, const py::object& rays_prev,
                                  const py::object& focal, const py::object& R,
                                  const py::object& t) {
    const char* kernel = "epipolar_error";
    const In<double> cur(kernel, "rays_cur", rays_cur, {ANY, 3});
    const In<double> prev(kernel, "rays_prev", rays_prev, {cur.size(), 3});
    const TwoView view = two_view(kernel, R, t, focal);
    const Mat3 Rt = transposed(view.R);
    Out<double> out({cur.size()});
    for (py::ssize_t i = 0; i < cur.size(); ++i) {
      const Vec3 line = Rt * cross(Vec3{cur(i, 0), cur(i, 1), cur(i, 2)}, view.t);
      const double lx = line[0] / view.fx, ly = line[1] / view.fy;
      out[i] = dot(line, {prev(i, 0), prev(i, 1), prev(i, 2)}) /
               std::max(std::sqrt(lx * lx + ly * ly), 1e-12);
    }
    return out.array();
  });
  // Of rays_prev of any length -> rho (N,), |d rho / d x_prev| (N,)
  module.def("inverse_depth", [](const py::object& rays_cur, const py::object& rays_prev,
                                 const py::object& focal, const py::object& R,
                                 const py::object& t) {
    const char* kernel = "inverse_depth";
    const In<double> cur(kernel, "rays_cur", rays_cur, {ANY, 3});
    const In<double> prev(kernel, "rays_prev", rays_prev, {cur.size(), 3});
    const TwoView view = two_view(kernel, R, t, focal);
    Out<double> rho({cur.size()}), per_pixel({cur.size()});
    for (py::ssize_t i = 0; i < cur.size(); ++i) {
      const Depth of = depth(view, cur(i, 0), cur(i, 1), {prev(i, 0), prev(i, 1), prev(i, 2)});
      rho[i] = of.rho;
      per_pixel[i] = of.per_pixel;
    }
    return py::make_tuple(rho.array(), per_pixel.array());
  });
}
