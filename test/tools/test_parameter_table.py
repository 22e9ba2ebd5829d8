"""The table of parameters in docs is the one that the settings give, and names every one."""

from dataclasses import fields
from pathlib import Path
import re

from mv_slapse.nodes.settings import NODE_SETTINGS, VideoSettings
from mv_slapse.tools import parameter_table
import pytest

PAGE = Path(__file__).resolve().parents[2] / 'docs' / 'parameters.md'


def rows() -> dict[str, list[str]]:
    lines = [line for line in parameter_table.text().splitlines() if line.startswith('| `')]
    cells = [[cell.strip() for cell in re.split(r'(?<!\\)\|', line)[1:-1]] for line in lines]
    assert all(len(row) == len(parameter_table.COLUMNS) for row in cells)
    return {row[0].strip('`'): row[1:] for row in cells}


def test_the_page_in_docs_is_up_to_date():
    assert PAGE.read_text(encoding='utf-8') == parameter_table.text(), 'run make config'


@pytest.mark.parametrize('node', NODE_SETTINGS)
def test_every_parameter_of_a_node_has_a_row(node):
    names = {f'{prefix}.{item.name}' if prefix else item.name
             for prefix, kind in NODE_SETTINGS[node] for item in fields(kind)}
    assert names <= set(rows())


def test_a_group_names_the_nodes_that_have_it():
    title = VideoSettings.__doc__.rstrip('.')
    section = parameter_table.text().split(f'## {title}')[1].split('##')[0]
    assert 'Of `decoder`, `all_in_one`.' in section


def test_a_row_gives_default_unit_bounds_and_meaning():
    default, unit, bounds, live, meaning = rows()['decoder.vector_sigma']
    assert (default, unit, bounds) == ('`0.2`', 'px', '0.01 … 10.0')
    assert (live, rows()['source'][3]) == ('live', '')
    assert meaning.startswith('standard deviation of a right vector')
    assert rows()['extraction.min_macroblocks'][2] == '≥ 4'
    assert rows()['source'][:3] == ["`''`", '-', '']
