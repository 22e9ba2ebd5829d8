"""The rules of the core that can be switched off, one at a time: a table for ``ablation.py``.

A rule is switched off by neutral functions in place of some of the core's, by other values of
constants, or by settings. ``mv_slapse.a.b:name`` is the name ``name`` of the module
``mv_slapse.a.b``, ``mv_slapse.a.b:Class.name`` a method. A function is replaced wherever it was
imported.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
import inspect
import sys
from typing import Any

from mv_slapse.tools import rows
import numpy as np


@dataclass(frozen=True)
class Rule:
    """A rule of the core.

    Attributes
    ----------
    name, what : str
        What it does in one sentence.
    off : dict of str to anything
        By the place of what is replaced: a function of the original that returns what takes its
        place.
    settings : dict of str to anything
        By the name of a setting (``scene.iterations``): its value.
    """

    name: str
    what: str
    off: dict[str, Callable[[Any], Any]] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def content(self) -> str:
        """How it is switched off, as text: what was measured otherwise is measured anew."""
        return str([(path, _text(new)) for path, new in self.off.items()]) + str(self.settings)


def place(path: str) -> tuple[Any, str]:
    """Return the module or class that holds a name, and that name."""
    module, _, name = path.partition(':')
    *holders, name = name.split('.')
    holder = import_module(module)
    for part in holders:
        holder = getattr(holder, part)
    return holder, name


def switch_off(name: str):
    """Switch a rule off in this process, for good."""
    rule = BY_NAME[name]
    for path, new in rule.off.items():
        holder, attribute = place(path)
        old = inspect.getattr_static(holder, attribute)
        value = new(old)
        setattr(holder, attribute, value)
        if inspect.isfunction(old) and inspect.ismodule(holder):
            for module in [module for name, module in sys.modules.items()
                           if name.startswith('mv_slapse')]:
                for known in [known for known, item in vars(module).items() if item is old]:
                    setattr(module, known, value)
    rows.measure = partial(_measured_or_failed, rows.measure)
    if rule.settings:
        rows.settings_of = partial(with_settings, rows.settings_of, rule.settings)


def _measured_or_failed(measure: Callable, *args: Any) -> dict[str, Any]:
    """Return the figures of a row; without a rule the core may fail in any way."""
    try:
        return measure(*args)
    except Exception as error:
        return {'error': repr(error)}


def with_settings(make: Callable, values: dict[str, Any], case: Any) -> Any:
    """Return the settings that a function makes, with other values of some."""
    settings = make(case)
    for path, value in values.items():
        part, _, name = path.partition('.')
        settings = replace(settings, **{part: replace(getattr(settings, part), **{name: value})})
    return settings


def gives(function: Callable) -> Callable[[Any], Any]:
    """Return what puts a function in the place of another."""
    return _Gives(function)


def value(new: Any) -> Callable[[Any], Any]:
    """Return what puts a value in the place of a constant."""
    return _Gives(new)


def constants(**values: Any) -> Callable[[Any], Any]:
    """Return what puts values in the place of some in a record of constants."""
    return _Constants(values)


class _Constants:
    """Takes the place of a record of constants."""

    def __init__(self, values: dict[str, Any]):
        self.values = values

    def __call__(self, old: Any) -> Any:
        return old._replace(**self.values)

    def __repr__(self) -> str:
        return str(self.values)


def policy(**values: float) -> Callable[[Any], Any]:
    """Return what puts other values into a policy that a kernel is given."""
    def changed(old: dict[str, float]) -> dict[str, float]:
        """Return the policy with these values, which it must have had."""
        assert values.keys() <= old.keys(), f'no {values} in {sorted(old)}'
        return {**old, **values}

    return changed


class _Gives:
    """Takes the place of anything; knows by what."""

    def __init__(self, new: Any):
        self.new = new

    def __call__(self, old: Any) -> Any:
        return self.new


def _text(new: Any) -> str:
    new = new.new if isinstance(new, _Gives) else new
    if not inspect.isfunction(new):
        return repr(new)
    code, inside = new.__code__, [cell.cell_contents for cell in new.__closure__ or ()]
    consts = [item for item in code.co_consts if not inspect.iscode(item)]
    return str((new.__name__, code.co_code.hex(), consts, code.co_names, inside))


def _no_blocks(first, *_args, **_named):
    """Return no block of as many as the first argument has."""
    return np.zeros(len(first), bool)


def _only_votes(self, extraction, correspondences):
    """Label macroblocks by their own vectors alone."""
    from mv_slapse.movers.mask import vote
    label, plane = vote(extraction, correspondences.x_cur)
    return replace(extraction, macroblock_label=label, macroblock_plane=plane)


def _without_past(self, extraction):
    """Return what is inherited where nothing is known."""
    from mv_slapse.movers.identity import History
    n = len(extraction.x_cur)
    return History(np.full(n, np.nan), np.full(n, np.nan), np.full(n, -1))


def _no_departure(past, extraction, *_args):
    """Return that no block has left."""
    return np.zeros(len(extraction.x_cur))


def _keep_evidence(old):
    """Return a refinement after which blocks are not judged again."""
    def refined(self, pair, found, *rest):
        """Refine, and keep what was judged before."""
        return replace(old(self, pair, found, *rest), evidence=found.evidence)

    return refined


def _steps(number):
    """Return what makes an iteration end after so many steps."""
    def limited(old):
        """Return the function with fewer steps."""
        def function(*args, **named):
            """Call it with fewer steps."""
            return old(*args, **(named | {'steps': number}))

        return function

    return limited


def _without_road(old):
    """Return a survey that finds no unsupported block on the road."""
    def survey(*args, **named):
        """Survey the ground without unsupported vectors."""
        belief, prior, road = old(*args, **named)
        return belief, prior, np.zeros_like(road)

    return survey


def _leave_at_once(self, state, extraction):
    """Remove planes that move without handing them over."""
    from mv_slapse.records import Label
    for plane in extraction.planes:
        if plane.label == Label.MOVING and plane.id in state.planes:
            state.remove_plane(plane.id)
            self.remove(plane.id)
    return []


def _all_still(extraction):
    """Return all stationary correspondences, whatever is around them."""
    from mv_slapse.geometry.camera import to_rays
    from mv_slapse.geometry.two_view import Pair
    from mv_slapse.records import Label
    still = (extraction.label == Label.STATIONARY) | (extraction.label == Label.INFINITY)
    x_cur, x_prev = (x[still].astype(float) for x in (extraction.x_cur, extraction.x_prev))
    pair = Pair(to_rays(extraction.K, x_cur), to_rays(extraction.K, x_prev), x_prev,
                extraction.sigma[still].astype(float), extraction.K)
    return pair, extraction.plane_id[still]


def _all_before(turns_only):
    """Return the same that takes each block to lie before the camera."""
    return lambda off, rho, epsilon_m: turns_only(off, np.ones_like(rho), epsilon_m)


def _prior_alone(self, *_args):
    """Return it as it is."""
    return self


MOVERS = 'mv_slapse.movers.'
SCORE = MOVERS + 'score:'
REGIONS = MOVERS + 'regions:'
SURFACES = 'mv_slapse.surfaces.'
MOTION = 'mv_slapse.motion.'
EXTRACTOR = 'mv_slapse.extraction.extractor:'
SCENE = 'mv_slapse.scene.'
OBSTACLES = 'mv_slapse.obstacles.'
TRACKER = OBSTACLES + 'tracker:ObstacleTracker.'

NOTHING = gives(lambda *_: None)
YES, NO, ZERO = gives(lambda *_: True), gives(lambda *_: False), gives(lambda *_: 0.0)
FIRST = gives(lambda first, *_: first)
ITSELF = gives(_prior_alone)
NO_BLOCKS = gives(_no_blocks)
LIKE_MOVERS = {MOVERS + 'possibly_dynamic:like_movers':
               gives(lambda shown, parallax: np.zeros(len(parallax), bool))}
BELOW_GROUND = {MOVERS + 'possibly_dynamic:below': NO_BLOCKS}
FROM_MOVERS = {MOVERS + 'possibly_dynamic:taken':
               gives(lambda grid, x_prev: np.zeros(len(x_prev), bool))}

RULES = (
    # Movers: the ones doubted most come first.
    Rule('terrain', 'what looks farther than the road in one proportion is land, no mover',
         {MOVERS + 'outlines:RULES': constants(dependence=np.inf)}),
    Rule('body', 'blocks that only together look farther than the ground are a mover',
         {MOVERS + 'body:with_bodies':
          gives(lambda regions, *_: (regions.members, regions.first, np.zeros(len(regions.first)),
                                     None))}),
    Rule('strips of a while ago', 'where strips were half a second ago tells their depths',
         {MOVERS + 'strip_depths:with_strips': gives(lambda blocks, *rest: blocks)}),
    Rule('bodies over pairs', 'what several pairs together tell of a body makes it a mover',
         {MOVERS + 'score:RULES': constants(bodies=0.0)}),
    Rule('upright', 'blocks of bodies tell nothing of the ground\'s height',
         {SURFACES + 'ground:POLICY': policy(upright_sure=1e18)}),
    Rule('possibly dynamic', 'blocks that may be a mover\'s do not count for the motion: all '
         'three ways', {**LIKE_MOVERS, **BELOW_GROUND, **FROM_MOVERS}),
    Rule('planar ambiguity', 'of the two motions that one plane allows the one with the scene '
         'before the camera is taken',
         {MOTION + 'planar_ambiguity:unfolded': gives(lambda pair, fit: fit)}),
    Rule('height belief', 'the camera\'s height over the ground comes from all pairs so far',
         {SURFACES + 'height:HeightBelief.seen': ITSELF}),
    Rule('mover mask', 'macroblocks in a mover\'s outline are the mover\'s, over pairs',
         {MOVERS + 'mask:Silhouettes.fill': gives(_only_votes)}),
    Rule('stray macroblocks', 'one with few of the mover beside it does not stretch its outline',
         {MOVERS + 'mask:BESIDE': value(0)}),
    Rule('outline that moves on', 'what the mover\'s outline held before is its without a vector',
         {MOVERS + 'mask:LIFETIME': value(0)}),
    Rule('rim of a mover', 'of that, what stands out of today\'s outline is not',
         {MOVERS + 'mask:AMID': value(0)}),
    Rule('reference depth', 'what is farther than all that was seen there a while ago departs',
         {MOVERS + 'reference_depth:departure': gives(_no_departure)}),
    Rule('like movers', 'blocks around a mover that move as it does do not count for the motion',
         LIKE_MOVERS),
    Rule('below the ground', 'nor do blocks that look farther than the ground they hide',
         BELOW_GROUND),
    Rule('last pair\'s movers', 'nor do blocks from where the last pairs showed a mover',
         FROM_MOVERS),
    Rule('unsupported on the road', 'unsupported vectors on the known ground are part of it',
         {SURFACES + 'ground:survey': _without_road}),
    Rule('score over pairs', 'a region\'s score and name pass from pair to pair',
         {MOVERS + 'identity:Memory.inherited': gives(_without_past)}),
    Rule('most of it stood', 'where little of a region scored before all of it counts, not its '
         'better half', {REGIONS + 'RULES': constants(part=0.0)}),
    Rule('memory without vectors', 'a block\'s history goes on where it has no vector',
         {MOVERS + 'identity:LIFETIME': value(1)}),
    Rule('given up later', 'a mover is given up at half the score at which it was found',
         {REGIONS + 'RULES': constants(kept=1.0)}),
    Rule('name of a plane', 'a region that was a stationary plane keeps its name',
         {REGIONS + 'RULES': constants(same_plane=np.inf)}),
    Rule('own growth', 'what comes near a standing camera is one region',
         {REGIONS + 'RULES': constants(own_growth=0.0)}),
    Rule('grown movers', 'blocks around a mover that move with it join it',
         {REGIONS + '_grown': gives(lambda alike, planes, _view:
                                    [alike.members[alike.rows(i)] for i in planes])}),
    Rule('copied vectors', 'wrong vectors that repeat their neighbours deserve less belief',
         {REGIONS + 'RULES': constants(repeated=-1.0)}),
    Rule('credibility', 'a score is bounded by how many vectors around are copies',
         {SCORE + 'RULES': constants(credit=1e9)}),
    Rule('hovering', 'what looks nearer than the ground seen below it hovers, so it moves',
         {SCORE + 'RULES': constants(least_ratio=np.inf)}),
    Rule('body above', 'a low region counts only if something goes on above it',
         {MOVERS + 'outlines:RULES': constants(lowest=0.0)}),
    Rule('ground below', 'what a region would hide must not be seen below it',
         {SCORE + 'RULES': constants(unseen=np.inf)}),
    Rule('vehicle size', 'what is larger than a vehicle is a building',
         {MOVERS + 'outlines:RULES': constants(widest=np.inf, tallest=np.inf)}),
    Rule('scattered', 'a region that fills little of its box does not move',
         {SCORE + 'RULES': constants(least_filled=0.0)}),
    Rule('above the horizon', 'what ends above the horizon does not move',
         {SCORE + 'RULES': constants(least_drop=-np.inf)}),
    Rule('rising departures', 'what departs must rise from the road',
         {REGIONS + 'RULES': constants(rising=0.0, rising_blocks=0.0)}),
    Rule('guessed ground', 'where no ground is seen a vague height bounds it for movers',
         {SURFACES + 'ground:GUESSED': value(-1.0)}),
    # Motion and extraction.
    Rule('second evidence', 'blocks are judged again after the refinement',
         {EXTRACTOR + 'PlaneExtractor._refined': _keep_evidence}),
    Rule('joint refinement', 'motion and planes are estimated again together',
         {SURFACES + 'joint:reestimate': _steps(0)}),
    Rule('refinement beyond 2 steps', 'of four', {SURFACES + 'joint:reestimate': _steps(2)}),
    Rule('measured noise', 'the scale of the vectors\' errors is measured',
         {MOTION + 'estimate:calibrated': gives(lambda pair, fit, noise: 1.0)}),
    Rule('five points', 'where the last motion does not fit five points give another',
         {EXTRACTOR + 'PREDICTED_COST': value(np.inf)}),
    Rule('turn on the spot', 'a pair without parallax may be a rotation',
         {MOTION + 'observations:may_turn': NO}),
    Rule('turns with wrong vectors', 'of a turn they lie behind the camera as often as before it',
         {MOTION + 'observations:turns_only': _all_before}),
    Rule('standstill', 'zero vectors everywhere mean that the camera stands',
         {MOTION + 'status:stands_still': NO}),
    # Surfaces.
    Rule('depths of earlier pairs', 'inverse depths are carried from pair to pair for planes',
         {SURFACES + 'block_map:BlockMap.joined': gives(lambda *arguments: arguments[-1])}),
    Rule('motion against the map', 'a pair is fitted to the depths of all before',
         {SURFACES + 'block_map:BlockMap.moving': gives(lambda *_: None)}),
    Rule('mounting learned', 'the ground\'s normal is learned from the courses',
         {SURFACES + 'ground:Mount.learned': ITSELF}),
    Rule('height informs the ground', 'the ground is looked for at the height of many pairs',
         {SURFACES + 'ground:GroundPrior.informed': ITSELF}),
    Rule('height forbids a ground', 'a ground at another height than many pairs show is none',
         {SURFACES + 'height:HeightBelief.allows': YES}),
    Rule('corridor', 'the ground is looked for near the camera\'s way',
         {SURFACES + 'ground:POLICY': policy(corridor=1e9)}),
    Rule('blocks below speak', 'a known ground with much alike below it is none',
         {SURFACES + 'ground:POLICY': policy(alike=0.0)}),
    Rule('upright walls', 'planes that may be upright are upright',
         {SURFACES + 'plane_search:POLICY': policy(upright_gate=0.0)}),
    Rule('density', 'a plane fills its outline',
         {SURFACES + 'plane_search:POLICY': policy(density=0.0)}),
    Rule('windows\' noise', 'windows tell how large the errors are',
         {SURFACES + 'plane_search:POLICY': policy(noise_least=0.0)}),
    Rule('planes recognised', 'a plane that comes back into view has its name again',
         {SURFACES + 'plane_track:KnownPlanes.recognised': gives(lambda *_: -1)}),
    Rule('planes missed', 'a plane that a pair does not show is kept',
         {SURFACES + 'plane_track:KnownPlanes.unseen': gives(lambda self: type(self).none())}),
    # Scene filter.
    Rule('ratio of baselines', 'the scale passes from pair to pair by their depths',
         {SCENE + 'scale.ratio:told': gives(lambda *_: [])}),
    Rule('ratio against prediction', 'a ratio that contradicts the speed does not count',
         {SCENE + 'scale.ratio:holds': gives(lambda state, log, sigma:
                                             bool(np.isfinite(sigma)))}),
    Rule('unit that drifts', 'a free scale is less sure with each ratio and turn, for good',
         {SCENE + 'scale.ratio:doubt_for_good': NOTHING}),
    Rule('ride', 'the height of a camera that keeps to the ground stays, known or not',
         {SCENE + 'scale.ride:Ride.seen': ITSELF}),
    Rule('supposed baseline', 'before any ground is seen most of what is low is ground',
         {SCENE + 'scale.rest:supposed_baseline': ZERO}),
    Rule('wheels that slip', 'a speed that contradicts the way does not count',
         {SCENE + 'gating:holds_length': YES}),
    Rule('new frame', 'a heading that is lost begins a new local frame',
         {SCENE + 'gauge:is_vague': NO}),
    Rule('agreement', 'the gate of planes is as wide as planes seen again show',
         {SCENE + 'noise:Agreement.seen': ITSELF}),
    Rule('dependence', 'how far neighbouring vectors err together is measured',
         {SCENE + 'noise:Dependence.seen': ITSELF}),
    Rule('still surroundings', 'a block on no plane counts where most around it is still and no '
         'mover beside it', {SCENE + 'update:stationary': gives(_all_still)}),
    Rule('patience', 'a plane must contradict the map for a while',
         {SCENE + 'gating:PATIENCE': value(0)}),
    Rule('walls out of view', 'well seen walls stay in the filter',
         {SCENE + 'plane_map:SceneMap.is_lasting': NO}),
    Rule('iterations beyond 2', 'an update is relinearised four times', {},
         {'scene.iterations': 2}),
    Rule('place in the block', 'vectors may tell of a place beside their block\'s middle',
         {SCENE + 'noise:COPIED': value(0.0)}, {'scene.place_bias': 0.0}),
    Rule('copied places', 'that place errs by more where vectors err together',
         {SCENE + 'noise:COPIED': value(0.0)}),
    Rule('focal error', 'the focal length may be wrong by a per cent', {},
         {'scene.focal_sigma': 0.0}),
    Rule('bias of depth', 'the depth of a whole surface errs in one pair', {},
         {'scene.depth_bias': 0.0}),
    # Obstacles and hand-over.
    Rule('hand-over to obstacles', 'a plane of the map that moves starts as an obstacle there',
         {SCENE + 'plane_map:SceneMap.release': gives(_leave_at_once)}),
    Rule('hand-over to the map', 'an obstacle that stops becomes a plane of the map',
         {TRACKER + '_has_stopped': NO}),
    Rule('stops unseen', 'one that is not seen any more may have stopped',
         {OBSTACLES + 'lifecycle:melts_into_scene': NO}),
    Rule('redetection', 'an obstacle\'s vectors are looked for where it must be',
         {OBSTACLES + 'redetection:found': NOTHING}),
    Rule('footprint', 'cars side by side are wider than one vehicle',
         {OBSTACLES + 'footprint:may_be_one': YES, OBSTACLES + 'footprint:stand_apart': NO}),
    Rule('hollow edge', 'what is too wide for one vehicle is two where its lower edge is hollow',
         {OBSTACLES + 'footprint:bodies': gives(lambda whole, view, least: [whole])}),
    Rule('followed before', 'a track follows what may move before the labels call it so',
         {TRACKER + '_try': gives(lambda self, unsure, free, extraction: [])}),
    Rule('begins again', 'a start that the next detection does not fit is forgotten',
         {OBSTACLES + 'track:Track.begin_again': NOTHING}),
    Rule('detection of several', 'a detection over several obstacles that is too wide for one is '
         'none', {TRACKER + '_of_one': gives(lambda self, found: found)}),
    Rule('units', 'obstacles follow the map where it becomes metric',
         {OBSTACLES + 'units:last_unit': gives(lambda before, now: 1.0)}),
    Rule('merging tracks', 'tracks of one vehicle become one', {TRACKER + '_merge': NOTHING}),
    Rule('expected places', 'two obstacles are not joined into one',
         {OBSTACLES + 'association:_as_expected': YES}),
    Rule('alone', 'a lasting score tells of a body where no other obstacle is near',
         {TRACKER + '_is_alone': NO}),
    Rule('may drive', 'an obstacle stands on the ground and is no building',
         {TRACKER + '_may_drive': YES}),
    Rule('unrest', 'a steady obstacle has little acceleration',
         {OBSTACLES + 'track:Track._unrest': gives(lambda self: 1.0)}),
    Rule('correlated outlines', 'what is wrong alike in successive pairs is not averaged',
         {OBSTACLES + 'track:_correlated': FIRST}),
    Rule('depth by the ground', 'an obstacle\'s depth comes from the map\'s ground',
         {OBSTACLES + 'detection:_on_ground': FIRST}),
    # Decoder: switched off by settings, so that correspondences are decoded anew.
    Rule('unsupported vectors', 'vectors that no neighbour supports are kept, less probable', {},
         {'decoder.lone_probability': 0.0}),
    Rule('expected motion', 'a vector near the motion of the pairs before is supported', {},
         {'decoder.prior_votes': 0.0}),
    Rule('bridging', 'macroblocks of an I frame are searched for in the past', {},
         {'decoder.bridge_intra': False}),
    Rule('halves', 'a segment with long vectors is split at its middle B frame', {},
         {'decoder.split_flow': 1e6}),
    Rule('chaining', 'pairs with little parallax are chained', {}, {'decoder.max_chain': 1}))
BY_NAME = {rule.name: rule for rule in RULES}
