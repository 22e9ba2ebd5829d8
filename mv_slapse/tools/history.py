"""What a run was like at each key frame, for its report."""

from array import array
from tempfile import TemporaryFile

from mv_slapse.pipeline import Step
from mv_slapse.records import ObstacleState, ScaleStatus, SegmentKind
from mv_slapse.storage.whole_files import unusable
import numpy as np

COLUMNS = ('stamp', 'status', 'x', 'y', 'z', 'sigma_x', 'sigma_y', 'sigma_z', 'speed', 'metric',
           'planes', 'obstacles', 'vectors', 'broken')


class History:
    """One row a key frame; they wait on the disk, for a run may last for days."""

    def __init__(self):
        """Hold nothing yet."""
        self._rows = TemporaryFile()  # noqa: SIM115 (as long as the history)

    def add(self, step: Step):
        """Take what a key frame pair gave.

        Raises
        ------
        UnusableOutput
            Where the disk is full.
        """
        scene, pair = step.scene, step.correspondences
        sigma = np.sqrt(np.diag(scene.pose_covariance)[:3].clip(0))
        confirmed = sum(obstacle.state is ObstacleState.CONFIRMED for obstacle in step.obstacles)
        row = array('d', (
            scene.stamp / 1e9, scene.status, *scene.t_world_from_cam, *sigma,
            float(np.linalg.norm(scene.velocity_world)),
            scene.scale_status is ScaleStatus.METRIC, len(scene.planes), confirmed, len(pair),
            pair.kind is SegmentKind.BROKEN))
        try:
            self._rows.write(row)
        except OSError as error:
            raise unusable('what report.html shows', error) from error

    def columns(self) -> dict[str, np.ndarray]:
        """Return (N,) arrays by COLUMNS: stamps [s], lengths [map unit], counts."""
        self._rows.seek(0)  # what is buffered is written before
        rows = np.frombuffer(self._rows.read()).reshape(-1, len(COLUMNS))
        return dict(zip(COLUMNS, rows.T, strict=True))
