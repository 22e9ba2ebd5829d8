"""Moving obstacles over time: one filter for each, (14)-(16) of [MVO]."""

from collections.abc import Sequence
import itertools

from mv_slapse.blas import one_thread
from mv_slapse.changed import replace
from mv_slapse.config import ObstacleSettings
from mv_slapse.geometry import two_view
from mv_slapse.geometry.camera import to_rays
from mv_slapse.obstacles import association, footprint, lifecycle, redetection, units
from mv_slapse.obstacles import track as tracks
from mv_slapse.obstacles.detection import detections, from_handover, inside, joined, tiles
from mv_slapse.obstacles.motion_model import CameraStep
from mv_slapse.obstacles.view import relative_motion, View, view_of
from mv_slapse.records import (
    Extraction,
    Label,
    Obstacle,
    PlaneHandover,
    ScalePrior,
    SceneEstimate,
    WITH_POSE,
)
import numpy as np

USED_IDS = 10_000  # remembered, so that none is given twice: half an hour of 5 new ones a second
OWN_IDS = 1_000_000  # ids from here on are given where a plane's id is another track's already
TALLEST = 5.0  # [m] of an obstacle: a lorry of 4 m, seen to a macroblock or so
SAME_DEPTH = 2.0  # times an obstacle's depth, or a share of it, that still is where it was
TENTATIVE_LIFETIME = 0.25  # [s] a track that is not yet confirmed may go without evidence


