"""Which blocks move: drawn streets with the truth of every block."""

from dataclasses import replace

from drawn_movers import behind_a_car_of_the_same_speed
from mv_slapse.config import ExtractionSettings
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry.blocks import count_macroblocks
from mv_slapse.movers.identity import FIRST_ID, Memory
from mv_slapse.movers.regions import KnownGround, with_moving_planes
from mv_slapse.records import (
    CameraMotion,
    Extraction,
    Label,
    MotionStatus,
    ScalePrior,
)
from mv_slapse.simulation.drawn import draw
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import pytest

THRESHOLD, STEP = 20.0, 6  # frames between key frames


def extraction_of(street, i, j, rng, outliers=0.1):
    """Return a pair in which nothing moves yet, its truth, and the ground plane."""
    drawn = draw(street, i, j, rng, 0.3, outliers)
    pair = drawn.correspondences
    (R0, t0), (R1, t1) = street.pose(i), street.pose(j)
    t = R1.T @ (t0 - t1)
    unit = np.linalg.norm(t)
    ground = next(p for p in street.planes if p.name == 'ground')
    plane = R1.T @ ground.normal / (ground.depth + ground.normal @ t1) * unit
    # What the extraction of stationary planes would have found: all but the cars.
    surface = np.where(drawn.label == Label.STATIONARY, drawn.surface, -1).astype(np.int32)
    motion = CameraMotion(MotionStatus.MOVING, R1.T @ R0, t / unit)
    return Extraction(
        pair.stamp, pair.previous_stamp, pair.width, pair.height, pair.kind, street.camera.K,
        motion, (), '', pair.x_cur, pair.x_prev, pair.sigma, pair.block,
        np.zeros(len(pair), np.int8), np.where(drawn.outlier, -1, surface)), drawn, plane


def run(street, rng, first=0, last=72, ground=True):
    """Yield the labelled extraction of each pair with its truth."""
    memory = Memory()
    for j in range(first + STEP, last, STEP):
        extraction, drawn, plane = extraction_of(street, j - STEP, j, rng)
        found, memory = with_moving_planes(extraction, memory, THRESHOLD,
                                           KnownGround(plane if ground else None))
        yield found, drawn


def street_of(*movers, seed=0, **settings):
    return Street(StreetSettings(seed=seed, movers=movers, n_frames=130, **settings))


@pytest.mark.parametrize('kind', ['faster', 'same_speed'])
@pytest.mark.parametrize('seed', [0, 1])
def test_a_mover_is_found_from_the_second_pair_on(kind, seed):
    street = street_of(kind, seed=seed)
    hits = []
    for k, (found, drawn) in enumerate(run(street, np.random.default_rng(seed))):
        on_it = (drawn.label == Label.MOVING) & ~drawn.outlier
        if k and on_it.sum() >= 6:
            hits.append(np.mean(found.label[on_it] == Label.MOVING) >= 0.5)
    assert np.mean(hits) >= 0.5


@pytest.mark.parametrize('kind', ['slower', 'oncoming'])
@pytest.mark.parametrize('seed', [0, 1, 2])
def test_what_moves_along_the_flow_is_found_by_its_place_on_the_ground(kind, seed):
    hits = []
    for found, drawn in run(street_of(kind, seed=seed), np.random.default_rng(seed), last=125):
        on_it = (drawn.label == Label.MOVING) & ~drawn.outlier
        if on_it.sum() >= 20:
            hits.append(np.mean(found.label[on_it] == Label.MOVING) >= 0.5)
    assert len(hits) >= 1
    assert np.mean(hits) >= 0.2


@pytest.mark.parametrize('seed', range(4))
def test_hardly_anything_still_is_called_moving(seed):
    street = street_of('slower', 'faster', seed=seed)
    wrong = [np.mean(found.label[(drawn.label != Label.MOVING) & ~drawn.outlier] == Label.MOVING)
             for found, drawn in run(street, np.random.default_rng(seed))]
    assert np.mean(wrong) < 0.02


def test_an_empty_street_has_few_moving_planes(rng):
    street = street_of(parked=2)
    count = [len(found.planes) for found, _ in run(street, rng, last=54)]
    assert np.mean(count) < 0.3


