"""Hypothesis strategies: any record that can be, to the bounds of what messages may say."""

from hypothesis import strategies as st
from mv_slapse import message_checks as check
from mv_slapse import records as r
from mv_slapse.field_values import SIGMAS
from mv_slapse.geometry import rotation
from mv_slapse.records import Label
from mv_slapse.ros_frames import RosFrames
from mv_slapse.strip_matches import StripMatches
import numpy as np

FAR = 1e5  # [m]: farther, sums of places lose the digits that a comparison looks at
WIDTH, HEIGHT = 64, 48
MACROBLOCKS = 12

stamps = st.integers(check.MAX_INTERVAL, check.MAX_STAMP)
ids = st.integers(0, 2**31 - 1)
counts = st.integers(0, 2**31 - 1)
texts = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=20)
labels = st.sampled_from(Label)


def floats(low, high, **options):
    return st.floats(low, high, allow_nan=False, **options)


def array(n, elements, dtype=float):
    shape = n if isinstance(n, tuple) else (n,)
    size = int(np.prod(shape))
    return st.lists(elements, min_size=size, max_size=size).map(
        lambda values: np.array(values, dtype).reshape(shape))


def vectors(bound=FAR):
    return array(3, floats(-bound, bound))


rotations = array(3, floats(-3.1, 3.1)).map(rotation.exp)


def covariances(n):
    """Return anything positive semidefinite, of rank one as well, and of any size."""
    parts = array((n, n), floats(-1, 1)), floats(-8, 6)
    return st.tuples(*parts).map(lambda p: 10.0**p[1] * p[0] @ p[0].T)


@st.composite
def columns(draw, n):
    """Return what both messages of a pair have, n rows."""
    pixel = floats(-check.FAR_OUT, check.FAR_OUT, width=32)
    return {'x_cur': draw(array((n, 2), pixel, np.float32)),
            'x_prev': draw(array((n, 2), pixel, np.float32)),
            'sigma': draw(array(n, floats(*(float(np.float32(s * f)) for s, f in zip(
                SIGMAS, (1.01, 0.99), strict=True)), width=32), np.float32)),
            'block': draw(array((n, 2), st.sampled_from([4, 8, 16]), np.uint8))}


@st.composite
def pairs(draw):
    """Return stamps, size and kind of a pair of key frames."""
    stamp = draw(stamps)
    step = draw(st.integers(check.MIN_INTERVAL, check.MAX_INTERVAL))
    return {'stamp': stamp, 'previous_stamp': stamp - step, 'width': WIDTH, 'height': HEIGHT,
            'kind': draw(st.sampled_from(r.SegmentKind)), 'reason': draw(texts)}


@st.composite
def correspondences(draw):
    n = draw(st.integers(0, 4))
    places = draw(columns(draw(st.integers(0, 3))))
    strips = StripMatches(draw(stamps), places['x_cur'], places['x_prev'], places['sigma'])
    return r.Correspondences(
        **draw(pairs()), n_b=draw(st.integers(0, check.MAX_B_FRAMES)), **draw(columns(n)),
        probability=draw(array(n, floats(0, 1, width=32), np.float32)), strips=strips)


@st.composite
def observations(draw):
    label = draw(st.sampled_from([Label.STATIONARY, Label.MOVING]))
    return r.PlaneObservation(
        draw(ids), label, draw(vectors()), draw(covariances(6 if label is Label.MOVING else 3)),
        draw(vectors()), draw(array((3, 3), floats(-FAR, FAR))),
        draw(st.sampled_from(r.ScalePrior)), draw(st.booleans()), draw(counts),
        draw(floats(-FAR, FAR)))


motions = st.builds(
    r.CameraMotion, st.sampled_from(r.MotionStatus), rotations, vectors(1), covariances(6),
    st.booleans())


@st.composite
def extractions(draw):
    n, plane_ids = draw(st.integers(0, 4)), st.integers(-1, 2**31 - 1)
    focal = draw(floats(1, 1e5))
    return r.Extraction(
        **draw(pairs()), K=np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]]),
        motion=draw(motions), planes=tuple(draw(st.lists(observations(), max_size=2))),
        **draw(columns(n)), label=draw(array(n, labels, np.int8)),
        plane_id=draw(array(n, plane_ids, np.int32)),
        macroblock_label=draw(array(MACROBLOCKS, labels, np.int8)),
        macroblock_plane=draw(array(MACROBLOCKS, plane_ids, np.int32)),
        baseline_ratio=draw(floats(-50, 50)),
        baseline_ratio_sigma=draw(floats(0, 1e6) | st.just(float('inf'))))


outlines = st.integers(0, 4).flatmap(lambda n: array((n, 3), floats(-FAR, FAR)))

map_planes = st.builds(
    r.MapPlane, ids, rotations.map(lambda R: R[0]), floats(-FAR, FAR), covariances(4), outlines,
    stamps, stamps, counts, counts, st.booleans())

scenes = st.builds(
    r.SceneEstimate, stamps, st.sampled_from(r.TrackingStatus), texts, rotations, vectors(),
    covariances(6), vectors(), vectors(), covariances(6), st.sampled_from(r.ScaleStatus), texts,
    st.lists(map_planes, max_size=2).map(tuple), floats(0, FAR), counts,
    unit=floats(1e-6, 1e6))

#: n/d of planes that lie no nearer to the origin than the frames are apart
plane_vectors = st.tuples(rotations, floats(5, FAR)).map(lambda p: p[0][0] / p[1])


@st.composite
def obstacles(draw, stamp=None):
    stamp = draw(stamps) if stamp is None else stamp
    times = floats(0, 1e6) | st.just(float('inf'))
    return r.Obstacle(
        draw(ids), stamp, draw(st.sampled_from(r.ObstacleState)), draw(plane_vectors),
        draw(vectors()), draw(vectors()), draw(covariances(6)), draw(times), draw(times),
        draw(array(4, floats(-1e4, 1e4, width=32))), draw(outlines), draw(counts),
        draw(floats(0, FAR)), draw(stamps), draw(st.sampled_from(r.ScalePrior)))


handovers = st.builds(
    r.PlaneHandover, stamps, ids, st.sampled_from([Label.STATIONARY, Label.MOVING]),
    plane_vectors, vectors(), covariances(6))

#: within a few metres: farther away a plane through the new origin may result, which has no n/d
frames = st.builds(RosFrames, R_base_from_cam=rotations, t_base_from_cam=vectors(0.5),
                   R_odom_from_start=rotations, t_odom_from_start=vectors(0.5))
