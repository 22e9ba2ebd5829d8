"""Records as the fields of messages, and back: shared by the ROS nodes and the bag writer.

``*_to_fields`` returns a message as a nested dict, field name to value, in which long arrays are
numpy columns of the message's own type; nodes and bags each fill their own message classes with
it. ``*_from_message`` reads any object that has the fields as attributes, whoever made it.

Positions go out in the odom frame and come back in {W}, see ``geometry.ros_frames``.
"""

from typing import Any

from mv_slapse.geometry import ros_frames
from mv_slapse.geometry.calibration import camera_from_calibration
from mv_slapse.geometry.camera import Camera
from mv_slapse.geometry.ros_frames import Pose, RosFrames, Twist
from mv_slapse.records import (
    CameraMotion,
    Correspondences,
    Extraction,
    Label,
    MapPlane,
    MotionStatus,
    Obstacle,
    ObstacleState,
    PlaneHandover,
    PlaneObservation,
    ScalePrior,
    ScaleStatus,
    SceneEstimate,
    SegmentKind,
    Speed,
    TrackingStatus,
)
import numpy as np
from scipy.spatial.transform import Rotation

Fields = dict[str, Any]


def stamp_to_fields(stamp: int) -> Fields:
    """Return builtin_interfaces/Time of a stamp [ns]."""
    sec, nanosec = divmod(int(stamp), 1_000_000_000)
    return {'sec': sec, 'nanosec': nanosec}


