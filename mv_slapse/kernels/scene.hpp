// The state of the scene filter as its kernels see it, and what its errors change, (13) of [MVO].
//
// Error state: pose of the previous key frame (theta [rad] in the camera, position in {W}), pose of
// the current one, velocity, angular velocity, mount, scale of the depths, heave, then 3 for each
// plane. See scene/state.py, which holds the meaning of each.

#pragma once

#include <vector>

#include "small.hpp"

namespace kernels {

constexpr int PREVIOUS = 0, CURRENT = 6, MOUNT = 18, DEPTH_SCALE = 21, HEAVE = 22, PLANES = 23;
constexpr int N_LASTING = 9;  // turn (3), place (2), height, speed, focal length, unit
constexpr int LASTING_TURN = 0, LASTING_PLACE = 3, LASTING_FOCAL = 7;

struct Pose {
  Mat3 R;  // world from camera
  Vec3 t;
};

struct Mat36 {
  double at[3][6];
};

struct Scene {
  Pose previous, current;
  Vec3 mount;
  double depth_scale, heave;
  std::vector<Vec3> planes, anchors;  // n / d about an anchor, axes of {W}

  int size() const { return PLANES + 3 * static_cast<int>(planes.size()); }
};

struct PlaneInCamera {
  Vec3 plane;
  Mat36 by_pose;  // error of the current pose
  Mat3 by_plane;
};

struct RelativeMotion {  // X_cur = R X_prev + t
  Mat3 R;
  Vec3 t;
  Mat3 R_cam_from_world;
};

Scene moved(const Scene& scene, const double* e);
PlaneInCamera plane_in_camera(const Scene& scene, int plane);  // (16) of [MVO]
RelativeMotion relative_motion(const Scene& scene);

// Adds to `row` (n,) what a derivative by (w, t) of the relative motion is by the two poses.
void add_by_poses(const RelativeMotion& motion, const Vec3& by_w, const Vec3& by_t, double* row);

// What is observed beside correspondences; `plane` is a position in the state's list.
enum class Kind { camera_height, mounting, level_course, baseline, depth_ratio };
struct Observation {
  Kind kind;
  int plane;
  double value, sigma;
  double lasting[N_LASTING];  // what one standard deviation of each lasting error does to it
  Mat3 R;                     // of depth_ratio: the pair's own motion, and the slope of the mean
  Vec3 t;                     // log of inverse depth by (w, t)
  double slope[6];
};

// Innovation z - h (m,) and derivative H of h (m, n), zeros given; returns m, 1 or 3.
int observe(const Scene& scene, const Observation& of, double* innovation, double* H);

}  // namespace kernels
