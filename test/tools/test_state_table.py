from pathlib import Path

from mv_slapse.nodes.settings import NODE_SETTINGS
from mv_slapse.states import CONDITIONS, Kind
from mv_slapse.tools import state_table

PAGE = Path(__file__).resolve().parents[2] / 'docs' / 'diagnostics.md'


def test_the_page_of_the_documentation_is_the_one_that_the_states_give():
    assert PAGE.read_text(encoding='utf-8') == state_table.text(), 'run make config'


def test_every_condition_says_what_to_do_next_and_whom_it_concerns():
    for key, condition in CONDITIONS.items():
        assert condition.next_step or condition.kind is Kind.WORKING, key
        assert set(condition.nodes) <= set(NODE_SETTINGS), key
        assert '|' not in condition.meaning + condition.next_step


def test_every_condition_has_a_row_below_its_kind():
    for key, condition in CONDITIONS.items():
        section = state_table.text().split(f'## {condition.kind.name.capitalize()}')[1]
        assert f'| `{key}` |' in section.split('##')[0]