def stamp_from_message(time: Any) -> int:
    """Return the stamp [ns] of a builtin_interfaces/Time."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def header(stamp: int, frame_id: str) -> Fields:
    """Return a std_msgs/Header."""
    return {'stamp': stamp_to_fields(stamp), 'frame_id': frame_id}


def camera_to_fields(camera: Camera, stamp: int, frame_id: str) -> Fields:
    """Return sensor_msgs/CameraInfo."""
    roi = {'x_offset': 0, 'y_offset': 0, 'height': 0, 'width': 0, 'do_rectify': False}
    return {'header': header(stamp, frame_id),
            'height': int(camera.height), 'width': int(camera.width),
            'distortion_model': camera.lens, 'd': _flat(camera.distortion), 'k': _flat(camera.K),
            'r': _flat(np.eye(3)), 'p': _flat(np.c_[camera.K, np.zeros(3)]),
            'binning_x': 0, 'binning_y': 0, 'roi': roi}


def camera_from_message(msg: Any, origin: str = 'camera_info') -> Camera:
    """Return the camera of a sensor_msgs/CameraInfo; an unusable one raises UnusableInput."""
    return camera_from_calibration((int(msg.width), int(msg.height)), msg.k,
                                   msg.distortion_model, msg.d, origin)


def correspondences_to_fields(record: Correspondences, frames: RosFrames) -> Fields:
    """Return mv_slapse_msgs/Correspondences."""
    return {
        'header': header(record.stamp, frames.camera),
        'previous_stamp': stamp_to_fields(record.previous_stamp),
        'width': int(record.width), 'height': int(record.height),
        'kind': int(record.kind), 'n_b': int(record.n_b), 'reason': record.reason,
        **_point_columns(record),
        'probability': _column(record.probability, np.float32),
    }


def correspondences_from_message(msg: Any) -> Correspondences:
    """Return the record of a mv_slapse_msgs/Correspondences."""
    return Correspondences(
        stamp_from_message(msg.header.stamp), stamp_from_message(msg.previous_stamp),
        int(msg.width), int(msg.height), SegmentKind(msg.kind), int(msg.n_b), msg.reason,
        probability=_column(msg.probability, np.float32), **_points_of(msg))


def extraction_to_fields(record: Extraction, frames: RosFrames) -> Fields:
    """Return mv_slapse_msgs/PlaneObservations."""
    motion = record.motion
    return {
        'header': header(record.stamp, frames.camera),
        'previous_stamp': stamp_to_fields(record.previous_stamp),
        'width': int(record.width), 'height': int(record.height),
        'kind': int(record.kind), 'reason': record.reason, 'k': _flat(record.K),
        'motion_status': int(motion.status), 'rotation': _flat(motion.R_cur_from_prev),
        'translation': _flat(motion.t_cur_from_prev),
        'motion_covariance': _flat(motion.covariance), 'forward': bool(motion.forward),
        'baseline_ratio': float(record.baseline_ratio),
        'baseline_ratio_sigma': float(record.baseline_ratio_sigma),
        'planes': [_observation_to_fields(plane) for plane in record.planes],
        **_point_columns(record),
        'label': _column(record.label, np.int8),
        'plane_id': _column(record.plane_id, np.int32),
        'macroblock_label': _column(record.macroblock_label, np.int8),
        'macroblock_plane': _column(record.macroblock_plane, np.int32),
    }


def extraction_from_message(msg: Any) -> Extraction:
    """Return the record of a mv_slapse_msgs/PlaneObservations."""
    motion = CameraMotion(MotionStatus(msg.motion_status), _matrix(msg.rotation, 3),
                          _flat(msg.translation), _matrix(msg.motion_covariance, 6),
                          bool(msg.forward))
    return Extraction(
        stamp_from_message(msg.header.stamp), stamp_from_message(msg.previous_stamp),
        int(msg.width), int(msg.height), SegmentKind(msg.kind), _matrix(msg.k, 3), motion,
        tuple(_observation_from_message(plane) for plane in msg.planes), msg.reason,
        label=_column(msg.label, np.int8), plane_id=_column(msg.plane_id, np.int32),
        macroblock_label=_column(msg.macroblock_label, np.int8),
        macroblock_plane=_column(msg.macroblock_plane, np.int32),
        baseline_ratio=float(msg.baseline_ratio),
        baseline_ratio_sigma=float(msg.baseline_ratio_sigma), **_points_of(msg))


def odometry_to_fields(scene: SceneEstimate, frames: RosFrames) -> Fields:
    """Return nav_msgs/Odometry: pose of the base in odom, twist in the base."""
    return {'header': header(scene.stamp, frames.odom), 'child_frame_id': frames.base,
            'pose': _pose_with_covariance(scene, frames),
            'twist': _twist_with_covariance(scene, frames)}


def speed_from_message(msg: Any) -> Speed:
    """Return the speed of a nav_msgs/Odometry of wheels: over ground, negative backwards."""
    linear = msg.twist.twist.linear
    return Speed(stamp_from_message(msg.header.stamp),
                 float(np.copysign(np.hypot(linear.x, linear.y), linear.x)))


def pose_to_fields(scene: SceneEstimate, frames: RosFrames) -> Fields:
    """Return geometry_msgs/PoseWithCovarianceStamped in odom."""
    return {'header': header(scene.stamp, frames.odom),
            'pose': _pose_with_covariance(scene, frames)}


def pose_from_message(msg: Any, frames: RosFrames) -> Pose:
    """Return the pose in {W} of a geometry_msgs/PoseWithCovarianceStamped in odom."""
    return ros_frames.pose_to_world(_pose_from_message(msg.pose), frames)


def pose_stamped_to_fields(scene: SceneEstimate, frames: RosFrames) -> Fields:
    """Return geometry_msgs/PoseStamped in odom, an entry of a nav_msgs/Path."""
    return camera_pose_to_fields(scene.stamp, _pose_of(scene), frames)


def camera_pose_to_fields(stamp: int, world_from_cam: Pose, frames: RosFrames) -> Fields:
    """Return geometry_msgs/PoseStamped in odom of a camera's pose in {W}."""
    return {'header': header(stamp, frames.odom), 'pose': _pose(world_from_cam, frames)}


def twist_to_fields(scene: SceneEstimate, frames: RosFrames) -> Fields:
    """Return geometry_msgs/TwistWithCovarianceStamped in the base."""
    return {'header': header(scene.stamp, frames.base),
            'twist': _twist_with_covariance(scene, frames)}


