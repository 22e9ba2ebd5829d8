"""Planes, camera motion and labels of each key frame pair, [MVO] 4: PlaneExtractor.extract."""

import itertools
from typing import NamedTuple

from mv_slapse.blas import one_thread
from mv_slapse.changed import replace
from mv_slapse.config import ExtractionSettings, USUAL_HEIGHT
from mv_slapse.extraction import coarse
from mv_slapse.extraction.pair_estimate import Found, labels, observations
from mv_slapse.extraction.state import Memory
from mv_slapse.geometry import rotation, two_view
from mv_slapse.geometry.camera import Camera, undistort
from mv_slapse.motion import estimate, planar_ambiguity, status
from mv_slapse.motion import observations as block_observations
from mv_slapse.motion.estimate import MotionFit, refined_from
from mv_slapse.motion.observations import BlockObservations, Depths
from mv_slapse.movers import possibly_dynamic, regions
from mv_slapse.movers.mask import Silhouettes
from mv_slapse.movers.reference_depth import departure, depths_of
from mv_slapse.records import CameraMotion, Correspondences, Extraction, Label, MotionStatus
from mv_slapse.strip_matches import StripMatches
from mv_slapse.surfaces import ground, joint, plane_search
from mv_slapse.surfaces.block_map import BaselineRatio, BlockMap
from mv_slapse.surfaces.ground import GroundPrior, GroundTrack, Mount, Ride
from mv_slapse.surfaces.plane_search import PlaneFit
from mv_slapse.surfaces.plane_track import KnownPlanes
import numpy as np

# Mean robust cost up to which the last motion explains a pair as well as five points would: about
# half of the blocks are within a standard deviation.
PREDICTED_COST = 0.5
MANY_MOVERS = 0.9  # share of blocks left below which the motion is estimated anew without them
STEPS = 1.0  # px by which vectors of half a pixel jump before a camera that has no baseline


def _ideal(strips: StripMatches, camera: Camera) -> StripMatches:
    """Return strips without the lens' distortion."""
    return replace(strips, x_cur=undistort(camera, strips.x_cur),
                   x_earlier=undistort(camera, strips.x_earlier))


class Told(NamedTuple):
    """What the map tells of a pair: depths of its blocks (N, 3), length [map unit], ratio."""

    known: np.ndarray
    length: float
    ratio: BaselineRatio


