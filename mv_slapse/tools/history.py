"""What a run was like at each key frame, for its report."""

from array import array

from mv_slapse.pipeline import Step
from mv_slapse.records import ObstacleState, ScaleStatus, SegmentKind
import numpy as np

COLUMNS = ('stamp', 'status', 'x', 'y', 'z', 'sigma_x', 'sigma_y', 'sigma_z', 'speed', 'metric',
           'planes', 'obstacles', 'vectors', 'broken')


class History:
    """One row a key frame: numbers only, so that a run of days stays small."""

    def __init__(self):
        """Hold nothing yet."""
        self._rows = array('d')

    def add(self, step: Step):
        """Take what a key frame pair gave."""
        scene, pair = step.scene, step.correspondences
        sigma = np.sqrt(np.diag(scene.pose_covariance)[:3].clip(0))
        confirmed = sum(obstacle.state is ObstacleState.CONFIRMED for obstacle in step.obstacles)
        self._rows.extend((
            scene.stamp / 1e9, scene.status, *scene.t_world_from_cam, *sigma,
            float(np.linalg.norm(scene.velocity_world)),
            scene.scale_status is ScaleStatus.METRIC, len(scene.planes), confirmed, len(pair),
            pair.kind is SegmentKind.BROKEN))

    def columns(self) -> dict[str, np.ndarray]:
        """Return (N,) arrays by COLUMNS: stamps [s], lengths [map unit], counts."""
        rows = np.array(self._rows).reshape(-1, len(COLUMNS))
        return dict(zip(COLUMNS, rows.T, strict=True))
