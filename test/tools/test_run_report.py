from html.parser import HTMLParser
import json
import re
import shutil
import subprocess

import av
import cv2
from mv_slapse.records import TrackingStatus
from mv_slapse.tools import main, overlay, run_report
import numpy as np
import pytest

CHROMIUM = shutil.which('chromium') or shutil.which('google-chrome')
SHOWN = """<script>onload = () => document.title =
  [...document.images].map(image => image.complete && image.naturalWidth > 0)</script>"""


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


@pytest.mark.skipif(CHROMIUM is None, reason='Chromium is not installed (apt: chromium)')
def test_a_browser_shows_all_pictures_without_a_network(folder, tmp_path):
    page = tmp_path / 'report.html'
    page.write_text((folder / 'report.html').read_text() + SHOWN)
    said = subprocess.run(
        [CHROMIUM, '--headless', '--no-sandbox', '--disable-gpu', f'--user-data-dir={tmp_path}',
         '--host-resolver-rules=MAP * ~NOTFOUND', '--dump-dom', page.as_uri()],
        capture_output=True, text=True, timeout=100, check=True).stdout
    assert '<title>true,true,true</title>' in said


def test_both_views_of_a_way_sideways_leave_room_for_what_stands_beside_it():
    n, wall = 50, [0.0, -2.0, 8.0, 100.0, -2.0, 8.0, 100.0, 2.0, 8.0, 0.0, 2.0, 8.0]
    rows = {'status': np.full(n, TrackingStatus.OK), 'x': np.linspace(0, 100, n),
            'y': np.linspace(0, -0.5, n), 'z': np.linspace(0, -1, n),
            **{f'sigma_{name}': np.full(n, 0.1) for name in 'xyz'}}
    map_ = {'planes': [{'normal': [0.0, 0.0, 1.0], 'outline': wall}]}
    figure = run_report._way(rows, map_, {f'p{name}': np.zeros(0) for name in 'xyz'}, 'm')
    for axes in figure.axes:
        low, high = axes.get_xlim()
        assert low < -1 < 8 < high
    assert sorted(figure.axes[1].get_ylim())[0] < -2 < 2 < sorted(figure.axes[1].get_ylim())[1]


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


@pytest.mark.parametrize(('path', 'name', 'said'), [
    ('a.mp4', 'rtsp://camera/1', 'record it first'), ('a.txt', 'v.mp4', 'output format'),
    ('shown', 'v.mp4', 'output format'), ('a.webm', 'v.mp4', 'does not support'),
    ('', 'v.mp4', 'is a directory'), ('v.mp4', 'v.mp4', 'the input itself'),
    ('v.mp4/a.mp4', 'v.mp4', 'exists'), ('x' * 250 + '.mp4', 'v.mp4', 'too long')])
def test_an_overlay_that_cannot_be_is_refused_before_the_run(tmp_path, path, name, said):
    (tmp_path / 'v.mp4').write_text('a video')
    given = name if '://' in name else str(tmp_path / name)
    with pytest.raises(overlay.UsageError, match=f'--overlay .*{said}'):
        overlay.check(tmp_path / path, given)
    assert [found.name for found in tmp_path.iterdir()] == ['v.mp4']
    assert (tmp_path / 'v.mp4').read_text() == 'a video'


def test_the_folder_of_an_overlay_is_made(tmp_path):
    overlay.check(tmp_path / 'new' / 'a.mp4', str(tmp_path / 'v.mp4'))
    assert list(tmp_path.rglob('*')) == [tmp_path / 'new']


def test_a_wrong_overlay_costs_no_run(call, clip, tmp_path):
    code, out, err = call('run', clip.video, '--camera', clip.camera, '-o', tmp_path / 'out',
                          '--overlay', tmp_path / 'a.txt', '--json')
    assert code == 2
    assert 'a fault of mv_slapse' not in err
    assert json.loads(out)['exit_code'] == 2
    assert not (tmp_path / 'out').exists()


def test_one_object_is_printed_where_the_overlay_fails(call, clip, tmp_path, monkeypatch):
    monkeypatch.setattr(overlay, 'check', lambda *_: None)
    code, out, err = call('run', clip.video, '--camera', clip.camera, '-o', tmp_path / 'out',
                          '--overlay', tmp_path / 'a.txt', '--json', '--max-frames', 9)
    assert code == 3
    assert json.loads(out) == {'error': err.split(': ', 1)[1].strip(), 'exit_code': 3}
    assert 'a.txt' in err
    assert (tmp_path / 'out' / 'summary.json').exists()


def test_the_version_is_told(capsys):
    with pytest.raises(SystemExit) as ended:
        main.main(['--version'])
    said = ''.join(capsys.readouterr())
    assert ended.value.code == 0
    assert re.match(r'mv_slapse \d+\.\d+\.\d+\n', said)
