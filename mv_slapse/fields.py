"""Records as the fields of messages, and back: shared by the ROS nodes and the bag writer.

``*_to_fields`` returns a message as a nested dict, field name to value, in which long arrays are
numpy columns of the message's own type; nodes and bags each fill their own message classes with
it. ``*_from_message`` reads any object that has the fields as attributes, whoever made it.

Positions go out in the odom frame and come back in {W}, see ``ros_frames``.
"""

from typing import Any

from mv_slapse import message_checks as check
from mv_slapse import ros_frames
from mv_slapse.calibration import camera_from_calibration
from mv_slapse.field_values import (
    column,
    Fields,
    flat,
    header,
    labels,
    map_plane_values,
    named_xyz,
    pair_of,
    point_columns,
    POINTS,
    points,
    points_of,
    published,
    quaternion,
    read_points,
    read_xyz,
    stamp_from_message,
    stamp_to_fields,
    strip_columns,
    strips_of,
)
from mv_slapse.geometry.camera import Camera
from mv_slapse.quaternion import to_matrix
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
    Speed,
    TrackingStatus,
)
from mv_slapse.ros_frames import Pose, RosFrames, Twist
import numpy as np

RATIOS = -50.0, 50.0  # log of a ratio of lengths
UNITS = 1 / check.FARTHEST, check.FARTHEST  # of a length in another unit
MAX_SPEED = 1000.0  # [m/s] of a vehicle


def camera_to_fields(camera: Camera, stamp: int, frame_id: str) -> Fields:
    """Return sensor_msgs/CameraInfo."""
    roi = {'x_offset': 0, 'y_offset': 0, 'height': 0, 'width': 0, 'do_rectify': False}
    return {'header': header(stamp, frame_id),
            'height': int(camera.height), 'width': int(camera.width),
            'distortion_model': camera.lens, 'd': flat(camera.distortion), 'k': flat(camera.K),
            'r': flat(np.eye(3)), 'p': flat(np.c_[camera.K, np.zeros(3)]),
            'binning_x': 0, 'binning_y': 0, 'roi': roi}


def camera_from_message(msg: Any, origin: str = 'camera_info') -> Camera:
    """Return the camera of a sensor_msgs/CameraInfo; an unusable one raises UnusableInput."""
    size, K = published(msg)
    return check.camera(camera_from_calibration(size, K, msg.distortion_model, msg.d, origin,
                                                (msg.width, msg.height)))


def correspondences_to_fields(record: Correspondences, frames: RosFrames) -> Fields:
    """Return mv_slapse_msgs/Correspondences."""
    return {
        'header': header(record.stamp, frames.camera),
        'previous_stamp': stamp_to_fields(record.previous_stamp),
        'width': int(record.width), 'height': int(record.height),
        'kind': int(record.kind), 'n_b': int(record.n_b), 'reason': record.reason,
        **point_columns(record),
        'probability': column(record.probability, np.float32), **strip_columns(record.strips)}


def correspondences_from_message(msg: Any) -> Correspondences:
    """Return the record of a mv_slapse_msgs/Correspondences, or raise InvalidMessage."""
    pair = pair_of(msg)
    check.same_length(msg, (*POINTS, 'probability'), check.most_blocks(msg.width, msg.height))
    return Correspondences(
        **pair, n_b=int(check.number(msg.n_b, 'n_b', 0, check.MAX_B_FRAMES)),
        probability=check.within(column(msg.probability, np.float32), 'probability', 0, 1),
        strips=strips_of(msg), **points_of(msg))