def test_what_is_far_behind_a_car_ahead_is_no_part_of_it():
    memory = Memory()
    for stamp in range(1, 5):
        pair, car, trees, ground = behind_a_car_of_the_same_speed(stamp)
        found, memory = with_moving_planes(pair, memory, THRESHOLD, KnownGround(ground))
    assert np.mean(found.label[car] == Label.MOVING) > 0.6
    assert not np.any(found.label[trees] == Label.MOVING)


def test_a_ground_that_no_road_shows_now_tells_movers_still():
    memory = Memory()
    for stamp in range(1, 8):
        pair, car, trees, ground = behind_a_car_of_the_same_speed(stamp)
        shown = car | trees
        rows = {name: getattr(pair, name)[shown]
                for name in ('x_cur', 'x_prev', 'sigma', 'block', 'label', 'plane_id')}
        found, memory = with_moving_planes(replace(pair, **rows), memory, THRESHOLD,
                                           KnownGround(ground))
    assert np.mean(found.label[car[shown]] == Label.MOVING) > 0.6
    assert not np.any(found.label[trees[shown]] == Label.MOVING)


@pytest.mark.parametrize(('height', 'least', 'most'), [(2.5, 0.6, 1.0), (60.0, 0.0, 0.0)])
def test_a_ground_that_may_lie_no_farther_tells_a_car_ahead(height, least, most):
    memory, far = Memory(), np.array([0, -1 / height, 0])
    for stamp in range(1, 9):
        pair, car, trees, _ = behind_a_car_of_the_same_speed(stamp)
        found, memory = with_moving_planes(pair, memory, THRESHOLD, KnownGround(far, nearer=4.0))
    assert least <= np.mean(found.label[car] == Label.MOVING) <= most
    assert not np.any(found.label[~car & (pair.x_cur[:, 1] > 190)] == Label.MOVING)
    assert not np.any(found.label[trees] == Label.MOVING)
    assert all(plane.scale_prior is ScalePrior.SMALLEST_MOTION for plane in found.planes)


def test_what_may_be_on_a_ground_that_nobody_has_seen_is_not_judged():
    pair, _, _, floor = behind_a_car_of_the_same_speed(1)
    _, memory = with_moving_planes(pair, Memory(), THRESHOLD, KnownGround(0.5 * floor, nearer=4.0))
    road = pair.x_cur[:, 1] > 290
    assert np.all(memory.score[road] == 0)


def test_what_is_half_as_sure_moves_beside_a_mover_only():
    pair, _, _, ground = behind_a_car_of_the_same_speed(1)
    x = pair.x_cur.astype(float)
    sure, beside, alone = (np.all(np.abs(x - (middle, 240)) < (30, 40), axis=1)
                           for middle in (310, 370, 500))
    side = np.where(sure, -8.0, 8.0)[:, None] * (1, 0)
    own = (sure | beside | alone)[:, None]
    pair = replace(pair, x_prev=np.where(own, x + side, pair.x_prev).astype(np.float32))
    seen = np.zeros(len(x), int)
    memory = Memory(0, pair.x_prev.astype(float), pair.block.astype(float), np.zeros_like(x),
                    np.where(sure, THRESHOLD, 3.0), np.zeros(len(x)), np.full(len(x), -1), seen)
    found, _ = with_moving_planes(pair, memory, THRESHOLD, KnownGround(ground))
    assert np.mean(found.label[sure] == Label.MOVING) == 1.0
    assert np.mean(found.label[beside] == Label.MOVING) == 1.0
    assert not np.any(found.label[alone] == Label.MOVING)
    assert set(found.plane_id[sure]).isdisjoint(found.plane_id[beside])


@pytest.mark.parametrize(('id_', 'called'), [(7, True), (-1, False)])
def test_what_was_called_moving_is_given_up_later_whatever_its_id(id_, called):
    pair, _, _, ground = behind_a_car_of_the_same_speed(1)
    x = pair.x_cur.astype(float)
    own = np.all(np.abs(x - (500, 240)) < (30, 40), axis=1)
    pair = replace(pair, x_prev=np.where(own[:, None], x + (8.0, 0), pair.x_prev).astype(
        np.float32))
    known = np.where(own, id_, -1)  # 7: a parked car that has started keeps its plane's id
    memory = Memory(0, pair.x_prev.astype(float), pair.block.astype(float), np.zeros_like(x),
                    np.full(len(x), 3.0), np.zeros(len(x)), known, np.zeros(len(x), int))
    found, memory = with_moving_planes(pair, memory, THRESHOLD, KnownGround(ground))
    assert np.all((memory.score[own] > 0.5 * THRESHOLD) & (memory.score[own] < THRESHOLD))
    assert np.mean(found.label[own] == Label.MOVING) == called


