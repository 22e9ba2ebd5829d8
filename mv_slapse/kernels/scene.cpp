// See scene.hpp: the state's geometry, and what is observed of it beside correspondences.

#include "scene.hpp"

#include <algorithm>
#include <cmath>

namespace kernels {

namespace {

constexpr double NO_LENGTH = 1e-18;  // square of a baseline that has no direction

Pose moved(const Pose& pose, const double* e) {
  return {pose.R * rotation_exp({e[0], e[1], e[2]}), pose.t + Vec3{e[3], e[4], e[5]}};
}

// Log of the distance between the two poses; adds `weight` times its derivative to H.
double log_baseline(const Scene& scene, double weight, double* H) {
  const Vec3 offset = scene.current.t - scene.previous.t;
  const double square = std::max(dot(offset, offset), NO_LENGTH);
  for (int i = 0; i < 3; ++i) {
    H[CURRENT + 3 + i] += weight * offset[i] / square;
    H[PREVIOUS + 3 + i] -= weight * offset[i] / square;
  }
  return 0.5 * std::log(square);
}

void add_by_plane(const Vec3& direction, const PlaneInCamera& of, int plane, double* H) {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 6; ++j) H[CURRENT + j] += direction[i] * of.by_pose.at[i][j];
    for (int j = 0; j < 3; ++j) H[PLANES + 3 * plane + j] += direction[i] * of.by_plane[3 * i + j];
  }
}

// The camera's height above a plane, which swings about its mean by the heave.
double camera_height(const Scene& scene, const Observation& of, double* H) {
  const auto ground = plane_in_camera(scene, of.plane);
  const double square = dot(ground.plane, ground.plane), depth = 1 / std::sqrt(square);
  add_by_plane((-depth / square) * ground.plane, ground, of.plane, H);
  H[HEAVE] = -of.value;
  return of.value * (1 + scene.heave) - depth;
}

// The ground's normal in the camera is the mount.
void mounting(const Scene& scene, const Observation& of, double* innovation, double* H) {
  const auto ground = plane_in_camera(scene, of.plane);
  const double length = norm(ground.plane);
  const Vec3 normal = (1 / length) * ground.plane;
  for (int i = 0; i < 3; ++i) {
    Vec3 direction = (-normal[i] / length) * normal;
    direction[i] += 1 / length;
    double* row = H + i * scene.size();
    add_by_plane(direction, ground, of.plane, row);
    row[MOUNT + i] = -1;
    innovation[i] = scene.mount[i] - normal[i];
  }
}

// A vehicle's course lies in the ground: mount . t = 0.
double level_course(const Scene& scene, double* H) {
  const auto motion = relative_motion(scene);
  const double length = norm(motion.t), along = dot(scene.mount, motion.t) / length;
  const Vec3 direction = (1 / length) * motion.t;
  add_by_poses(motion, {}, (1 / length) * (scene.mount - along * direction), H);
  for (int i = 0; i < 3; ++i) H[MOUNT + i] = direction[i];
  return -along;
}

// The log of the baseline, by the scale of the depths as the filter's own motion makes them.
double depth_ratio(const Scene& scene, const Observation& of, double* H) {
  const auto motion = relative_motion(scene);
  const double length = std::max(norm(motion.t), 1e-9);
  const Vec3 by_w{of.slope[0], of.slope[1], of.slope[2]}, by_t{of.slope[3], of.slope[4],
                                                               of.slope[5]};
  const Vec3 turn = rotation_log(motion.R * transposed(of.R));
  const double change = dot(by_w, turn) + dot(by_t, (1 / length) * motion.t - of.t);
  const double along = dot(motion.t, by_t) / (length * length);
  add_by_poses(motion, by_w, (1 / length) * (by_t - along * motion.t), H);
  const double value = log_baseline(scene, -1, H);
  H[DEPTH_SCALE] = 1;
  return value - scene.depth_scale - change;
}

}  // namespace

Scene moved(const Scene& scene, const double* e) {
  Scene out = scene;
  out.previous = moved(scene.previous, e + PREVIOUS);
  out.current = moved(scene.current, e + CURRENT);
  out.mount = scene.mount + Vec3{e[MOUNT], e[MOUNT + 1], e[MOUNT + 2]};
  out.mount = (1 / norm(out.mount)) * out.mount;
  out.depth_scale += e[DEPTH_SCALE];
  out.heave += e[HEAVE];
  for (std::size_t k = 0; k < scene.planes.size(); ++k)
    for (int i = 0; i < 3; ++i) out.planes[k][i] += e[PLANES + 3 * k + i];
  return out;
}

PlaneInCamera plane_in_camera(const Scene& scene, int k) {
  const Vec3& plane = scene.planes[k];
  const Vec3 offset = scene.current.t - scene.anchors[k];
  const Mat3 R = transposed(scene.current.R);
  const double scale = 1 + dot(plane, offset), square = scale * scale;
  const Vec3 turned = R * plane;
  PlaneInCamera out;
  out.plane = (1 / scale) * turned;
  const Mat3 by_turn = skew(out.plane);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      out.by_pose.at[i][j] = by_turn[3 * i + j];
      out.by_pose.at[i][3 + j] = -turned[i] * plane[j] / square;
      out.by_plane[3 * i + j] = R[3 * i + j] / scale - turned[i] * offset[j] / square;
    }
  return out;
}

RelativeMotion relative_motion(const Scene& scene) {
  const Mat3 R = transposed(scene.current.R);
  return {R * scene.previous.R, R * (scene.previous.t - scene.current.t), R};
}

void add_by_poses(const RelativeMotion& motion, const Vec3& by_w, const Vec3& by_t, double* row) {
  const Vec3 turned = transposed(motion.R) * by_w, moved = transposed(motion.R_cam_from_world) * by_t;
  const Vec3 swung = transposed(skew(motion.t)) * by_t;
  for (int i = 0; i < 3; ++i) {
    row[PREVIOUS + i] += turned[i];
    row[PREVIOUS + 3 + i] += moved[i];
    row[CURRENT + i] += swung[i] - by_w[i];
    row[CURRENT + 3 + i] -= moved[i];
  }
}

int observe(const Scene& scene, const Observation& of, double* innovation, double* H) {
  switch (of.kind) {
    case Kind::camera_height:
      *innovation = camera_height(scene, of, H);
      return 1;
    case Kind::mounting:
      mounting(scene, of, innovation, H);
      return 3;
    case Kind::level_course:
      *innovation = level_course(scene, H);
      return 1;
    case Kind::baseline:
      *innovation = std::log(of.value) - log_baseline(scene, 1, H);
      return 1;
    case Kind::depth_ratio:
      *innovation = depth_ratio(scene, of, H);
      return 1;
  }
  return 0;  // no: the border lets no other kind in
}

}  // namespace kernels
