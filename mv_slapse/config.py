"""Settings of every part, with unit, meaning, bounds and source beside each default.

The one list: ROS parameters, the YAML in ``config/`` and the table of the documentation come
from these dataclasses.
"""

from dataclasses import dataclass, field, fields
from typing import Any

from mv_slapse.errors import UsageError

GREATEST = 1e9  # that a number without another bound may be: what is made of it stays finite
USUAL_HEIGHT = 1.65  # [m] of the camera, where nobody gives it
LEAST_HEIGHT = 0.001  # [m]


def setting(default: Any, unit: str, meaning: str, low: Any = None, high: Any = None) -> Any:
    """Return a dataclass field that carries its unit, its meaning and its bounds."""
    metadata = {'doc': f'[{unit}] {meaning}', 'low': low, 'high': high}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Checked:
    """Settings that refuse a value outside its bounds."""

    def __post_init__(self):
        """Reject what no run can use, naming the setting, the value and the bound."""
        for item in fields(self):
            value, low, high = (getattr(self, item.name), item.metadata['low'],
                                item.metadata['high'])
            if isinstance(item.default, float) and high is None:
                high = GREATEST
            if low is not None and not value >= low or high is not None and not value <= high:
                raise UsageError(f'{type(self).__name__}.{item.name} = {value!r} is out of '
                                 f'bounds [{low}, {high}]: {item.metadata["doc"]}')


ENCODED = ('mpeg2video', 'h264')
RECODE = ('auto', 'always', 'never')


@dataclass(frozen=True)
class EncoderSettings(Checked):
    """From pictures to packets in memory, where the input has no motion vectors of its own."""

    codec: str = setting(
        'mpeg2video', '-', f'of the packets, one of {", ".join(ENCODED)}; H.264 takes twice the '
        'time')
    b_frames: int = setting(
        0, '-', 'B frames between two key frames; each makes the pose a picture later and the '
        'rate of poses lower', 0, 3)
    quality: int = setting(
        0, '-', 'quantiser of MPEG-2 (2 to 31) or rate factor of H.264 (1 to 51); 0: as gives the '
        'truest vectors', 0, 51)
    rate: float = setting(
        0.0, '1/s', 'rate of pictures that come without times, as in a folder; 0: unknown', 0.0,
        10000.0)
    recode: str = setting(
        'auto', '-', f'which video is decoded and encoded again, one of {", ".join(RECODE)}; '
        'auto: that of codecs without motion vectors (HEVC, VP9, AV1, JPEG); always: also one '
        'whose own vectors are of no use')

    def __post_init__(self):
        """Refuse a codec that cannot be encoded, and a word that is no choice."""
        super().__post_init__()
        for name, choices in (('codec', ENCODED), ('recode', RECODE)):
            if getattr(self, name) not in choices:
                raise UsageError(f'encoder.{name} = {getattr(self, name)!r}: choose one of '
                                 f'{", ".join(choices)}')


