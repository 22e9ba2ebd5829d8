from dataclasses import replace

import made_up
from mv_slapse.errors import UnusableInput
from mv_slapse.records import Speed
from mv_slapse.storage import tables
import numpy as np
from numpy.testing import assert_allclose
import pytest


def read(tmp_path, header, rows):
    path = tmp_path / 'table.csv'
    path.write_text('\n'.join([header, *rows]) + '\n')
    return tables.read_table(path, header)


def test_planes_hold_the_same_points_in_the_camera(rng, tmp_path):
    scene = made_up.scene(rng)
    plane = scene.planes[0]
    X_world = rng.normal(size=(4, 3))
    X_world -= (X_world @ plane.normal + plane.depth)[:, None] * plane.normal
    X_cam = (X_world - scene.t_world_from_cam) @ scene.R_world_from_cam
    table = read(tmp_path, tables.PLANES_HEADER, tables.plane_rows(scene))
    normal = np.array([table[name][0] for name in ('nx', 'ny', 'nz')])
    assert_allclose(np.linalg.norm(normal), 1, atol=1e-8)
    assert_allclose(X_cam @ normal + table['d'][0], 0, atol=1e-7)
    assert table['d'][0] >= 0
    assert (table['stamp'][0], table['id'][0], table['n_macroblocks'][0]) == (scene.stamp, 7, 42)


def test_a_plane_that_is_not_seen_has_no_row(rng):
    scene = made_up.scene(rng)
    unseen = replace(scene, planes=(replace(scene.planes[0], n_macroblocks=0),))
    assert list(tables.plane_rows(unseen)) == []


def test_an_obstacle_comes_back_from_its_row(rng, tmp_path):
    obstacle = made_up.obstacle(rng)
    table = read(tmp_path, tables.OBSTACLES_HEADER, [tables.obstacle_row(obstacle)])
    row = {name: values[0] for name, values in table.items()}
    assert (row['stamp'], row['id'], row['state']) == (obstacle.stamp, 9, 'confirmed')
    assert_allclose([row[name] for name in ('x', 'y', 'width', 'height')], obstacle.box)
    assert_allclose([row['px'], row['py'], row['pz']], obstacle.position, rtol=1e-8)
    assert_allclose([row['vx'], row['vy'], row['vz']], obstacle.velocity, rtol=1e-8)
    assert row['ttc'] == np.inf


def test_speeds_come_back_with_every_digit_of_their_stamps(tmp_path):
    speeds = [Speed(1_700_000_000_123_456_789, 8.25), Speed(1_700_000_000_223_456_789, -0.5)]
    tables.write_speeds(tmp_path / 'speeds.csv', speeds)
    assert tables.read_speeds(tmp_path / 'speeds.csv') == speeds


@pytest.mark.parametrize(('text', 'message'), [('time,speed\n0,1\n', 'no column stamp'),
                                               ('stamp,speed\n0,fast\n', 'column speed'),
                                               ('stamp,speed\n0,1\n1.5,nan\n',
                                                'at stamp 1.500000000 is nan m/s'),
                                               ('stamp,speed\n0,inf\n', 'stamp 0.0+ is inf'),
                                               ('stamp,speed\n0,-1001\n', '-1001 m/s, which no '
                                                'vehicle has .at most 1000.; correct it'),
                                               ('stamp,speed\n1403636579763555584,1\n',
                                                "stamps are in seconds: '1403636579763555584'")])
def test_a_table_that_holds_no_speeds_is_refused(tmp_path, text, message):
    (tmp_path / 'speeds.csv').write_text(text)
    with pytest.raises(UnusableInput, match=message):
        tables.read_speeds(tmp_path / 'speeds.csv')


def test_a_table_may_begin_as_spreadsheets_write_it(tmp_path):
    (tmp_path / 'speeds.csv').write_bytes(b'\xef\xbb\xbfstamp,speed\r\n1,1000\r\n')
    assert tables.read_speeds(tmp_path / 'speeds.csv') == [Speed(1_000_000_000, 1000.0)]


def test_empty_rows_of_a_table_are_none(tmp_path):
    (tmp_path / 'table.csv').write_text('a,id\n1,2\n\n ,,\n3,4\n\n')
    assert list(tables.read_table(tmp_path / 'table.csv', 'a,id')['a']) == [1, 3]


def test_a_table_without_rows_has_empty_columns(tmp_path):
    table = read(tmp_path, tables.PLANES_HEADER, [])
    assert [len(values) for values in table.values()] == [0] * 7


@pytest.mark.parametrize(('text', 'message'), [('a,b\n1,2\n', 'no column id'),
                                               ('a,id\n1,two\n', 'column id is not a number'),
                                               ('a,id\n1,2\n\n1\n', 'row 4 has 1 values for 2'),
                                               ('a,id\n1,2,\n', 'row 2 has 3 values for 2'),
                                               ('', 'no column a, id')])
def test_a_wrong_table_is_refused(tmp_path, text, message):
    (tmp_path / 'table.csv').write_text(text)
    with pytest.raises(UnusableInput, match=message):
        tables.read_table(tmp_path / 'table.csv', 'a,id')
