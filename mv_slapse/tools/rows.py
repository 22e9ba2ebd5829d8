"""Rows of the evaluation, measured by many workers; nothing is made or measured twice.

A cache folder holds the videos that were rendered or encoded, the correspondences that were
decoded, and the figures of each row. Videos and correspondences are found again as long as the
code that made them says the same, so that another commit of the core need not make them again.
"""

import ast
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache as remembered
from hashlib import sha256
import json
import os
from pathlib import Path
import pickle  # of files that this program wrote itself  # nosec B403
import re
import tempfile
from typing import Any

from mv_slapse.config import SceneSettings, Settings
from mv_slapse.errors import MvSlapseError
from mv_slapse.records import Correspondences
from mv_slapse.tools.batch.workers import open_pool, Workers
from mv_slapse.tools.cases import Case, Scene
from mv_slapse.tools.eval import evaluate, Marks
from mv_slapse.tools.plain import plain
from mv_slapse.tools.run import decode, Decoded, replay

PACKAGE = Path(__file__).resolve().parents[1]
# What pictures and correspondences depend on, below the package.
OF_PICTURES = ('simulation', 'codec/encoding/encoder.py')
OF_VECTORS = ('codec', 'geometry/blocks.py', 'geometry/camera.py', 'geometry/rotation.py',
              'strip_matches.py')
KERNELS = 'kernels'  # counted among them where the codec calls them
NOT_MEASURED = ('nodes', 'launch', 'tools')  # what no figure depends on, but for
TOOLS = tuple(f'tools/{name}.py' for name in ('cases', 'altered', 'eval', 'run', 'rows'))
DIGITS = 6  # of the figures that are kept

Figures = dict[str, Any]


@dataclass(frozen=True)
class Cache:
    """A folder of what is slow to make, and of the figures of one state of the code.

    Attributes
    ----------
    folder : Path
    label : str
        Names the state of the code, usually a commit: figures of another one are not taken.
    only : str
        Only rows whose name holds this text.
    """

    folder: Path
    label: str
    only: str = ''

    def cases(self, scene: Scene) -> list[Case]:
        """Return the cases of a scene, whose videos are made where they are missing."""
        folder = self.folder / 'inputs' / _slug(scene.name, scene.content, _said(OF_PICTURES))
        folder.mkdir(parents=True, exist_ok=True)
        return list(scene.make(folder, self.only))

    def decoded(self, case: Case, settings: Settings) -> Decoded:
        """Return the correspondences of a case, decoded where nobody did so before."""
        columns = [item.name for item in fields(Correspondences)]
        video = sha256(case.video.read_bytes()).hexdigest()
        file = self.folder / 'decoded' / (_slug(
            case.name, video, repr(case.camera), repr(settings.decoder), repr(columns),
            _said(_of_vectors())) + '.pickle')
        if not file.exists():
            _write(file, pickle.dumps(decode(case.video, case.camera, settings)))
        return pickle.loads(file.read_bytes())  # nosec B301

    def figures(self, case: Case) -> Path:
        """Return where the figures of a row are kept, which go with what it measures.

        Scenes of other seeds and lengths may have the same name.
        """
        truth = case.ground_truth
        files = [case.video, case.labels, case.boxes, case.annotation,
                 *(sorted(truth.iterdir()) if truth and truth.is_dir() else [truth])]
        content = [sha256(file.read_bytes()).hexdigest() for file in files if file]
        slug = _slug(case.name, repr(case.camera), repr(case.height), repr(case.speeds), *content)
        return self.folder / 'figures' / self.label / f'{slug}.json'


