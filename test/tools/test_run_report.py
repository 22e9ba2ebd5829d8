from html.parser import HTMLParser
import re

import av
import cv2
from mv_slapse.evaluation.truth import LabelTable
from mv_slapse.records import Label
from mv_slapse.storage.tum import Trajectory
from mv_slapse.tools import main, overlay
from mv_slapse.tools.eval import Results
import numpy as np
import pytest


class Page(HTMLParser):
    """Titles, texts and sources of a page."""

    def __init__(self, text):
        super().__init__()
        self.titles, self.texts, self.sources, self._tag = [], [], [], ''
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self._tag = tag
        self.sources += [value for name, value in attrs if name in ('src', 'href')]

    def handle_data(self, data):
        (self.titles if self._tag == 'h2' else self.texts).append(data.strip())


@pytest.fixture(scope='module')
def folder(clip, tmp_path_factory):
    out = tmp_path_factory.mktemp('reported')
    assert main.main(['run', str(clip.video), '--camera', str(clip.camera), '-o', str(out),
                      '--set', 'scene.gate=17.5', '--overlay', str(out / 'shown.mp4'),
                      '--quiet']) == 0
    return out


def test_a_run_leaves_a_page_that_needs_no_network(folder):
    page = Page((folder / 'report.html').read_text())
    assert [title for title in page.titles if title] == [
        'What came out', 'The way, planes and obstacles', 'Over time', 'Time by stage',
        'Settings that are not the usual ones', 'Provenance']
    assert len(page.sources) == 3
    assert all(source.startswith('data:image/png;base64,') for source in page.sources)
    assert '{\n "scene.gate": 17.5\n}' in page.texts


def test_a_run_without_report_leaves_none(clip, tmp_path):
    assert main.main(['run', str(clip.video), '--camera', str(clip.camera), '-o', str(tmp_path),
                      '--no-report', '--quiet', '--max-frames', '8']) in (0, 4)
    assert not (tmp_path / 'report.html').exists()


def test_an_overlay_shows_every_picture_up_to_the_last_key_frame(folder, clip):
    with av.open(str(folder / 'shown.mp4')) as video, av.open(str(clip.video)) as given:
        shown = [frame.to_ndarray(format='bgr24') for frame in video.decode(video=0)]
        pictures = [frame.to_ndarray(format='gray') for frame in given.decode(video=0)]
    assert len(pictures) - 3 <= len(shown) <= len(pictures)
    assert shown[0].shape[:2] == pictures[0].shape
    apart = np.ptp(shown[5].astype(int), axis=2)  # colour, where the given one is grey
    assert np.mean(apart > 30) > 0.1
    grey = cv2.cvtColor(shown[5], cv2.COLOR_BGR2GRAY)
    assert np.corrcoef(grey.ravel(), pictures[5].ravel())[0, 1] > 0.8
    assert sorted(path.name for path in folder.glob('*part*')) == []


def test_blocks_and_boxes_lie_where_they_belong():
    x, y = (values.ravel() for values in np.meshgrid([8.0, 24, 40, 56], [8.0, 24]))
    label = np.full((1, 8), Label.UNKNOWN, int)
    label[0, 1], label[0, 6] = Label.MOVING, Label.STATIONARY
    plane = np.array([[-1, 7, -1, -1, -1, -1, 2, -1]])
    results = Results(Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4))), {},
                      {}, LabelTable(np.zeros(1, np.int64), x, y, label, plane), {})
    obstacle = {'id': [3.0], 'x': [36.0], 'y': [18.0], 'width': [10.0], 'height': [8.0],
                'vx': [3.0], 'vy': [0.0], 'vz': [4.0], 'ttc': [1.5]}
    image = np.full((32, 64, 3), 100, np.uint8)
    drawn = overlay.draw(image, results, 0, {k: np.array(v) for k, v in obstacle.items()})
    np.testing.assert_allclose(drawn[8, 18], 0.6 * 100 + 0.4 * np.array(overlay.RED), atol=1)
    np.testing.assert_allclose(drawn[30, 33], 0.6 * 100 + 0.4 * np.array(overlay.PLANES[2]),
                               atol=1)
    np.testing.assert_array_equal(drawn[26, 40], overlay.RED)
    assert (drawn[30, 50:] == 100).all()
    assert (image == 100).all()


def test_a_stream_cannot_be_read_twice(clip, tmp_path, capsys):
    with pytest.raises(overlay.UsageError, match='record it first'):
        overlay.write(tmp_path / 'a.mp4', 'rtsp://camera/1', tmp_path)


def test_the_version_is_told(capsys):
    with pytest.raises(SystemExit) as ended:
        main.main(['--version'])
    said = ''.join(capsys.readouterr())
    assert ended.value.code == 0
    assert re.match(r'mv_slapse \d+\.\d+\.\d+\n', said)