def transform_to_fields(scene: SceneEstimate, frames: RosFrames) -> Fields:
    """Return geometry_msgs/TransformStamped odom -> base."""
    return _transform(scene.stamp, frames.odom, frames.base,
                      ros_frames.pose_to_odom(_pose_of(scene), frames))


def camera_transform_to_fields(stamp: int, frames: RosFrames) -> Fields:
    """Return geometry_msgs/TransformStamped base -> camera, for /tf_static."""
    return _transform(stamp, frames.base, frames.camera,
                      Pose(frames.R_base_from_cam, frames.t_base_from_cam))


def plane_map_to_fields(scene: SceneEstimate, frames: RosFrames) -> Fields:
    """Return mv_slapse_msgs/PlaneMap in odom."""
    return {'header': header(scene.stamp, frames.odom), 'tracking': int(scene.status),
            'reason': scene.reason, 'scale_status': int(scene.scale_status),
            'scale_source': scene.scale_source,
            'planes': [_map_plane_to_fields(plane, frames) for plane in scene.planes]}


def scene_from_messages(odometry: Any, plane_map: Any, frames: RosFrames,
                        baseline: float = 0.0) -> SceneEstimate:
    """Return the scene of a nav_msgs/Odometry and the PlaneMap of the same stamp.

    ``baseline`` [map unit] is in neither message; it is the distance to the previous pose.
    """
    pose = pose_from_message(odometry, frames)
    twist = Twist(_read_xyz(odometry.twist.twist.linear),
                  _read_xyz(odometry.twist.twist.angular), _matrix(odometry.twist.covariance, 6))
    twist = ros_frames.twist_to_world(twist, pose.R, frames)
    return SceneEstimate(
        stamp_from_message(odometry.header.stamp), TrackingStatus(plane_map.tracking),
        plane_map.reason, pose.R, pose.t, pose.covariance, twist.linear, twist.angular,
        twist.covariance, ScaleStatus(plane_map.scale_status), plane_map.scale_source,
        tuple(_map_plane_from_message(plane, frames) for plane in plane_map.planes), baseline)


def obstacles_to_fields(stamp: int, obstacles: list[Obstacle], scale_status: ScaleStatus,
                        frames: RosFrames) -> Fields:
    """Return mv_slapse_msgs/ObstacleArray in odom."""
    return {'header': header(stamp, frames.odom), 'scale_status': int(scale_status),
            'obstacles': [_obstacle_to_fields(obstacle, frames) for obstacle in obstacles]}


def obstacles_from_message(msg: Any, frames: RosFrames) -> list[Obstacle]:
    """Return the obstacles of a mv_slapse_msgs/ObstacleArray in {W}."""
    stamp = stamp_from_message(msg.header.stamp)
    return [_obstacle_from_message(stamp, obstacle, frames) for obstacle in msg.obstacles]


def handover_to_fields(record: PlaneHandover, frames: RosFrames) -> Fields:
    """Return mv_slapse_msgs/PlaneHandover in odom."""
    return {'header': header(record.stamp, frames.odom), 'id': int(record.id),
            'to_label': int(record.to_label),
            'plane': ros_frames.plane_to_odom(record.plane, frames),
            'velocity': ros_frames.vectors_to_odom(record.velocity, frames),
            'covariance': _flat(ros_frames.plane_velocity_covariance_to_odom(
                record.plane, record.covariance, frames))}


def handover_from_message(msg: Any, frames: RosFrames) -> PlaneHandover:
    """Return the record of a mv_slapse_msgs/PlaneHandover in {W}."""
    plane, inverse = _flat(msg.plane), frames.inverse()
    return PlaneHandover(
        stamp_from_message(msg.header.stamp), int(msg.id), Label(msg.to_label),
        ros_frames.plane_to_odom(plane, inverse),
        ros_frames.vectors_to_world(_flat(msg.velocity), frames),
        ros_frames.plane_velocity_covariance_to_odom(plane, _matrix(msg.covariance, 6), inverse))


