"""``mv_slapse eval``: the folder of a run against whatever truth there is."""

from collections.abc import Iterator
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from mv_slapse import fields
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.evaluation import annotation as annotations
from mv_slapse.evaluation import (
    consistency,
    detection,
    planes,
    planner,
    tracking,
    trajectory,
)
from mv_slapse.evaluation.truth import LabelTable, read_arrays, read_labels, read_truth, Truth
from mv_slapse.level import frames_from_transforms
from mv_slapse.records import SceneEstimate
from mv_slapse.ros_frames import RosFrames
from mv_slapse.storage.archives import read_map
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.storage.tables import OBSTACLES_HEADER, PLANES_HEADER, read_table
from mv_slapse.storage.tum import read_trajectory, Trajectory
from mv_slapse.storage.whole_files import whole
import numpy as np


@dataclass(frozen=True)
class Results:
    """The files of a run that are evaluated; stamps as the truth counts them."""

    trajectory: Trajectory
    planes: dict[str, np.ndarray]
    obstacles: dict[str, np.ndarray]
    labels: LabelTable
    summary: dict[str, Any]

    @property
    def is_metric(self) -> bool:
        """Whether lengths are in metres."""
        return self.summary.get('scale_status') == 'metric'


@dataclass(frozen=True)
class Marks:
    """Files in which somebody marked movers in the pictures, and what else is known of these."""

    labels: str | Path | None = None  # motion_labels.npz
    boxes: str | Path | None = None  # boxes.csv
    annotation: str | Path | None = None  # annotation.json, of the last frame
    # of the frames that labels and boxes count [1/s]; as in the run's summary by default
    fps: float | None = None
    # above the ground [m]: tells what is aside where a run has a free scale; 0: not known
    camera_height: float = 0.0


def evaluate(out: str | Path, ground_truth: str | Path | None = None, marks: Marks = Marks(),
             stamp_offset: float = 0.0) -> dict[str, Any]:
    """Return all figures that the given truth allows, by the names that ``eval --json`` prints.

    Parameters
    ----------
    out : folder of a run
    ground_truth : trajectory file, or a folder as the simulator writes it
    marks : files of movers in the pictures
    stamp_offset : float
        Taken off the run's stamps before they are compared [s].

    Raises
    ------
    UsageError, UnusableInput
        Where there is no truth, or a file cannot be read.
    """
    labels, boxes, annotation = marks.labels, marks.boxes, marks.annotation
    if all(given is None for given in (ground_truth, labels, boxes, annotation)):
        raise UsageError('there is nothing to compare with; give --ground-truth, --labels, '
                         '--boxes or --annotation')
    results = read_results(out, stamp_offset)
    truth = read_truth(ground_truth) if ground_truth is not None else Truth()
    is_exact = ground_truth is not None and Path(ground_truth).is_dir()  # of the simulator
    figures = _counts(results) | {'unexplained_step': consistency.unexplained_step(
        read_scenes(out))}
    scale = 1.0
    if truth.trajectory is not None:
        score = trajectory.evaluate(results.trajectory, truth.trajectory)
        found = trajectory.figures(score)
        # Without a known unit of length only similarity says something.
        figures |= {name: value for name, value in found.items()
                    if results.is_metric or 'rigid' not in name}
        figures['epsilon_d_percent'] = trajectory.epsilon_d(
            results.trajectory, truth.trajectory, results.is_metric)
        figures |= consistency.figures(
            results.trajectory, read_pose_covariances(out, stamp_offset), truth.trajectory,
            results.is_metric, is_exact=is_exact)
        scale = 1.0 if results.is_metric else score.alignment.scale
    figures |= _plane_figures(results, truth, scale)
    if truth.movers is not None:
        figures |= tracking.figures(
            results.obstacles, results.labels.stamps, truth.movers, truth.trajectory, scale,
            read_covariances(out, stamp_offset))
        if truth.labels is not None:
            figures |= detection.block_figures(results.labels, truth.labels, truth.movers)
    if not results.is_metric and truth.trajectory is None:
        scale = _metres_by_the_ground(out, marks.camera_height)
    course = planner.Course(results.trajectory, scale)
    if boxes is None and annotation is None:  # those tell of one vehicle among others
        points = None if labels is None else _read_points(results, labels, marks.fps)
        movers = truth.movers if points is None else detection.point_boxes(points)
        figures |= planner.figures(results.obstacles, results.labels.stamps, movers, course,
                                   points)
    if annotation is not None:
        figures |= annotations.figures(
            results.obstacles, int(results.labels.stamps.max(initial=0)), results.trajectory,
            _read_annotation(annotation), results.is_metric)
    return figures | _label_figures(results, marks)


