"""What a batch must not write over."""

from pathlib import Path

from mv_slapse.errors import UnusableOutput, UsageError
from mv_slapse.tools.batch import places
import pytest


@pytest.fixture
def data(tmp_path):
    """Return a folder with a bag and a camera."""
    (tmp_path / 'bags' / 'drive').mkdir(parents=True)
    (tmp_path / 'bags' / 'drive' / 'metadata.yaml').touch()
    (tmp_path / 'camera.yaml').touch()
    return tmp_path


@pytest.mark.parametrize(('output', 'name'), [
    ('bags', 'drive'), ('.', 'bags'), ('.', 'camera.yaml'), ('bags/drive', 'drive'),
    ('bags/drive/out', 'drive'), ('link', 'drive')])
def test_results_do_not_go_where_something_is_read(data, output, name):
    (data / 'link').symlink_to(data / 'bags')
    read = [str(data / 'bags' / 'drive'), str(data / 'camera.yaml')]
    with pytest.raises(UsageError, match=r'would replace .*, which is read.* -o'):
        places.check(data / output, ['other', name], read)


def test_results_may_lie_beside_what_is_read(data):
    read = [str(data / 'bags' / 'drive'), str(data / 'camera.yaml'), '/odom', '']
    places.check(data, ['drive', 'odom', 'camera'], read)
    places.check(data / 'bags' / 'out', ['drive', 'camera.yaml'], read)


@pytest.mark.parametrize('name', [places.TABLE, places.PAGE])
def test_a_table_that_no_batch_wrote_stays(tmp_path, name):
    (tmp_path / name).touch()
    with pytest.raises(UsageError, match=f'{name} is there and no batch wrote it'):
        places.check(tmp_path, [], [])
    (tmp_path / places.LOCK).touch()
    places.check(tmp_path, [], [])


def test_only_a_folder_of_a_run_is_replaced(tmp_path):
    place = tmp_path / 'a.mp4'
    places.check_replaceable(place)
    place.mkdir()
    places.check_replaceable(place)
    (place / 'mine.txt').touch()
    with pytest.raises(UnusableOutput, match=r'a\.mp4 is there and no run of a batch'):
        places.check_replaceable(place)
    (place / places.ROW).touch()
    places.check_replaceable(place)
    with pytest.raises(UnusableOutput):
        places.check_replaceable(Path(__file__))