def _observation_to_fields(plane: PlaneObservation) -> Fields:
    return {'id': int(plane.id), 'label': int(plane.label), 'is_ground': bool(plane.is_ground),
            'n_macroblocks': int(plane.n_macroblocks), 'plane': _flat(plane.plane),
            'covariance': _flat(plane.covariance), 't_d': _flat(plane.t_d),
            'product': _flat(plane.product), 'scale_prior': int(plane.scale_prior),
            'score': float(plane.score), 'departed': float(plane.departed)}


def _observation_from_message(msg: Any) -> PlaneObservation:
    covariance = _flat(msg.covariance)
    return PlaneObservation(
        int(msg.id), Label(msg.label), _flat(msg.plane),
        _matrix(covariance, 6 if covariance.size == 36 else 3), _flat(msg.t_d),
        _matrix(msg.product, 3), ScalePrior(msg.scale_prior), bool(msg.is_ground),
        int(msg.n_macroblocks), float(msg.score), float(msg.departed))


def _map_plane_to_fields(plane: MapPlane, frames: RosFrames) -> Fields:
    normal, depth, covariance = ros_frames.normal_depth_to_odom(
        plane.normal, plane.depth, plane.covariance, frames)
    return {'id': int(plane.id), 'normal': _named_xyz(normal), 'depth': depth,
            'covariance': _flat(covariance),
            'outline': _points(ros_frames.points_to_odom(plane.outline, frames)),
            'first_seen': stamp_to_fields(plane.first_stamp),
            'last_seen': stamp_to_fields(plane.last_stamp),
            'n_observations': int(plane.n_observations),
            'n_macroblocks': int(plane.n_macroblocks), 'is_ground': bool(plane.is_ground)}


def _map_plane_from_message(msg: Any, frames: RosFrames) -> MapPlane:
    normal, depth, covariance = ros_frames.normal_depth_to_odom(
        _read_xyz(msg.normal), msg.depth, _matrix(msg.covariance, 4), frames.inverse())
    return MapPlane(int(msg.id), normal, depth, covariance,
                    ros_frames.points_to_world(_read_points(msg.outline), frames),
                    stamp_from_message(msg.first_seen), stamp_from_message(msg.last_seen),
                    int(msg.n_observations), int(msg.n_macroblocks), bool(msg.is_ground))


def _obstacle_to_fields(obstacle: Obstacle, frames: RosFrames) -> Fields:
    return {'id': int(obstacle.id), 'state': int(obstacle.state),
            'plane': ros_frames.plane_to_odom(obstacle.plane, frames),
            'position': _named_xyz(ros_frames.points_to_odom(obstacle.position, frames)),
            'velocity': _named_xyz(ros_frames.vectors_to_odom(obstacle.velocity, frames)),
            'covariance': _flat(ros_frames.state_covariance_to_odom(obstacle.covariance, frames)),
            'time_to_contact': float(obstacle.time_to_contact),
            'time_to_contact_variance': float(obstacle.time_to_contact_variance),
            'box': _column(obstacle.box, np.float32),
            'outline': _points(ros_frames.points_to_odom(obstacle.outline, frames)),
            'n_macroblocks': int(obstacle.n_macroblocks), 'age': float(obstacle.age),
            'last_seen': stamp_to_fields(obstacle.last_seen),
            'scale_prior': int(obstacle.scale_prior)}


def _obstacle_from_message(stamp: int, msg: Any, frames: RosFrames) -> Obstacle:
    inverse = frames.inverse()
    return Obstacle(
        int(msg.id), stamp, ObstacleState(msg.state),
        ros_frames.plane_to_odom(_flat(msg.plane), inverse),
        ros_frames.points_to_world(_read_xyz(msg.position), frames),
        ros_frames.vectors_to_world(_read_xyz(msg.velocity), frames),
        ros_frames.state_covariance_to_odom(_matrix(msg.covariance, 6), inverse),
        float(msg.time_to_contact), float(msg.time_to_contact_variance), _flat(msg.box),
        ros_frames.points_to_world(_read_points(msg.outline), frames), int(msg.n_macroblocks),
        float(msg.age), stamp_from_message(msg.last_seen), ScalePrior(msg.scale_prior))


