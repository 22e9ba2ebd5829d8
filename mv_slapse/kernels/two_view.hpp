// Two views of stationary points, X_cur = R X_prev + t: the joint cost (10) of [MVO] and its normal
// equations, for the motion of a pair, for its joint refinement and for the scene filter.

#pragma once

#include <vector>

#include "lanes.hpp"
#include "small.hpp"

namespace kernels {

struct TwoView {
  Mat3 R;
  Vec3 t;
  double fx, fy;  // px
};

// Correspondences by column, padded to whole lanes by ones that count nothing. Rays are (x, y, 1)
// in camera k and (u, v, 1) in camera k-1, with a standard deviation of (u, v) [px].
struct Blocks {
  explicit Blocks(std::size_t n = 0);
  void set(std::size_t i, double x_, double y_, double u_, double v_, double sigma_) {
    x[i] = x_;
    y[i] = y_;
    u[i] = u_;
    v[i] = v_;
    sigma[i] = sigma_;
  }

  std::size_t count;
  std::vector<double> x, y, u, v, sigma, counts;
};

// Normal equations A d = b with their cost: sums over the lower triangle, mirrored in the end.
template <int N>
struct Equations {
  std::array<double, N * N> A{};
  std::array<double, N> b{};
  double cost = 0;
  double weights = 0, squares = 0;  // of the kernel, and of the squared errors with them [1]
};

struct PlaneNoise {
  double relief;         // of a surface about its plane, as a share of depth
  double width;          // of the Geman-McClure kernel, in standard deviations
  double across, along;  // correspondences that tell as much as one does, by the epipolar line
};

struct Joint {
  PlaneNoise noise;
  double bias;    // of all depths of a surface, as a share
  double offset, roll;  // that all vectors share, and what turns the picture [px]
};

// Of the epipolar error, (5) of [MVO], by (w, t), R -> exp(w) R. The cost is minus twice the log
// likelihood, at most width^2 for each correspondence.
Equations<6> epipolar_terms(const Blocks& blocks, const TwoView& view, double width);

// Signed distances [sigma] of x_prev from the epipolar lines, of `count` blocks and the padding.
std::vector<double> epipolar_errors(const Blocks& blocks, const TwoView& view);

// That cost alone.
double epipolar_cost(const Blocks& blocks, const TwoView& view, double width);

// Of the homography (9) of one plane n / d in camera k, by (w, t, plane).
Equations<9> plane_terms(const Blocks& blocks, const TwoView& view, const Vec3& plane,
                         const PlaneNoise& noise);

// Of (10) by (w, t, plane 0, ...): A (n x n), b (n) with n = 6 + 3 P; returns the cost. groups[0]
// lies on no plane, groups[i + 1] on plane i.
double normal_equations(const std::vector<Blocks>& groups, const TwoView& view,
                        const double* planes, const Joint& joint, double* A, double* b);

// Two unit vectors normal to a direction and to each other.
void tangent_basis(const Vec3& direction, Vec3& first, Vec3& second);

}  // namespace kernels