@dataclass(frozen=True)
class DecoderSettings(Checked):
    """From packets to correspondences, [SLAPSE] III and V-A."""

    match_probability: float = setting(
        0.6, '-', 'probability p that one motion vector is right, [SLAPSE] III-B, before the '
        'stream has shown its own', 0.01, 0.999)
    vector_sigma: float = setting(
        0.2, 'px', 'standard deviation of a right vector where the picture has texture, (2) of '
        '[SLAPSE]', 0.01, 10.0)
    paper_weights: bool = setting(
        False, '-', 'weigh direct to indirect evidence sqrt(2) to 1, (5) of [SLAPSE], instead of '
        'by inverse variance, 2 to 1')
    bend_slack: float = setting(
        2.0, 'px', 'how far the two vectors of a B block may depart from constant velocity', 0.0)
    bend_tolerance: float = setting(
        0.15, '-', 'the same, as a share of the motion over the segment', 0.0)
    agreement_slack: float = setting(
        1.0, 'px', 'how far vectors of neighbouring macroblocks may differ', 0.01)
    agreement_tolerance: float = setting(
        0.1, '-', 'the same, as a share of the length of the vector', 0.0)
    min_support: float = setting(
        2.0, '-', 'least support of a vector by its own and the 8 macroblocks around', 0.0, 9.0)
    lone_probability: float = setting(
        0.2, '-', 'probability of a vector that nothing supports, as a share of the probability '
        'of others; a bare road shows no other ones; 0: they are left out', 0.0, 0.49)
    prior_votes: float = setting(
        1.0, '-', 'support that a vector gets from the motion of the pairs before, in macroblocks',
        0.0, 9.0)
    prior_slack: float = setting(
        2.0, 'px', 'how far a vector may be from that motion to get support', 0.01)
    prior_tolerance: float = setting(
        0.1, '-', 'the same, as a share of the expected vector', 0.0)
    split_flow: float = setting(
        16.0, 'px', 'median motion of a segment beyond which its middle B frame is a pose of its '
        'own, if either half has parallax enough; for a focal length of up to 500 px: a longer '
        'one shows the same motion in more pixels; 0: always', 0.0)
    split_share: float = setting(
        0.6, '-', 'least share of correspondences that both halves must keep, or the segment '
        'stays whole', 0.0)
    bridge_intra: bool = setting(
        True, '-', 'look at pictures: search the macroblocks of an I frame that no vectors, or '
        'few, join to the past, weigh vectors by texture, and cut macroblocks on the way ahead')
    bridge_variance: float = setting(
        1.0, '-', 'variance of a match so found, in units of a motion vector', 0.01, 100.0)
    bridge_minimum: int = setting(
        100, '-', 'fewest matches that bridge an I frame; below, the pair is broken', 1)
    min_parallax: float = setting(
        6.0, 'px', 'parallax after removing rotation, of the nearest three tenths of the blocks, '
        'at which a pair is long enough; shorter ones are chained', 0.0)
    min_chain_time: float = setting(
        0.035, 's', 'shorter pairs are chained whatever their parallax: an error of the scale in '
        'each adds up over their number', 0.0)
    max_chain: int = setting(12, '-', 'most pairs that are chained into one', 1)
    max_chain_time: float = setting(
        0.25, 's', 'longest time that a chain spans, also where the camera stands still; what '
        'takes longer between key frames is split at its middle B frame', 0.0)
    max_chain_flow: float = setting(
        32.0, 'px', 'median motion at which a chain ends whatever its parallax', 1.0)


@dataclass(frozen=True)
class ExtractionSettings(Checked):
    """From correspondences to labelled planes and camera motion, [MVO] 4."""

    epsilon_f: float = setting(
        3.0, 'sigma', 'largest epipolar error of an inlier, (3) of [MVO]; 99.7 % of a Gaussian',
        0.5, 20.0)
    epsilon_m: float = setting(
        1.0, 'px', 'smallest parallax of a block not at infinity, (7) of [MVO]', 0.0, 20.0)
    epsilon_h: float = setting(
        3.0, 'sigma', 'largest error of a block on the ground, along its epipolar line', 0.5, 20.0)
    min_macroblocks: int = setting(20, '-', 'smallest plane, section VII-A of [SLAPSE]', 4)
    moving_score: float = setting(
        13.0, '-', 'squared distance from anything stationary, summed over key frames, at which a '
        'region is called moving: no pair tells more than 10, so that two agree', 1.0)
    max_blocks: int = setting(
        2000, '-', 'most macroblocks of a key frame that are looked at: a larger picture is taken '
        'as one of fewer pixels, in steps of a half, so that a pair of 1080p costs about as much '
        'as one of KITTI',
        300, 100000)
    max_planes: int = setting(8, '-', 'most stationary planes of a key frame', 1, 64)
    max_uncertainty: float = setting(
        0.055, '-', 'standard deviation of a plane n / d, as a share of it, at which it is '
        'reported: 3 deg, or 5.5 % of its depth', 0.001, 1.0)
    relief: float = setting(
        0.03, '-', 'depth of a surface about its plane, as a share of depth: a facade 10 m off '
        'has windows and hedges of 0.3 m', 0.0, 1.0)
    trials: int = setting(128, '-', 'planes sampled in the search for the ground', 8, 100000)
    radius: float = setting(
        96.0, 'px', 'a quarter of the distance within which blocks are sampled for the ground',
        16.0)
    ground_tilt: float = setting(
        0.07, 'rad', 'standard deviation of the ground normal before it is found: 4 deg of '
        'mounting', 0.001, 1.0)
    ground_wobble: float = setting(
        0.01, 'rad', 'its change from one key frame to the next: suspension and road', 1e-4, 1.0)
    standstill_share: float = setting(
        0.5, '-', 'share of blocks with a zero vector at which the camera stands', 0.1, 1.0)
    min_inliers: float = setting(
        0.4, '-', 'smallest share of blocks that agree with a camera motion; below, the motion '
        'is unknown: vectors at random make 0.15 to 0.3', 0.0, 1.0)
    own_top: float = setting(
        0.0, '-', 'share of the picture at its top that shows the vehicle itself, or a bar, and '
        'tells nothing of the scene', 0.0, 0.9)
    own_bottom: float = setting(
        0.0, '-', 'the same at its bottom: a bonnet, a bumper, a gripper', 0.0, 0.9)
    own_left: float = setting(0.0, '-', 'the same at its left', 0.0, 0.9)
    own_right: float = setting(0.0, '-', 'the same at its right', 0.0, 0.9)
    seed: int = setting(0, '-', 'of the sampling; the same seed gives the same planes', 0)


