import json

from mv_slapse.errors import UnusableInput
from mv_slapse.evaluation import truth
from mv_slapse.evaluation.truth import LabelTable
import numpy as np
import pytest

SCENE = {'planes': [{'id': 3, 'name': 'wall', 'normal': [0, 0, -1], 'depth': 9.0, 'polygon': []}]}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / 'ground_truth.tum').write_text('0 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0 1\n')
    (tmp_path / 'scene.json').write_text(json.dumps(SCENE))
    (tmp_path / 'movers.csv').write_text(truth.MOVER_COLUMNS + '\n' + ','.join('1' * 17) + '\n')
    np.savez(tmp_path / 'truth_labels.npz', stamp=[0.0, 0.1], x=[7.5], y=[7.5],
             label=np.zeros((2, 1), np.int8), plane=np.full((2, 1), 3, np.int32))
    return tmp_path


def test_a_folder_is_read_whole(folder):
    found = truth.read_truth(folder)
    assert len(found.trajectory) == 2
    assert (found.planes[0].id, found.planes[0].name, found.planes[0].depth) == (3, 'wall', 9)
    assert found.movers['stamp'][0] == 10**9
    np.testing.assert_array_equal(found.labels.stamps, [0, 10**8])


def test_a_file_is_a_trajectory(folder):
    found = truth.read_truth(folder / 'ground_truth.tum')
    assert len(found.trajectory) == 2
    assert found.planes is None


def test_what_is_missing_in_a_folder_stays_unknown(folder):
    for name in ('scene.json', 'movers.csv', 'truth_labels.npz'):
        (folder / name).unlink()
    found = truth.read_truth(folder)
    assert (found.planes, found.movers, found.labels) == (None, None, None)


def test_a_folder_without_truth_is_refused(tmp_path):
    with pytest.raises(UnusableInput, match='holds no truth'):
        truth.read_truth(tmp_path)


@pytest.mark.parametrize('name', ['scene.json', 'truth_labels.npz', 'movers.csv'])
def test_a_broken_file_is_refused_by_name(folder, name):
    (folder / name).write_text('{"planes": [{}]}')
    with pytest.raises(UnusableInput, match=name):
        truth.read_truth(folder)


def test_tables_are_cut_to_their_common_blocks():
    def table(x, label):
        return LabelTable(np.array([0]), np.array(x), np.zeros(len(x)), np.array([label]),
                          np.array([label]))

    a, b = truth.on_common_blocks(table([7.5, 23.5, 39.5], [0, 1, 2]),
                                  table([39.5, 7.5], [5, 6]))
    np.testing.assert_array_equal(a.x, b.x)
    np.testing.assert_array_equal(a.label, [[0, 2]])
    np.testing.assert_array_equal(b.label, [[6, 5]])
