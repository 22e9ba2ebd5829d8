"""The printed pipelines from correspondences to poses, planes and labels.

Before the first motion there is nothing to show. Where a pair tells no motion the filter predicts,
and planes that are not found in it are deleted, as VI-C of [SLAPSE] says.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from mv_slapse.config import DecoderSettings, Settings
from mv_slapse.evaluation.detection import grid_index
from mv_slapse.evaluation.truth import LabelTable
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.geometry.camera import Camera, to_pixels, to_rays, undistort
from mv_slapse.records import Correspondences, Label
import numpy as np

from papers import filters, obstacles, two_views
from papers.two_views import Thresholds, View

# Pairs of key frames as [SLAPSE] V-A has them: none is chained, split or bridged by a search, and
# direct vectors weigh sqrt 2. Which vectors are right the print does not say how to tell: that is
# the package's way, by the agreement of a macroblock's evidence with what lies around.
DECODER = DecoderSettings(paper_weights=True, max_chain=1, split_flow=1e6, bridge_intra=False,
                          lone_probability=0.0)
SETTINGS = Settings(decoder=DECODER)
# Plane management of [MVO] verifies planes by the filter's output, and does not say how: one that
# departs by more than this share of itself begins anew. Without it `kitti00` errs by 8 %.
VERIFIED = 0.3
BOUNDS = Thresholds()
STILL = 0.1  # share of the camera's speed, "close to zero" of an obstacle's, section 5 of [MVO]
TOLD = 6  # blocks of a mover, at least, where somebody told which those are
OBSTACLE = ('stamp', 'id', 'x', 'y', 'width', 'height', 'px', 'py', 'pz', 'vx', 'vy', 'vz', 'ttc')


@dataclass
class Found:
    """What a pipeline found.

    Attributes
    ----------
    poses : list of (stamp, R, t)
        X_world = R X_cam + t [first baselines].
    planes : list of (stamp, id, nx, ny, nz, d, n_macroblocks)
        In the camera of each key frame, d >= 0.
    stamps, labels, numbers : list
        Of each key frame with a motion: its stamp, and label and plane of each macroblock.
    blocks : list of (M,) arrays
        Labels by Definition 1 alone; of [MVO] only.
    covariances : dict of (6, 6) arrays
        Of (position, rotation about the axes of {W}) by stamp; of [MVO] only.
    obstacles : list of OBSTACLE
        Of each moving plane: the box of its blocks [px], where the ray of its middle meets the
        plane and the velocity, in {W} [first baselines, per second], time to contact [s].
    """

    poses: list = field(default_factory=list)
    planes: list = field(default_factory=list)
    stamps: list = field(default_factory=list)
    labels: list = field(default_factory=list)
    numbers: list = field(default_factory=list)
    blocks: list = field(default_factory=list)
    covariances: dict = field(default_factory=dict)
    obstacles: list = field(default_factory=list)
    size: tuple[int, int] = (0, 0)

    def plane_table(self) -> dict[str, np.ndarray]:
        """Return the planes as columns of a planes.csv."""
        return _table(('stamp', 'id', 'nx', 'ny', 'nz', 'd', 'n_macroblocks'), self.planes)

    def obstacle_table(self) -> dict[str, np.ndarray]:
        """Return the obstacles as columns of an obstacles.csv; the print confirms none later."""
        table = _table(OBSTACLE, self.obstacles)
        return table | {'state': np.full(len(table['stamp']), 'confirmed')}

    def label_table(self, by_block: bool = False) -> LabelTable:
        """Return the labels of macroblocks, of planes or of each block by itself."""
        centres = grid_centres(*self.size)
        labels, numbers = (np.array(rows, int).reshape(-1, len(centres)) for rows in (
            self.blocks if by_block else self.labels, self.numbers))
        return LabelTable(np.array(self.stamps, np.int64), *centres.T, labels, numbers)


def _table(names, rows):
    columns = np.array(rows, object).reshape(-1, len(names)).T
    return {name: column.astype(np.int64 if name in ('stamp', 'id') else float)
            for name, column in zip(names, columns, strict=True)}


class Pair(NamedTuple):
    """A pair of key frames as both pipelines take it."""

    view: View
    sigma: np.ndarray
    cell: np.ndarray
    dt: float
    stamp: int


class Pipeline:
    """What [SLAPSE] and [MVO] have in common; ``step`` takes one pair after another."""

    def __init__(self, camera: Camera, bounds: Thresholds = BOUNDS):
        """Start without a motion."""
        self.camera, self.bounds = camera, bounds
        self.found = Found(size=(camera.width, camera.height))
        self.scene = None
        self._rng = np.random.default_rng(0)
        self._grid = np.full(len(grid_centres(*self.found.size)), -1)

    def step(self, correspondences: Correspondences):
        """Take the matches of a pair of key frames."""
        pair = self._read(correspondences)
        first = self._motion(pair.view)
        if self.scene is None and first is None:
            return
        if self.scene is None:
            self.found.poses.append((correspondences.previous_stamp, np.eye(3), np.zeros(3)))
            R, t = first[0].T, -first[0].T @ first[1]
            self.scene = self.FILTER(R, t, pair.dt)
        else:
            self.scene.step(pair.dt)
        plane = np.full(len(pair.sigma), -1)
        if first is None:
            self.scene.keep([])
            self.found.labels.append(np.full(len(self._grid), -1))
            self.found.blocks.append(self.found.labels[-1])
        else:
            plane = self._planes(pair, *first)
        self._write(correspondences, pair, plane)

    def planes_of(self, correspondences: Correspondences) -> list[np.ndarray]:
        """Return the macroblocks (M, 2) [px] of each plane of a pair, whatever came before."""
        pair = self._read(correspondences)
        first, none = self._motion(pair.view), np.full(len(pair.sigma), -1)
        if first is None:
            return []
        near = ~two_views.at_infinity(pair.view, first[0], self.bounds.m)
        plane = two_views.homographies(pair.view, near, none, self.bounds)
        centres = grid_centres(*self.found.size)[pair.cell]
        return [centres[plane == n] for n in np.unique(plane[plane >= 0])]

    def _read(self, c: Correspondences) -> Pair:
        x_cur, x_prev = (undistort(self.camera, x) for x in (c.x_cur, c.x_prev))
        return Pair(View(x_cur, x_prev, self.camera.K), np.asarray(c.sigma, float),
                    grid_index(c.x_cur, c.width, c.height), (c.stamp - c.previous_stamp) * 1e-9,
                    c.stamp)

    def _motion(self, view: View):
        """Return the first estimate of the motion, R_cur_from_prev and t; None without any."""
        F, inlier = two_views.eight_points(view, self.bounds.f, self._rng)
        return None if F is None or inlier.sum() < 16 else two_views.motion(view, F, inlier)

    def _extracted(self, pair: Pair, R: np.ndarray, candidates) -> np.ndarray:
        """Return the plane (N,) of each match, -1 for none; or one of the pair before."""
        view = pair.view
        before = grid_index(view.x_prev, *self.found.size)
        known = np.where(before >= 0, self._grid[before], -1)
        near = candidates & ~two_views.at_infinity(view, R, self.bounds.m)
        return two_views.homographies(view, near, known, self.bounds)

    def _consistent(self, view: View, rows: np.ndarray, R, t):
        """Return the plane of matches under a motion, and which agree; None: none lies there.

        A homography has eight unknowns, a plane under a known motion three: a homography that no
        plane makes must not enter the filter.
        """
        plane = two_views.fitted_plane(view.of(rows), R, t)
        there = two_views.transfer(to_rays(view.K, view.x_cur), R, t, plane[None])
        agree = rows & (there[:, 2] > 0)
        off = to_pixels(view.K, np.where(agree[:, None], there, 1.0)) - view.x_prev
        agree &= np.linalg.norm(off, axis=1) < self.bounds.h
        return (plane, agree) if agree.sum() >= self.bounds.smallest else None

    def _write(self, c: Correspondences, pair: Pair, plane: np.ndarray):
        found = self.found
        found.poses.append((c.stamp, *self.scene.advance()))
        if self.scene.has_pose:
            found.covariances[c.stamp] = self.scene.pose_covariance()
        for id_, n in zip(self.scene.ids, self.scene.in_camera(), strict=True):
            size = np.linalg.norm(n)
            found.planes.append((c.stamp, id_, *(n / size), 1 / size, int((plane == id_).sum())))
        self._grid = self._on_grid(pair, plane)
        found.stamps.append(c.stamp)
        found.numbers.append(self._grid)

    def _on_grid(self, pair: Pair, values: np.ndarray) -> np.ndarray:
        grid = np.full(len(self._grid), -1)
        grid[pair.cell] = values
        return grid


class Slapse(Pipeline):
    """[SLAPSE]: everything that moves like a plane is one of the scene."""

    FILTER = filters.Slapse

    def _planes(self, pair: Pair, R, t) -> np.ndarray:
        scene, view = self.scene, pair.view
        plane = self._extracted(pair, R, np.ones(len(pair.sigma), bool))
        scene.keep(set(plane.tolist()))
        self._observe(pair, plane, scene.ids)
        for id_ in [n for n in np.unique(plane[plane >= 0]) if n not in scene.ids]:
            found = self._consistent(view, plane == id_, *scene.motion)
            plane[plane == id_] = -1
            if found is not None:
                plane[found[1]] = id_
                scene.add(int(id_), found[0])
                self._observe(pair, plane, [id_])
        self.found.labels.append(self._on_grid(pair, np.zeros(len(plane), int)))
        return plane

    def _observe(self, pair: Pair, plane: np.ndarray, ids):
        of = np.isin(plane, ids)
        if of.any():
            row = np.array([self.scene.ids.index(n) for n in plane[of]])
            self.scene.observe(pair.view.of(of), row, pair.sigma[of])


class Mvo(Pipeline):
    """[MVO]: blocks and planes are told apart by whether they move; (10) goes to the filter."""

    FILTER = filters.Mvo

    def __init__(self, camera: Camera, bounds: Thresholds = BOUNDS):
        """Start without a motion."""
        super().__init__(camera, bounds)
        self._obstacles: dict[int, obstacles.Obstacle] = {}

    def _motion(self, view: View):
        F, inlier = two_views.eight_points(view, self.bounds.f, self._rng)
        if F is None or inlier.sum() < 16:
            return None
        return two_views.refined(view.of(inlier), *two_views.motion(view, F, inlier))

    def _planes(self, pair: Pair, R, t) -> np.ndarray:
        view, bounds = pair.view, self.bounds
        still = two_views.stationary(view, R, t, bounds)
        plane = self._extracted(pair, R, np.ones(len(still), bool))
        moving = np.isin(plane, two_views.moving_planes(plane, still))
        numbers, planes, row = [], [], np.full(len(plane), -1)
        for id_ in np.unique(plane[(plane >= 0) & ~moving]):
            found = self._consistent(view, (plane == id_) & still, R.T, -R.T @ t)
            if found is not None:
                row[found[1]] = len(numbers)
                numbers.append(int(id_))
                planes.append(found[0])
        found = self._joined(pair, still, row, numbers, two_views.Joint(
            R, t, np.array(planes).reshape(-1, 3), np.zeros((0, 0))))
        self._follow(pair, found, self._movers(pair, np.where(moving, plane, -1)))
        self._label(pair, still, plane, moving, two_views.at_infinity(view, R, bounds.m))
        return plane

    def _joined(self, pair, still, row, numbers, start):
        """Estimate motion and planes together, (10), hand them to the filter and return them."""
        sigma = float(np.median(pair.sigma))
        scene, found = self.scene, two_views.joint(pair.view, still, row, start, sigma)
        scene.keep(numbers)
        baseline = np.linalg.norm(scene.motion[1])
        scene.keep(self._verified(dict(zip(numbers, found.planes, strict=True)), baseline))
        for id_, plane in zip(numbers, found.planes, strict=True):
            if id_ not in scene.ids:
                scene.add_in_camera(id_, plane / baseline)
        scene.observe(found, numbers)
        return found

    def _verified(self, found, baseline) -> list[int]:
        """Return the planes of the filter that are where it expects them, of those found again.

        Blocks hand their plane on to what lies beside it. Where nothing is as expected the
        expected baseline is wrong, and not the planes.
        """
        expected = dict(zip(self.scene.ids, baseline * self.scene.in_camera(), strict=True))
        good = [id_ for id_, plane in expected.items()
                if np.linalg.norm(found[id_] - plane) < VERIFIED * np.linalg.norm(found[id_])]
        return good or list(expected)

    def _movers(self, pair: Pair, plane: np.ndarray) -> np.ndarray:
        """Return the mover (N,) of each match, -1 for none; ``plane`` (N,) is its moving plane."""
        return plane

    def _follow(self, pair: Pair, motion: two_views.Joint, mover: np.ndarray):
        """Take each moving plane to its filter, (12) to (16).

        One that is not found is deleted, one that stands still handed to the scene's filter.
        """
        (R, t), velocity = self.scene.advance(), self.scene.x[-3:].copy()
        speed, road = np.linalg.norm(velocity), obstacles.road_of(self.scene.in_camera())
        baseline, sigma = np.linalg.norm(self.scene.motion[1]), float(np.median(pair.sigma))
        before, self._obstacles = self._obstacles, {}
        for id_ in np.unique(mover[mover >= 0]):
            seen, one = pair.view.of(mover == id_), before.get(id_)
            found = obstacles.observed(seen, motion.R, baseline * motion.t, road, sigma,
                                       self.bounds.tilt)
            if one is None:
                one = obstacles.Obstacle(found, R, t, pair.dt, speed)
            else:
                one.step(pair.dt, speed)
                one.observe(found, R, t, pair.dt)
            place = one.shown(seen, R, t, velocity)
            if np.linalg.norm(one.x[3:]) < STILL * speed:
                self.scene.add(int(id_), one.x[:3])
            elif place is not None:
                self._obstacles[id_] = one
                self.found.obstacles.append((pair.stamp, id_, *place))

    def _label(self, pair, still, plane, moving, far):
        """Note the labels by Definition 2, where a plane is, and by Definition 1."""
        by_block = np.where(far & still, Label.INFINITY,
                            np.where(still, Label.STATIONARY, Label.MOVING))
        by_plane = np.where(moving, Label.MOVING, np.where(
            plane >= 0, Label.STATIONARY, np.where(far & still, Label.INFINITY, Label.UNKNOWN)))
        self.found.labels.append(self._on_grid(pair, by_plane))
        self.found.blocks.append(self._on_grid(pair, by_block))


class Told(Mvo):
    """[MVO], told which blocks show which mover: what its filter (14)-(16) makes of them."""

    def __init__(self, movers_at: Callable[[int], np.ndarray], camera: Camera,
                 bounds: Thresholds = BOUNDS):
        """Take a function of a stamp that returns the mover of each macroblock, -1 for none."""
        super().__init__(camera, bounds)
        self._movers_at = movers_at

    def _movers(self, pair, plane):
        """Return those blocks of each mover that lie on one plane."""
        true, none = self._movers_at(pair.stamp)[pair.cell], np.full(len(plane), -1)
        one, found = replace(self.bounds, smallest=TOLD, planes=1), none.copy()
        for id_ in np.unique(true[true >= 0]):
            found[two_views.homographies(pair.view, true == id_, none, one) >= 0] = id_
        return found


def run(pipeline: Callable[..., Pipeline], camera: Camera, pairs, bounds: Thresholds = BOUNDS
        ) -> Found:
    """Run a pipeline over pairs of key frames."""
    made = pipeline(camera, bounds)
    for pair in pairs:
        made.step(pair)
    return made.found