@dataclass(frozen=True)
class MountSettings(Checked):
    """How the camera is mounted: from it come the scale and how large vehicles look."""

    camera_height: float = setting(
        0.0, 'm', 'height of a camera that is rigidly mounted on a ground vehicle; 0: unknown, '
        'the scale stays free and vehicles are taken to look as from 1.65 m', 0.0, 1000.0)

    def __post_init__(self):
        """Refuse a height that is next to none, too."""
        super().__post_init__()
        if 0 < self.camera_height < LEAST_HEIGHT:
            raise UsageError(f'camera_height = {self.camera_height!r} is out of bounds '
                             f'[{LEAST_HEIGHT}, 1000.0] [m]; give 0 where it is not known')


@dataclass(frozen=True)
class SceneSettings(MountSettings):
    """Filter of camera and stationary planes, [SLAPSE] VI and [MVO] 5."""

    camera_height_sigma: float = setting(
        0.02, '-', 'standard deviation of that height above the road that is seen, as a share of '
        'it: suspension, crown and bumps', 1e-4, 1.0)
    camera_height_time: float = setting(
        0.3, 's', 'for which that height stays wrong alike', 0.0)
    camera_height_bias: float = setting(
        0.015, '-', 'standard deviation of what of that height is wrong for good, as a share: '
        'how it was measured, load, road that vectors show too near or too far', 0.0, 1.0)
    mounting_sigma: float = setting(
        0.01, 'rad', 'standard deviation of the ground normal in a mounted camera from key frame '
        'to key frame: pitch and roll on the suspension', 1e-4, 1.0)
    course_sigma: float = setting(
        0.02, 'rad', 'standard deviation of a vehicle\'s course from the plane of the ground: '
        'heave and pitch', 1e-4, 1.0)
    acceleration: float = setting(
        1.5, 'm/s^1.5', 'random walk of the velocity where the scale is metric: a car brakes '
        'with 5 m/s^2', 0.0)
    free_acceleration: float = setting(
        0.5, 's^-0.5', 'the same where it is free, as a share of the greatest speed so far: a '
        'flight turns round in 2 s', 0.0)
    angular_acceleration: float = setting(
        1.0, 'rad/s^1.5', 'random walk of the angular velocity', 0.0)
    turn_rate: float = setting(
        0.5, 'rad/s', 'standard deviation of the angular velocity, however long nothing is seen: '
        'a car turns a corner with 0.6 rad/s', 0.01)
    ground_slope: float = setting(
        0.005, 'rad/m^0.5', 'random walk of the ground normal along the way: 3 deg in 100 m', 0.0)
    relief: float = setting(
        0.03, '-', 'depth of a surface about its plane, as a share of depth; where the scale '
        'is metric also what its depth changes by while the camera moves by it', 0.0, 1.0)
    depth_bias: float = setting(
        0.015, '-', 'error of the depth of a whole surface in one pair, as a share: encoders '
        'pull its vectors the same way; 1 to 2.4 % was measured on road', 0.0, 1.0)
    dependence: float = setting(
        3.0, '-', 'neighbouring motion vectors err together: so many tell as much as one '
        'independent one before the stream has shown it', 1.0)
    depth_dependence: float = setting(
        6.0, '-', 'the same along epipolar lines, where the relief of a surface errs together '
        'as well', 1.0)
    vector_bias: float = setting(
        0.012, 'px', 'error that all vectors of a pair share, which no averaging removes, and as '
        'much again that all pairs share: 0.01 to 0.02 was measured', 1e-4, 10.0)
    mover_bias: float = setting(
        0.2, 'px', 'the same for each share of the vectors that movers have: encoders predict '
        'vectors from those around, and what differs from side to side turns the picture: the '
        'roll is as unsure as these leave it at the mean distance of blocks from the middle; '
        'buses over a fifth of the picture made some 0.1 px', 0.0, 16.0)
    place_bias: float = setting(
        0.4, 'px', 'standard deviation of the place in its block that a vector tells of, which '
        'all share: what is left where encoders prefer the vectors of the blocks around; more '
        'where the stream shows that most are copied from those', 0.0, 16.0)
    focal_sigma: float = setting(
        0.01, '-', 'standard deviation of the focal length, as a share: what calibration, focus '
        'and temperature leave', 0.0, 0.5)
    speed_sigma: float = setting(
        0.02, '-', 'standard deviation of the way of one pair by a speed that is given, as a '
        'share: slip, and stamps that are some ms off', 1e-4, 1.0)
    speed_bias: float = setting(
        0.01, '-', 'standard deviation of what of a given speed is wrong for good, as a share: '
        'the size of the wheels', 0.0, 1.0)
    speed_arm: float = setting(
        0.5, 'm', 'standard deviation of the camera\'s place to the side of where the speed is '
        'taken, which goes farther or less far in turns', 0.0)
    ratio_sigma: float = setting(
        0.006, '-', 'common error of the depths of one pair, as a share: 0.5 % was measured',
        1e-4, 1.0)
    ratio_drift: float = setting(
        0.004, '-', 'random walk of the scale of the block map from pair to pair', 1e-5, 1.0)
    gate: float = setting(
        16.3, '-', 'largest squared Mahalanobis distance of a plane observation, 99.9 % of '
        'chi-square with 3 degrees of freedom', 1.0)
    iterations: int = setting(4, '-', 'relinearisations of one update', 1, 50)
    plane_lifetime: float = setting(2.0, 's', 'a plane is kept this long without support', 0.0)
    lost_after: float = setting(
        1.0, 's', 'without an accepted observation for this long the filter is LOST', 0.0)