def test_what_ends_above_the_horizon_does_not_move_with_what_is_beside_it():
    pair, _, _, ground = behind_a_car_of_the_same_speed(1)
    x = pair.x_cur.astype(float)
    tall = np.all(np.abs(x - (310, 200)) < (30, 80), axis=1)
    above = np.all(np.abs(x - (370, 150)) < (30, 26), axis=1)
    assert x[above, 1].max() < 180
    side = np.where(tall, -8.0, 8.0)[:, None] * (1, 0)
    own = (tall | above)[:, None]
    pair = replace(pair, x_prev=np.where(own, x + side, pair.x_prev).astype(np.float32),
                   label=np.where(own[:, 0], 0, pair.label).astype(np.int8))
    memory = Memory(0, pair.x_prev.astype(float), pair.block.astype(float), np.zeros_like(x),
                    np.where(tall, THRESHOLD, 1.2 * THRESHOLD), np.zeros(len(x)),
                    np.full(len(x), -1), np.zeros(len(x), int))
    found, memory = with_moving_planes(pair, memory, THRESHOLD, KnownGround(ground))
    assert np.all((memory.score[above] > 0.5 * THRESHOLD) & (memory.score[above] < THRESHOLD))
    assert np.mean(found.label[tall] == Label.MOVING) == 1.0
    assert not np.any(found.label[above] == Label.MOVING)


def with_own_vectors(pair, own, vector):
    """Return a pair in which some blocks (N,) bool come from elsewhere, and a memory of movers.

    ``vector`` (N, 2) or (2,) is what they move by [px]; they have scored THRESHOLD already.
    """
    x = pair.x_cur.astype(float)
    pair = replace(pair, x_prev=np.where(own[:, None], x - vector, pair.x_prev).astype(np.float32),
                   label=np.where(own, 0, pair.label).astype(np.int8))
    return pair, Memory(0, x=pair.x_prev.astype(float), block=pair.block.astype(float),
                        velocity=np.zeros_like(x), score=np.where(own, THRESHOLD, 0.0),
                        left=np.zeros(len(x)), id=np.full(len(x), -1),
                        seen=np.zeros(len(x), int))


def standing_upright(pair, own, foot):
    """Return a pair in which blocks (N,) bool stand on the ground at a row [px]."""
    rho = (foot - 180) / 700 / 1.65
    return with_own_vectors(pair, own, rho / (1 + rho) * (pair.x_cur - (320, 180)))[0]


def after_departures(own, left, stays, pairs=3):
    """Return what is found after pairs in which blocks have left and others stay as they were.

    ``own`` has the motion of what stands on the ground, all else but the car that of the road.
    """
    memory = Memory()
    for stamp in range(1, 1 + pairs):
        pair, _, _, ground = behind_a_car_of_the_same_speed(stamp)
        pair = standing_upright(pair, own(pair.x_cur), 300)
        departure = np.where(left(pair.x_cur), 5.0, np.where(stays(pair.x_cur), -1.4, 0.0))
        found, memory = with_moving_planes(pair, memory, THRESHOLD / 2, KnownGround(ground),
                                           departure)
    return found


def box(x0, y0, x1, y1):
    return lambda x: np.all((x > (x0, y0)) & (x < (x1, y1)), axis=1)


@pytest.mark.parametrize(('stood', 'moves'), [(True, 1.0), (False, 0.0)], ids=['body', 'road'])
def test_where_only_road_is_farther_than_before_no_car_has_left(stood, moves):
    body = box(480, 220, 580, 300)
    found = after_departures(body if stood else box(0, 0, 0, 0), body, box(0, 0, 0, 0))
    there = body(found.x_cur)
    assert np.mean(found.label[there] == Label.MOVING) == pytest.approx(moves, abs=0.2)
    assert all(plane.score > 10 for plane in found.planes if plane.id in found.plane_id[there])


