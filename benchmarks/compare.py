"""The papers as printed, their competitor and what a user would write, beside the package.

All take the same videos, coded as MPEG-2, the papers' codec: some the motion vectors, the others
decoded pictures. ``papers`` has the printed pipelines, ``one_point_ekf.py`` the 1-point RANSAC EKF
of Civera et al. (2010), ``odometry.py`` corners (Lucas-Kanade) and ORB features with an essential
matrix from picture to picture. ``departures.py`` has each step of the papers beside what stands in
its place. Nobody is told the camera's height; the two odometries are told the true length of each
step.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
import sys
import tempfile
import time
from typing import Any

import compare_page
import departures
from mv_slapse import quaternion
from mv_slapse.config import Settings
from mv_slapse.errors import MvSlapseError
from mv_slapse.evaluation import consistency, detection, planes, tracking, trajectory
from mv_slapse.evaluation.truth import LabelTable, read_arrays, read_truth, Truth
from mv_slapse.records import Label
from mv_slapse.storage.tum import Trajectory
from mv_slapse.tools import cases
from mv_slapse.tools import evaluate as evaluation
from mv_slapse.tools.batch.workers import open_pool, Workers
from mv_slapse.tools.cases import Case, Scene
from mv_slapse.tools.eval import evaluate, Marks, read_results
from mv_slapse.tools.inputs import pictures
from mv_slapse.tools.rows import Cache
from mv_slapse.tools.run import decode, replay
import numpy as np
import odometry
import one_point_ekf
from papers import pipelines, two_views
from papers.pipelines import Found

CODEC = '/mpeg2.'
STREETS, FRAMES = 4, 150
SWEEP = (1.0, 2.0, 3.0, 4.0)  # px, of table I of [SLAPSE]
IN_TABLE = 4  # planes of a pair at most: in that table they are 2.0 to 4.3 in the mean
UPRIGHT = 0.3  # standard deviation of a mover's slope, of one row of the departures
WITH_WAY = ('kitti00', 'parking')
Row = dict[str, Any]


def as_trajectory(poses) -> Trajectory:
    """Return poses (stamp, R, t) as a trajectory."""
    stamps, R, t = zip(*poses, strict=True)
    return Trajectory(np.array(stamps, np.int64), np.array(t, float).reshape(-1, 3),
                      np.array([quaternion.from_matrix(one) for one in R]))


def way(estimate: Trajectory, truth: Trajectory, unit: str) -> Row:
    """Return the figures of a way and its picture.

    ``unit`` tells what epsilon_D is measured in: the ``first step``, as in the papers, ``metres``,
    or nothing but the median ``ratio`` to the true distances, which is given of all.
    """
    try:
        score = trajectory.evaluate(estimate, truth)
    except MvSlapseError as error:
        return {'error': str(error)}
    i, j = trajectory.associate(estimate.stamps, truth.stamps)
    gone, true = (np.linalg.norm(path.positions[rows[1:]] - path.positions[rows[0]], axis=1)
                  for path, rows in ((estimate, i), (truth, j)))
    in_metres = Trajectory(estimate.stamps, estimate.positions * float(
        np.median(true / np.maximum(gone, 1e-12))), estimate.quaternions)
    aligned = trajectory.align(estimate.positions[i], truth.positions[j])
    return {**trajectory.figures(score),
            'epsilon_d_percent': None if unit == 'ratio' else trajectory.epsilon_d(
                estimate, truth, unit == 'metres'),
            'epsilon_d_by_ratio': trajectory.epsilon_d(in_metres, truth, True),
            'covered_percent': 100 * float(np.ptp(estimate.stamps) / np.ptp(truth.stamps)),
            'path': aligned.apply(estimate.positions[i])[:, [0, 2]].tolist(),
            'truth': truth.positions[:, [0, 2]].tolist()}


def ours(case: Case, folder: Path) -> Row:
    """Return the figures of the package without a height, default settings."""
    settings = Settings()
    decoded = decode(case.video, case.camera, settings)
    summary = replay(decoded, case.camera, settings, folder)
    found = evaluate(folder, case.ground_truth, Marks(case.labels))
    of_movers = mover_figures(case, decoded.stamps)
    if of_movers:
        found |= of_movers(read_results(folder).labels)
    if case.ground_truth:
        truth, results = read_truth(case.ground_truth), read_results(folder)
        found |= way(results.trajectory, truth.trajectory, 'first step')
        found |= of_planes(results.planes, results.labels, truth, found['scale'])
    spent = {name: s for name, s in summary.cpu_seconds.items() if name not in ('total', 'write')}
    return found | {'cpu_ms': 1e3 * sum(spent.values()) / summary.frames,
                    'n_frames': summary.frames}


def printed(case: Case, pipeline: type[pipelines.Pipeline]) -> Row:
    """Return the figures of a pipeline of the papers."""
    tells_movers = issubclass(pipeline, pipelines.Mvo)
    decoded = decode(case.video, case.camera, pipelines.SETTINGS)
    start = time.process_time()
    found = pipelines.run(pipeline, case.camera, decoded.pairs)
    spent = time.process_time() - start + decoded.cpu_seconds
    row: Row = {'cpu_ms': 1e3 * spent / len(decoded.stamps), 'n_frames': len(decoded.stamps)}
    if case.ground_truth:
        truth = read_truth(case.ground_truth)
        row |= against(found, truth)
        if tells_movers and truth.movers is not None and 'error' not in row:
            row |= of_obstacles(found, truth, row['scale'])
            for prefix, tilt in (('told_', np.inf), ('upright_', UPRIGHT)):
                told = pipelines.run(partial(pipelines.Told, movers_at(truth)), case.camera,
                                     decoded.pairs, two_views.Thresholds(tilt=tilt))
                row |= {prefix + name: value
                        for name, value in of_obstacles(told, truth, row['scale']).items()}
    of_movers = mover_figures(case, decoded.stamps)
    if of_movers and tells_movers:
        row |= of_movers(found.label_table())
        row |= {f'by_block_{name}': value
                for name, value in of_movers(found.label_table(by_block=True)).items()}
    return row


def of_obstacles(found: Found, truth: Truth, scale: float) -> Row:
    """Return the figures of the obstacles of [MVO]."""
    return tracking.figures(found.obstacle_table(), np.array(found.stamps), truth.movers,
                            truth.trajectory, scale)


def movers_at(truth: Truth) -> Callable[[int], np.ndarray]:
    """Return what tells the mover of each macroblock at a stamp, -1 for none."""
    def at(stamp: int) -> np.ndarray:
        """Return the true one."""
        frame = np.abs(truth.labels.stamps - stamp).argmin()
        return np.where(truth.labels.label[frame] == Label.MOVING, truth.labels.plane[frame], -1)

    return at


def mover_figures(case: Case, stamps: Sequence[int]) -> Callable[[LabelTable], Row] | None:
    """Return what gives the figures of movers of a table of labels; None without a truth."""
    truth = read_truth(case.ground_truth) if case.ground_truth else Truth()
    if case.labels:
        content = read_arrays(case.labels, ('tracks', 'visible', 'label'))
        points = detection.PointLabels(
            content['tracks'], content['visible'].astype(bool), content['label'],
            1e9 * (len(stamps) - 1) / (max(stamps) - min(stamps)))
        figures = partial(detection.point_figures, points=points)
    elif truth.labels:
        figures = partial(detection.block_figures, truth=truth.labels, movers=truth.movers)
    else:
        return None
    return lambda labels: figures(labels) | {'movers_once': once(figures, labels)}


def once(figures: Callable[[LabelTable], Row], labels: LabelTable) -> int:
    """Return how many movers are found in some key frame, as [MVO] counts them."""
    seen: set[int] = set()
    for k in range(1, len(labels.stamps)):
        rows = slice(k - 1, k + 1)  # the first of a table does not count
        two = replace(labels, stamps=labels.stamps[rows], label=labels.label[rows],
                      plane=labels.plane[rows])
        none = replace(two, label=np.full_like(two.label, Label.UNKNOWN))
        seen |= {*figures(none)['movers_missed']} - {*figures(two)['movers_missed']}
    return len(seen)


def against(found: Found, truth: Truth) -> Row:
    """Return the figures of a printed pipeline's results against the truth there is."""
    estimate = as_trajectory(found.poses)
    row = way(estimate, truth.trajectory, 'first step')
    if found.covariances and 'error' not in row:
        row |= consistency.figures(estimate, found.covariances, truth.trajectory, False,
                                   truth.planes is not None)
    if truth.labels is not None and 'error' not in row:
        row |= of_planes(found.plane_table(), found.label_table(), truth, row['scale'])
    return row


