"""Filter of the camera and the stationary planes: SceneFilter.step, [SLAPSE] VI, [MVO] 5."""

from collections.abc import Sequence

from mv_slapse.blas import one_thread
from mv_slapse.changed import replace
from mv_slapse.config import SceneSettings, USUAL_HEIGHT
from mv_slapse.filters import ekf
from mv_slapse.geometry import rotation
from mv_slapse.geometry.camera import UP
from mv_slapse.geometry.rotation import norm
from mv_slapse.records import Extraction, MotionStatus, PlaneHandover, Speed, TrackingStatus
from mv_slapse.scene import gating as scene_gate
from mv_slapse.scene import gauge as scene_gauge
from mv_slapse.scene import observations as scene_observations
from mv_slapse.scene import plane_map as scene_map
from mv_slapse.scene import record as scene_record
from mv_slapse.scene import state as scene_state
from mv_slapse.scene import update as scene_update
from mv_slapse.scene.noise import Agreement, Dependence
from mv_slapse.scene.observations import Observation
from mv_slapse.scene.progress import Progress, SHORTEST
from mv_slapse.scene.scale import height as scene_height
from mv_slapse.scene.scale import ratio as scene_ratio
from mv_slapse.scene.scale import rest as scene_rest
from mv_slapse.scene.scale import speed as scene_speed
from mv_slapse.scene.scale.ride import Ride
from mv_slapse.scene.scale.speed import SpeedLog, Way
from mv_slapse.scene.state import SceneState
import numpy as np

START = 3.0  # factor on the random walk of the velocity while the camera starts to move
SLOW = 0.1  # share of the highest speed that is guessed where a start shows no known plane
WAITING = ('the ground, whose depth the camera\'s height tells in metres, has not been seen alike '
           f'in {scene_height.ENOUGH} successive pairs yet')
FREE_SIGMA = 100.0  # of a velocity nobody knows yet, in units/s
FIRST_METRIC_SIGMA = 0.1  # of the ground's depth, or the way, in the pair that tells metres


