// See two_view.hpp.

#include "two_view.hpp"

#include <algorithm>

#include "two_view_arguments.hpp"

namespace kernels {

Blocks::Blocks(std::size_t n) : count(n) {
  const std::size_t padded = (n + LANES - 1) / LANES * LANES;
  for (auto* column : {&x, &y, &u, &v}) column->resize(padded);
  sigma.resize(padded, 1);
  counts.resize(padded);
  std::fill_n(counts.begin(), n, 1);
}

void tangent_basis(const Vec3& direction, Vec3& first, Vec3& second) {
  std::size_t least = 0;
  for (std::size_t i = 1; i < 3; ++i)
    if (std::abs(direction[i]) < std::abs(direction[least])) least = i;
  Vec3 axis{};
  axis[least] = 1;
  first = cross(direction, axis);
  first = (1 / norm(first)) * first;
  second = cross(direction, first);
  second = (1 / norm(second)) * second;
}

namespace {

const Four ONE = Four{} + 1.0;

KERNELS_INLINE Four3 ray(const std::vector<double>& x, const std::vector<double>& y,
                         std::size_t i) {
  return {load(&x[i]), load(&y[i]), ONE};
}

struct Line {  // epipolar lines in camera k-1 and the distances of x_prev from them
  Four3 c;     // x_cur x t
  Four lx, ly, inverse_norm, error;
};

KERNELS_INLINE Line epipolar_line(const TwoView& view, const Mat3& Rt, const Four3& x,
                                  const Four3& prev) {
  const double by_fx = 1 / view.fx, by_fy = 1 / view.fy;
  Line out;
  out.c = cross(x, view.t);
  const Four3 line = Rt * out.c;
  out.lx = line.x * by_fx;
  out.ly = line.y * by_fy;
  // The epipole has none.
  out.inverse_norm = 1.0 / at_least(root(out.lx * out.lx + out.ly * out.ly), 1e-12);
  out.error = dot(prev, line) * out.inverse_norm;
  return out;
}

// Fills the upper triangle of A from the lower one.
template <int N>
void mirror(Equations<N>& out) {
  for (int i = 0; i < N; ++i)
    for (int j = i + 1; j < N; ++j) out.A[i * N + j] = out.A[j * N + i];
}

}  // namespace

KERNELS_WIDE
Equations<6> epipolar_terms(const Blocks& blocks, const TwoView& view, double width) {
  const Mat3 Rt = transposed(view.R);
  const double shrink = 1 / (width * width), by_fx = 1 / view.fx, by_fy = 1 / view.fy;
  Four A[21] = {}, b[6] = {}, cost = {}, weights = {}, squares = {};
  Line lines[AT_ONCE];
  struct {
    Four J[6], weight, off;
  } terms[AT_ONCE];
  const std::size_t groups = blocks.x.size() / LANES;
  for (std::size_t begin = 0; begin < groups; begin += AT_ONCE) {
    const std::size_t n = std::min(AT_ONCE, groups - begin);
    for (std::size_t g = 0; g < n; ++g) {
      const std::size_t i = (begin + g) * LANES;
      lines[g] = epipolar_line(view, Rt, ray(blocks.x, blocks.y, i), ray(blocks.u, blocks.v, i));
    }
    for (std::size_t g = 0; g < n; ++g) {
      const std::size_t i = (begin + g) * LANES;
      const Four3 x = ray(blocks.x, blocks.y, i), prev = ray(blocks.u, blocks.v, i);
      const Line& line = lines[g];
      const Four sigma = load(&blocks.sigma[i]), counts = load(&blocks.counts[i]);
      // error = y . c / norm with y = R x_prev; norm^2 = sum((line / focal)^2), line = R^T c.
      const Four lx = line.lx * by_fx, ly = line.ly * by_fy, inverse = line.inverse_norm;
      const Four ratio = line.error * inverse;
      const Four3 tilt{prev.x - ratio * lx, prev.y - ratio * ly, prev.z};
      const Four3 by_c = inverse * (view.R * tilt);
      const Four3 w = cross(by_c, line.c), t = cross(by_c, x);
      const Four sharp = 1.0 / sigma, scaled = line.error * sharp, m2 = scaled * scaled;
      const Four kernel = 1.0 / (1.0 + m2 * shrink);
      const Four shown = counts * kernel * kernel, weight = shown * (sharp * sharp);
      terms[g] = {{w.x, w.y, w.z, t.x, t.y, t.z}, weight, weight * line.error};
      cost += counts * m2 * kernel;
      weights += shown;
      squares += shown * m2;
    }
    for (std::size_t g = 0; g < n; ++g) {
      const auto& of = terms[g];
      for (int r = 0, k = 0; r < 6; ++r) {
        const Four weighted = of.weight * of.J[r];
        for (int s = 0; s <= r; ++s, ++k) A[k] += weighted * of.J[s];
        b[r] -= of.off * of.J[r];
      }
    }
  }
  Equations<6> out;
  for (int r = 0, k = 0; r < 6; ++r) {
    for (int s = 0; s <= r; ++s, ++k) out.A[6 * r + s] = sum(A[k]);
    out.b[r] = sum(b[r]);
  }
  mirror(out);
  out.cost = sum(cost);
  out.weights = sum(weights);
  out.squares = sum(squares);
  return out;
}

KERNELS_WIDE
std::vector<double> epipolar_errors(const Blocks& blocks, const TwoView& view) {
  const Mat3 Rt = transposed(view.R);
  std::vector<double> out(blocks.x.size());
  for (std::size_t i = 0; i < blocks.x.size(); i += LANES) {
    const Line line = epipolar_line(view, Rt, ray(blocks.x, blocks.y, i),
                                    ray(blocks.u, blocks.v, i));
    store(line.error / load(&blocks.sigma[i]), &out[i]);
  }
  return out;
}

KERNELS_WIDE
double epipolar_cost(const Blocks& blocks, const TwoView& view, double width) {
  const Mat3 Rt = transposed(view.R);
  const double shrink = 1 / (width * width);
  Four cost = {};
  for (std::size_t i = 0; i < blocks.x.size(); i += LANES) {
    const Line line = epipolar_line(view, Rt, ray(blocks.x, blocks.y, i),
                                    ray(blocks.u, blocks.v, i));
    const Four scaled = line.error / load(&blocks.sigma[i]), m2 = scaled * scaled;
    cost += load(&blocks.counts[i]) * m2 / (1.0 + m2 * shrink);
  }
  return sum(cost);
}

KERNELS_WIDE
Equations<9> plane_terms(const Blocks& blocks, const TwoView& view, const Vec3& plane,
                         const PlaneNoise& noise) {
  const Mat3 Rt = transposed(view.R);
  const Mat3& R = view.R;
  const double shrink = 1 / (noise.width * noise.width), relief2 = noise.relief * noise.relief;
  const double across = 1 / noise.across, lengthwise = 1 / noise.along;
  Four A[45] = {}, b[9] = {}, cost = {};
  struct {
    Four3 x, p;
    Four along, iz, qx, qy, ex, ey, Wxx, Wxy, Wyy;
  } terms[AT_ONCE];
  const std::size_t groups = blocks.x.size() / LANES;
  for (std::size_t begin = 0; begin < groups; begin += AT_ONCE) {
    const std::size_t n = std::min(AT_ONCE, groups - begin);
    for (std::size_t g = 0; g < n; ++g) {
      const std::size_t i = (begin + g) * LANES;
      const Four3 x = ray(blocks.x, blocks.y, i);
      const Four u = load(&blocks.u[i]), v = load(&blocks.v[i]), sigma = load(&blocks.sigma[i]);
      const Four counts = load(&blocks.counts[i]), variance = sigma * sigma;
      // x_prev ~ q = R^T p, p = x + t (plane . x).
      const Four along = dot(x, plane);
      const Four3 p{x.x + along * view.t[0], x.y + along * view.t[1], x.z + along * view.t[2]};
      const Four3 q = Rt * p, far = Rt * x;
      const Four iz = 1.0 / q.z, qx = q.x * iz, qy = q.y * iz, far_iz = 1.0 / far.z;
      const Four ex = view.fx * (u - qx), ey = view.fy * (v - qy);
      // Noise across and along the epipolar line, the parallax' direction, to which relief adds.
      const Four px = view.fx * (qx - far.x * far_iz), py = view.fy * (qy - far.y * far_iz);
      const Four square = at_least(px * px + py * py, 1e-18), inverse = 1.0 / square;
      const Four share = 1.0 / variance, slack = 1.0 / (variance + relief2 * square);
      const Four e_along = px * ex + py * ey, e2 = e_along * e_along * inverse;
      const Four m2 = (ex * ex + ey * ey - e2) * share + e2 * slack;
      const Four kernel = 1.0 / (1.0 + m2 * shrink), weight = counts * kernel * kernel;
      const Four own = across * share * weight;
      const Four more = (lengthwise * slack * weight - own) * inverse;
      const Four Wxx = own + more * px * px, Wxy = more * px * py, Wyy = own + more * py * py;
      cost += counts * m2 * kernel;
      terms[g] = {x, p, along, iz, qx, qy, ex, ey, Wxx, Wxy, Wyy};
    }
    for (std::size_t g = 0; g < n; ++g) {
      const auto& [x, p, along, iz, qx, qy, ex, ey, Wxx, Wxy, Wyy] = terms[g];
      // d pixel = a . (R dq), a (2, 3); S = a^T W a and pull = a^T W e hold all that is told.
      const Four fu = view.fx * iz, fv = view.fy * iz, hu = -(fu * qx), hv = -(fv * qy);
      const Four3 au{R[0] * fu + R[2] * hu, R[3] * fu + R[5] * hu, R[6] * fu + R[8] * hu};
      const Four3 av{R[1] * fv + R[2] * hv, R[4] * fv + R[5] * hv, R[7] * fv + R[8] * hv};
      const Four3 Wu{Wxx * au.x + Wxy * av.x, Wxx * au.y + Wxy * av.y, Wxx * au.z + Wxy * av.z};
      const Four3 Wv{Wxy * au.x + Wyy * av.x, Wxy * au.y + Wyy * av.y, Wxy * au.z + Wyy * av.z};
      const Four3 S[3] = {{au.x * Wu.x + av.x * Wv.x, au.x * Wu.y + av.x * Wv.y,
                           au.x * Wu.z + av.x * Wv.z},
                          {au.y * Wu.x + av.y * Wv.x, au.y * Wu.y + av.y * Wv.y,
                           au.y * Wu.z + av.y * Wv.z},
                          {au.z * Wu.x + av.z * Wv.x, au.z * Wu.y + av.z * Wv.y,
                           au.z * Wu.z + av.z * Wv.z}};
      const Four3 pull{ex * Wu.x + ey * Wv.x, ex * Wu.y + ey * Wv.y, ex * Wu.z + ey * Wv.z};
      // J = [a x p, (plane . x) a, (a . t) x^T].
      const Four3 Sp[3] = {cross(S[0], p), cross(S[1], p), cross(S[2], p)};  // S by w, (3, 3)
      const Four3 ww[3] = {cross(Four3{Sp[0].x, Sp[1].x, Sp[2].x}, p),
                           cross(Four3{Sp[0].y, Sp[1].y, Sp[2].y}, p),
                           cross(Four3{Sp[0].z, Sp[1].z, Sp[2].z}, p)};
      const Four3 s{dot(S[0], view.t), dot(S[1], view.t), dot(S[2], view.t)};
      const Four3 sp = cross(s, p), gp = cross(pull, p), as = along * s;
      const Four along2 = along * along, ts = dot(s, view.t), gt = dot(pull, view.t);
      const Four tx = ts * x.x, ty = ts * x.y;
      const Four rows[45] = {
          ww[0].x,
          ww[1].x, ww[1].y,
          ww[2].x, ww[2].y, ww[2].z,
          along * Sp[0].x, along * Sp[0].y, along * Sp[0].z, along2 * S[0].x,
          along * Sp[1].x, along * Sp[1].y, along * Sp[1].z, along2 * S[1].x, along2 * S[1].y,
          along * Sp[2].x, along * Sp[2].y, along * Sp[2].z, along2 * S[2].x, along2 * S[2].y,
          along2 * S[2].z,
          sp.x * x.x, sp.y * x.x, sp.z * x.x, as.x * x.x, as.y * x.x, as.z * x.x, tx * x.x,
          sp.x * x.y, sp.y * x.y, sp.z * x.y, as.x * x.y, as.y * x.y, as.z * x.y, tx * x.y,
          ty * x.y,
          sp.x, sp.y, sp.z, as.x, as.y, as.z, tx, ty, ts};
      for (int k = 0; k < 45; ++k) A[k] += rows[k];
      const Four right[9] = {gp.x, gp.y, gp.z, along * pull.x, along * pull.y, along * pull.z,
                             gt * x.x, gt * x.y, gt};
      for (int k = 0; k < 9; ++k) b[k] += right[k];
    }
  }
  Equations<9> out;
  for (int r = 0, k = 0; r < 9; ++r) {
    for (int c = 0; c <= r; ++c, ++k) out.A[9 * r + c] = sum(A[k]);
    out.b[r] = sum(b[r]);
  }
  mirror(out);
  out.cost = sum(cost);
  return out;
}

namespace {

// Marginalises a common scale error of a plane's parallax: encoders pull all vectors of a surface
// the same way, so that its depth errs as a whole by a share s ~ N(0, bias^2) that does not average
// out over its blocks. With (1 + s) plane for plane, s is a tenth unknown; its Schur complement
// remains.
void take_bias(Equations<9>& of, const Vec3& plane, double bias) {
  if (bias == 0) return;
  double column[9], own = 1 / (bias * bias), right = 0;
  for (int r = 0; r < 9; ++r)
    column[r] = dot({of.A[9 * r + 6], of.A[9 * r + 7], of.A[9 * r + 8]}, plane);
  for (int k = 0; k < 3; ++k) {
    own += plane[k] * column[6 + k];
    right += plane[k] * of.b[6 + k];
  }
  for (int r = 0; r < 9; ++r) {
    for (int c = 0; c < 9; ++c) of.A[9 * r + c] -= column[r] * column[c] / own;
    of.b[r] -= column[r] * right / own;
  }
}

// Marginalises a common error of all vectors, which is a turn of the camera by some `sigma` [rad]
// about each axis: what remains knows the rotation no better.
void take_turn(double* A, double* b, int n, const Vec3& sigma) {
  if (sigma[0] == 0) return;
  double own[9];
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) own[3 * r + c] = A[r * n + c] + (r == c) / (sigma[r] * sigma[r]);
  if (!cholesky(own, 3)) return;  // no: it is positive definite
  std::vector<double> columns(3 * n), gain(3 * n);
  for (int r = 0; r < n; ++r) {
    for (int k = 0; k < 3; ++k) columns[3 * r + k] = gain[3 * r + k] = A[r * n + k];
    cholesky_solve(own, 3, &gain[3 * r]);
  }
  const Vec3 right{b[0], b[1], b[2]};
  for (int r = 0; r < n; ++r)
    for (int k = 0; k < 3; ++k) {
      for (int c = 0; c < n; ++c) A[r * n + c] -= gain[3 * r + k] * columns[3 * c + k];
      b[r] -= gain[3 * r + k] * right[k];
    }
}

}  // namespace