def of_planes(table: detection.Table, labels: LabelTable, truth: Truth, scale: float) -> Row:
    """Return the figures of planes, of those that are true ones.

    As in the papers, where somebody told which planes of the scene were found; here an observation
    counts where four fifths of its macroblocks lie on one true plane.
    """
    if truth.labels is None:
        return {}
    shares = planes.plane_shares(table, truth.planes, labels, truth.labels).max(axis=1)
    some = {name: values[shares >= planes.PURE] for name, values in table.items()}
    return planes.figures(planes.evaluate(
        some, truth.planes, truth.trajectory, scale, (labels, truth.labels))) | {
        'on_one_percent': 100 * float(np.mean(shares[np.isfinite(shares)] >= planes.PURE)),
        'n_rows': int(np.isfinite(shares).sum())}


def by_pictures(case: Case, walk: Callable, unit: str) -> Row:
    """Return the figures of an odometry that takes decoded pictures."""
    start = time.process_time()
    images = list(pictures(case.video))
    truth = read_truth(case.ground_truth).trajectory
    stamps = truth.stamps
    poses = walk(images, case.camera.K, truth)
    spent = time.process_time() - start
    estimate = as_trajectory([(stamps[pose.index], pose.R, pose.t) for pose in poses])
    return way(estimate, truth, unit) | {'cpu_ms': 1e3 * spent / len(images),
                                         'n_frames': len(images)}