@dataclass(frozen=True)
class ObstacleSettings(Checked):
    """Filters of moving obstacles, (14)-(16) of [MVO]."""

    lifetime: float = setting(
        0.5, 's', 'an obstacle expires this long after its last evidence; one that was seen for '
        'less, after as long', 0.0)
    min_macroblocks: int = setting(4, '-', 'smallest support of a moving plane', 4)
    gate: float = setting(0.999, '-', 'share of right detections inside the gate of a track', 0.5,
                          0.999999)
    acceleration: float = setting(
        2.0, 'm/s^2', 'of obstacles, standard deviation; without metric scale taken as [1/s] '
        'times a tenth of the speed', 0.0, 100.0)
    vector_bias: float = setting(
        0.15, 'px', 'error that all vectors of a region share, which no averaging removes', 0.0,
        16.0)
    correlation_time: float = setting(
        0.4, 's', 'for which the outline of a region, and so its place and depth, is wrong alike',
        0.0)
    moving_confidence: float = setting(
        0.99, '-', 'confidence at which a velocity differs from zero, as the labels said before',
        0.5, 0.999999)
    confirm_time: float = setting(
        0.1, 's', 'that the evidence must span which confirms an obstacle: its label took two '
        'pairs before', 0.0)
    confirm_pairs: int = setting(
        2, '-', 'key frame pairs with evidence; of 8 a second a third comes too late', 1)
    confirm_window: float = setting(0.6, 's', 'in which these pairs must lie', 0.0)
    min_speed: float = setting(
        0.3, 'm/s', 'slowest obstacle that is confirmed, where scale is metric', 0.0)
    still_time: float = setting(
        0.5, 's', 'without evidence of motion, after which an obstacle joins the scene', 0.0)
    still_speed: float = setting(
        1.0, 'm/s', 'fastest estimate that may still be a standing obstacle; without metric scale '
        'taken times a tenth of the camera\'s speed', 0.0)


@dataclass(frozen=True)
class Settings:
    """Settings of the whole pipeline."""

    encoder: EncoderSettings = field(default_factory=EncoderSettings)
    decoder: DecoderSettings = field(default_factory=DecoderSettings)
    extraction: ExtractionSettings = field(default_factory=ExtractionSettings)
    scene: SceneSettings = field(default_factory=SceneSettings)
    obstacles: ObstacleSettings = field(default_factory=ObstacleSettings)
