"""Parameter files of the nodes, written from the settings so that they name every parameter."""

import argparse
from dataclasses import Field, fields
from pathlib import Path
import textwrap

from mv_slapse.nodes.settings import NODE_SETTINGS
import yaml

HEADER = ('# Parameters of {node}: every one, at its default. '
          'Written by `make config` from the settings.')
WIDTH = 95


def text(node: str) -> str:
    """Return the parameter file of a node, each parameter under its unit, meaning and bounds."""
    lines = [HEADER.format(node=node), '/**:', '  ros__parameters:']
    for prefix, kind in NODE_SETTINGS[node]:
        lines.append('')
        lines.append(f'    # {kind.__doc__.splitlines()[0]}')
        indent = '    '
        if prefix:
            lines.append(f'    {prefix}:')
            indent = '      '
        for item in fields(kind):
            lines += _comment(item, indent)
            lines.append(f'{indent}{item.name}: {_value(item.default)}')
    return '\n'.join(lines) + '\n'


def write(folder: Path) -> list[Path]:
    """Write the files of all nodes into a folder and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f'{node}.yaml' for node in NODE_SETTINGS]
    for path in paths:
        path.write_text(text(path.stem))
    return paths


def _comment(item: Field, indent: str) -> list[str]:
    low, high = item.metadata['low'], item.metadata['high']
    bounds = ('' if low is None and high is None else f' (at least {low})' if high is None
              else f' (at most {high})' if low is None else f' ({low} to {high})')
    return textwrap.wrap(item.metadata['doc'] + bounds, WIDTH, initial_indent=indent + '# ',
                         subsequent_indent=indent + '#   ', break_long_words=False)


def _value(value) -> str:
    value = list(value) if isinstance(value, tuple) else value
    # yaml ends a bare scalar with the mark of a document's end
    return yaml.safe_dump(value, default_flow_style=True, width=1000).split('\n')[0]


def main() -> int:
    """Write the parameter files into the folder that the command line names."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument('folder', type=Path)
    for path in write(parser.parse_args().folder):
        print(path)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
