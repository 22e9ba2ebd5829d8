"""What a run would say on /diagnostics: the states of ``all_in_one`` as far as a run has them."""

from collections import Counter
from typing import Any

from mv_slapse.field_values import Fields, header
from mv_slapse.records import ObstacleState, ScaleStatus, SegmentKind, TrackingStatus
from mv_slapse.states import CONDITIONS, Kind

PERIOD = 1_000_000_000  # [ns] of the stream
LEVELS = {Kind.FAILED: 2, Kind.WAITING: 1, Kind.DEGRADED: 1, Kind.WORKING: 0}
NAME = 'mv_slapse'
TRACKING = {TrackingStatus.LOST: 'lost', TrackingStatus.INITIALISING: 'initialising',
            TrackingStatus.PREDICTED: 'predicted'}


class StepDiagnostics:
    """Counts over a run, and its state once a second of the stream."""

    def __init__(self):
        """Begin with nothing counted."""
        self._counts = Counter({'key frame pairs': 0, 'broken pairs': 0})
        self._due: int | None = None

    def add(self, step: Any) -> Fields | None:
        """Take a ``pipeline.Step``; return diagnostic_msgs/DiagnosticArray where one is due."""
        pair, stamp = step.correspondences, step.scene.stamp
        self._counts['key frame pairs'] += 1
        self._counts['broken pairs'] += pair.kind is SegmentKind.BROKEN
        if self._due is not None and self._due - PERIOD <= stamp < self._due:
            return None
        self._due = stamp + PERIOD
        return {'header': header(stamp, ''), 'status': [self._status(step)]}

    def _status(self, step: Any) -> Fields:
        found = conditions(step)
        key, said = next(iter(found.items()))
        kind = CONDITIONS[key].kind
        scene = step.scene
        values = {'state': kind.name.lower(), 'condition': key, 'tracking': scene.status.name,
                  'planes in the map': len(scene.planes), 'resets': scene.resets,
                  'covariances repaired': scene.repairs,
                  'scale': f'{scene.scale_status.name.lower()} ({scene.scale_source})',
                  'obstacles': sum(o.state is not ObstacleState.TENTATIVE
                                   for o in step.obstacles),
                  **self._counts, **{k: v for k, v in found.items() if k != key}}
        return {'level': LEVELS[kind], 'name': NAME, 'hardware_id': 'mv_slapse',
                'message': 'ok' if key == 'working' else f'{kind.name.lower()}: {said}',
                'values': [{'key': key, 'value': str(values[key])} for key in sorted(values)]}


def conditions(step: Any) -> dict[str, str]:
    """Return the conditions that hold after a step, the worst first, with what they say."""
    scene, pair, found = step.scene, step.correspondences, {}
    if scene.status in TRACKING:
        key = TRACKING[scene.status]
        found[key] = (f'{scene.status.name.lower()}: {scene.reason or "no reason given"}; '
                      f'{CONDITIONS[key].next_step}')
    if pair.kind is SegmentKind.BROKEN:
        found['broken'] = f'the last pair of key frames is broken: {pair.reason}'
    if step.extraction.reason:
        found['no_motion'] = f"the camera's motion is not known: {step.extraction.reason}"
    if scene.scale_status is ScaleStatus.UNKNOWN:
        condition = CONDITIONS['no_scale']
        found['no_scale'] = f'{condition.meaning}; {condition.next_step}'
    order = list(CONDITIONS)
    return dict(sorted(found.items(), key=lambda item: order.index(item[0]))) or {'working': 'ok'}
