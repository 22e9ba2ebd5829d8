"""The tables of all states of the nodes in the documentation, written from the states."""

import argparse
from pathlib import Path

from mv_slapse.states import ALL, Condition, CONDITIONS, Kind

HEAD = """# Diagnostics

Written by `make config` from `mv_slapse/states.py`; do not edit.

Each node publishes its state on `/diagnostics` once a second of real time, whatever `/clock`
does. The message begins with the kind of the state and says the reason and the next step; beside
it stand `state` (the kind), `condition` (the name below), counters, and what else holds. A node in
several conditions tells those of the worst kind.

| Kind | Level | Meaning |
| --- | --- | --- |
| failed | ERROR | nothing usable comes out, and will not before something is changed |
| waiting | WARN | nothing usable comes out yet, or no more |
| degraded | WARN | it works, not as well as it could |
| working | OK | something usable has come out in the last 3 s, and nothing hinders it |

Usable is: of `decoder` a pair that is not broken, of `plane_extraction` one whose motion is known,
of `slam` and `all_in_one` a pose that is tracked, of `obstacle_tracker` obstacles (none is an
answer as well) at a known pose. Values such as `tracking` are shown as `unknown` 3 s after the key
frame that told them.

Counters: `messages on TOPIC`, `rejected on TOPIC` (messages that say what cannot be), `unusable on
TOPIC`, `lost on TOPIC` (by the middleware), `faults`, `resets`, `key frame pairs`, `broken pairs`,
`packets dropped by overload`, `segments dropped by overload`, `gaps`, `observations dropped`,
`covariances repaired` (by the filter, where rounding had spoilt one). `publishers of TOPIC` is how
many the middleware has connected: 0 where a publisher is missing or its QoS does not fit.
"""
COLUMNS = ('Condition', 'Nodes', 'Meaning', 'Next step')


def text() -> str:
    """Return the page, with a table for each kind."""
    return HEAD + ''.join(map(_section, Kind))


def _section(kind: Kind) -> str:
    rows = [COLUMNS, ('---',) * len(COLUMNS),
            *(_row(key, found) for key, found in CONDITIONS.items() if found.kind is kind)]
    table = '\n'.join(f'| {" | ".join(row)} |' for row in rows)
    return f'\n## {kind.name.capitalize()}\n\n{table}\n'


def _row(key: str, condition: Condition) -> tuple[str, ...]:
    nodes = 'all' if condition.nodes == ALL else ', '.join(f'`{n}`' for n in condition.nodes)
    return f'`{key}`', nodes, condition.meaning, condition.next_step


def main() -> int:
    """Write the page into the file that the command line names."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument('file', type=Path)
    path = parser.parse_args().file
    path.write_text(text(), encoding='utf-8')
    print(path)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
