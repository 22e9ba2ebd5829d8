"""What a run did: ``summary.json``, and what the terminal says."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mv_slapse.storage.archives import SCHEMA_VERSION

SHARE_OF_POSES = 0.5  # with fewer key frames tracked, the run counts as lost


@dataclass
class Summary:
    """What a run did; the content of ``summary.json``.

    Attributes
    ----------
    input, command : str
    frames, key_frames, poses, broken_segments : int
        Pictures decoded, pictures that may have a pose, those that have one, pairs without
        vectors.
    broken_reasons, statuses : dict
        How often each reason, and each tracking status, occurred.
    scale_status, scale_source : str
    planes, obstacles_confirmed : int
        Planes ever in the map, obstacles ever confirmed.
    fps, first_stamp, last_stamp : float
        Mean rate of the pictures [1/s], stamps of the first and the last key frame [s].
    cpu_seconds : dict
        By stage, and the sum.
    known_map, camera, settings, versions : dict
    warnings : list of str
    """

    input: str
    command: str = ''
    schema_version: int = SCHEMA_VERSION
    frames: int = 0
    key_frames: int = 0
    poses: int = 0
    broken_segments: int = 0
    broken_reasons: dict[str, int] = field(default_factory=dict)
    statuses: dict[str, int] = field(default_factory=dict)
    reasons: dict[str, int] = field(default_factory=dict)
    scale_status: str = 'unknown'
    scale_source: str = ''
    planes: int = 0
    obstacles_confirmed: int = 0
    fps: float = 0.0
    first_stamp: float = 0.0
    last_stamp: float = 0.0
    interrupted: bool = False
    known_map: dict[str, Any] = field(default_factory=dict)
    cpu_seconds: dict[str, float] = field(default_factory=dict)
    camera: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    @property
    def is_lost(self) -> bool:
        """Whether most key frames have no pose."""
        return self.poses < SHARE_OF_POSES * self.key_frames

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``summary.json``."""
        return asdict(self)


def text(summary: Summary, output: str | Path) -> str:
    """Return what a run reports on the terminal."""
    s, total = summary, summary.cpu_seconds['total']
    stages = ', '.join(f'{name} {seconds:.2f}' for name, seconds in s.cpu_seconds.items()
                       if name != 'total')
    scale = f'{s.scale_status} ({s.scale_source})' if s.scale_source else s.scale_status
    lines = [f'{s.input}: {s.frames} frames, {s.key_frames} key frames, {s.poses} with a pose, '
             f'{s.broken_segments} broken segments',
             f'scale {scale}; {s.planes} planes, {s.obstacles_confirmed} obstacles confirmed',
             f'CPU {total:.2f} s, {1000 * total / max(s.frames, 1):.1f} ms a frame ({stages})',
             *(f'warning: {warning}' for warning in s.warnings), f'results in {output}']
    return '\n'.join(lines)


def lost_message(summary: Summary) -> str:
    """Return why a run counts as lost, and what to do."""
    causes = [*summary.reasons] or [*summary.broken_reasons] or ['unknown']
    return (f'{summary.input}: tracking was lost for most of the input, {summary.poses} of '
            f'{summary.key_frames} key frames have a pose (most often: {causes[0]}); see '
            'mv_slapse inspect, and check the camera file')