def _pose_of(scene: SceneEstimate) -> Pose:
    return Pose(scene.R_world_from_cam, scene.t_world_from_cam, scene.pose_covariance)


def _pose(world_from_cam: Pose, frames: RosFrames) -> Fields:
    pose = ros_frames.pose_to_odom(world_from_cam, frames)
    return {'position': _named_xyz(pose.t), 'orientation': _quaternion(pose.R)}


def _pose_with_covariance(scene: SceneEstimate, frames: RosFrames) -> Fields:
    covariance = ros_frames.pose_to_odom(_pose_of(scene), frames).covariance
    return {'pose': _pose(_pose_of(scene), frames), 'covariance': _flat(covariance)}


def _twist_with_covariance(scene: SceneEstimate, frames: RosFrames) -> Fields:
    twist = Twist(scene.velocity_world, scene.omega_cam, scene.twist_covariance)
    twist = ros_frames.twist_to_base(twist, scene.R_world_from_cam, frames)
    return {'twist': {'linear': _named_xyz(twist.linear), 'angular': _named_xyz(twist.angular)},
            'covariance': _flat(twist.covariance)}


def _pose_from_message(msg: Any) -> Pose:
    q = msg.pose.orientation
    R = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    return Pose(R, _read_xyz(msg.pose.position), _matrix(msg.covariance, 6))


def _transform(stamp: int, parent: str, child: str, pose: Pose) -> Fields:
    return {'header': header(stamp, parent), 'child_frame_id': child,
            'transform': {'translation': _named_xyz(pose.t), 'rotation': _quaternion(pose.R)}}


def _point_columns(record: Correspondences | Extraction) -> Fields:
    columns = {'x_cur': record.x_cur[:, 0], 'y_cur': record.x_cur[:, 1],
               'x_prev': record.x_prev[:, 0], 'y_prev': record.x_prev[:, 1],
               'sigma': record.sigma}
    return {**{name: _column(values, np.float32) for name, values in columns.items()},
            'block_width': _column(record.block[:, 0], np.uint8),
            'block_height': _column(record.block[:, 1], np.uint8)}


def _points_of(msg: Any) -> Fields:
    def pairs(first: str, second: str, dtype: type) -> np.ndarray:
        """Return two columns of the message as one (N, 2)."""
        return np.stack([_column(getattr(msg, first), dtype),
                         _column(getattr(msg, second), dtype)], axis=1)

    return {'x_cur': pairs('x_cur', 'y_cur', np.float32),
            'x_prev': pairs('x_prev', 'y_prev', np.float32),
            'sigma': _column(msg.sigma, np.float32),
            'block': pairs('block_width', 'block_height', np.uint8)}


def _column(values: Any, dtype: type) -> np.ndarray:
    return np.ascontiguousarray(values, dtype)


def _flat(values: Any) -> np.ndarray:
    return np.array(values, float).ravel()


def _matrix(values: Any, n: int) -> np.ndarray:
    return np.array(values, float).reshape(n, n)



def _named_xyz(v: np.ndarray) -> Fields:
    return {'x': float(v[0]), 'y': float(v[1]), 'z': float(v[2])}


def _read_xyz(msg: Any) -> np.ndarray:
    return np.array([msg.x, msg.y, msg.z], float)


def _points(X: np.ndarray) -> list[Fields]:
    return [_named_xyz(point) for point in np.reshape(X, (-1, 3))]


def _read_points(points: Any) -> np.ndarray:
    return np.array([[p.x, p.y, p.z] for p in points], float).reshape(-1, 3)


def _quaternion(R: np.ndarray) -> Fields:
    x, y, z, w = Rotation.from_matrix(R).as_quat()
    return {'x': float(x), 'y': float(y), 'z': float(z), 'w': float(w)}
