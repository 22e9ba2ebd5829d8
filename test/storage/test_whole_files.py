import os
import subprocess
import sys

from mv_slapse.errors import UnusableOutput
from mv_slapse.storage import whole_files
import pytest

FULL = '''
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
'''


def test_a_file_takes_its_place_when_it_is_whole(tmp_path):
    path = tmp_path / 'a.txt'
    with whole_files.whole(path) as file:
        file.write('one')
        assert [entry.name for entry in tmp_path.iterdir()] == ['a.txt.part']
    assert path.read_text() == 'one'
    assert [entry.name for entry in tmp_path.iterdir()] == ['a.txt']


def test_text_is_utf_8_and_a_name_that_is_none_is_escaped(tmp_path):
    path = tmp_path / 'a.txt'
    whole_files.write_text(path, 'straße ' + os.fsdecode(b'stra\xdfe'))
    assert path.read_bytes() == 'straße stra\\udcdfe'.encode()


def test_an_old_file_stays_where_the_new_one_fails(tmp_path):
    path = tmp_path / 'a.txt'
    whole_files.write_text(path, 'old')
    with pytest.raises(TypeError), whole_files.whole(path) as file:
        file.write(b'new')
    assert path.read_text() == 'old'
    assert [entry.name for entry in tmp_path.iterdir()] == ['a.txt']


def test_a_place_that_is_not_there_is_an_error_of_its_own(tmp_path):
    with pytest.raises(UnusableOutput, match='No such file') as caught:
        whole_files.write_text(tmp_path / 'gone' / 'a.txt', 'text')
    assert caught.value.exit_code == 3


def test_a_full_disk_is_an_error_of_its_own_and_leaves_the_old_file(tmp_path):
    path = tmp_path / 'a.txt'
    path.write_text('old')
    code = f'''{FULL}
from mv_slapse.errors import UnusableOutput
from mv_slapse.storage import whole_files
try:
    whole_files.write_text({str(path)!r}, 'x' * 100_000)
except UnusableOutput as error:
    sys.exit(error.exit_code)
'''
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert done.returncode == 3, done.stderr
    assert path.read_text() == 'old'
    assert os.listdir(tmp_path) == ['a.txt']