class SceneFilter:
    """Follows the camera's pose and the stationary planes from extraction to extraction.

    Attributes
    ----------
    distances : dict of float
        Squared Mahalanobis distance of each known plane that the last pair showed from its
        prediction, by its id, over the running mean of such (see scene_noise.Agreement):
        chi-square with 3 degrees of freedom where the filter is consistent.
    """

    def __init__(self, settings: SceneSettings):
        """Start before the first key frame."""
        self._settings = settings
        self._state: SceneState | None = None
        self._progress = Progress(0, 0.0)
        self._map = scene_map.SceneMap()
        self.distances: dict[int, float] = {}
        self._ride, self._agreement, self._grounds = Ride(), Agreement(), scene_height.Grounds()
        self._dependence = Dependence(settings.dependence)
        self._speeds = SpeedLog()

    @one_thread
    def step(self, extraction: Extraction, handovers: Sequence[PlaneHandover] = (),
             speeds: Sequence[Speed] = ()):
        """Take in one key frame pair.

        Parameters
        ----------
        extraction : Extraction
            In the order of stamps.
        handovers : sequence of PlaneHandover
            Planes that have come to rest, from the obstacle tracker.
        speeds : sequence of Speed
            Told since the step before, if any: these make the scale metric.

        Returns
        -------
        estimate : SceneEstimate
            Pose, velocity and map at the pair's key frame; ``status`` says how far to trust it.
        handovers : list of PlaneHandover
            Planes of the map that have started to move.
        """
        self._speeds.feed(speeds)
        if self._state is None:
            self._begin(extraction)
        self._speeds.forget(min(self._progress.stamp, extraction.previous_stamp))
        self._map.accept(self._state, handovers)
        leaving = self._map.release(self._state, extraction)
        status, reason = self._advance(extraction)
        if self._is_unscaled and self._progress.waits_for_metres:
            status, reason = TrackingStatus.INITIALISING, WAITING
        self._progress.publish(status, self._state.current.t)
        self._progress.repairs += ekf.repair(self._state.error)
        return scene_record.estimate(self._state, self._map.planes(self._state), extraction.stamp,
                                     status, reason, self._progress), leaving

    def _begin(self, extraction: Extraction):
        """Put {W} at the first key frame."""
        self._state = scene_state.start(UP, FREE_SIGMA, 1.0, 0.07)
        scene_state.sway(self._state, np.inf, self._settings)
        self._progress = Progress(extraction.previous_stamp, self._settings.lost_after)

    def _advance(self, extraction: Extraction):
        """Predict to the key frame and correct; return the tracking status and its reason."""
        status = extraction.motion.status
        follows = self._catch_up(extraction)
        dt, reason = self._progress.elapse(extraction.stamp), extraction.reason
        if dt > self._progress.horizon:
            status = MotionStatus.UNKNOWN
        elif status != MotionStatus.UNKNOWN and (
                self._progress.is_astray or scene_gauge.is_vague(self._state)):
            self._begin_anew()
        if self._progress.metric and status in scene_rest.RESTS and not self._progress.rested:
            self._progress.stop = scene_rest.Stop(extraction.previous_stamp, self._state.velocity)
        if status == MotionStatus.STANDSTILL:
            return self._stand(extraction)
        if status == MotionStatus.ROTATION_ONLY:
            return self._turn(extraction, dt)
        if self._progress.supported is None and status != MotionStatus.MOVING:
            return TrackingStatus.INITIALISING, reason
        if status == MotionStatus.UNKNOWN:
            self._coast(dt, extraction.previous_stamp)
            return self._progress.unsupported(extraction.stamp, reason)
        self._predict(dt)
        return self._correct(extraction, follows)

    @property
    def _is_tied(self) -> bool:
        """Whether more than the map tells lengths: metres, or a height that stays."""
        return self._progress.metric or self._ride.height > 0

    @property
    def _is_unscaled(self) -> bool:
        """Whether a camera height is given that has told no metres yet."""
        return self._settings.camera_height > 0 and not self._progress.metric

    def _catch_up(self, extraction: Extraction) -> bool:
        """Predict through pairs that never came; return whether there was none.

        A pair relates its own two key frames: the earlier one must be the filter's last.
        """
        gap = (extraction.previous_stamp - self._progress.stamp) * 1e-9
        if gap <= SHORTEST:
            return True
        start, self._progress.stamp = self._progress.stamp, extraction.previous_stamp
        if self._progress.supported is not None:
            self._coast(gap, start)
        return False

    def _begin_anew(self):
        """Begin a new local frame where the heading has been lost: no plane's place is known."""
        for id in list(self._state.planes):
            self._map.leave(self._state, id)
        scene_gauge.begin_anew(self._state, self._is_tied)
        self._progress.anew = self._progress.started
        self._progress.resets += self._progress.started
        self._progress.blind = 0.0

    def _stand(self, extraction: Extraction):
        """Zero-velocity update: the pose stays exactly as it is, so nothing drifts."""
        state = self._state
        state.previous = state.current.copy()
        if self._progress.started:
            scene_state.halt(state, np.zeros(3), np.eye(3) * 1e-4)
            prev, cur = state.at('previous'), state.at('current')
            state.error.P[prev, :] = state.error.P[cur, :]
            state.error.P[:, prev] = state.error.P[:, cur]
            state.error.lasting[prev] = state.error.lasting[cur]
        return self._rested(extraction, scene_rest.STANDING)

    def _rested(self, extraction: Extraction, reason: str):
        """Note that the camera has not moved; planes out of view do not age meanwhile.

        Depths that have contradicted the length predicted until now tell none after the rest.
        """
        progress = self._progress
        progress.rested = progress.started
        progress.carried &= not progress.refused
        progress.see(extraction.stamp)
        self._map.wait(extraction.stamp - extraction.previous_stamp)
        way = self._way(extraction.previous_stamp, 0.0)
        progress.stop, doubt = scene_rest.doubt(progress.stop, extraction, self._state,
                                                way.length if way else 0.0, self._settings)
        return (TrackingStatus.PREDICTED, doubt) if doubt else (TrackingStatus.OK, reason)

    def _turn(self, extraction: Extraction, dt: float):
        """Turn a camera that stays where it is, but for a pixel of the nearest plane."""
        motion, started = extraction.motion, self._progress.started
        focal = extraction.K[0, 0]
        noise = motion.covariance[:3, :3] * self._dependence.value + np.eye(3) * (
            self._settings.vector_bias / focal)**2
        scene_state.turn_on_the_spot(
            self._state, motion.R_cur_from_prev, noise,
            started * scene_rest.reach(self._state) / focal, self._settings.focal_sigma)
        if not started:
            return TrackingStatus.INITIALISING, scene_rest.TURNING
        scene_state.halt(self._state, -rotation.log(motion.R_cur_from_prev) / dt, noise / dt**2)
        view = 2 * np.arctan(0.5 * extraction.width / focal)
        scene_ratio.turn(self._state, rotation.angle(motion.R_cur_from_prev) / view,
                         self._progress.metric)
        return self._rested(extraction, scene_rest.TURNING)

    def _predict(self, dt: float):
        """Move the camera at constant velocity; the planes change along the way."""
        settings, state = self._settings, self._state
        speed = norm(state.velocity)
        density = (settings.acceleration if self._progress.metric
                   else self._progress.free_acceleration(speed, settings.free_acceleration))
        # Between two key frames a start is no random walk.
        density *= START if self._progress.rested else 1.0
        scene_state.propagate(state, dt, density, settings.angular_acceleration,
                              settings.turn_rate)
        scene_state.sway(state, dt, settings)
        if self._is_tied:
            # Where nothing else carries the scale the planes do, and stay as they are.
            scene_state.renew(state, settings.relief)
        ground = self._map.ground
        if ground in state.planes:
            # The road bends below the vehicle, so about its place; the usual height of a camera
            # tells metres where the scale is free.
            scene_state.move_anchor(state, ground, state.previous.t)
            height = 1 / norm(state.planes[ground].plane)
            metres = speed * dt * (1.0 if self._progress.metric else USUAL_HEIGHT / height)
            scene_state.bend(state, ground, settings.ground_slope * np.sqrt(metres))

    def _coast(self, dt: float, start: int):
        """Move on from a stamp without a view, but no farther than a prediction says something.

        A mounted camera stays upright, a speed counts. A very long step may be the clock's.
        """
        left, place = self._progress.horizon - self._progress.blind, self._state.current.t
        self._progress.blind += dt
        if left <= 0:
            return
        self._predict(min(dt, left))
        self._progress.carried = False
        ground, turn = self._map.ground, norm(self._state.omega) * min(dt, left)
        way = self._way(start, turn) if self._progress.metric else None
        observations = self._rigid(ground) if ground in self._state.planes else []
        observations += [scene_speed.observed(way, self._settings)] if way else []
        if observations and self._state.velocity.any():
            self._state = scene_update.observe(self._state, observations, self._settings)
        if dt > self._settings.lost_after:
            scene_state.doubt_way(self._state, place)
        if dt > left:
            self._state.current.t = place

    def _way(self, start: int, turn: float) -> Way | None:
        """Return the way [m] since a stamp by the speeds given, if they tell one that can be."""
        return scene_speed.way(self._speeds, self._state, self._progress, start, turn,
                               self._settings)

    def _correct(self, extraction: Extraction, follows: bool):
        """Update with the pair's correspondences and with what is known of the scale."""
        first = not self._progress.started or self._progress.anew
        turn = rotation.angle(extraction.motion.R_cur_from_prev)
        way = self._way(extraction.previous_stamp, turn)
        self._ride = self._ride.kept(self._state, extraction.motion)
        self._progress.anew, baseline = False, self._baseline(extraction, way)
        pair, plane_id = scene_update.stationary(extraction)
        self._dependence = self._dependence.seen(pair, extraction.motion.R_cur_from_prev,
                                                 extraction.motion.t_cur_from_prev)
        settings = self._dependence.settings(self._settings, extraction.label)
        shown = scene_update.shown(self._state.previous, extraction.motion, baseline)
        expected = replace(self._state, current=shown) if self._progress.rested else self._state
        known = self._known(scene_gate.distances(expected, extraction, settings))
        trusted = scene_gate.trusted(self._state, extraction, known, self._progress.misses)
        ground = scene_gate.ground_of(extraction, trusted)
        ids = self._map.join(self._state, extraction, known, trusted, baseline, shown)
        index = np.full(len(pair), -1)
        for i, id in enumerate(ids):
            index[plane_id == id] = i
        depths = scene_ratio.depths_of(pair, extraction.motion, settings)
        follows &= self._progress.carried and bool(np.isfinite(extraction.baseline_ratio_sigma))
        rigid = self._rigid(ground)
        if rigid and follows:
            scene_ratio.doubt(self._state, scene_ratio.ABOVE_GROUND)
        elif follows and not self._progress.metric:
            scene_ratio.doubt_for_good(self._state, scene_ratio.sampling(extraction, settings))
        ratio = (scene_ratio.told(self._state, extraction, depths, settings, self._progress.rested,
                                  bool(known)) if follows else [])
        if ratio:  # braking hard, a step from the length predicted would go beyond zero
            shown = scene_update.shown(self._state.previous, extraction.motion,
                                      float(np.exp(self._state.depth_scale)))
        start = self._state.error_to(replace(self._state, current=shown))
        gauge = self._gauge(baseline, first, way, bool(known or ratio))
        observations = [*rigid, *gauge, *ratio]
        self._state = scene_update.update(
            self._state, start, pair, (index, ids), settings, observations)
        if self._progress.gives_depths_up(follows, bool(ratio)):
            self._progress.carried = scene_ratio.begin(self._state, depths, settings.ratio_sigma)
        if first or self._progress.rested:
            scene_state.doubt_speed(self._state)
            self._progress.going = self._progress.interval
        # Not the speed now: what comes to rest could hardly start again, the scale would shrink.
        self._progress.fastest = max(norm(self._state.velocity), self._progress.fastest)
        if ground is not None and not settings.camera_height:
            self._ride = self._ride.seen(self._state, ground)
        self._map.observe(self._state, extraction, ids)
        self._forget(extraction.stamp)
        if first or known or (ratio or way) and not self.distances:
            self._progress.see(extraction.stamp)
            self._progress.rested, self._progress.started = False, True
            return TrackingStatus.OK, ''
        return self._progress.unsupported(
            extraction.stamp, scene_gate.CONTRADICTED if self.distances else scene_gate.SCALELESS)

    def _known(self, distances: dict[int, float]) -> set[int]:
        """Return the planes that are where they were predicted, by their squared distances."""
        self.distances = {id: squared / self._agreement.scale for id, squared in distances.items()}
        self._agreement = self._agreement.seen(distances.values())
        return {id for id, squared in self.distances.items() if squared < self._settings.gate}

    def _baseline(self, extraction: Extraction, way: Way | None) -> float:
        """Return the best guess of the distance between the pair's key frames [map unit]."""
        settings, progress = self._settings, self._progress
        guess = norm(self._state.current.t - self._state.previous.t)
        if way:
            if not progress.metric:
                self._make_metric(way.length / max(guess, 1e-9), scene_speed.SOURCE)
            return way.length
        if progress.rested:
            slow = max(guess, SLOW * progress.fastest * progress.interval)
            again = progress.carried and scene_ratio.baseline(self._state, extraction)
            return again or slow
        if not progress.started or guess < 1e-9:
            supposed = scene_rest.supposed_baseline(extraction, settings.camera_height)
            scene_gauge.doubt_scale(self._state, scene_rest.SUPPOSED_SIGMA if supposed else 0.0)
            guess = supposed or 1.0
        by_height = self._is_unscaled or progress.source == scene_height.SOURCE
        return guess * self._metres(extraction, guess) if by_height else guess

    def _metres(self, extraction: Extraction, guess: float) -> float:
        """Return by what lengths grow where grounds agree at last on what a metre is, else 1.

        A pair's ratio to the one before tells its way [map unit]; the first one is the unit.
        Metres, by which a way is predicted, grow where they are wrong in bulk, and only once the
        ground has contradicted them for long.
        """
        progress, ground, length = self._progress, scene_gate.ground_seen(extraction), guess
        if progress.started and not progress.metric:
            length = progress.carried and scene_ratio.baseline(self._state, extraction)
        if not length or ground is None:
            return 1.0
        if progress.waits_for_metres:  # others have to confirm what this ground tells
            progress.told = progress.age
        self._grounds = self._grounds.seen(ground, length, self._settings)
        if progress.metric and not scene_gate.outlasts(progress.misses, ground.id):
            return 1.0
        if (metres := self._grounds.metres(scene_height.GROSS * progress.metric)) is None:
            return 1.0
        if self._map.ground in self._state.planes:  # It may be one that they contradict.
            self._map.leave(self._state, self._map.ground)
        self._make_metric(metres, scene_height.SOURCE)
        return metres

    def _make_metric(self, factor: float, source: str):
        """Make lengths metres by a factor, which compares one pair with its prediction.

        What was published last stays where it is: odometry is continuous. A height that was
        learned in the unit before would carry the factor's error on: it is learned anew.
        """
        if self._progress.started:
            place = self._progress.place
            scene_state.rescale_about(self._state, place, factor, FIRST_METRIC_SIGMA)
            self._progress.fastest *= factor
            self._progress.unit *= factor
            self._map.scale(factor, place)
            self._ride = self._ride.released(self._state)
        scene_gauge.doubt_scale(self._state, 0.0)
        self._progress.source = source

    def _gauge(self, baseline: float, first: bool, way: Way | None,
               told: bool) -> list[Observation]:
        """Return the length of the first baseline, which is the unit, or the guess after a rest.

        Or of any by its speed. Where nothing has told one it stays about as predicted: directions
        alone, which err, would draw it toward zero. Predicted from rest a baseline is zero, about
        which its direction would mean nothing.
        """
        progress = self._progress
        if way:
            return [scene_speed.observed(way, self._settings)]
        if first or progress.rested:
            sigma = scene_gauge.UNKNOWN_SCALE if progress.rested or self._is_tied else 1e-3
        elif told:
            return []
        else:
            sigma = scene_speed.UNTOLD_SIGMA
        return [scene_observations.baseline(baseline, sigma)]

    def _rigid(self, ground: int | None) -> list[Observation]:
        """Return what is known of a mounted camera."""
        told = ground is not None and not self._is_unscaled
        return self._ride.observations(ground, self._settings) if told else []

    def _forget(self, stamp: int):
        """Marginalise planes out that have had no support for long, unless they may return."""
        for id in self._map.overdue(self._state, stamp, self._settings.plane_lifetime * 1e9):
            self._map.leave(self._state, id)