def extraction_to_fields(record: Extraction, frames: RosFrames) -> Fields:
    """Return mv_slapse_msgs/PlaneObservations."""
    motion = record.motion
    return {
        'header': header(record.stamp, frames.camera),
        'previous_stamp': stamp_to_fields(record.previous_stamp),
        'width': int(record.width), 'height': int(record.height),
        'kind': int(record.kind), 'reason': record.reason, 'k': flat(record.K),
        'motion_status': int(motion.status), 'rotation': flat(motion.R_cur_from_prev),
        'translation': flat(motion.t_cur_from_prev),
        'motion_covariance': flat(motion.covariance), 'forward': bool(motion.forward),
        'baseline_ratio': float(record.baseline_ratio),
        'baseline_ratio_sigma': float(record.baseline_ratio_sigma),
        'planes': [_observation_to_fields(plane) for plane in record.planes],
        **point_columns(record),
        'label': column(record.label, np.int8),
        'plane_id': column(record.plane_id, np.int32),
        'macroblock_label': column(record.macroblock_label, np.int8),
        'macroblock_plane': column(record.macroblock_plane, np.int32),
    }


def extraction_from_message(msg: Any) -> Extraction:
    """Return the record of a mv_slapse_msgs/PlaneObservations, or raise InvalidMessage."""
    pair, size = pair_of(msg), (msg.width, msg.height)
    check.same_length(msg, (*POINTS, 'label', 'plane_id'), check.most_blocks(*size))
    check.same_length(msg, ('macroblock_label', 'macroblock_plane'),
                      check.most_macroblocks(*size))
    motion = CameraMotion(
        check.member(MotionStatus, msg.motion_status, 'motion_status'),
        check.rotation(msg.rotation, 'rotation'),
        check.numbers(msg.translation, 'translation', (3,), check.FARTHEST),
        check.covariance(msg.motion_covariance, 'motion_covariance', 6), bool(msg.forward))
    return Extraction(
        **pair, K=check.intrinsics(msg.k), motion=motion,
        planes=tuple(map(_observation_from_message, check.count(msg.planes, 'planes'))),
        label=labels(msg, 'label'), plane_id=column(msg.plane_id, np.int32),
        macroblock_label=labels(msg, 'macroblock_label'),
        macroblock_plane=column(msg.macroblock_plane, np.int32),
        baseline_ratio=check.number(msg.baseline_ratio, 'baseline_ratio', *RATIOS),
        baseline_ratio_sigma=check.number(msg.baseline_ratio_sigma, 'baseline_ratio_sigma', 0),
        **points_of(msg))


def odometry_to_fields(scene: SceneEstimate, frames: RosFrames) -> Fields:
    """Return nav_msgs/Odometry: pose of the base in odom, twist in the base."""
    return {'header': header(scene.stamp, frames.odom), 'child_frame_id': frames.base,
            'pose': _pose_with_covariance(scene, frames),
            'twist': _twist_with_covariance(scene, frames)}


def speed_from_message(msg: Any) -> Speed:
    """Return the speed of a nav_msgs/Odometry of wheels: over ground, negative backwards."""
    x, y, _ = read_xyz(msg.twist.twist.linear, 'twist.twist.linear', MAX_SPEED)
    return Speed(stamp_from_message(msg.header.stamp), float(np.copysign(np.hypot(x, y), x)))


def pose_to_fields(scene: SceneEstimate, frames: RosFrames) -> Fields:
    """Return geometry_msgs/PoseWithCovarianceStamped in odom."""
    return {'header': header(scene.stamp, frames.odom),
            'pose': _pose_with_covariance(scene, frames)}


def pose_with_covariance_from_message(msg: Any) -> Pose:
    """Return the pose of a geometry_msgs/PoseWithCovarianceStamped, in its own frame."""
    return _pose_from_message(msg.pose)


def pose_from_message(msg: Any, frames: RosFrames) -> Pose:
    """Return the pose in {W} of a geometry_msgs/PoseWithCovarianceStamped in odom."""
    return ros_frames.pose_to_world(_pose_from_message(msg.pose), frames)


def pose_stamped_to_fields(scene: SceneEstimate, frames: RosFrames) -> Fields:
    """Return geometry_msgs/PoseStamped in odom, an entry of a nav_msgs/Path."""
    return camera_pose_to_fields(scene.stamp, _pose_of(scene), frames)


