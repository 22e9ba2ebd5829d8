import re

import cv2
from mv_slapse.config import EncoderSettings
from mv_slapse.errors import UnusableInput
from mv_slapse.storage import picture_folder
from mv_slapse.storage.picture_folder import entries, Entry
from mv_slapse.tools.inputs import open_input
import numpy as np
import pytest

STAMP = 1403636579763555584  # [ns], of the form that EuRoC has


def store(folder, names):
    """Write pictures whose grey value counts them."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full((8, 12, 3), 10 * i, np.uint8))
    return [folder / name for name in names]


def test_kitti_odometry(tmp_path):
    paths = store(tmp_path / 'image_0', ['000000.png', '000001.png', '000002.png'])
    store(tmp_path / 'image_1', ['000000.png'])
    (tmp_path / 'times.txt').write_text('0.000000e+00\n1.037360e-01\n2.074718e-01\n')
    expected = [*map(Entry, paths, [0, 103736000, 207471800])]
    assert entries(str(tmp_path)) == expected
    assert entries(str(tmp_path / 'image_0')) == expected
    assert entries(str(tmp_path / 'image_0' / '%06d.png')) == expected


def test_kitti_raw(tmp_path):
    paths = store(tmp_path / 'image_00' / 'data', ['0000000000.png', '0000000001.png'])
    (tmp_path / 'image_00' / 'timestamps.txt').write_text(
        '2011-09-26 13:02:25.594360375\n2011-09-26 13:02:25.697764000\n')
    found = entries(str(tmp_path))
    assert [path for path, _ in found] == paths
    assert found[0].stamp == 1317042145594360375
    assert found[1].stamp - found[0].stamp == 103403625


def test_euroc(tmp_path):
    camera = tmp_path / 'mav0' / 'cam0'
    paths = store(camera / 'data', [f'{STAMP + i}.png' for i in (0, 50_000_000)])
    (camera / 'data.csv').write_text('#timestamp [ns],filename\r\n' + ''.join(
        f'{path.stem},{path.name}\r\n' for path in paths))
    expected = [*map(Entry, paths, [STAMP, STAMP + 50_000_000])]
    for name in (tmp_path, camera, camera / 'data'):
        assert entries(str(name)) == expected


def test_tum(tmp_path):
    paths = store(tmp_path / 'rgb', ['1305031102.175304.png', '1305031102.211214.png'])
    store(tmp_path / 'depth', ['1305031102.160407.png'])
    (tmp_path / 'rgb.txt').write_text('# color images\n# file: x.bag\n' + ''.join(
        f'{path.stem} rgb/{path.name}\n' for path in paths))
    for name in (tmp_path, tmp_path / 'rgb'):
        assert entries(str(name)) == [*map(Entry, paths, [1305031102175304000,
                                                          1305031102211214000])]


def test_pictures_without_times_need_a_rate(tmp_path):
    paths = store(tmp_path, ['a1.jpg', 'a2.jpg', 'a3.jpg', 'b1.jpg'])
    with pytest.raises(UnusableInput, match='--set encoder.rate=30'):
        entries(str(tmp_path))
    assert entries(str(tmp_path / 'a%d.jpg'), 4.0) == [
        *map(Entry, paths[:3], [0, 250_000_000, 500_000_000])]


@pytest.mark.parametrize('names', [
    [f'{i}.png' for i in range(12)], [f'left{i}_0.png' for i in (8, 9, 10, 100)],
    ['000009.png', '000010.png', '000100.png'], ['a.png', 'a1.png', 'a02.png', 'b.png']])
def test_numbers_in_names_count_by_their_value(tmp_path, names):
    paths = store(tmp_path, names)
    assert [path for path, _ in entries(str(tmp_path), 1.0)] == paths


def test_what_exists_is_no_pattern(tmp_path):
    video, folder = tmp_path / 'my%20drive.mp4', tmp_path / 'a%20d'
    video.touch()
    paths = store(folder, ['1.png', '2.png'])
    assert not picture_folder.is_folder(str(video))
    for name in (folder, folder / '%d.png'):
        assert picture_folder.is_folder(str(name))
        assert [path for path, _ in entries(str(name), 1.0)] == paths


def test_pictures_are_read_in_grey(tmp_path):
    store(tmp_path, ['1.png', '2.png', '3.bmp'])
    images = [picture.image for picture in picture_folder.pictures(entries(str(tmp_path), 1.0))]
    assert [(image.shape, image[0, 0]) for image in images] == [((8, 12), 0), ((8, 12), 10),
                                                                ((8, 12), 20)]


@pytest.mark.parametrize(('name', 'content', 'match'), [
    ('times.txt', '0.0\n', '2 pictures and 1 times'), ('times.txt', '0.0\nlate\n', 'is no time'),
    ('data.csv', '#time\n1\n', 'cannot be'), ('data.csv', 'x,1.png\n', 'cannot be'),
    ('timestamps.txt', '2011-13-26 13:02:25.5\n', 'is no time'),
    ('times.txt', '1e400\n0\n', 'is no time')])
def test_times_that_do_not_fit_are_refused(tmp_path, name, content, match):
    store(tmp_path, ['1.png', '2.png'])
    (tmp_path / name).write_text(content)
    with pytest.raises(UnusableInput, match=match):
        entries(str(tmp_path))


def test_what_is_no_picture_is_refused(tmp_path):
    (tmp_path / 'none').mkdir()
    for name in (tmp_path / 'none', tmp_path / 'no' / '%d.png'):
        with pytest.raises(UnusableInput, match='no pictures there'):
            entries(str(name), 1.0)
    large = bytearray(cv2.imencode('.png', np.zeros((8, 8), np.uint8))[1].tobytes())
    large[16:24] = (100_000).to_bytes(4, 'big') * 2
    for content in (b'', b'abc', bytes(large)):
        (tmp_path / '1.png').write_bytes(content)
        with pytest.raises(UnusableInput, match='1.png is no picture'):
            list(picture_folder.pictures(entries(str(tmp_path), 1.0)))


def test_hidden_files_are_passed_over(tmp_path):
    paths = store(tmp_path, ['000000.png', '000001.png'])
    (tmp_path / '._000000.png').write_bytes(b'of macOS')
    assert [entry.path for entry in entries(str(tmp_path), 10)] == paths


@pytest.mark.parametrize(('names', 'said'), [
    (['00.png', '01.png', '02.png', '06.png'], 'leave out numbers, first after 2;'),
    ([f'f_{i}.png' for i in (0, 5, 10, 15, 25)], 'leave out numbers, first after 15;'),
    (['0.jpg', '0.png', '1.jpg', '1.png', '2.png'], '^2 pictures are there with more than .*/0,'),
    (['a1.png', 'a2.png', 'a3.png', 'b9.png'], '^$'), (['3.png', '11.png', '12.png'], '^$'),
    (['1.png', '2.png', '3.png'], '^$'), (['a.png', 'b.png'], '^$'), (['5.png'], '^$')])
def test_names_that_tell_of_missing_or_double_pictures_give_a_warning(tmp_path, names, said):
    store(tmp_path, names)
    assert re.search(said, picture_folder.warning(entries(str(tmp_path), 10)))
    with open_input(str(tmp_path), encoder=EncoderSettings(rate=10.0)) as video:
        assert re.search(said, video.warning)


@pytest.mark.parametrize(('times', 'said'), [
    ('0.0\n0.1\nnan\n', "times.txt, line 3: 'nan' is no time; give seconds"),
    ('0\n100000000\n200000000\n', 'are 1e[+]08 s apart; give seconds, not nanoseconds'),
    (f'{STAMP}\n{STAMP + 1}\n{STAMP + 2}\n', "line 1: '1403.*' is no time; give seconds")])
def test_times_that_are_no_seconds_are_refused_with_their_line(tmp_path, times, said):
    store(tmp_path, ['0.png', '1.png', '2.png'])
    (tmp_path / 'times.txt').write_text(times)
    with pytest.raises(UnusableInput, match=said):
        entries(str(tmp_path))