def test_what_has_left_is_no_part_of_what_stands_beside_it_and_moves_alike():
    car, both = box(480, 220, 580, 300), box(400, 60, 640, 300)
    found = after_departures(both, car, lambda x: both(x) & ~car(x))
    x = found.x_cur
    assert np.mean(found.label[car(x)] == Label.MOVING) > 0.8
    beyond = both(x) & ~box(450, 160, 610, 320)(x)  # as far as movers grow
    assert not np.any(found.label[beyond] == Label.MOVING)


@pytest.mark.parametrize('way', [1, -1], ids=['comes near', 'is left behind'])
def test_a_car_is_one_region_though_its_vectors_differ(way):
    pair, car, _, ground = behind_a_car_of_the_same_speed(1, way)
    x = pair.x_cur.astype(float)
    own = car & (x[:, 0] > 320) & (x[:, 1] < 240)
    pair, memory = with_own_vectors(pair, own, way * 0.2 * (x - (320, 180)))
    found, _ = with_moving_planes(pair, memory, THRESHOLD / 2, KnownGround(ground))
    assert np.mean(found.label[own] == Label.MOVING) == 1.0
    assert len(np.unique(found.plane_id[own])) == 1


@pytest.mark.parametrize('copied', [False, True])
def test_what_moves_as_copied_vectors_do_is_no_car(rng, copied):
    memory = Memory()
    for stamp in range(1, 5):
        pair, car, trees, ground = behind_a_car_of_the_same_speed(stamp)
        wrong = ~car & ~trees & (rng.uniform(size=len(car)) < 0.5)
        off = 0.0 if copied else rng.uniform(-40, 40, (len(car), 2))
        label = np.where(car, Label.INFINITY, pair.label)
        pair = replace(pair, label=np.where(wrong, Label.UNKNOWN, label),
                       x_prev=np.where(wrong[:, None], pair.x_cur + off, pair.x_prev))
        found, memory = with_moving_planes(pair, memory, THRESHOLD, KnownGround(ground))
    assert np.mean(found.label[car] == Label.MOVING) == pytest.approx(0.0 if copied else 1.0,
                                                                      abs=0.4)


def test_the_id_of_a_mover_lasts(rng):
    ids = []
    for found, drawn in run(street_of('faster'), rng):
        on_it = found.plane_id[drawn.label == Label.MOVING]
        if np.any(on_it >= 0):
            ids.append(np.bincount(on_it[on_it >= 0]).argmax())
    assert len(ids) > 8
    assert np.mean(np.array(ids) == ids[-1]) > 0.8
    assert min(ids) >= FIRST_ID


def test_the_score_of_a_mover_grows_from_pair_to_pair(rng):
    scores = [max((plane.score for plane in found.planes if plane.label is Label.MOVING),
                  default=0.0) for found, _ in run(street_of('faster'), rng)]
    first, *later = (score for score in scores if score > 0)
    assert THRESHOLD <= first < 2 * THRESHOLD < max(later)
    assert np.all(np.diff([first, *later]) > 0)


def test_moving_planes_tell_the_speed(rng):
    street = street_of('faster')
    car, speeds = street.movers[0], []
    for found, drawn in run(street, rng):
        now = round(found.stamp * 1e-9 * street.settings.fps)
        unit = np.linalg.norm(street.pose(now)[1] - street.pose(now - STEP)[1])
        for plane in found.planes:
            if np.mean(drawn.surface[found.plane_id == plane.id] == car.id) > 0.8:
                speeds.append(-plane.t_d[2] * unit / (STEP / street.settings.fps))
    assert np.median(speeds) == pytest.approx(car.profile.speed(1.0), abs=1.5)


def test_without_ground_what_contradicts_the_flow_is_still_found(rng):
    hits = [np.mean(found.label[drawn.label == Label.MOVING] == Label.MOVING)
            for found, drawn in run(street_of('faster'), rng, ground=False)]
    assert np.mean(np.array(hits[2:]) > 0.4) > 0.6


