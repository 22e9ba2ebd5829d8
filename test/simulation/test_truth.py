import json

from mv_slapse.records import Label
from mv_slapse.simulation import drawn, truth
from mv_slapse.simulation.render import Renderer
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import pytest

MOVERS = ('slower', 'faster', 'oncoming')


@pytest.fixture(scope='module')
def street():
    return Street(StreetSettings(seed=5, n_frames=4, fps=10.0, movers=MOVERS))


@pytest.fixture(scope='module')
def folder(street, tmp_path_factory):
    path = tmp_path_factory.mktemp('truth')
    assert len(list(truth.film(street, path))) == 4
    return path


def read_movers(folder):
    return np.genfromtxt(folder / 'movers.csv', delimiter=',', names=True)


def test_a_block_has_the_surface_that_covers_more_than_half_of_it():
    surface = np.zeros((40, 48), int)
    surface[:16, :9] = 7
    surface[:16, 16:24] = 1000
    surface[16:32, 16:26] = -1
    expected = [7, truth.NONE, 0, 0, -1, 0]
    np.testing.assert_array_equal(truth.block_surfaces(surface), expected)


def test_labels_of_blocks_agree_with_the_rays_through_their_centres(street):
    surface = Renderer(street).frame(2).surface
    blocks = truth.block_surfaces(surface)
    _, expected, _ = drawn.match(street, 2, 2, drawn.block_centres(640, 480))
    assert np.mean(blocks[blocks != truth.NONE] != expected[blocks != truth.NONE]) < 0.05


def test_the_folder_holds_a_label_and_a_surface_for_every_block_of_every_frame(folder):
    archive = np.load(folder / 'truth_labels.npz')
    assert archive['label'].shape == archive['plane'].shape == (4, 1200)
    assert (archive['label'].dtype, archive['plane'].dtype) == (np.int8, np.int32)
    np.testing.assert_allclose(archive['stamp'], [0, 0.1, 0.2, 0.3])
    assert (archive['x'][1], archive['y'][0]) == (23.5, 7.5)
    moving = archive['label'] == Label.MOVING
    assert set(np.unique(archive['plane'][moving])) <= {1000, 1001, 1002}
    assert np.all(archive['plane'][archive['label'] == Label.INFINITY] == -1)
    assert np.all(archive['plane'][archive['label'] == Label.STATIONARY] >= 0)


def test_the_pose_file_holds_the_poses_of_the_street(folder, street):
    rows = np.loadtxt(folder / 'ground_truth.tum')
    np.testing.assert_allclose(rows[0], [0, 0, 0, 0, 0, 0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(rows[3, 1:4], street.pose(3)[1], atol=1e-9)


def test_the_scene_file_holds_every_plane_with_an_outline_on_it(folder, street):
    scene = json.loads((folder / 'scene.json').read_text())
    assert [plane['name'] for plane in scene['planes']] == list(street.names)
    assert [mover['id'] for mover in scene['movers']] == [1000, 1001, 1002]
    assert (scene['schema_version'], scene['camera_height']) == (1, 1.65)
    for plane in scene['planes']:
        polygon = np.array(plane['polygon'])
        np.testing.assert_allclose(polygon @ plane['normal'], -plane['depth'], atol=1e-5)
        assert len(polygon) >= 3


def test_the_stated_velocity_is_the_change_of_the_stated_position(folder):
    table = read_movers(folder)
    for id_ in (1000, 1001):
        rows = table[table['id'] == id_]
        position = np.c_[rows['px'], rows['py'], rows['pz']]
        velocity = np.c_[rows['vx'], rows['vy'], rows['vz']]
        np.testing.assert_allclose(np.diff(position, axis=0) / 0.1, velocity[:-1], atol=1e-5)


def test_boxes_contain_the_projected_position(folder, street):
    rows = read_movers(folder)
    for row in rows[rows['n_macroblocks'] > 5]:   # others may be half hidden
        R, t = street.pose(round(row['stamp'] * 10))
        X = R.T @ (np.array([row['px'], row['py'], row['pz']]) - t)
        x, y = (street.camera.K @ X)[:2] / X[2]
        assert row['x'] - 1 <= x <= row['x'] + row['width'] + 1
        assert row['y'] - 1 <= y <= row['y'] + row['height'] + 1


def test_contact_comes_after_the_stated_time():
    settings = StreetSettings(seed=5, movers=MOVERS, sway=0.0, vibration=0.0)
    street = Street(settings)
    surface = np.full((480, 640), 1000)
    contact = truth.mover_truths(street, 0, surface, np.zeros(1)[:0])[0].time_to_contact
    rear = street.mover(1000).face_towards(street.ride.pose(0.0)[1], contact).centre
    np.testing.assert_allclose(street.ride.pose(contact)[1][2], rear[2], atol=1e-6)
    away = truth.mover_truths(street, 0, surface + 1, np.zeros(1)[:0])[0]
    assert away.time_to_contact == np.inf


def test_a_car_that_starts_changes_its_label():
    street = Street(StreetSettings(seed=1, movers=('starting',)))
    surface = np.array([1000])
    assert drawn.labels(street, surface, 1.0) == Label.STATIONARY
    assert drawn.labels(street, surface, 3.0) == Label.MOVING


def test_the_box_spans_the_visible_pixels(street):
    surface = np.full((480, 640), 0)
    surface[100:120, 30:70] = 1000
    found = truth.mover_truths(street, 0, surface, truth.block_surfaces(surface))
    np.testing.assert_array_equal(found[0].box, [30, 100, 40, 20])
    assert (len(found), found[0].n_macroblocks) == (1, 2)


def test_a_car_that_stops_changes_its_label():
    street = Street(StreetSettings(seed=1, movers=('stopping',)))
    assert drawn.labels(street, np.array([1000]), 0.4) == Label.MOVING
    assert drawn.labels(street, np.array([1000]), 2.4) == Label.STATIONARY
