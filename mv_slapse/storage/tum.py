"""Trajectories as text, one pose a row: ``stamp tx ty tz qx qy qz qw`` (TUM format)."""

from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

from mv_slapse import quaternion
from mv_slapse.errors import UnusableInput
from mv_slapse.records import SceneEstimate, WITH_POSE
from mv_slapse.ros_frames import ORIGIN, Pose
from mv_slapse.storage import whole_files
import numpy as np

LAST_SECOND = 9_000_000_000  # [s]


@dataclass(frozen=True)
class Trajectory:
    """Poses over time.

    Attributes
    ----------
    stamps : (N,) int64
        [ns], increasing.
    positions : (N, 3) float64
    quaternions : (N, 4) float64
        x y z w, unit.
    """

    stamps: np.ndarray
    positions: np.ndarray
    quaternions: np.ndarray

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.stamps)

    def rotations(self) -> np.ndarray:
        """Return the rotation matrices (N, 3, 3)."""
        return quaternion.to_matrix(self.quaternions)


def format_stamp(stamp: int) -> str:
    """Return a stamp [ns] in seconds with all its digits."""
    sec, nanosec = divmod(abs(int(stamp)), 1_000_000_000)
    return f'{"-" if stamp < 0 else ""}{sec}.{nanosec:09d}'


def parse_stamp(text: str) -> int:
    """Return the stamp [ns] of a text in seconds, exactly: a float would lose digits.

    Raises
    ------
    ValueError, ArithmeticError
        Where it is no number, or no time that 64 bits hold.
    """
    seconds = Decimal(text)
    if not abs(seconds) <= LAST_SECOND:
        raise ValueError(f'{text[:40]} is no time')
    return int((seconds * 1_000_000_000).to_integral_value())


def format_row(stamp: int, R: np.ndarray, t: np.ndarray) -> str:
    """Return the row of a pose X_W = R X + t, with 9 decimals and without a line end."""
    q = quaternion.from_matrix(R)
    q = -q if q[3] < 0 else q
    return ' '.join([format_stamp(stamp), *(f'{value:.9f}' for value in (*t, *q))])


class TrajectoryRows:
    """Rows of a trajectory that grows, and that begins where the camera began to move."""

    def __init__(self):
        """Have seen no key frame yet."""
        self._began: int | None = None  # stamp of the key frame before the first motion [ns]
        self._has_origin = False

    def of(self, scene: SceneEstimate, previous_stamp: int, origin: Pose = ORIGIN) -> list[str]:
        """Return the rows that a key frame adds, the first time that of the origin before it."""
        has_pose, rows = scene.status in WITH_POSE, []
        if self._began is None and (has_pose or scene.baseline):  # no more at rest
            self._began = previous_stamp
        if has_pose:
            if not self._has_origin:
                rows.append(format_row(self._began, origin.R, origin.t))
            self._has_origin = True
            rows.append(format_row(scene.stamp, scene.R_world_from_cam, scene.t_world_from_cam))
        return rows


def write_trajectory(path: str | Path, trajectory: Trajectory):
    """Write a trajectory file."""
    write_poses(path, zip(trajectory.stamps, trajectory.rotations(), trajectory.positions,
                          strict=True))


def write_poses(path: str | Path, poses: Iterable[tuple[int, np.ndarray, np.ndarray]]):
    """Write a trajectory file of (stamp, R, t), as ``format_row`` takes them."""
    whole_files.write_text(path, ''.join(format_row(*pose) + '\n' for pose in poses))


def read_trajectory(path: str | Path) -> Trajectory:
    """Return the poses of a trajectory file, sorted by stamp; ``#`` starts a comment.

    Raises
    ------
    UnusableInput
        Naming the file, the line and what was expected.
    """
    try:
        lines = Path(path).read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UnusableInput(f'{path} cannot be read as a trajectory: {error}') from None
    rows = [_parse(path, i, line) for i, line in enumerate(lines, 1)
            if line.strip() and not line.lstrip().startswith('#')]
    rows.sort(key=lambda row: row[0])
    values = np.array([row[1] for row in rows], float).reshape(-1, 7)
    norms = np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    stamps = np.array([row[0] for row in rows], np.int64)
    return Trajectory(stamps, values[:, :3], values[:, 3:] / norms)


def _parse(path: str | Path, number: int, line: str) -> tuple[int, list[float]]:
    parts = line.replace(',', ' ').split()
    try:
        stamp, values = parse_stamp(parts[0]), [float(part) for part in parts[1:]]
    except (ArithmeticError, ValueError):
        values = []
    if len(values) != 7 or not np.all(np.isfinite(values)) or not np.any(values[3:]):
        raise UnusableInput(f'{path}, line {number}: expected "stamp tx ty tz qx qy qz qw", '
                            f'got {line.strip()[:80]!r}')
    return stamp, values