double normal_equations(const std::vector<Blocks>& groups, const TwoView& view,
                        const double* planes, const Joint& joint, double* A, double* b) {
  const int n_planes = static_cast<int>(groups.size()) - 1, n = 6 + 3 * n_planes;
  std::fill(A, A + n * n, 0.0);
  std::fill(b, b + n, 0.0);
  const auto off_planes = epipolar_terms(groups[0], view, joint.noise.width);
  double cost = off_planes.cost;
  for (int r = 0; r < 6; ++r) {
    for (int c = 0; c < 6; ++c) A[r * n + c] = off_planes.A[6 * r + c] / joint.noise.across;
    b[r] = off_planes.b[r] / joint.noise.across;
  }
  for (int i = 0; i < n_planes; ++i) {
    const Vec3 plane{planes[3 * i], planes[3 * i + 1], planes[3 * i + 2]};
    auto of = plane_terms(groups[i + 1], view, plane, joint.noise);
    take_bias(of, plane, joint.bias);
    const auto at = [i](int r) { return r < 6 ? r : r + 3 * i; };
    for (int r = 0; r < 9; ++r) {
      for (int c = 0; c < 9; ++c) A[at(r) * n + at(c)] += of.A[9 * r + c];
      b[at(r)] += of.b[r];
    }
    cost += of.cost;
  }
  take_turn(A, b, n, (2 / (view.fx + view.fy)) * Vec3{joint.offset, joint.offset, joint.roll});
  return cost;
}

}  // namespace kernels