def camera_pose_to_fields(stamp: int, world_from_cam: Pose, frames: RosFrames) -> Fields:
    """Return geometry_msgs/PoseStamped in odom of a camera's pose in {W}."""
    return {'header': header(stamp, frames.odom),
            'pose': _pose(ros_frames.pose_to_odom(world_from_cam, frames))}


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


def plane_map_to_fields(scene: SceneEstimate, frames: RosFrames, resets: int = 0,
                        began: int = 0) -> Fields:
    """Return mv_slapse_msgs/PlaneMap in odom.

    Of a trajectory that began anew ``resets`` times, the last time at a stamp [ns].
    """
    return {'header': header(scene.stamp, frames.odom), 'tracking': int(scene.status),
            'reason': scene.reason, 'scale_status': int(scene.scale_status),
            'scale_source': scene.scale_source, 'resets': int(resets),
            'began': stamp_to_fields(began), 'unit': float(scene.unit),
            'planes': [map_plane_to_fields(plane, frames) for plane in scene.planes]}


def scene_from_messages(odometry: Any, plane_map: Any, frames: RosFrames,
                        baseline: float = 0.0) -> SceneEstimate:
    """Return the scene of a nav_msgs/Odometry and the PlaneMap of the same stamp.

    ``baseline`` [map unit] is in neither message; it is the distance to the previous pose.
    """
    pose, inverse = pose_from_message(odometry, frames), frames.inverse()
    twist = ros_frames.twist_to_world(_twist_from_message(odometry.twist), pose.R, frames)
    return SceneEstimate(
        stamp_from_message(odometry.header.stamp), tracking_from_message(plane_map),
        plane_map.reason, pose.R, pose.t, pose.covariance, twist.linear, twist.angular,
        twist.covariance, check.member(ScaleStatus, plane_map.scale_status, 'scale_status'),
        plane_map.scale_source, tuple(_map_plane_from_message(plane, frames, inverse) for plane
                                      in check.count(plane_map.planes, 'planes')), baseline,
        int(plane_map.resets), unit=check.number(plane_map.unit, 'unit', *UNITS))


def check_odometry(msg: Any):
    """Raise InvalidMessage where a nav_msgs/Odometry says what cannot be."""
    stamp_from_message(msg.header.stamp)
    _pose_from_message(msg.pose)
    _twist_from_message(msg.twist)


def check_plane_map(msg: Any):
    """Raise InvalidMessage where a mv_slapse_msgs/PlaneMap says what cannot be."""
    stamp_from_message(msg.header.stamp)
    stamp_from_message(msg.began)
    tracking_from_message(msg)
    check.member(ScaleStatus, msg.scale_status, 'scale_status')
    check.number(msg.unit, 'unit', *UNITS)
    for plane in check.count(msg.planes, 'planes'):
        map_plane_values(plane)


def tracking_from_message(plane_map: Any) -> TrackingStatus:
    """Return how far a mv_slapse_msgs/PlaneMap says that its pose can be trusted."""
    return check.member(TrackingStatus, plane_map.tracking, 'tracking')


def obstacles_to_fields(stamp: int, obstacles: list[Obstacle], scale_status: ScaleStatus,
                        frames: RosFrames) -> Fields:
    """Return mv_slapse_msgs/ObstacleArray in odom."""
    return {'header': header(stamp, frames.odom), 'scale_status': int(scale_status),
            'obstacles': [_obstacle_to_fields(obstacle, frames) for obstacle in obstacles]}


def obstacles_from_message(msg: Any, frames: RosFrames) -> list[Obstacle]:
    """Return the obstacles of a mv_slapse_msgs/ObstacleArray in {W}."""
    stamp = stamp_from_message(msg.header.stamp)
    return [_obstacle_from_message(stamp, obstacle, frames)
            for obstacle in check.count(msg.obstacles, 'obstacles')]


