"""The whole without ROS: figure 1 of [MVO] as one method, Slapse.step."""

from collections.abc import Sequence
from dataclasses import dataclass

from mv_slapse.blas import one_thread
from mv_slapse.config import Settings
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry.camera import Camera
from mv_slapse.obstacles.tracker import ObstacleTracker
from mv_slapse.records import (
    Correspondences,
    Extraction,
    Obstacle,
    PlaneHandover,
    SceneEstimate,
    Speed,
)
from mv_slapse.scene.filter import SceneFilter


@dataclass(frozen=True)
class Step:
    """All that one key frame pair leads to."""

    correspondences: Correspondences
    extraction: Extraction
    scene: SceneEstimate
    obstacles: tuple[Obstacle, ...]
    handovers: tuple[PlaneHandover, ...]


class Slapse:
    """Localisation, planes and moving obstacles from correspondences."""

    def __init__(self, camera: Camera, settings: Settings):
        """Start before the first key frame."""
        self._extractor = PlaneExtractor(camera, settings.extraction,
                                         settings.scene.camera_height)
        self._scene = SceneFilter(settings.scene)
        self._tracker = ObstacleTracker(settings.obstacles)
        self._to_scene: list[PlaneHandover] = []

    @one_thread
    def step(self, correspondences: Correspondences, speeds: Sequence[Speed] = ()) -> Step:
        """Take in the correspondences of one key frame pair, in the order of stamps.

        ``speeds`` of the vehicle that were told since the pair before make the scale metric.
        Planes that change their label reach the other filter within this step, or, on their
        way to the scene filter, at the next.
        """
        extraction = self._extractor.extract(correspondences)
        scene, to_tracker = self._scene.step(extraction, self._to_scene, speeds)
        obstacles, self._to_scene = self._tracker.step(extraction, scene, to_tracker)
        return Step(correspondences, extraction, scene, tuple(obstacles),
                    (*to_tracker, *self._to_scene))
