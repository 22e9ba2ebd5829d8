"""The layers that the README draws, and the bounds of style, held by tests."""

import ast
from itertools import chain
from pathlib import Path
import statistics
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'mv_slapse'
FILES = sorted(PACKAGE.rglob('*.py'))
ROS = ('rclpy', 'rcl_interfaces', 'builtin_interfaces', 'std_msgs', 'std_srvs', 'geometry_msgs',
       'nav_msgs', 'sensor_msgs', 'visualization_msgs', 'diagnostic_msgs', 'tf2_msgs', 'tf2_ros',
       'foxglove_msgs', 'ffmpeg_image_transport_msgs', 'mv_slapse_msgs', 'ament_index_python')
HOME = {**dict.fromkeys(ROS, 'nodes'), 'launch': 'launch', 'launch_ros': 'launch', 'av': 'codec',
        'rosbags': 'storage', 'mcap': 'storage', 'argparse': 'tools',
        'mv_slapse_kernels': 'kernels', 'dask': 'batch', 'distributed': 'batch'}
ROOMS = ('codec', 'motion', 'surfaces', 'movers', 'extraction', 'filters', 'scene', 'obstacles')
CORE = ('kernels', 'geometry', *ROOMS, 'pipeline')
NOT_IN_CORE = {'time', 'datetime', 'random', 'threading', 'multiprocessing', 'logging'}
BASE = {'blas', 'changed', 'config', 'errors', 'records', 'strip_matches'}
LOW = {*BASE, 'kernels', 'geometry'}
# What each part may import of this package; a part that is not listed may import everything.
BELOW = {
    'blas': set(),
    'errors': set(),
    'changed': set(),
    'heap': set(),
    'quaternion': set(),
    'records': {'strip_matches'},
    'strip_matches': set(),
    'config': {'errors'},
    'kernels': {'errors'},
    'geometry': {*BASE, 'kernels'},
    'calibration': {'errors', 'geometry'},
    'drawing': LOW,
    'ros_frames': {'geometry'},
    'frame_change': {*LOW, 'ros_frames'},
    'known_map': {*LOW, 'ros_frames'},
    'level': {*LOW, 'fields', 'field_values', 'message_checks', 'quaternion', 'ros_frames'},
    'codec': LOW,
    'motion': LOW,
    'surfaces': {*LOW, 'motion'},
    'movers': {*LOW, 'motion', 'surfaces'},
    'extraction': {*LOW, 'motion', 'surfaces', 'movers'},
    'filters': LOW,
    'scene': {*LOW, 'filters'},
    'obstacles': {*LOW, 'filters'},
    'evaluation': {*LOW, 'storage'},
    'pipeline': {*LOW, *ROOMS},
    'batch': {*LOW, 'evaluation', 'storage', 'tools'},
    'states': set(),
    'step_diagnostics': {*LOW, 'field_values', 'states'},
    'storage': {*LOW, 'calibration', 'codec', 'fields', 'known_map', 'level', 'picture_size',
                'plane_messages', 'planner_fields', 'quaternion', 'ros_frames',
                'step_diagnostics', 'video_messages', 'view_fields'},
    'nodes': {*LOW, *ROOMS, 'pipeline', 'storage', 'calibration', 'drawing', 'fields',
              'field_values',
              'frame_change', 'heap', 'known_map', 'level', 'message_checks', 'plane_messages',
              'planner_fields', 'quaternion', 'ros_frames', 'states', 'video_messages',
              'view_fields'},
}


@pytest.mark.parametrize('path', FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_function_has_more_than_six_parameters(path):
    for function in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(function, ast.FunctionDef):
            taken = function.args
            names = [one.arg for one in (*taken.posonlyargs, *taken.args, *taken.kwonlyargs)]
            assert len([name for name in names if name not in ('self', 'cls')]) <= 6, function.name


def folder_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE).with_suffix('').parts
    return 'batch' if parts[:2] == ('tools', 'batch') else parts[0]


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