def handover_to_fields(record: PlaneHandover, frames: RosFrames) -> Fields:
    """Return mv_slapse_msgs/PlaneHandover in odom."""
    return {'header': header(record.stamp, frames.odom), 'id': int(record.id),
            'to_label': int(record.to_label),
            'plane': ros_frames.plane_to_odom(record.plane, frames),
            'velocity': ros_frames.vectors_to_odom(record.velocity, frames),
            'covariance': flat(ros_frames.plane_velocity_covariance_to_odom(
                record.plane, record.covariance, frames))}


def handover_from_message(msg: Any, frames: RosFrames) -> PlaneHandover:
    """Return the record of a mv_slapse_msgs/PlaneHandover in {W}."""
    plane, inverse = check.numbers(msg.plane, 'plane', (3,), check.FARTHEST), frames.inverse()
    velocity = check.numbers(msg.velocity, 'velocity', (3,), check.FARTHEST)
    return PlaneHandover(
        stamp_from_message(msg.header.stamp), int(msg.id),
        check.member(Label, msg.to_label, 'to_label'), ros_frames.plane_to_odom(plane, inverse),
        ros_frames.vectors_to_world(velocity, frames),
        ros_frames.plane_velocity_covariance_to_odom(
            plane, check.covariance(msg.covariance, 'covariance', 6), inverse))


def _observation_to_fields(plane: PlaneObservation) -> Fields:
    return {'id': int(plane.id), 'label': int(plane.label), 'is_ground': bool(plane.is_ground),
            'n_macroblocks': int(plane.n_macroblocks), 'plane': flat(plane.plane),
            'covariance': flat(plane.covariance), 't_d': flat(plane.t_d),
            'product': flat(plane.product), 'scale_prior': int(plane.scale_prior),
            'score': float(plane.score)}


def _observation_from_message(msg: Any) -> PlaneObservation:
    label = check.member(Label, msg.label, 'planes[].label')
    return PlaneObservation(
        int(msg.id), label, check.numbers(msg.plane, 'planes[].plane', (3,), check.FARTHEST),
        check.covariance(msg.covariance, 'planes[].covariance',
                         3 if label is Label.STATIONARY else 6),
        check.numbers(msg.t_d, 'planes[].t_d', (3,), check.FARTHEST),
        check.numbers(msg.product, 'planes[].product', (3, 3), check.FARTHEST),
        check.member(ScalePrior, msg.scale_prior, 'planes[].scale_prior'), bool(msg.is_ground),
        int(msg.n_macroblocks), check.number(msg.score, 'planes[].score'))


def map_plane_to_fields(plane: MapPlane, frames: RosFrames) -> Fields:
    """Return mv_slapse_msgs/MapPlane in odom."""
    normal, depth, covariance = ros_frames.normal_depth_to_odom(
        plane.normal, plane.depth, plane.covariance, frames)
    return {'id': int(plane.id), 'normal': named_xyz(normal), 'depth': depth,
            'covariance': flat(covariance),
            'outline': points(ros_frames.points_to_odom(plane.outline, frames)),
            'first_seen': stamp_to_fields(plane.first_stamp),
            'last_seen': stamp_to_fields(plane.last_stamp),
            'n_observations': int(plane.n_observations),
            'n_macroblocks': int(plane.n_macroblocks), 'is_ground': bool(plane.is_ground)}


def _map_plane_from_message(msg: Any, frames: RosFrames, inverse: RosFrames) -> MapPlane:
    normal, depth, covariance, outline, first_seen, last_seen = map_plane_values(msg)
    normal, depth, covariance = ros_frames.normal_depth_to_odom(normal, depth, covariance, inverse)
    return MapPlane(int(msg.id), normal, depth, covariance,
                    ros_frames.points_to_world(outline, frames), first_seen, last_seen,
                    int(msg.n_observations), int(msg.n_macroblocks), bool(msg.is_ground))