def _walk(walk: Callable, images, K, truth: Trajectory):
    def length(i: int, j: int) -> float:
        """Return the true way between two pictures [m]."""
        return float(np.linalg.norm(truth.positions[j] - truth.positions[i]))

    return walk(images, K, length)


def _ours(case: Case) -> Row:
    with tempfile.TemporaryDirectory() as folder:
        return ours(case, Path(folder))


METHODS: dict[str, Callable[[Case], Row]] = {
    'ours': _ours,
    'SLAPSE': partial(printed, pipeline=pipelines.Slapse),
    'MVO': partial(printed, pipeline=pipelines.Mvo),
    '1-point EKF': partial(by_pictures, unit='ratio',
                           walk=lambda images, K, truth: one_point_ekf.drive(images, K)),
    'LK': partial(by_pictures, unit='metres', walk=partial(_walk, odometry.corner_tracking)),
    'ORB': partial(by_pictures, unit='metres', walk=partial(_walk, odometry.orb_matching))}


def measured(case: Case, method: str) -> Row:
    """Return the figures of a case by one of METHODS."""
    return METHODS[method](case)


def extraction(case: Case, threshold: float) -> Row:
    """Return how many planes [SLAPSE] extracts, and true ones, as in its table I.

    Each pair by itself. An extracted plane is a true positive where four fifths of its macroblocks
    whose surface is known lie on one.
    """
    truth = read_truth(case.ground_truth).labels
    maker = pipelines.Slapse(case.camera, two_views.Thresholds(h=threshold, planes=IN_TABLE))
    places = {(x, y): i for i, (x, y) in enumerate(zip(truth.x, truth.y, strict=True))}
    n_planes, n_true = 0, 0
    for pair in decode(case.video, case.camera, pipelines.SETTINGS).pairs:
        frame = np.flatnonzero(np.abs(truth.stamps - pair.stamp) < trajectory.TOLERANCE)
        for cells in maker.planes_of(pair):
            known = [places[cell] for cell in map(tuple, cells) if cell in places]
            surface = truth.plane[frame[0], known]
            surface = surface[surface >= 0]
            n_planes += 1
            most = np.bincount(np.unique(surface, return_inverse=True)[1]).max(initial=0)
            n_true += len(surface) > 0 and most >= planes.PURE * len(surface)
    return {'planes': n_planes, 'true': n_true}


def scenes(data: Path, streets: int, frames: int) -> list[Scene]:
    """Return what is compared: two ways, rendered streets, labelled clips."""
    found = cases.given(data) if data.is_dir() else []
    found = [scene for scene in found if scene.name in WITH_WAY or '/seq' in scene.name]
    return found + [scene for scene in cases.streets(streets, frames)
                    if scene.name.startswith('street')]


def jobs(scene: Scene, made: list[Case]):
    """Yield what is measured on a scene: a tag, a function and its arguments."""
    for case in made:
        if CODEC not in case.name or case.name.startswith((cases.FREE, cases.GIVEN)):
            continue
        methods = METHODS if case.ground_truth else ('ours', 'MVO')
        for method in methods:
            yield ('row', scene.name, method), measured, (case, method)
        if case.ground_truth and case.ground_truth.is_dir():
            for threshold in SWEEP:
                yield ('sweep', scene.name, threshold), extraction, (case, threshold)


def run_all(scenes: list[Scene], cache: Cache, workers: Workers, others) -> dict[tuple, Any]:
    """Measure everything; return what was found by tag."""
    found = {}
    with open_pool(workers) as pool:
        for scene in scenes:
            pool.submit(scene, cache.cases, scene)
        for tag, function, arguments in others:
            pool.submit(tag, function, *arguments)
        for tag, value in pool.results():
            if isinstance(value, Exception):
                raise value
            if isinstance(tag, Scene):
                for name, function, arguments in jobs(tag, value):
                    pool.submit(name, function, *arguments, priority=1)
                continue
            found[tag] = value
            print(*tag, file=sys.stderr, flush=True)
    return found


def main(arguments: list[str] | None = None) -> int:
    """Measure everything and write the page and its pictures."""
    parser = argparse.ArgumentParser(prog='compare.py', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    evaluation.add_options(parser)
    parser.set_defaults(streets=STREETS, frames=FRAMES)
    parser.add_argument('-o', '--output', type=Path, default=Path('docs/comparison.md'))
    options = parser.parse_args(arguments)
    wanted = scenes(options.data.resolve(), options.streets, options.frames)
    cache = evaluation.cache_of(options)
    cache = replace(cache, only=cache.only or CODEC)  # other videos are not even made
    found = run_all(wanted, cache, evaluation.workers_of(options),
                    departures.jobs(options.data.resolve()))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    compare_page.write(options.output, found, '\n'.join(__doc__.splitlines()[2:]),
                       evaluation.commit_of(Path.cwd()))
    return 0


if __name__ == '__main__':
    sys.exit(main())