class ObstacleTracker:
    """Obstacles from the moving planes of successive key frame pairs."""

    def __init__(self, settings: ObstacleSettings):
        """Start without obstacles."""
        self._settings = settings
        self._forget()
        self._used: dict[int, None] = {}  # ids, the newest last
        self._next_id = OWN_IDS

    @one_thread
    def step(self, extraction: Extraction, scene: SceneEstimate,
             handovers: Sequence[PlaneHandover] = ()
             ) -> tuple[list[Obstacle], list[PlaneHandover]]:
        """Move all obstacles to a key frame and correct them by its moving planes.

        Parameters
        ----------
        extraction : Extraction
            Lengths in baselines; the scene's baseline makes them map units. Where that is 0 (the
            camera stands still) they are map units already.
        scene : SceneEstimate
            Of the same key frame.
        handovers : sequence of PlaneHandover
            Planes that the scene filter found moving; the others are ignored.

        Returns
        -------
        obstacles : list of Obstacle
            By id. Planners use those CONFIRMED and COASTING.
        handovers : list of PlaneHandover
            Obstacles that came to a stop, for the scene filter.
        """
        if self._scene is not None and extraction.stamp <= self._scene.stamp:
            if 1e-9 * (self._scene.stamp - extraction.stamp) <= self._settings.lifetime:
                return self._obstacles(self._scene.stamp), []  # the pair is late
            self._forget()  # the clock was set back, as by another recording
        self._tracks = [track for track in self._tracks
                        if not self._expired(track, extraction.previous_stamp)]
        # They come in the unit that the scene's map had before this pair.
        self._waiting.update((item.id, item) for item in handovers
                             if item.to_label is Label.MOVING)
        self._change_unit(scene)
        view = view_of(extraction, scene, self._scene, self._view)
        self._predict(extraction, scene, view)
        self._scene, self._view = scene, view
        if scene.status in WITH_POSE:
            self._place = scene.t_world_from_cam
        owners = {track.plane_id: track for track in self._tracks}
        expected = {track.plane_id: track.box(view) for track in self._tracks}
        found = [body for item in detections(extraction, view, self._settings)
                 for body in footprint.bodies(item, view, self._settings.min_macroblocks)]
        moving = self._joined([item for item in found if item.called], expected, extraction)
        unsure = self._joined([item for item in found if not item.called], {}, extraction)
        free = self._continue(self._of_one(moving), owners, extraction)
        free += self._try(unsure, free, extraction)
        self._search(extraction)
        self._begin(free, extraction)
        self._merge()
        self._take(extraction)
        return self._finish(extraction)

    def _forget(self):
        """Begin anew, with ids that were not given yet."""
        self._tracks: list[tracks.Track] = []
        self._waiting: dict[int, PlaneHandover] = {}
        self._scene: SceneEstimate | None = None
        self._view: View | None = None
        self._place = np.zeros(3)  # position that was published last

    def _change_unit(self, scene):
        """Take all along into another unit of the map; forget what cannot come."""
        unit = 1.0 if self._scene is None else units.last_unit(self._scene, scene)
        if unit is None:
            self._forget()
        elif unit != 1.0:
            for track in self._tracks:
                track.scale(unit)
            self._scene = units.scene_in_unit(self._scene, unit, self._place)
            self._view = self._view.in_unit(unit, self._place)
            self._waiting = {id_: units.handover_in_unit(item, unit, self._place)
                             for id_, item in self._waiting.items()}

    def _predict(self, extraction, scene, view):
        """Move the tracks on; drop those that leave the view."""
        if self._scene is None:
            return
        dt = 1e-9 * (extraction.stamp - self._scene.stamp)
        R, t = view.R_cur_from_prev, view.t_cur_from_prev
        if extraction.previous_stamp != self._scene.stamp:
            R, t = relative_motion(self._scene, scene)
        step = CameraStep(R, t, dt, self._view.scene_velocity, self._view.scene_covariance)
        self._tracks = [track for track in self._tracks
                        if track.predict(step, view, self._settings)]

    def _joined(self, found, expected, extraction):
        """Return the detections of vehicles, of which some show several surfaces."""
        return [joined(group, self._view) for group in association.groups(
            found, self._settings.gate, expected,
            lambda group: self._may_be_one(group, extraction))]

    def _continue(self, found, owners, extraction):
        """Update tracks by their detections; return the detections that have none."""
        pairs = association.associate(self._tracks, found, self._settings.gate)
        parts = {i: [found[j]] for i, j in pairs}
        taken, free = {j for _, j in pairs}, []
        for item in (item for j, item in enumerate(found) if j not in taken):
            home = next((i for i in parts if self._tracks[i].evidence[-1].called
                         and self._tracks[i].contains(item, self._view, self._settings.gate)
                         and owners.get(item.id, self._tracks[i]) is self._tracks[i]
                         and self._may_be_one([*parts[i], item], extraction)), None)
            (free if home is None else parts[home]).append(item)
        for i, group in parts.items():
            self._update(self._tracks[i], joined(group, self._view), extraction)
            self._own(self._tracks[i])
        return free

    def _update(self, track, detection, extraction):
        """Correct a track; one that nobody called moving begins again where none is a body."""
        called = any(e.called for e in track.evidence)
        track.update(detection, extraction, self._view, self._settings)
        if not (called or lifecycle.one_body(track.evidence)):
            track.begin_again(detection, extraction, self._view)

    def _try(self, unsure, free, extraction):
        """Follow what may move before the labels call it so; return what no track is near."""
        waiting = [track for track in self._tracks
                   if not track.confirmed and track.last_seen != extraction.stamp]
        for i, j in association.associate(waiting, unsure, self._settings.gate):
            self._update(waiting[i], unsure[j], extraction)
        places = [track.box(self._view) for track in self._tracks] + [item.box for item in free]
        return [item for item in unsure
                if not any(association.box_overlap(place, item.box) for place in places)]

    def _own(self, owner):
        """Let a plane be of the track that it was seen of last, and of no other one."""
        for track in self._tracks:
            if track is not owner and track.plane_id == owner.plane_id:
                track.plane_id = tracks.NO_PLANE

    def _may_be_one(self, group, extraction):
        """Return whether detections may be surfaces of one vehicle by the ground they cover."""
        return (footprint.may_be_one(joined(group, self._view), self._view)
                and not footprint.stand_apart(group, extraction, self._view))

    def _of_one(self, found):
        """Return detections without those of several obstacles, of none of which they tell."""
        places = [track.box(self._view) for track in self._tracks if track.confirmed]
        return [item for item in found
                if sum(association.covers(item.box, place) for place in places) < 2
                or footprint.may_be_one(item, self._view)]

    def _search(self, extraction):
        """Look for the vectors of confirmed obstacles that the labels do not show."""
        for track in self._tracks:
            if track.confirmed and track.last_seen != extraction.stamp and track.is_moving(
                    self._settings):
                # The last labels may have held a part of it only.
                box = track.body(self._view)
                item = redetection.found(track.mu, track.P, box, extraction, self._view,
                                    self._settings)
                if item is not None:
                    track.x, track.block = tiles(box)
                    track.update(replace(item, id=track.plane_id), extraction, self._view,
                                 self._settings)

    def _merge(self):
        """Let the tracks of one vehicle become one, under the id that is known longest."""
        kept: list[tracks.Track] = []
        order = sorted(self._tracks, key=lambda track: (not track.confirmed, track.first_seen))
        for track in order:
            home = next((other for other in kept if other.contains(
                track, self._view, self._settings.gate)), None)
            if home is None:
                kept.append(track)
            elif track.last_seen > home.last_seen:
                home.continue_as(track)
        self._tracks = kept

    def _begin(self, free, extraction):
        """Start a track for each of the detections that no track has."""
        for detection in free:
            self._tracks.append(tracks.start(detection, extraction, self._view,
                                             self._new_id(detection.id)))
            self._own(self._tracks[-1])

    def _take(self, extraction):
        """Start a track for each plane that the scene filter gave up, once its blocks are seen."""
        for plane_id, item in sorted(self._waiting.items()):
            late = 1e-9 * (extraction.stamp - item.stamp) > self._settings.lifetime
            known = any(track.plane_id == plane_id for track in self._tracks)
            detection = None if late or known else from_handover(item, extraction, self._view,
                                                                 self._settings)
            if detection is not None:
                self._begin([detection], extraction)
            if late or known or detection is not None:
                del self._waiting[plane_id]

    def _finish(self, extraction):
        """Confirm, hand over and expire tracks; return what is left and what is handed over."""
        given = []
        for track in self._tracks:
            track.confirmed = track.confirmed or self._may_drive(track) and lifecycle.confirms(
                track.evidence, self._view.is_metric, self._settings, self._is_alone(track))
            if (track.confirmed and track.plane_id > tracks.NO_PLANE
                    and self._has_stopped(track, extraction)):
                given.append(track)
        handed = [track.handover(extraction.stamp, self._view) for track in given]
        self._tracks = [track for track in self._tracks if track not in given
                        and not self._expired(track, extraction.stamp)]
        self._remember_ids()
        return self._obstacles(extraction.stamp), handed

    def _remember_ids(self):
        """Note which ids are given; those that were not for longest are forgotten."""
        for track in self._tracks:
            self._used.pop(track.id, None)
            self._used[track.id] = None
        while len(self._used) > USED_IDS:
            del self._used[next(iter(self._used))]

    def _may_drive(self, track):
        """Tell whether an obstacle touches the ground, where there is one, and is no building."""
        if self._view.ground is None:
            return True
        return (track.scale_prior is ScalePrior.GROUND_CONTACT
                and track.height(self._view) <= TALLEST * self._view.metre)

    def _is_alone(self, track):
        """Tell whether no confirmed obstacle's outline meets a track's: it is no part of one."""
        box = track.body(self._view)
        return not any(other.confirmed and association.box_overlap(other.body(self._view), box) > 0
                       for other in self._tracks)

    def _has_stopped(self, track, extraction):
        unit = self._view.speed_unit
        if track.last_seen == extraction.stamp:
            return lifecycle.stands_still(track.evidence, unit, self._settings)
        motion = track.motion(self._view)
        sigma = float(np.sqrt(np.trace(motion.covariance[3:, 3:]) / 3))
        return lifecycle.melts_into_scene(float(np.linalg.norm(motion.velocity)), sigma,
                                           _still_share(track, extraction, self._view), unit,
                                           self._settings)

    def _expired(self, track, stamp):
        """Tell whether nobody has seen a track for long; a confirmed one for as long as it was."""
        seen = 1e-9 * (track.last_seen - track.first_seen) if track.confirmed else 0.0
        return 1e-9 * (stamp - track.last_seen) > min(
            max(seen, TENTATIVE_LIFETIME), self._settings.lifetime)

    def _obstacles(self, stamp):
        return [track.obstacle(stamp, self._view)
                for track in sorted(self._tracks, key=lambda track: track.id)]

    def _new_id(self, plane_id):
        """Return the plane's id, or one of the tracker's own where that is taken."""
        new = {track.id for track in self._tracks}
        if plane_id >= 0 and plane_id not in self._used and plane_id not in new:
            return plane_id
        self._next_id = next(i for i in itertools.count(self._next_id + 1)
                             if i not in self._used and i not in new)
        return self._next_id


def _still_share(track, extraction, view):
    """Return the share of the labelled blocks inside a track's box that may stand where it is.

    Of a car that drives as fast as the camera the labels call the blocks stationary, and far off.
    """
    at = np.flatnonzero(inside(extraction.x_cur, track.body(view))
                        & (extraction.label != Label.UNKNOWN.value))
    rays, before = (to_rays(view.K, x[at].astype(float)) for x in (extraction.x_cur,
                                                                   extraction.x_prev))
    rho, per_pixel = two_view.inverse_depth(rays, before, np.diag(view.K)[:2],
                                            view.R_cur_from_prev, view.t_cur_from_prev)
    nearer, noise = np.exp(track.mu[2]) * np.array([rho, 2 * per_pixel * extraction.sigma[at]])
    stands = ((extraction.label[at] == Label.STATIONARY.value)
              & (nearer + noise > 1 / SAME_DEPTH) & (nearer - noise < SAME_DEPTH))
    return float(np.mean(stands)) if len(at) else 0.0
