"""What the map knows of its planes besides their state: outline, age, support."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from mv_slapse.changed import replace
from mv_slapse.geometry.plane import MOST_KEPT, scaled_about, WELL_SEEN
from mv_slapse.kernels.binding import compiled
from mv_slapse.records import Extraction, Label, MapPlane, PlaneHandover
from mv_slapse.scene import gauge as scene_gauge
from mv_slapse.scene.state import AnchoredPlane, Pose, SceneState, UNIT
import numpy as np

FARTHEST = 30.0  # an outline ends this many plane depths from the camera: beyond, a block's
#                  position on a grazing plane is noise
CORNERS = 32  # of an outline, at most: of a circle all but 0.6 % lies inside
MOST_LEFT = 200  # planes that the filter gave up and the map still shows


@dataclass(frozen=True)
class Sighting:
    """History of one plane: stamps [ns], counts, and its outline (M, 3) in {W}."""

    first_stamp: int
    last_stamp: int
    n_observations: int = 0
    n_macroblocks: int = 0
    outline: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    is_ground: bool = False


class SceneMap:
    """History of the planes that the scene filter holds."""

    def __init__(self):
        """Start empty."""
        self._sightings: dict[int, Sighting] = {}
        self._waited, self._seen = 0, {}
        self._left: dict[int, MapPlane] = {}

    @property
    def ground(self) -> int | None:
        """Return the id of the ground seen last."""
        grounds = [id for id, sighting in self._sightings.items() if sighting.is_ground]
        return max(grounds, key=lambda id: self._sightings[id].last_stamp, default=None)

    def remove(self, id: int):
        """Forget a plane."""
        del self._sightings[id], self._seen[id]

    def leave(self, state: SceneState, id: int):
        """Take a plane out of the state; keep a wall as it was last known, if it was well seen.

        Not the ground: elsewhere the road is another plane.
        """
        if not self.is_lasting(id):
            state.remove_plane(id)
            self.remove(id)
            return
        self._sightings[id] = replace(self._sightings[id], n_macroblocks=0)
        self._left[id] = self._map_planes(state)[id]
        state.remove_plane(id)
        if len(self._left) > MOST_LEFT:
            oldest = min(self._left, key=lambda id: self._left[id].last_stamp)
            del self._left[oldest]
            self.remove(oldest)

    def is_lasting(self, id: int) -> bool:
        """Tell whether a plane is a wall that was seen often enough to be worth keeping."""
        sighting = self._sightings[id]
        return sighting.n_observations >= WELL_SEEN and not sighting.is_ground

    def overdue(self, state: SceneState, stamp: int, lifetime: int) -> list[int]:
        """Return the planes that the filter should give up.

        Those unseen for longer than ``lifetime`` [ns], rests left out, but for walls that were
        well seen: these may come back into view, and are given up where there are too many.
        """
        unseen = {id: stamp - self._waited - self._seen[id] for id in state.planes}
        lasting = {id for id in unseen if self.is_lasting(id)}
        late = [id for id, time in unseen.items() if time > lifetime and id not in lasting]
        away = sorted((id for id in lasting if unseen[id] > lifetime), key=unseen.get)
        return late + away[max(MOST_KEPT - len(unseen) + len(away) + len(late), 0):]

    def wait(self, time: int):
        """Let no plane age for a time [ns] in which nothing new came into view."""
        self._waited += time

    def adopt(self, id: int, stamp: int):
        """Begin the history of a plane that another filter hands over."""
        self._sightings[id] = Sighting(stamp, stamp)
        self._left.pop(id, None)
        self._seen[id] = stamp - self._waited

    def accept(self, state: SceneState, handovers: Sequence[PlaneHandover]):
        """Take planes over that have come to rest."""
        for handover in handovers:
            if handover.to_label != Label.STATIONARY or handover.id in state.planes:
                continue
            anchor = state.current.t.copy()
            scale = 1 + handover.plane @ anchor
            J = UNIT / scale - np.outer(handover.plane, anchor) / scale**2
            state.add_plane(handover.id, AnchoredPlane(handover.plane / scale, anchor),
                            J @ handover.covariance[:3, :3] @ J.T)
            self.adopt(handover.id, handover.stamp)

    def release(self, state: SceneState, extraction: Extraction) -> list[PlaneHandover]:
        """Give planes away that the extraction now sees moving."""
        leaving = []
        for plane in extraction.planes:
            if plane.label == Label.MOVING and plane.id in state.planes:
                leaving.append(self.handover(state, plane.id, extraction.stamp))
                state.remove_plane(plane.id)
                self.remove(plane.id)
        return leaving

    def join(self, state: SceneState, extraction: Extraction, known: set[int], trusted: set[int],
             baseline: float, shown: Pose) -> list[int]:
        """Return the planes to update, after putting new and lost ones into the state afresh.

        A plane comes in with next to no prior; its correspondences then determine it, together
        with everything they are correlated with. Of the planes seen ``known`` are where they were
        predicted, and ``trusted`` may be used; ``baseline`` is the length [map unit] of the pair's
        way, and ``shown`` the pose at its end.
        """
        ids = []
        for plane in extraction.planes:
            if plane.id not in trusted:
                continue
            if plane.id not in known:
                if plane.id in state.planes:
                    state.remove_plane(plane.id)
                world = shown.R @ plane.plane / baseline
                state.add_plane(plane.id, AnchoredPlane(world, shown.t.copy()),
                                UNIT * (3 * np.linalg.norm(world)) ** 2)
            ids.append(plane.id)
        return ids

    def scale(self, factor: float, place: np.ndarray):
        """Multiply all lengths by a factor, so that a place (3,) in {W} stays."""
        def moved(outline):
            """Return an outline (M, 3) scaled about the place."""
            return place + factor * (outline - place)

        self._sightings = {id: replace(s, outline=moved(s.outline))
                           for id, s in self._sightings.items()}
        for id, plane in self._left.items():
            depth, covariance = scaled_about(place, factor, plane.normal, plane.depth,
                                             plane.covariance)
            self._left[id] = replace(plane, depth=depth, covariance=covariance,
                                     outline=moved(plane.outline))

    def observe(self, state: SceneState, extraction: Extraction, ids: list[int]):
        """Note which planes of ``ids`` a key frame shows, and where."""
        seen = {plane.id: plane for plane in extraction.planes if plane.id in ids}
        self._sightings = {id: replace(s, n_macroblocks=0) if s.n_macroblocks else s
                           for id, s in self._sightings.items()
                           if id in state.planes or id in self._left}
        for id, plane in seen.items():
            old = self._sightings.get(id, Sighting(extraction.stamp, extraction.stamp))
            self._seen[id] = extraction.stamp - self._waited
            self._left.pop(id, None)
            self._sightings[id] = Sighting(
                old.first_stamp, extraction.stamp, old.n_observations + 1, plane.n_macroblocks,
                _outline(state, id, old.outline, extraction), plane.is_ground)

    def planes(self, state: SceneState) -> tuple[MapPlane, ...]:
        """Return all planes in {W}: those that the filter holds, then those that it gave up."""
        held = self._map_planes(state)
        return (*(held[id] for id in sorted(held)), *self._left.values())

    def _map_planes(self, state: SceneState) -> dict[int, MapPlane]:
        """Write the planes that the filter holds down in {W}, by their ids."""
        planes, anchors = state.anchored
        normals, depths, covariances = compiled.planes_in_world(
            planes, anchors, state.error.P, state.error.lasting, state.gauge.place,
            state.gauge.covariance)
        return {id: MapPlane(
            id, normals[k], float(depths[k]), covariances[k],
            seen.outline, seen.first_stamp, seen.last_stamp, seen.n_observations,
            seen.n_macroblocks, seen.is_ground)
            for k, (id, seen) in enumerate((id, self._sightings[id]) for id in state.planes)}

    def handover(self, state: SceneState, id: int, stamp: int) -> PlaneHandover:
        """Write a plane down for the obstacle tracker; it starts at rest."""
        anchored = state.planes[id]
        scale = 1 - anchored.plane @ anchored.anchor
        plane = anchored.plane / scale
        J = UNIT / scale + np.outer(anchored.plane, anchored.anchor) / scale**2
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = J @ scene_gauge.covariance(state, id) @ J.T
        covariance[3:, 3:] = scene_gauge.covariance(state, 'velocity') + UNIT
        return PlaneHandover(stamp, id, Label.MOVING, plane, np.zeros(3), covariance)


def _outline(state: SceneState, id: int, old: np.ndarray, extraction: Extraction):
    """Return the convex outline (M, 3) in {W} of a plane's macroblocks and of an older one."""
    anchored, pose = state.planes[id], state.current
    return compiled.plane_outline(
        extraction.x_cur, extraction.plane_id, id, extraction.K,
        np.concatenate([pose.R.ravel(), pose.t]), np.array([anchored.plane, anchored.anchor]),
        old, FARTHEST, CORNERS)
