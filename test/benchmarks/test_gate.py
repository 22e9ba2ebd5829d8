"""Two measurements side by side: what counts as worse."""

import json

import gate
import pytest


def clips(found, still):
    """Return rows of five clips with their altered versions."""
    return {f'{folder}seq{i}{version}/mpeg2.mpg':
            {'movers_found': found, 'stationary_called_moving_percent': still + add}
            for i in range(5) for folder, version, add in (
                ('moving/', '', 0.0), ('', ', mirrored', 0.1), ('', ', cut', -0.1))}


def street(ate, noise=''):
    return {f'street {i}{noise}/{name}': {'ate_mean_percent': ate * factor, 'pose_nees': 6.0}
            for i in range(4) for name, factor in (('mpeg2.mpg', 1.0), ('h264.mp4', 2.0))}


def flagged(before, after, altered=None):
    return {(change.group, change.measure.name)
            for change in gate.changes(before, after, altered) if change.is_flagged}


def test_a_group_is_a_scene_in_all_its_encodings():
    assert list(gate.groups(clips(1, 1.0)))[:2] == ['seq0', 'seq0, mirrored']
    assert len(gate.groups(street(0.1))['street 0']) == 2


def test_what_differs_less_than_versions_of_a_clip_is_not_flagged():
    before, after = clips(2, 1.0), clips(2, 1.0)
    after['moving/seq0/mpeg2.mpg']['stationary_called_moving_percent'] = 1.19
    assert not flagged(before, after)
    after['moving/seq0/mpeg2.mpg']['stationary_called_moving_percent'] = 1.25  # scatter 0.1
    assert flagged(before, after) == {('seq0', 'still so [%]')}
    assert not flagged(after, before)


def test_a_mover_that_is_lost_in_every_clip_alike_is_flagged():
    before = {name: dict(row) for name, row in clips(2, 1.0).items()}
    after = {name: dict(row) for name, row in before.items()}
    after['moving/seq1/mpeg2.mpg']['movers_found'] = 0
    assert flagged(before, after) == {('seq1', 'found')}


def test_the_scatter_of_the_way_comes_from_pictures_with_noise():
    before, after = street(0.10), street(0.11)
    assert {group for group, _ in flagged(before, after)} == {f'street {i}' for i in range(4)}
    assert not flagged(before, after, street(0.12, ', noise'))


def test_a_group_without_versions_has_the_usual_scatter():
    rows = clips(2, 1.0) | {'other/mpeg2.mpg': {'stationary_called_moving_percent': 1.0}}
    spread = gate.scatter(rows, gate.MEASURES[2])
    assert spread('other') == pytest.approx(0.1)


def test_nees_is_worse_where_it_is_farther_from_six():
    def rows(nees):
        return {'a/b.mp4': {'pose_nees': nees}}
    for better, worse in ((6.0, 9.0), (4.0, 2.0), (7.0, 2.0)):
        assert flagged(rows(better), rows(worse))
        assert not flagged(rows(worse), rows(better))


def test_files_are_compared_and_the_exit_code_tells(tmp_path, capsys):
    for name, ate in (('a', 0.1), ('b', 0.2)):
        content = {'commit': name, 'code': '', 'rows': street(ate)}
        (tmp_path / name).write_text(gate.written(content))
    assert json.loads((tmp_path / 'a').read_text())['rows'] == street(0.1)
    assert gate.main(['compare', str(tmp_path / 'a'), str(tmp_path / 'a')]) == 0
    assert 'rows without any difference: 8 of 8' in capsys.readouterr().out
    assert gate.main(['compare', str(tmp_path / 'a'), str(tmp_path / 'b')]) == 1
    assert 'x 2.000' in capsys.readouterr().out