@pytest.mark.parametrize(('climb', 'least', 'most'), [(0.0, 20, 1000), (1.0, 0, 0)])
def test_only_what_rides_knows_movers_by_their_place_on_the_ground(rng, climb, least, most):
    street, called = street_of('slower'), 0
    extractor = PlaneExtractor(street.camera, ExtractionSettings())
    for j in range(STEP, 60, STEP):
        track = extractor._memory.ground
        extractor._memory = replace(extractor._memory, ground=replace(
            track, mount=replace(track.mount, climb=climb)))
        drawn = draw(street, j - STEP, j, rng, 0.3, 0.0)
        found = extractor.extract(drawn.correspondences)
        called += np.sum(found.label[drawn.label == Label.MOVING] == Label.MOVING)
    assert least <= called <= most


def test_labels_planes_and_ids_agree(rng):
    for found, _ in run(street_of('slower', 'faster'), rng, last=42):
        moving = {plane.id for plane in found.planes if plane.label is Label.MOVING}
        assert set(found.plane_id[found.label == Label.MOVING]) == moving
        assert all(plane.label in (Label.MOVING, Label.UNKNOWN) and plane.n_macroblocks >= 3
                   for plane in found.planes)


def test_what_is_half_as_sure_is_told_before_it_is_called_moving(rng):
    told = []
    for found, _ in run(street_of('slower', 'faster'), rng, last=42):
        unsure = [plane for plane in found.planes if plane.label is Label.UNKNOWN]
        for plane in unsure:
            own = found.plane_id == plane.id
            assert plane.id < -1
            assert not np.any(found.label[own] == Label.MOVING)
            assert plane.n_macroblocks == count_macroblocks(found.x_cur[own])
            assert THRESHOLD / 2 <= plane.score < THRESHOLD
            assert plane.covariance.shape == (6, 6)
        assert len({plane.id for plane in unsure}) == len(unsure)
        told.append((len(unsure), len(found.planes) - len(unsure)))
    # A region scores 10 in a pair at most.
    assert told[0][0] > 0 == told[0][1]
    assert told[2][1] > 0


def test_what_may_move_takes_in_what_it_encloses():
    memory = Memory()
    for stamp in (1, 2):
        pair, car, _, ground = behind_a_car_of_the_same_speed(stamp)
        wrong = car & (np.abs(pair.x_cur - (312, 240)) < 12).all(axis=1)
        pair = replace(pair, label=np.where(wrong, Label.UNKNOWN, pair.label),
                       x_prev=pair.x_prev + np.float32(9) * wrong[:, None])
        found, memory = with_moving_planes(pair, memory, THRESHOLD, KnownGround(ground))
    plane, = found.planes
    assert plane.label is Label.UNKNOWN
    assert np.count_nonzero(wrong) > 0
    assert np.all(found.plane_id[wrong] == plane.id)
    assert np.all(found.label[wrong] == Label.UNKNOWN)


def test_a_gap_forgets_and_no_blocks_are_no_movers(rng):
    street = street_of('faster')
    extraction, _, plane = extraction_of(street, 0, STEP, rng)
    _, memory = with_moving_planes(extraction, Memory(), THRESHOLD, KnownGround(plane))
    later, _, plane = extraction_of(street, 10, 10 + STEP, rng)
    fresh, _ = with_moving_planes(later, Memory(next_id=memory.next_id), THRESHOLD,
                                  KnownGround(plane))
    after_gap, _ = with_moving_planes(later, memory, THRESHOLD, KnownGround(plane))
    np.testing.assert_array_equal(after_gap.label, fresh.label)
    nothing = replace(extraction, **{name: getattr(extraction, name)[:0] for name in (
        'x_cur', 'x_prev', 'sigma', 'block', 'label', 'plane_id')})
    assert with_moving_planes(nothing, memory, THRESHOLD, KnownGround(plane))[0].planes == ()


def test_a_plane_that_begins_to_move_keeps_its_id(rng):
    memory, street = Memory(), street_of('faster')
    for j in range(STEP, 60, STEP):
        extraction, drawn, plane = extraction_of(street, j - STEP, j, rng, outliers=0.0)
        car = drawn.label == Label.MOVING
        extraction = replace(extraction, plane_id=np.where(car, 7, -1).astype(np.int32))
        found, memory = with_moving_planes(extraction, memory, THRESHOLD, KnownGround(plane))
    assert 7 in [item.id for item in found.planes]
    assert np.mean(found.plane_id[car] == 7) > 0.5
