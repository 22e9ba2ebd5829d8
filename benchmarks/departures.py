"""Each step of the papers that docs/papers.md departs from, beside what stands in its place.

Scenes are drawn (vectors of a street with Gaussian errors and a share of wrong ones, no pictures),
rendered, or ``kitti00``; the truth is known of all. Each function returns rows of one paragraph of
that page: what is measured, by the step as printed, and by the package.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
import tempfile
from typing import Any, NamedTuple

from mv_slapse.codec.encoding.encoder import encode, Encoding
from mv_slapse.codec.evidence import collect
from mv_slapse.codec.frames import FrameDecoder
from mv_slapse.codec.merging import existence, merge
from mv_slapse.codec.segments import SegmentBuilder
from mv_slapse.config import DecoderSettings, ExtractionSettings, Settings
from mv_slapse.evaluation import trajectory
from mv_slapse.evaluation.detection import grid_index
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry import rotation
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.two_view import Pair
from mv_slapse.motion.estimate import from_essential_matrix, refined_from
from mv_slapse.pipeline import Slapse
from mv_slapse.records import Label, SegmentKind
from mv_slapse.simulation import drawn
from mv_slapse.simulation.render import Renderer
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.storage.tum import read_trajectory
from mv_slapse.tools.run import decode, replay
import numpy as np
from papers import pipelines, two_views
from papers.two_views import Thresholds, View
from scipy.stats import binom

SEEDS = 4
GAP = 4  # pictures between key frames at 30 Hz, as MPEG-2 with three B frames has them
RIGHT = 1.0  # px from the truth, of a right vector

Rows = list[tuple[str, str, str]]


def lemma_2(kind: SegmentKind, n_b: int, p: float) -> float:
    """Return the mean variance of a merged vector in units of one vector's, (8) and (9).

    As derived: (9) printed has 2 + i where the variances of sqrt 2 times a direct and i indirect
    vectors add up to 2 + 2 i, and does not condition on a right vector being there.
    """
    i = np.arange(n_b + 1)
    chance = binom.pmf(i, n_b, p * p)
    none_direct = (chance[1:] * 2 / i[1:]).sum()
    if kind is SegmentKind.PI:
        return none_direct / existence(kind, n_b, p)
    direct = (chance * (2 + 2 * i) / (i + np.sqrt(2))**2).sum()
    return ((1 - p) * none_direct + p * direct) / existence(kind, n_b, p)


def lemma_2_printed(n_b: int, p: float) -> float:
    """Return (9) as printed."""
    i = np.arange(n_b + 1)
    direct = (binom.pmf(i, n_b, p * p) * (2 + i) / (i + np.sqrt(2))**2).sum()
    return (1 - p) * lemma_2(SegmentKind.PI, n_b, p) + p * direct


def drawn_variance(n_b: int, p: float, n: int = 400_000) -> float:
    """Return what (9) is of drawn vectors, merged as (5) and (6) say."""
    rng = np.random.default_rng(0)
    direct, indirect = rng.random(n) < p, rng.random((n, n_b)) < p * p
    weight = np.sqrt(2) * direct + indirect.sum(1)
    error = np.sqrt(2) * direct * rng.normal(size=n)
    error += (indirect * rng.normal(0, np.sqrt(2), (n, n_b))).sum(1)
    return float(np.mean((error[weight > 0] / weight[weight > 0])**2))


def variances() -> Rows:
    """Lemma 2."""
    return [(f'variance of a merged vector, Lemma 2 (9), n_B = {n_b}, p = 0.6; drawn: '
             f'{drawn_variance(n_b, 0.6):.3f}', f'{lemma_2_printed(n_b, 0.6):.3f}',
             f'{lemma_2(SegmentKind.PP, n_b, 0.6):.3f}') for n_b in (1, 2, 3)]


def merging() -> Rows:
    """Vectors of rendered streets: averaged as printed, and sorted out first."""
    found = np.zeros((2, 3))
    for seed in range(SEEDS):
        street = Street(StreetSettings(seed=seed, n_frames=4 * GAP + 1))
        images = [frame.image for frame in Renderer(street).frames()]
        decoder, segments = FrameDecoder(with_luma=False), SegmentBuilder()
        packets = list(encode(images, street.settings.fps, Encoding('mpeg2video', GAP - 1, 12)))
        frames = [frame for packet in packets for frame in decoder.feed(packet)]
        for frame in [*frames, *decoder.flush()]:
            segment = segments.add(frame)
            if segment is None:
                continue
            i, j = (round(one.stamp * 1e-9 * street.settings.fps)
                    for one in (segment.previous, segment.current))
            settings = DecoderSettings(lone_probability=0.0)
            merged = merge(segment, collect(segment, settings), settings)
            everything = collect(segment, replace(settings, bend_slack=1e9))
            for k, (x, vector) in enumerate((_averaged(everything, street),
                                             (merged.x_cur, merged.x_prev - merged.x_cur))):
                there, _, seen = drawn.match(street, i, j, x.astype(float))
                off = np.linalg.norm(x + vector - there, axis=1)[seen]
                found[k] += (off < RIGHT).sum(), len(off), 1
    printed, ours = (f'{100 * right / n:.0f} %, {right / pairs:.0f}' for right, n, pairs in found)
    return [('merged vectors within 1 px of the truth, and how many a pair: rendered streets, '
             'MPEG-2, three B frames', printed, ours)]


def _averaged(evidence, street):
    """Return the mean of all vectors of each macroblock at its centre, (5) and (6)."""
    size = street.camera.width, street.camera.height
    cell = grid_index(evidence.x_cur, *size)
    inside = cell >= 0
    weight = np.where(evidence.variance == 1, np.sqrt(2), 1.0)[inside]
    cell, vector = cell[inside], evidence.vector[inside]
    whole = np.bincount(cell, weight)
    some = np.flatnonzero(whole)
    mean = [np.bincount(cell, weight * column)[some] / whole[some] for column in vector.T]
    return grid_centres(*size)[some], np.stack(mean, 1)


def key_frames(data: Path) -> Rows:
    """Pairs as printed, from I or P frame to the next, and as the package makes them."""
    rows = []
    for name, why in (('kitti00/mpeg2.mpg', 'B frames as poses'),
                      ('kitti00/h264_lowlatency.mp4', 'I frames bridged'),
                      ('parking/h264_lowlatency.mp4', 'pairs chained')):
        video, found = data / name, []
        if not video.exists():
            continue
        camera = read_camera(video.parent / 'camera.yaml')
        truth = read_trajectory(video.parent / 'ground_truth.tum')
        for decoder in (replace(pipelines.DECODER, paper_weights=False), DecoderSettings()):
            settings = Settings(decoder=decoder)
            with tempfile.TemporaryDirectory() as folder:
                replay(decode(video, camera, settings), camera, settings, folder)
                path = read_trajectory(Path(folder) / 'trajectory.tum')
            score = trajectory.figures(trajectory.evaluate(path, truth))
            found.append(f'{score["ate_mean_percent"]:.3f} %, {len(path)}')
        rows.append((f'error of the way and poses by the package, `{name}`: {why}', *found))
    return rows


def camera_motion() -> Rows:
    """Return errors of the first motion: eight points and five, each then refined."""
    rows = []
    for kind, settings in (('street', {}), ('bare road', {'houses': False, 'parked': 0})):
        found: list[list[tuple[float, float]]] = [[], [], []]
        for seed in range(3 * SEEDS):
            street, rng = _street(seed, movers=(), **settings), np.random.default_rng(seed)
            view, _ = _drawn(street, 0, GAP, rng, 0.4)
            R_true, t_true = _motion(street, 0, GAP)
            rays, turned = to_rays(view.K, view.x_cur), to_rays(view.K, view.x_prev)
            F, inlier = two_views.eight_points(view, Thresholds().f, rng)
            first = two_views.motion(view, F, inlier)
            better = two_views.refined(view.of(inlier), *first)
            pair = Pair(rays, turned, view.x_prev, np.full(len(rays), 0.25), view.K)
            fits = [refined_from(pair, *one) for one in from_essential_matrix(
                rays, turned, 1.0 / view.K[0, 0])]
            best = min(fits, key=lambda fit: fit.cost + fit.behind)
            for errors, (R, t) in zip(found, (first, better, (
                    best.R_cur_from_prev, best.t_cur_from_prev)), strict=True):
                errors.append((np.degrees(rotation.angle(R @ R_true.T)),
                               np.degrees(np.arccos(np.clip(t @ t_true, -1, 1)))))
        shown = ['{:.3f}, {:.2f}'.format(*np.median(one, axis=0)) for one in found]
        rows.append((f'first motion of drawn pairs, two vectors of five wrong, {kind}: median '
                     'error of rotation and direction [deg]; printed: of F, and after (5)',
                     '; '.join(shown[:2]), shown[2]))
    return rows


def moving_planes() -> Rows:
    """Definition 1 of [MVO] by block with the true motion, and what the package calls moving."""
    printed: dict[float, np.ndarray] = {e: np.zeros(6) for e in (1.0, 2.0, 4.0)}
    ours = np.zeros(6)
    for seed in range(SEEDS):
        street, rng = _street(seed, parked=2), np.random.default_rng(seed)
        extractor = PlaneExtractor(street.camera, ExtractionSettings())
        for i in range(0, 10 * GAP, GAP):
            view, truth = _drawn(street, i, i + GAP, rng, 0.0)
            R, t = _motion(street, i, i + GAP)
            for e, counts in printed.items():
                still = two_views.stationary(view, R, t, Thresholds(e=e))
                counts += _called(street, truth, ~still)
            found = extractor.extract(truth.correspondences)
            cell = grid_index(view.x_cur, street.camera.width, street.camera.height)
            if i:  # a region is judged over pairs: the first says nothing
                ours += _called(street, truth, found.macroblock_label[cell] == Label.MOVING)
    rows = []
    for n, what in enumerate(('still blocks', 'blocks of parked cars', 'blocks of moving cars')):
        shares = ', '.join(f'{100 * c[2 * n] / c[2 * n + 1]:.0f}' for c in printed.values())
        rows.append((f'{what} called moving on drawn streets [%]; printed with the true motion, '
                     'ε_e = 1, 2, 4 px', shares, f'{100 * ours[2 * n] / ours[2 * n + 1]:.1f}'))
    return rows


def _called(street, truth, moving):
    """Return how many of still, parked and moving blocks are called moving, and how many are."""
    names = np.array([*street.names, ''])
    still = truth.label != Label.MOVING
    parked = still & np.char.startswith(names[np.clip(truth.surface, -1, len(names) - 1)],
                                        'parked')
    return np.array([count for rows in (still, parked, ~still)
                     for count in (moving[rows].sum(), rows.sum())], float)


def gauge() -> Rows:
    """(12) along its one-parameter family, and the depth of a car by the ground."""
    street, rng = _street(0, movers=('oncoming',)), np.random.default_rng(0)
    errors = []
    for i in range(0, 10 * GAP, GAP):
        view, truth = _drawn(street, i, i + GAP, rng, 0.0)
        on_car = truth.label == Label.MOVING
        if on_car.sum() < 6:
            continue
        R, t = _motion(street, i, i + GAP)
        back = np.linalg.norm(view.x_cur - truth.x_true, axis=1)[on_car]
        errors.append(_family(view.of(on_car), R, t, back))
    spread = np.max(errors) if errors else 0.0
    return [('sum of (12) of a drawn car at half and at twice its distance and speed, relative '
             'change', f'{spread:.0e}: any distance will do', 'the ground under it tells which')]


def _family(view: View, R, t, size) -> float:
    """Return how much (12) changes where plane and motion are scaled against each other."""
    plane, relative = np.array([0.0, 0.0, -1 / 20.0]), np.array([0.1, 0.0, -3.0])
    rays, sums = to_rays(view.K, view.x_cur), []
    for scale in (0.5, 1.0, 2.0):
        there = two_views.transfer(rays, R.T, -R.T @ (scale * relative), plane[None] / scale)
        there = there @ view.K.T
        sums.append(np.sum((there[:, :2] / there[:, 2:] - view.x_prev)**2) / np.sum(size**2))
    return float(np.ptp(sums) / sums[1])


def starting() -> Rows:
    """Which blocks of a car that starts ahead are called moving, second by second."""
    shares: dict[int, list[tuple[float, ...]]] = {0: [], 1: []}
    for seed in range(SEEDS):
        street = _street(seed, movers=('starting',), n_frames=121)
        rng, car, since = np.random.default_rng(seed), street.movers[0], 0
        truths = [drawn.draw(street, i, i + GAP, rng, 0.25, 0.1) for i in range(0, 117, GAP)]
        pairs = [truth.correspondences for truth in truths]
        printed, slapse = pipelines.run(pipelines.Mvo, street.camera, pairs), Slapse(
            street.camera, Settings())
        for k, truth in enumerate(truths):
            ours = slapse.step(pairs[k]).extraction.macroblock_label
            on = truth.surface == car.id
            since += car.is_moving(pairs[k].stamp * 1e-9)
            if since and on.sum() >= 6:
                cell = grid_index(pairs[k].x_cur, street.camera.width, street.camera.height)[on]
                shares[min(since * GAP // 30, 1)].append(tuple(
                    np.mean(labels[cell] == Label.MOVING)
                    for labels in (printed.blocks[k], printed.labels[k], ours)))
    means = [100 * np.mean(shares[second], axis=0) for second in (0, 1)]
    shown = [', '.join(f'{mean[k]:.0f}' for mean in means) for k in range(3)]
    return [('blocks of a car that starts ahead called moving in the first second and later [%], '
             'drawn streets; printed: Definition 1, Definition 2', '; '.join(shown[:2]), shown[2])]


def rest() -> Rows:
    """Two seconds of standstill in a drawn street: how far the pose walks."""
    street = _street(1, standstill=(1.0, 3.0), n_frames=121, movers=())
    rng = np.random.default_rng(0)
    walked = []
    for way in _ways(street, [drawn.draw_pair(street, i, i + GAP, rng, 0.25, 0.1)
                              for i in range(0, 120, GAP)], 8):
        at_rest = way.places[(way.stamps >= street.stamp(32)) & (way.stamps <= street.stamp(88))]
        walked.append(np.linalg.norm(at_rest - at_rest[0], axis=1).max())
    return [('farthest from where the camera stopped, 2 s of a drawn standstill [m]',
             f'{walked[0]:.2f} [SLAPSE], {walked[1]:.2f} [MVO]', f'{walked[2]:.3f}')]


def loss() -> Rows:
    """Two seconds without a vector: how far off the pose is afterwards, and how far it says."""
    rows = []
    for what, turn in (('straight', 0.0), ('in a turn of 60 deg', 60.0)):
        errors, sigmas = [], []
        for seed in range(SEEDS // 2):
            street = _street(seed, movers=(), n_frames=181, turn=turn, speed=8.0)
            rng = np.random.default_rng(seed)
            ways = _ways(street, [drawn.draw_pair(street, i, i + GAP, rng, 0.25, 0.1)
                                  for i in range(0, 180, GAP) if not 60 <= i < 120], 15)[1:]
            errors.append([np.linalg.norm(way.places[-1] - street.pose(180)[1]) for way in ways])
            sigmas.append([way.sigma for way in ways])
        shown = zip(np.median(errors, 0), np.median(sigmas, 0), strict=True)
        rows.append((f'place 2 s after 2 s without a vector at 8 m/s, {what}: error and its '
                     'standard deviation as told [m]; printed: [MVO]',
                     *(f'{error:.1f}, {sigma:.2f}' for error, sigma in shown)))
    return rows


def returning() -> Rows:
    """Forth and back in a drawn street, always looking ahead: planes are lost and come back."""
    steps = [GAP] * 25 + [3, 2, 1, -1, -2, -3] + [-GAP] * 25
    frames, found = np.cumsum([0, *steps]), []
    for seed in range(SEEDS // 2):
        street, rng = _street(seed, movers=(), n_frames=110), np.random.default_rng(seed)
        pairs = [replace(drawn.draw_pair(street, i, j, rng, 0.25, 0.1),
                         stamp=street.stamp(GAP * (k + 1)), previous_stamp=street.stamp(GAP * k))
                 for k, (i, j) in enumerate(zip(frames[:-1], frames[1:], strict=True))]
        ways = _ways(street, pairs, 25)
        found.append([(np.linalg.norm(way.places[-1]), way.n_planes) for way in (
            ways[0], ways[2])])
    return [('error at the end of 35 m forth and back, drawn streets [m], and numbers given to '
             'planes; printed: [SLAPSE]', *(f'{error:.2f}, {n:.0f}'
                                            for error, n in np.median(found, 0)))]


class _Way(NamedTuple):
    """Stamps (N,), places (N, 3) [m], sigma of the last [m], and how many planes there were."""

    stamps: np.ndarray
    places: np.ndarray
    sigma: float
    n_planes: int


def _ways(street: Street, pairs, n: int) -> list[_Way]:
    """Return the ways of [SLAPSE], [MVO] and the package; the first n steps tell the scale."""
    slapse, fps = Slapse(street.camera, Settings()), street.settings.fps
    scenes = [slapse.step(pair).scene for pair in pairs]
    places = [[street.pose(round(stamp * 1e-9 * fps))[1] for stamp in (
        pair.previous_stamp, pair.stamp)] for pair in pairs[1:n]]
    true = sum(np.linalg.norm(b - a) for a, b in places)

    def way(stamps, places, P, planes):
        scale = true / np.linalg.norm(np.diff(places[:n], axis=0), axis=1).sum()
        return _Way(np.array(stamps), scale * np.array(places),
                    scale * np.sqrt(np.trace(P[:3, :3])), len(set(planes)))

    printed = [pipelines.run(kind, street.camera, pairs)
               for kind in (pipelines.Slapse, pipelines.Mvo)]
    return [*(way([pose[0] for pose in one.poses[1:]], [pose[2] for pose in one.poses[1:]],
                  one.covariances.get(pairs[-1].stamp, np.full((6, 6), np.nan)),
                  [row[1] for row in one.planes]) for one in printed),
            way([one.stamp for one in scenes], [one.t_world_from_cam for one in scenes],
                scenes[-1].pose_covariance, [plane.id for one in scenes for plane in one.planes])]


def _street(seed: int, **settings: Any) -> Street:
    return Street(StreetSettings(**{'seed': seed, 'n_frames': 11 * GAP, **settings}))


def _drawn(street: Street, i: int, j: int, rng, outliers: float):
    """Return a drawn pair as a view, and its truth; vectors err by 0.25 px."""
    truth = drawn.draw(street, i, j, rng, 0.25, outliers)
    pair = truth.correspondences
    return View(pair.x_cur.astype(float), pair.x_prev.astype(float), street.camera.K), truth


def _motion(street: Street, i: int, j: int):
    """Return the true R_cur_from_prev and the direction of t_cur_from_prev."""
    (R_i, t_i), (R_j, t_j) = street.pose(i), street.pose(j)
    t = R_j.T @ (t_i - t_j)
    return R_j.T @ R_i, t / np.linalg.norm(t)


#: what is measured, under the paragraph of docs/papers.md that tells why
DRAWN: dict[str, tuple[Callable[[], Rows], ...]] = {
    'Vectors': (variances, merging), 'Camera motion': (camera_motion,),
    'Moving planes': (moving_planes, starting), 'Gauge': (gauge,), 'Loss': (loss,),
    'Planes that come back': (returning,), 'Rests': (rest,)}


def jobs(data: Path) -> Iterator[tuple[tuple, Callable, tuple]]:
    """Yield what is measured: a tag, a function and its arguments."""
    for title, functions in DRAWN.items():
        for function in functions:
            yield ('departure', title, function.__name__), function, ()
    yield ('departure', 'Key frames', 'key_frames'), key_frames, (data,)
