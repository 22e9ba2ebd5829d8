"""Rules are switched off as the table says, and what they earn is told from chance."""

import inspect
from pathlib import Path
import subprocess
import sys

import ablation
from mv_slapse.codec.encoding.encoder import LOW_LATENCY, write_video
from mv_slapse.simulation.render import Renderer
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.storage.camera_info import write_camera
import pytest
import rules

RULE = rules.BY_NAME['terrain']
# Each rule in a process of its own, which goes on from where the libraries are loaded.
WITHOUT_EACH = """
import os, sys, traceback
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import rules
from mv_slapse.pipeline import Slapse
from mv_slapse.records import Label
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.tools import rows
folder = Path(sys.argv[2])
camera = read_camera(folder / 'camera.yaml')

def run():
    settings = rows.settings_of(type('Case', (), {'height': 1.65}))
    slapse = Slapse(camera, settings)
    pairs = rows.decode(folder / 'street.mp4', camera, settings).pairs
    return [slapse.step(pair).extraction for pair in pairs]

# Else rules of movers have nothing to do.
assert any(Label.MOVING in extraction.label for extraction in run())
for rule in rules.RULES:
    child = os.fork()
    if not child:
        try:
            rules.switch_off(rule.name)
            run()
        except Exception:
            print(rule.name, traceback.format_exc(), flush=True)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        print(rule.name, 'ended the process', flush=True)
"""


@pytest.mark.parametrize('path', sorted({path for rule in rules.RULES for path in rule.off}))
def test_what_a_rule_replaces_is_there(path):
    holder, name = rules.place(path)
    assert inspect.getattr_static(holder, name) is not None


def test_without_any_rule_a_drive_among_cars_is_measured(tmp_path):
    street = Street(StreetSettings(n_frames=9, movers=('slower', 'faster', 'oncoming')))
    write_camera(tmp_path / 'camera.yaml', street.camera)
    write_video(tmp_path / 'street.mp4', (frame.image for frame in Renderer(street).frames()),
                street.settings.fps, LOW_LATENCY)
    said = subprocess.run(
        [sys.executable, '-c', WITHOUT_EACH, str(Path(rules.__file__).parent), str(tmp_path)],
        check=True, capture_output=True, text=True).stdout
    assert not said


def test_what_a_rule_changes_of_a_policy_is_in_it():
    for rule in rules.RULES:
        for path, new in rule.off.items():
            if path.endswith('POLICY'):
                holder, name = rules.place(path)
                assert new(getattr(holder, name)) != getattr(holder, name)


def test_settings_of_rules_are_there():
    from mv_slapse.tools import rows
    case = type('Case', (), {'height': 1.0})
    for rule in rules.RULES:
        if rule.settings:
            changed = rules.with_settings(rows.settings_of, rule.settings, case)
            assert changed != rows.settings_of(case)


def test_no_two_rules_share_a_name_or_a_content():
    assert len({rule.name for rule in rules.RULES}) == len(rules.RULES)
    assert len({rule.content for rule in rules.RULES}) == len(rules.RULES)


def test_a_function_is_replaced_wherever_it_was_imported():
    code = f"""
import sys
sys.path.insert(0, {str(rules.__file__.rpartition('/')[0])!r})
import numpy as np, rules
rules.switch_off('body')
rules.switch_off('terrain')
rules.switch_off('iterations beyond 2')
from mv_slapse.movers import body, outlines
from mv_slapse.tools import rows
regions = type('Regions', (), {{'members': [1], 'first': [2]}})
assert body.with_bodies(regions, (3, 4))[:2] == ([1], [2])
assert outlines.RULES.dependence == np.inf
assert rows.settings_of(type('Case', (), {{'height': 0.0}})).scene.iterations == 2
"""
    subprocess.run([sys.executable, '-c', code], check=True)


def street(ate, n=3):
    return {f'street {i}/mpeg2.mpg': {'ate_mean_percent': ate, 'cpu_ms': 2.0} for i in range(n)}


@pytest.mark.parametrize(('ate', 'verdict'), [
    (0.1, 'nothing beyond scatter'), (0.11, 'nothing beyond scatter'), (0.2, 'earns'),
    (0.05, 'costs more than it earns')])
def test_a_rule_earns_what_is_worse_without_it(ate, verdict):
    altered = {f'street {i}, noise/mpeg2.mpg': {'ate_mean_percent': 0.12} for i in range(3)}
    found = ablation.Verdict(RULE, street(0.1), street(ate), altered)
    assert found.judgement == verdict
    assert found.over_all('ln ATE') == f'× {ate / 0.1:.3f}'
    assert found.same == (3 if ate == 0.1 else 0)


def test_what_is_a_little_worse_in_row_after_row_is_earned_too():
    altered = {f'street {i}, noise/mpeg2.mpg': {'ate_mean_percent': 0.2} for i in range(8)}
    before, after = street(0.1, 8), street(0.11, 8)
    found = ablation.Verdict(RULE, before, after, altered)
    assert not found.earned
    assert found.single == (8, 0)
    assert found.judgement == 'earns a little, row after row'
    mixed = {name: after[name] if i % 2 else before[name] | {'ate_mean_percent': 0.09}
             for i, name in enumerate(before)}
    assert ablation.Verdict(RULE, before, mixed, altered).judgement == 'nothing beyond scatter'


def test_a_row_that_fails_without_a_rule_needs_it():
    after = street(0.1) | {'street 1/mpeg2.mpg': {'error': 'lost'}}
    assert 'needed' in ablation.Verdict(RULE, street(0.1), after, {}).judgement


def test_a_third_holds_one_encoding_of_each_scene():
    assert [ablation.a_third(i, ['a', 'b', 'c']) for i in range(4)] == [['a'], ['b'], ['c'], ['a']]


def test_rules_are_measured_once_and_written_down(tmp_path, monkeypatch):
    measured = []

    def measure(scenes, cache, pool, tell, choose):
        measured.append((cache.label, pool.change))
        return street(0.1 if pool.change is None else 0.3)

    monkeypatch.setattr(ablation, 'measure_all', measure)
    page = tmp_path / 'page.md'
    assert ablation.main(['--rules', 'terrain, body', '--cache', str(tmp_path), '-o',
                          str(page), '--data', str(tmp_path)]) == 0
    assert len({label for label, _ in measured}) == 3
    assert [change and change.args for _, change in measured] == [None, ('terrain',), ('body',)]
    text = page.read_text()
    assert '| terrain | earns | 3, 0 | 3, 0 | 0 of 3 | × 3.000 |' in text
    assert 'street 0, ATE: 0.1000 → 0.3000' in text