def imported(path: Path, nodes=ast.walk) -> set[str]:
    names = set()
    for node in nodes(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f'{node.module}.{alias.name}' for alias in node.names)}
    return names


def function_lengths() -> dict[str, int]:
    lengths = {}
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lengths[f'{module_of(path)}.{node.name}'] = node.end_lineno - node.lineno + 1
    return lengths


def code_lengths() -> list[int]:
    """Lines of each function without those of its docstring."""
    lengths = []
    for node in chain.from_iterable(ast.walk(ast.parse(path.read_text())) for path in FILES):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            doc = node.body[0] if ast.get_docstring(node) is not None else None
            lines = doc.end_lineno - doc.lineno + 1 if doc else 0
            lengths.append(node.end_lineno - node.lineno + 1 - lines)
    return lengths


@pytest.mark.parametrize('path', FILES, ids=module_of)
def test_a_library_is_imported_only_in_its_folder(path):
    folder = folder_of(path)
    names = {name.split('.')[0] for name in imported(path)}
    assert not {name for name in names if HOME.get(name, folder) != folder}


@pytest.mark.parametrize('path', FILES, ids=module_of)
def test_imports_go_one_way(path):
    folder = folder_of(path)
    parts = {name.split('.')[1] for name in imported(path) if name.startswith('mv_slapse.')}
    assert parts - {folder} <= BELOW.get(folder, parts)


@pytest.mark.parametrize('path', [p for p in FILES if folder_of(p) in CORE], ids=module_of)
def test_the_core_has_no_clock_no_threads_and_no_output(path):
    tree = ast.parse(path.read_text())
    called = {node.func.id for node in ast.walk(tree)
              if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    assert not called & {'print', 'exit', 'quit', 'input'}
    assert not {name.split('.')[0] for name in imported(path)} & NOT_IN_CORE


def test_there_is_no_import_cycle():
    modules = {module_of(path): path for path in FILES}
    # an import inside a function does not run while modules load
    graph = {name: {used for used in imported(path, ast.iter_child_nodes) if used in modules}
             for name, path in modules.items()}
    while leaves := {name for name, used in graph.items() if not used}:
        graph = {name: used - leaves for name, used in graph.items() if name not in leaves}
    assert not graph, f'in or behind a cycle: {sorted(graph)}'


def test_everything_but_the_nodes_is_imported_without_ros():
    modules = [module_of(p) for p in FILES if folder_of(p) not in ('nodes', 'launch', '__main__')]
    code = f'''
import importlib, sys
class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.split('.')[0] in {ROS!r}:
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, NoRos())
for module in {modules!r}:
    importlib.import_module(module)
'''
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_no_function_is_longer_than_60_lines():
    assert not {name: n for name, n in function_lengths().items() if n > 60}


def test_half_of_the_functions_have_10_lines_and_nine_in_ten_30():
    lengths = code_lengths()
    assert statistics.median(lengths) <= 10
    assert statistics.quantiles(lengths, n=10)[-1] <= 30


def test_no_file_is_longer_than_400_lines():
    files = [*FILES, *(ROOT / 'test').rglob('*.py')]
    lengths = {path.name: len(path.read_text().splitlines()) for path in files}
    assert not {name: n for name, n in lengths.items() if n > 400}


@pytest.mark.parametrize('path', sorted(PACKAGE.rglob('*/__init__.py')), ids=module_of)
def test_the_init_file_of_a_folder_holds_at_most_its_docstring(path):
    assert len(path.read_text().splitlines()) <= 1


@pytest.mark.parametrize('room', ROOMS)
def test_a_room_of_the_core_has_at_most_12_modules(room):
    bound = 16 if room == 'codec' else 12  # codec's stages and formats are a module each
    modules = [path for path in (PACKAGE / room).glob('*.py') if path.stem != '__init__']
    assert len(modules) <= bound
