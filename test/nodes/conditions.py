"""Waiting for conditions of states.CONDITIONS, and which of them a node has been in."""

from mv_slapse.states import CONDITIONS, Kind
from nodes.bench import messages_of, value_of

LEVELS = dict(zip(Kind, (b'\x02', b'\x01', b'\x01', b'\x00'), strict=True))
SEEN = {}  # node -> conditions that it has been in, the last one at the end


def state(node):
    return value_of(node, 'condition')


def note(node):
    SEEN.setdefault(node, []).append(state(node))


def reaches(bench, node, key, said=''):
    """Wait for a condition; level, kind and words are those of the table."""
    assert bench.spin(lambda: state(node) == key, 10), messages_of(node)
    note(node)
    assert said in messages_of(node)
    if key != 'rejected':
        kind = CONDITIONS[key].kind
        assert value_of(node, 'state') == kind.name.lower()
        assert node.health.status().level == LEVELS[kind]


def leaves(bench, node, key):
    assert bench.spin(lambda: state(node) != key, 10), messages_of(node)
    note(node)