class PlaneExtractor:
    """Turns correspondences into camera motion, labelled planes and labelled macroblocks."""

    def __init__(self, camera: Camera, settings: ExtractionSettings, camera_height: float = 0.0):
        """Start without memory of any plane; the camera's height is in metres, 0: unknown."""
        self._camera = camera
        self._camera_height = camera_height or USUAL_HEIGHT
        self._settings = settings
        self._memory = Memory(ground=GroundTrack(Mount(
            spread=settings.ground_tilt, widest=settings.ground_tilt)))
        self._movers = regions.Memory()
        self._silhouettes = Silhouettes()
        self._draws = np.random.default_rng(settings.seed).random((settings.trials, 10))

    @one_thread
    def extract(self, correspondences: Correspondences) -> Extraction:
        """Extract what one key frame pair shows; figure 1 of [MVO], top.

        Returns an Extraction whose motion status is UNKNOWN, with a reason, where the pair is
        broken or no motion explains enough of its vectors.
        """
        factor = coarse.factor_of(correspondences.width, correspondences.height,
                                  self._settings.max_blocks)
        if factor == 1:
            return self._extracted(correspondences, self._camera)
        found = self._extracted(coarse.correspondences_of(correspondences, factor),
                                coarse.camera_of(self._camera, factor))
        return coarse.extraction_of(found, factor, correspondences, self._camera.K)

    def _extracted(self, correspondences: Correspondences, camera: Camera) -> Extraction:
        """Extract what a pair shows that a camera has taken."""
        whole = self._blank(correspondences, camera)
        scene = status.scene(whole, correspondences.x_cur, self._settings)
        shown, rows = self._shown(status.only(whole, scene), correspondences.lone[scene],
                                  correspondences.reason, _ideal(correspondences.strips, camera))
        return self._silhouettes.fill(status.scattered(whole, shown, scene[rows]), correspondences)

    def _shown(self, whole: Extraction, lone: np.ndarray, reason: str, strips: StripMatches):
        """Return what a pair shows, and the rows of the whole that it made use of."""
        settings, (rows,) = self._settings, (~lone).nonzero()
        reason = reason or status.too_few(len(rows))
        if reason:
            return self._unknown(status.only(whole, rows), reason), rows
        pair = status.pair(whole)
        supported = pair[rows]
        if status.stands_still(whole, rows, settings.standstill_share):
            return self._standing(status.only(whole, rows)), rows
        fit, free = self._first_motion(whole, supported)
        noise = estimate.calibrated(supported, fit, self._memory.noise)
        pair = replace(pair, sigma=noise * pair.sigma)
        seen = self._observed(pair, fit)
        if np.count_nonzero(seen.epipolar_inlier[rows]) < settings.min_inliers * len(rows):
            return self._unknown(status.only(whole, rows), status.disagreement(seen[rows])), rows
        known = self._map(whole).known(pair, (whole.width, whole.height))
        inlier = rows[seen.epipolar_inlier[rows]]
        if block_observations.may_turn(seen.parallax[inlier], settings.epsilon_m):
            turned = self._turned(status.only(whole, rows), seen[rows], known[rows], fit)
            if turned is not None:
                return turned, rows
        fit, length, ratio = self._map(whole).measured(
            pair[rows[free]], known.take(rows[free], 0), fit, whole.stamp)
        seen = self._observed(pair, fit)
        floor, road = self._survey(whole, seen, lone, fit, ratio)
        left = np.ones(len(whole.x_cur), bool)  # what no mover held, lone blocks too
        left[rows] = free
        rows, = (~lone | road).nonzero()
        blank, evidence = status.only(whole, rows), seen[rows]
        pair = evidence.pair
        told = Told(known.take(rows, 0), length, ratio)
        found = self._named(Found(fit, evidence, self._planes(
            blank, Found(fit, evidence, []), told, floor, (left[rows], road[rows]))))
        found = self._moving(blank, pair, found, floor, ratio, strips)
        found = self._refined(pair, found, floor)
        blank = replace(blank, baseline_ratio=ratio.log, baseline_ratio_sigma=ratio.sigma)
        shown = self._finished(blank, pair, found, noise, floor)
        self._remember_map(shown, found, told)
        return shown, rows

    def _map(self, whole: Extraction) -> BlockMap:
        """Return the map in the earlier camera of a pair."""
        return self._memory.map.at(whole.previous_stamp)

    def _unknown(self, whole: Extraction, reason: str) -> Extraction:
        """Return a pair whose motion is unknown; the map goes on as before."""
        self._memory = replace(self._memory, map=self._map(whole).coasted(
            whole.stamp, whole.K, (whole.width, whole.height)))
        return replace(whole, reason=reason)

    def _remember_map(self, shown: Extraction, found: Found, told: Told):
        """Correct the map by the blocks (N,) that stand still."""
        motion, still = shown.motion, (shown.label != Label.MOVING.value) & ~found.doubtful
        carried = self._map(shown).moved(
            shown.stamp, (motion.R_cur_from_prev, told.length * motion.t_cur_from_prev),
            found.evidence.pair[still], told.known[still], (shown.width, shown.height))
        self._memory = replace(self._memory, map=replace(carried, length=told.length))

    def _blank(self, correspondences: Correspondences, camera: Camera) -> Extraction:
        """Return an extraction that knows nothing yet but undistorted pixels.

        Columns are rounded to float32 as messages hold them.
        """
        n = len(correspondences)
        return Extraction(
            correspondences.stamp, correspondences.previous_stamp, correspondences.width,
            correspondences.height, correspondences.kind, camera.K,
            CameraMotion(MotionStatus.UNKNOWN),
            x_cur=undistort(camera, correspondences.x_cur).astype(np.float32),
            x_prev=undistort(camera, correspondences.x_prev).astype(np.float32),
            sigma=correspondences.sigma, block=correspondences.block,
            label=np.full(n, Label.UNKNOWN.value, np.int8), plane_id=np.full(n, -1, np.int32))

    def _standing(self, blank: Extraction) -> Extraction:
        """Label a key frame pair of a camera that stands still."""
        still = np.linalg.norm(blank.x_cur - blank.x_prev, axis=1) < STEPS
        self._memory = replace(self._memory, stamp=blank.stamp, previous_stamp=None, movers=None,
                               map=self._map(blank).rested(blank.stamp))
        motion = CameraMotion(MotionStatus.STANDSTILL, covariance=np.diag([1e-8] * 3 + [0.0] * 3))
        return self._without_baseline(blank, motion, still)

    def _observed(self, pair: two_view.Pair, fit: MotionFit) -> BlockObservations:
        """Return what the blocks of a pair say under a motion."""
        settings = self._settings
        return block_observations.observe(pair, fit, settings.epsilon_f, settings.epsilon_m,
                                          settings.relief)

    def _turned(self, whole: Extraction, seen: BlockObservations, known: np.ndarray,
                fit: MotionFit) -> Extraction | None:
        """Label the supported rows of a camera that turns on the spot; None where it moves."""
        settings, pair = self._settings, seen.pair
        R, covariance, off = estimate.turn(pair, fit.R_cur_from_prev)
        pixels = off * pair.sigma
        if not block_observations.turns_only(pixels, seen.rho, settings.epsilon_m):
            return None
        carried = self._map(whole)
        way = carried.turning(pair, known, R)
        self._memory = replace(self._memory.turned(whole.stamp, R), map=carried.moved(
            whole.stamp, (way.R, way.t) if way else (R, np.zeros(3)), pair, known,
            (whole.width, whole.height)))
        motion = CameraMotion(MotionStatus.ROTATION_ONLY, R, covariance=covariance)
        blank = replace(whole, sigma=pair.sigma.astype(np.float32))
        return self._without_baseline(blank, motion, (off < settings.epsilon_f) | (pixels < STEPS))

    def _without_baseline(self, blank: Extraction, motion: CameraMotion, still) -> Extraction:
        """Label blocks (N,) that stay where they were: what moves then moves itself.

        Without a baseline there is no unit of length: moving planes have a prior's.
        """
        label = np.where(still, Label.STATIONARY, Label.UNKNOWN).astype(np.int8)
        ground = regions.KnownGround(level=self._memory.ground.mount.normal,
                                     camera_height=self._camera_height)
        shown, self._movers = regions.with_moving_planes(
            replace(blank, label=label, motion=motion), self._movers,
            self._settings.moving_score, ground)
        return shown

    def _motion(self, pair: two_view.Pair) -> MotionFit:
        """Estimate the motion from the last one or, where that fails, five points, [MVO] 4.1."""
        last, predicted, others = self._memory.motion, None, []
        if last is not None:
            predicted = refined_from(pair, last.R_cur_from_prev, last.t_cur_from_prev)
        if predicted is None or predicted.cost > PREDICTED_COST:
            starts = estimate.from_essential_matrix(
                pair.rays_cur, pair.rays_prev, 0.7 / pair.K[0, 0])[:1]
            starts = starts or [(np.eye(3), np.array([0.0, 0.0, -1.0]))] * (predicted is None)
            others = [refined_from(pair, *start) for start in starts]
        return planar_ambiguity.unfolded(pair, planar_ambiguity.likeliest(pair, predicted, others))

    def _first_motion(self, whole: Extraction, pair: two_view.Pair):
        """Estimate the motion without what was a mover, and what must be one by the ground.

        Also returns the blocks (N,) bool of the pair that are left.
        """
        memory = self._memory
        follows = memory.stamp == whole.previous_stamp
        held = possibly_dynamic.taken(memory.movers if follows else None, pair.x_prev)
        free = possibly_dynamic.without(held)
        fit = self._motion(pair[free])
        if follows and memory.ground.plane is not None:
            prior = self._ground_prior(whole, fit, BaselineRatio())
            free = possibly_dynamic.without(held | self._below(pair, fit, prior))
            if np.count_nonzero(free) < MANY_MOVERS * len(free):
                fit = refined_from(pair[free], fit.R_cur_from_prev, fit.t_cur_from_prev)
        return fit, free

    def _below(self, pair, fit: MotionFit, prior: GroundPrior) -> np.ndarray:
        """Return the blocks (N,) bool below the ground that is expected, none: too unsure."""
        if prior.spread > ground.FORGOTTEN:
            return np.zeros(len(pair), bool)
        rho, per_pixel = two_view.inverse_depth(pair.rays_cur, pair.rays_prev, pair.focal,
                                                fit.R_cur_from_prev, fit.t_cur_from_prev)
        return possibly_dynamic.below(pair.rays_cur, rho, per_pixel * pair.sigma,
                                      prior.normal * prior.inverse_depth, prior.spread)

    def _planes(self, blank, begun: Found, told: Told, prior: GroundPrior,
                blocks: tuple[np.ndarray, np.ndarray]) -> list[PlaneFit]:
        """Find the ground, known planes and new ones, among ``blocks`` (free ones, road) (N,)."""
        evidence, (free, road) = begun.evidence, blocks
        pair = evidence.pair
        depths = Depths(pair.rays_cur, evidence.rho, evidence.sigma_rho, blank.x_cur)
        free = free & evidence.has_depth
        found = []
        floor = ground.find_ground(depths, free, prior, self._settings, self._draws, road)
        if floor is not None:
            found.append(replace(floor, id=self._memory.ground.id))
            free = free & ~floor.member
        known = self._known(blank, begun.fit, told.ratio)
        depths = replace(depths, sigma=evidence.blur)
        if np.isfinite(told.ratio.sigma):
            depths = self._map(blank).joined(pair, told.known, begun.fit, told.length, depths)
        walls, known = plane_search.stationary_planes(
            depths, free, known,
            prior.normal if floor is None else floor.plane / rotation.norm(floor.plane),
            self._settings, (self._settings.max_planes - len(found), self._memory.next_id))
        newest = int(known.id.max(initial=-1))
        self._memory = replace(
            self._memory, planes=known, next_id=max(self._memory.next_id, newest + 1))
        return found + walls

    def _known(self, blank, fit: MotionFit, ratio) -> KnownPlanes:
        """Predict the planes of the last pair; none where this pair does not follow it."""
        memory = self._memory
        if memory.stamp != blank.previous_stamp:
            return KnownPlanes.none()
        return memory.planes.predicted(fit.R_cur_from_prev, fit.t_cur_from_prev,
                                       *memory.log_ratio(blank, ratio))

    def _moving(self, blank, pair, found: Found, prior: GroundPrior, ratio,
                strips: StripMatches) -> Found:
        """Find what moves by itself, and take it out of the stationary planes."""
        label, plane_id = labels(found)
        id_, seen = next(((plane.id, plane.plane) for plane in found.planes if plane.is_ground),
                         (-1, None))
        floor, nearer = ground.for_movers(seen, prior, self._memory.height)
        rides, fit = self._memory.ground.mount.rides, found.fit
        motion = CameraMotion(MotionStatus.MOVING, fit.R_cur_from_prev, fit.t_cur_from_prev)
        shown = replace(blank, motion=motion, label=label, plane_id=plane_id,
                        sigma=pair.sigma.astype(np.float32))
        self._memory = replace(self._memory, past=self._memory.past_at(blank, fit, ratio))
        level = gone = None
        if rides:
            level, gone = prior.normal, departure(
                self._memory.past, blank,
                depths_of(pair, blank, found.evidence, found.evidence.has_depth), floor)
        known = regions.KnownGround(floor if rides else None, level, nearer, self._camera_height,
                                    id_)
        shown, self._movers = regions.with_moving_planes(
            shown, self._movers, self._settings.moving_score, known, gone, strips)
        still = shown.label != Label.MOVING.value
        planes = [replace(plane, member=plane.member & still) for plane in found.planes
                  if plane.is_ground or 2 * still[plane.member].sum() > plane.member.sum()]
        lost = {plane.id for plane in found.planes} - {plane.id for plane in planes}
        if lost:
            known = self._memory.planes
            self._memory = replace(self._memory, planes=known[~np.isin(known.id, list(lost))])
        evidence = found.evidence
        unsure = possibly_dynamic.like_movers(shown, evidence.parallax)
        if seen is not None:
            unsure |= possibly_dynamic.below(pair.rays_cur, evidence.rho, evidence.blur, seen)
        return replace(found, planes=planes, moving=shown, doubtful=unsure)

    def _ground_prior(self, blank, fit: MotionFit, ratio) -> GroundPrior:
        """Predict the ground; with unknown baseline ratio at an unchanged speed."""
        log, sigma = self._memory.log_ratio(blank, ratio)
        return self._memory.ground.prior(fit.R_cur_from_prev, fit.t_cur_from_prev, log, sigma,
                                         self._settings.ground_wobble)

    def _survey(self, whole, evidence, lone, fit: MotionFit, ratio):
        """Predict the ground, and tell which lone blocks (N,) bool lie on it."""
        memory = self._memory
        # What flies has no way on the ground.
        turn = rotation.angle(fit.R_cur_from_prev) if memory.ground.mount.rides else 0.0
        ride = Ride(ground.course_of(fit.t_cur_from_prev), turn, self._settings.epsilon_h)
        belief, prior, road = ground.survey(
            evidence, whole.x_cur, lone, self._ground_prior(whole, fit, ratio),
            memory.height.moved(*memory.log_ratio(whole, ratio)), ride)
        self._memory = replace(memory, height=belief)
        return prior, road

    def _refined(self, pair, found: Found, prior: GroundPrior) -> Found:
        """Re-estimate motion and planes together, (10), and judge the blocks again."""
        settings, fit, planes = self._settings, found.fit, found.planes
        index = np.full(len(pair), -1)
        for i, plane in enumerate(planes):
            index[plane.member] = i
        stationary = found.evidence.epipolar_inlier & ~found.evidence.backward
        stationary &= (found.moving.label != Label.MOVING.value) & ~found.doubtful
        index[~stationary] = joint.LEFT_OUT
        R, t, values, covariance = joint.reestimate(
            pair, (fit.R_cur_from_prev, fit.t_cur_from_prev, [plane.plane for plane in planes]),
            index, settings.relief,
            expected=[(i, *prior.upright(plane.plane)) for i, plane in enumerate(planes)
                      if plane.is_ground and plane.member.sum() < settings.min_macroblocks])
        fit = replace(fit, R_cur_from_prev=R, t_cur_from_prev=t, covariance=covariance[:6, :6])
        planes = [replace(plane, plane=value,
                          covariance=covariance[6 + 3 * i:9 + 3 * i, 6 + 3 * i:9 + 3 * i])
                  for i, (plane, value) in enumerate(zip(planes, values, strict=True))]
        # What leans over once no prior holds it was not well seen, nor what many pairs contradict.
        mount, height = self._memory.ground.mount, self._memory.height
        planes = [plane for plane in planes if not plane.is_ground or (
            mount.holds(plane.plane) and height.allows(plane.plane))]
        return Found(fit, self._observed(pair, fit), planes, found.moving, found.doubtful)

    def _finished(self, blank, pair, found: Found, noise, prior) -> Extraction:
        """Write labels and planes down and keep what the next pair needs."""
        label, plane_id = labels(found)
        seen = (*observations(blank.x_cur, found), *found.moving.planes)
        self._remember(blank, pair, found, seen, noise, prior)
        fit = found.fit
        motion = CameraMotion(MotionStatus.MOVING, fit.R_cur_from_prev, fit.t_cur_from_prev,
                              fit.covariance, bool(fit.t_cur_from_prev[2] < 0))
        return replace(blank, motion=motion, planes=seen, label=label,
                       plane_id=plane_id, sigma=pair.sigma.astype(np.float32))

    def _named(self, found: Found) -> Found:
        """Give an id to every plane that has none."""
        ids = itertools.count(self._memory.next_id)
        planes = [plane if plane.id >= 0 else replace(plane, id=next(ids))
                  for plane in found.planes]
        self._memory = replace(self._memory, next_id=next(ids))
        return replace(found, planes=planes)

    def _remember(self, blank, pair, found: Found, observations, noise, prior):
        """Keep motion, labels, ground and depths for the next pair."""
        floor = next((plane for plane in observations if plane.is_ground), None)
        track = self._memory.ground
        track = replace(track, mount=track.mount.learned(found.fit.t_cur_from_prev,
                                                         self._settings.ground_wobble))
        track = (track.missed(prior) if floor is None
                 else track.seen(floor.id, floor.plane, floor.covariance))
        evidence = found.evidence
        still = evidence.has_depth & (found.moving.label != Label.MOVING.value) & ~found.doubtful
        self._memory = Memory(
            blank.stamp, found.fit, blank.previous_stamp, track, noise, self._memory.next_id,
            self._memory.planes, possibly_dynamic.painted(found.moving), self._memory.height,
            self._memory.past.noted(blank.stamp, depths_of(pair, blank, evidence, still)),
            self._memory.map)