def _obstacle_to_fields(obstacle: Obstacle, frames: RosFrames) -> Fields:
    return {'id': int(obstacle.id), 'state': int(obstacle.state),
            'plane': ros_frames.plane_to_odom(obstacle.plane, frames),
            'position': named_xyz(ros_frames.points_to_odom(obstacle.position, frames)),
            'velocity': named_xyz(ros_frames.vectors_to_odom(obstacle.velocity, frames)),
            'covariance': flat(ros_frames.state_covariance_to_odom(obstacle.covariance, frames)),
            'time_to_contact': float(obstacle.time_to_contact),
            'time_to_contact_variance': float(obstacle.time_to_contact_variance),
            'box': column(obstacle.box, np.float32),
            'outline': points(ros_frames.points_to_odom(obstacle.outline, frames)),
            'n_macroblocks': int(obstacle.n_macroblocks), 'age': float(obstacle.age),
            'last_seen': stamp_to_fields(obstacle.last_seen),
            'scale_prior': int(obstacle.scale_prior)}


def _obstacle_from_message(stamp: int, msg: Any, frames: RosFrames) -> Obstacle:
    inverse = frames.inverse()
    return Obstacle(
        int(msg.id), stamp, check.member(ObstacleState, msg.state, 'state'),
        ros_frames.plane_to_odom(check.numbers(msg.plane, 'plane', (3,)), inverse),
        ros_frames.points_to_world(read_xyz(msg.position, 'position'), frames),
        ros_frames.vectors_to_world(read_xyz(msg.velocity, 'velocity'), frames),
        ros_frames.state_covariance_to_odom(
            check.covariance(msg.covariance, 'covariance', 6), inverse),
        float(msg.time_to_contact), float(msg.time_to_contact_variance),
        check.numbers(msg.box, 'box', (4,)),
        ros_frames.points_to_world(read_points(msg.outline), frames), int(msg.n_macroblocks),
        float(msg.age), stamp_from_message(msg.last_seen),
        check.member(ScalePrior, msg.scale_prior, 'scale_prior'))


def _pose_of(scene: SceneEstimate) -> Pose:
    return Pose(scene.R_world_from_cam, scene.t_world_from_cam, scene.pose_covariance)


def _pose(pose: Pose) -> Fields:
    return {'position': named_xyz(pose.t), 'orientation': quaternion(pose.R)}


def _pose_with_covariance(scene: SceneEstimate, frames: RosFrames) -> Fields:
    pose = ros_frames.pose_to_odom(_pose_of(scene), frames)
    return {'pose': _pose(pose), 'covariance': flat(pose.covariance)}


def _twist_with_covariance(scene: SceneEstimate, frames: RosFrames) -> Fields:
    twist = Twist(scene.velocity_world, scene.omega_cam, scene.twist_covariance)
    twist = ros_frames.twist_to_base(twist, scene.R_world_from_cam, frames)
    return {'twist': {'linear': named_xyz(twist.linear), 'angular': named_xyz(twist.angular)},
            'covariance': flat(twist.covariance)}


def _pose_from_message(msg: Any) -> Pose:
    q = check.quaternion(msg.pose.orientation, 'pose.orientation')
    return Pose(to_matrix(q), read_xyz(msg.pose.position, 'pose.position'),
                check.covariance(msg.covariance, 'pose.covariance', 6))


def _twist_from_message(msg: Any) -> Twist:
    return Twist(read_xyz(msg.twist.linear, 'twist.twist.linear'),
                 read_xyz(msg.twist.angular, 'twist.twist.angular'),
                 check.covariance(msg.covariance, 'twist.covariance', 6))


def _transform(stamp: int, parent: str, child: str, pose: Pose) -> Fields:
    return {'header': header(stamp, parent), 'child_frame_id': child,
            'transform': {'translation': named_xyz(pose.t), 'rotation': quaternion(pose.R)}}
