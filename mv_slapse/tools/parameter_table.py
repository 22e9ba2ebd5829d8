"""The table of all settings in the documentation, written from the settings themselves."""

import argparse
from dataclasses import Field, fields
from pathlib import Path

from mv_slapse.nodes.settings import is_live, NODE_SETTINGS
import yaml

HEAD = """# Parameters

Written by `make config` from `mv_slapse/config.py` and `mv_slapse/nodes/settings.py`; do not edit.

They are set at the start, by a file (`config/<node>.yaml` names every one), `--ros-args -p
name:=value`, or `params_file:=` of the launch file; an integer is taken for a float. Those marked
live can change while the node runs (`ros2 param set`): those with a prefix are settings of the
core, and a new value lets their part begin anew, a trajectory where the last pose was. On the
command line these are `mv_slapse run --set scene.camera_height=1.65`. A name that is none is
warned about, with the nearest one that is.
"""
COLUMNS = ('Parameter', 'Default', 'Unit', 'Bounds', 'Live', 'Meaning')


def text() -> str:
    """Return a page with a table for each group of settings and the nodes that have it."""
    nodes: dict[tuple[str, type], list[str]] = {}
    for node, groups in NODE_SETTINGS.items():
        for group in groups:
            nodes.setdefault(group, []).append(f'`{node}`')
    sections = (_section(prefix, kind, names) for (prefix, kind), names in nodes.items())
    return HEAD + ''.join(sections)


def _section(prefix: str, kind: type, nodes: list[str]) -> str:
    rows = [COLUMNS, ('---',) * len(COLUMNS), *(_row(prefix, kind, item) for item in fields(kind))]
    table = '\n'.join(f'| {" | ".join(row)} |' for row in rows)
    title = kind.__doc__.splitlines()[0].rstrip('.')
    return f'\n## {title}\n\nOf {", ".join(nodes)}.\n\n{table}\n'


def _row(prefix: str, kind: type, item: Field) -> tuple[str, ...]:
    unit, _, meaning = item.metadata['doc'][1:].partition('] ')
    name = f'{prefix}.{item.name}' if prefix else item.name
    cells = (f'`{name}`', f'`{_value(item.default)}`', unit, _bounds(item),
             'live' if is_live(kind, item.name) else '', meaning)
    return tuple(cell.replace('|', '\\|') for cell in cells)


def _value(value) -> str:
    value = list(value) if isinstance(value, tuple) else value
    return yaml.safe_dump(value, default_flow_style=True, width=1000).split('\n')[0]


def _bounds(item: Field) -> str:
    low, high = item.metadata['low'], item.metadata['high']
    if low is None and high is None:
        return ''
    return f'≥ {low}' if high is None else f'≤ {high}' if low is None else f'{low} … {high}'


def main() -> int:
    """Write the table into the file that the command line names."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument('file', type=Path)
    path = parser.parse_args().file
    path.write_text(text(), encoding='utf-8')
    print(path)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