def measure_all(scenes: Sequence[Scene], cache: Cache, workers: Workers,
                tell: Callable[[str, Figures], None] | None = None,
                choose: Callable[[Scene, list[Case]], list[Case]] = lambda scene, cases: cases
                ) -> dict[str, Figures]:
    """Return the figures of each row by its name, in the order of the scenes.

    Rows whose figures the cache has are not measured again. ``tell`` is called with each row as it
    is done; ``choose`` returns which of a scene's rows are measured. Workers of other machines
    need the cache folder under the same name.
    """
    names: dict[str, list[str]] = {}
    found: dict[str, Figures] = {}
    left = deque(scenes)
    with open_pool(workers) as pool:
        def prepare_next():
            """Make the cases of one more scene; their rows come before those of the next."""
            if left:
                scene = left.popleft()
                pool.submit(scene, cache.cases, scene)

        # Workers of others may still be on their way.
        for _ in range(max(pool.threads, os.cpu_count() or 1)):
            prepare_next()
        for scene, result in pool.results():
            if isinstance(result, Exception):
                raise result
            if scene is not None:
                cases = choose(scene, result)
                names[scene.name] = [case.name for case in cases]
                for case in cases:
                    pool.submit(None, measured, case, cache, priority=1)
                prepare_next()
                continue
            name, figures = result
            found[name] = figures
            if tell:
                tell(name, figures)
    return {name: found[name] for scene in scenes for name in names[scene.name]}


def measured(case: Case, cache: Cache) -> tuple[str, Figures]:
    """Return the name and the figures of a case; they are kept."""
    file = cache.figures(case)
    if not file.exists():
        _write(file, json.dumps(rounded(measure(case, cache)), indent=1).encode())
    return case.name, json.loads(file.read_text())


def measure(case: Case, cache: Cache) -> Figures:
    """Run one case and return its figures; with the message as ``error`` where it refuses."""
    settings = settings_of(case)
    with tempfile.TemporaryDirectory() as folder:
        try:
            summary = replay(cache.decoded(case, settings), case.camera, settings, folder,
                             case.speeds)
            figures: Figures = {'n_poses': summary.poses}
            if case.ground_truth or case.labels or case.boxes or case.annotation:
                marks = Marks(case.labels, case.boxes, case.annotation,
                              camera_height=case.true_height)
                figures |= evaluate(folder, case.ground_truth, marks)
        except MvSlapseError as error:
            return {'error': str(error)}
    return figures | {'cpu_ms': 1e3 * summary.cpu_seconds['total'] / max(summary.frames, 1)}


def settings_of(case: Case) -> Settings:
    """Return the settings that a case is run with."""
    return Settings(scene=SceneSettings(camera_height=case.height))


def rounded(figures: Figures) -> Figures:
    """Return figures with as many digits as are kept."""
    return {name: float(f'{value:.{DIGITS}g}') if isinstance(value, float) else value
            for name, value in plain(figures).items()}


def state_of_code() -> str:
    """Return a name of the code that figures depend on, comments and docstrings apart."""
    return _said(tuple(path.name for path in sorted(PACKAGE.iterdir())
                       if path.name not in NOT_MEASURED) + TOOLS)[:12]


def _write(file: Path, content: bytes):
    """Write a file as a whole: another process may be about to read it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f'{file.name} {os.getpid()}')
    part.write_bytes(content)
    part.replace(file)


def _slug(name: str, *content: str) -> str:
    """Return a name of a file that differs where any of its content does."""
    digest = sha256('\n'.join(content).encode()).hexdigest()[:12]
    return f'{re.sub("[^A-Za-z0-9]+", "-", name)}-{digest}'


def _of_vectors() -> tuple[str, ...]:
    calls = any(KERNELS in file.read_text() for file in (PACKAGE / 'codec').glob('*.py'))
    return (*OF_VECTORS, KERNELS) if calls else OF_VECTORS


@remembered
def _said(places: tuple[str, ...]) -> str:
    """Return what code below the package says, without comments and docstrings."""
    files = [file for place in places for file in
             sorted([PACKAGE / place, *(PACKAGE / place).rglob('*')]) if file.is_file()]
    texts = [(_without_docstrings(file.read_text()) if file.suffix == '.py' else file.read_text())
             for file in files if file.suffix in ('.py', '.cpp', '.hpp', '.h')]
    return sha256('\n'.join(texts).encode()).hexdigest()


def _without_docstrings(text: str) -> str:
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(
                node) is not None:
            node.body[0] = ast.Pass()
    return ast.unparse(tree)