void bind_two_view(kernels::py::module_& module) {
  using namespace kernels;
  // K (3, 3), ideal pixels (N, 2) float32 of both pictures -> rays_cur, rays_prev (N, 3), x_prev
  module.def("rays_of", [](const py::object& K, const py::object& x_cur,
                           const py::object& x_prev) {
    const char* kernel = "rays_of";
    const In<double> k(kernel, "K", K, {3, 3}, Check::finite);
    const In<float> cur(kernel, "x_cur", x_cur, {ANY, 2});
    const auto n = cur.size();
    const In<float> prev(kernel, "x_prev", x_prev, {n, 2});
    Out<double> ray_cur({n, 3}), ray_prev({n, 3}), pixels({n, 2});
    const auto write = [&](const In<float>& x, Out<double>& ray) {
      const double fx = k(0, 0), fy = k(1, 1), cx = k(0, 2), cy = k(1, 2), skew = k(0, 1) / fx;
      for (py::ssize_t i = 0; i < n; ++i) {
        ray(i, 1) = (x(i, 1) - cy) / fy;
        ray(i, 0) = (x(i, 0) - cx) / fx;
        if (skew != 0) ray(i, 0) -= skew * ray(i, 1);
        ray(i, 2) = 1;
      }
    };
    write(cur, ray_cur);
    write(prev, ray_prev);
    for (py::ssize_t i = 0; i < 2 * n; ++i) pixels[i] = prev[i];
    return py::make_tuple(ray_cur.array(), ray_prev.array(), pixels.array());
  });
  // index: plane of each, -1 on none; options: relief, width, across, along, bias, offset of Joint
  module.def("normal_equations", [](const py::object& rays_cur, const py::object& rays_prev,
                                    const py::object& sigma, const py::object& focal,
                                    const py::object& R, const py::object& t,
                                    const py::object& index, const py::object& planes,
                                    const py::object& options) {
    const char* kernel = "normal_equations";
    const PairArrays pair(kernel, rays_cur, rays_prev, sigma);
    const In<double> of(kernel, "planes", planes, {ANY, 3}, Check::finite);
    const auto n = 6 + 3 * of.size();
    Out<double> A({n, n}), b({n});
    const double cost = normal_equations(pair.groups(kernel, index, static_cast<int>(of.size())),
                                         two_view(kernel, R, t, focal), of.data(),
                                         joint_of(kernel, options), A.data(), b.data());
    return py::make_tuple(A.array(), b.array(), cost);
  });
}
