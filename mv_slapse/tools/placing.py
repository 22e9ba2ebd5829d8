"""``run --map``: what a run found waits until it is known where it lies in an earlier map."""

from pathlib import Path
from typing import Any

from mv_slapse.frame_change import step_in
from mv_slapse.known_map import about, PERIOD, place
from mv_slapse.pipeline import Step
from mv_slapse.records import TrackingStatus
from mv_slapse.ros_frames import ORIGIN
from mv_slapse.storage.archives import read_map

WAIT = 15_000_000_000  # [ns] of the video until the run goes on in a frame of its own


class Placing:
    """Holds key frames back until the planes of a known map are found again, or WAIT is over.

    Attributes
    ----------
    origin : Pose
        Of the first key frame's camera in the frame of the results.
    """

    def __init__(self, path: str | Path | None):
        """Read the map; without one nothing is held."""
        self._path, self._known = path, read_map(path) if path else None
        self._held: list[Step] = []
        self._first, self._due = None, 0
        self._is_decided = self._known is None
        self._told: dict[str, Any] = {} if path is None else {
            'file': str(path), 'found': False, 'reason': 'the run was too short'}
        self.origin = ORIGIN

    def add(self, step: Step) -> list[Step]:
        """Return the steps that can be written now, in the frame of the results."""
        if self._is_decided:
            return [self._moved(step)]
        self._held.append(step)
        scene = step.scene
        if self._first is None:
            self._first = scene.stamp
        if scene.status is TrackingStatus.OK and scene.stamp >= self._due:
            self._due = scene.stamp + PERIOD
            self._look(step)
        return self.rest() if self._is_decided or scene.stamp - self._first > WAIT else []

    def rest(self) -> list[Step]:
        """Return what is still held, at the end or once it is decided where it lies."""
        self._is_decided, held = True, self._held
        self._held = []
        return [self._moved(step) for step in held]

    def content(self) -> dict[str, Any]:
        """Return what the summary says of it; nothing where there is no map."""
        return self._told

    def warnings(self) -> list[str]:
        """Return what to tell where the map was not found again."""
        if self._told.get('found', True):
            return []
        return [f'the planes of {self._path} are not found again ({self._told["reason"]}); the '
                'results are in a frame of their own']

    def _look(self, step: Step):
        placing = place(self._known, step.scene, about())
        pose = placing.known_from_world
        self._told['reason'] = placing.reason
        if pose is None:
            return
        self._is_decided, self.origin = True, pose
        self._told.update(found=True, stamp=step.scene.stamp / 1e9,
                          position_sigma_m=placing.position_sigma,
                          planes=[list(pair) for pair in placing.matches],
                          position=pose.t.tolist())

    def _moved(self, step: Step) -> Step:
        return step_in(step, self.origin) if self._told.get('found') else step