def _metres_by_the_ground(out: str | Path, camera_height: float) -> float | None:
    """Return the metres of a map unit, by how high the first camera is above the ground."""
    if not camera_height:
        return None
    ground = [plane for plane in read_map(Path(out) / 'map.json').planes
              if plane.is_ground and plane.depth]
    if not ground:
        return None
    return camera_height / abs(max(ground, key=lambda plane: plane.n_observations).depth)


def read_covariances(out: str | Path, stamp_offset: float = 0.0) -> tracking.Covariances:
    """Return the covariances (6, 6) of obstacles by stamp and id; the tables have none.

    They are in the messages of the run, which a run that was interrupted may lack.
    """
    bag, shift = Path(out) / 'results.mcap', round(stamp_offset * 1e9)
    if not bag.exists():
        return {}
    frames = frames_of(bag)
    messages = (msg for _, msg in BagReader(bag).messages(['/obstacles']))
    return {(o.stamp - shift, o.id): o.covariance for msg in messages
            for o in fields.obstacles_from_message(msg, frames)}


def read_pose_covariances(out: str | Path, stamp_offset: float = 0.0) -> dict[int, np.ndarray]:
    """Return the covariances (6, 6) of poses in {W} by stamp, from the messages of the run."""
    bag, shift = Path(out) / 'results.mcap', round(stamp_offset * 1e9)
    if not bag.exists():
        return {}
    frames = frames_of(bag)
    messages = (msg for _, msg in BagReader(bag).messages(['/pose']))
    return {fields.stamp_from_message(msg.header.stamp) - shift:
            fields.pose_from_message(msg, frames).covariance for msg in messages}


def read_scenes(out: str | Path) -> Iterator[SceneEstimate]:
    """Yield what the messages of a run say of its poses; none where it has no messages."""
    bag, odometry = Path(out) / 'results.mcap', None
    if not bag.exists():
        return
    frames = frames_of(bag)
    for _, msg in BagReader(bag).messages(['/odometry', '/planes/map']):
        if hasattr(msg, 'twist'):
            odometry = msg
        elif odometry is not None and odometry.header.stamp == msg.header.stamp:
            yield fields.scene_from_messages(odometry, msg, frames)


def frames_of(bag: Path) -> RosFrames:
    """Return where {W} lies in the odom of a run's messages."""
    return frames_from_transforms(
        transform for _, msg in BagReader(bag).messages(['/tf_static'])
        for transform in msg.transforms)


def read_results(out: str | Path, stamp_offset: float = 0.0) -> Results:
    """Read the folder of a run.

    Raises
    ------
    UnusableInput
        Where it is not one.
    """
    out, shift = Path(out), round(stamp_offset * 1e9)
    if not (out / 'trajectory.tum').exists():
        raise UnusableInput(f'{out} is not a folder of results: it has no trajectory.tum; '
                            'write one with: mv_slapse run INPUT --camera camera.yaml -o OUT')
    path = read_trajectory(out / 'trajectory.tum')
    labels = read_labels(out / 'labels.npz')
    return Results(
        Trajectory(path.stamps - shift, path.positions, path.quaternions),
        _shifted(read_table(out / 'planes.csv', PLANES_HEADER), shift),
        _shifted(read_table(out / 'obstacles.csv', OBSTACLES_HEADER), shift),
        LabelTable(labels.stamps - shift, labels.x, labels.y, labels.label, labels.plane),
        _read_summary(out / 'summary.json'))


def plot(path: str | Path, out: str | Path, ground_truth: str | Path | None,
         stamp_offset: float = 0.0):
    """Draw the trajectory of a run over the true one.

    Raises
    ------
    UsageError
        Where there is no true trajectory.
    """
    from mv_slapse.tools import figures, page
    truth = read_truth(ground_truth) if ground_truth is not None else Truth()
    if truth.trajectory is None:
        raise UsageError('--plot needs a true trajectory; give --ground-truth')
    comparison = figures.compare(read_results(out, stamp_offset), truth)
    with whole(path, 'wb') as file:
        file.write(page.png(figures.way_and_error(comparison)))


def text(figures: dict[str, Any]) -> str:
    """Return figures as lines of a table."""
    width = max(map(len, figures))
    lines = [f'{name:{width}}  {_shown(value)}' for name, value in figures.items()]
    if figures.get('scale_status') != 'metric' and 'ate_mean_m' in figures:
        lines.append('the scale is free: errors are those after alignment in scale, too')
    return '\n'.join(lines)


def _counts(results: Results) -> dict[str, Any]:
    n_key_frames, n_poses = len(results.labels.stamps), len(results.trajectory)
    n_all = results.summary.get('key_frames', n_key_frames + 1)
    return {'n_poses': n_poses, 'n_key_frames': n_all,
            'posed_percent': 100 * min(n_poses / max(n_all, 1), 1.0),
            'scale_status': results.summary.get('scale_status', 'unknown'),
            **detection.obstacle_figures(results.obstacles, n_key_frames)}


def _plane_figures(results: Results, truth: Truth, scale: float) -> dict[str, Any]:
    if truth.planes is None or truth.trajectory is None:
        return {}
    labels = None if truth.labels is None else (results.labels, truth.labels)
    return planes.figures(planes.evaluate(results.planes, truth.planes, truth.trajectory, scale,
                                          labels))


def _label_figures(results: Results, marks: Marks) -> dict[str, Any]:
    figures = {}
    if marks.labels is not None:
        points = _read_points(results, marks.labels, marks.fps)
        figures |= detection.point_figures(results.labels, points)
    if marks.boxes is not None:
        table = read_table(marks.boxes, 'frame,x,y,width,height')
        figures |= detection.box_figures(results.obstacles, results.labels.stamps, table,
                                         _rate(results, marks.fps))
    return figures


def _read_points(results: Results, labels: str | Path, fps: float | None) -> detection.PointLabels:
    content = read_arrays(labels, ('tracks', 'visible', 'label'))
    return detection.PointLabels(content['tracks'], content['visible'].astype(bool),
                                 content['label'], _rate(results, fps))


def _rate(results: Results, fps: float | None) -> float:
    fps = fps or results.summary.get('fps')
    if not fps:
        raise UsageError('the run does not say how many frames a second has; give --fps')
    return fps


def _read_annotation(path: str | Path) -> list[annotations.Vehicle]:
    try:
        return annotations.vehicles(json.loads(Path(path).read_text()))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnusableInput(f'{path} is not an annotation of vehicles: {error!r}') from None


def _shifted(table: dict[str, np.ndarray], shift: int) -> dict[str, np.ndarray]:
    return {**table, 'stamp': table['stamp'].astype(np.int64) - shift}


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        return {}  # the run was killed before its end; its other files are whole
    except (OSError, ValueError) as error:
        raise UnusableInput(f'{path} cannot be read: {error}') from None


def _shown(value: Any) -> str:
    if value is None:
        return '-'
    return f'{value:.4f}' if isinstance(value, float) else str(value)
