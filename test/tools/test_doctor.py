"""Doctor: what is there is found, what is missing or broken is named with its cure."""

import sys
import types

from mv_slapse.tools import doctor
from mv_slapse.tools.doctor import Finding
import pytest

GOOD = Finding('numpy', True, '2.0')
BAD = Finding('scipy', False, 'not installed', 'pip install scipy')
BAD_ROS = Finding('rclpy', False, 'not installed', 'source it', needed=False)


def test_this_installation_can_run_the_command_line():
    findings = doctor.examine()
    assert doctor.exit_code(findings) == 0, doctor.table(findings)


def test_the_vectors_of_the_test_clip_show_its_motion():
    measured, count = doctor.measure_shift()
    assert measured == pytest.approx(doctor.SHIFT, abs=0.1)
    assert count > 50


def test_vectors_that_disagree_with_the_motion_are_a_finding(monkeypatch):
    monkeypatch.setattr(doctor, 'measure_shift', lambda: (0.0, 99))
    finding = doctor.motion_vectors()
    assert not finding.ok
    assert '0.00 px' in finding.detail


def test_a_message_passes_through_dds(ros_domain):
    pytest.importorskip('mv_slapse_msgs')
    finding = doctor.dds()
    assert finding.ok, finding.detail


def test_a_missing_library_is_named_with_its_cure():
    finding = doctor.library('no_such_module', 'no-such-distribution', '1.0')
    assert not finding.ok
    assert 'ModuleNotFoundError' in finding.detail
    assert 'pip install no-such-distribution' in finding.cure


@pytest.mark.parametrize(('version', 'ok'), [('1.25.2', False), ('1.26', True), ('1.26.4', True),
                                             ('2.0.0rc1', True), ('10.1', True)])
def test_a_library_that_is_too_old_is_not_ok(monkeypatch, version, ok):
    monkeypatch.setitem(sys.modules, 'made_up_library',
                        types.SimpleNamespace(__version__=version))
    assert doctor.library('made_up_library', 'made-up', '1.26').ok is ok


def test_without_ros_the_command_line_still_runs(monkeypatch):
    monkeypatch.setattr(doctor.importlib.util, 'find_spec', lambda name: None)
    findings = doctor.ros()
    assert [item.ok for item in findings] == [False, False, False]
    assert doctor.exit_code([GOOD, *findings]) == 0


def test_a_missing_library_of_the_command_line_gives_exit_code_3():
    assert doctor.exit_code([GOOD, BAD]) == 3


def test_the_table_names_what_is_missing_and_what_cannot_run():
    lines = doctor.table([GOOD, BAD_ROS]).splitlines()
    assert lines[0].split() == ['numpy', 'ok', '2.0']
    assert lines[1].split() == ['rclpy', 'MISSING', 'not', 'installed']
    assert lines[2].split() == ['->', 'source', 'it']
    assert lines[-2].endswith('command line: can run')
    assert lines[-1].endswith('can NOT run')


def test_without_dask_all_but_batch_runs(monkeypatch):
    monkeypatch.setattr(doctor, 'EXTRAS', (('no_such_dask', "'dask>=1.0'", '1.0'),))
    monkeypatch.setattr(doctor, 'LIBRARIES', doctor.LIBRARIES[:4])
    monkeypatch.setattr(doctor, 'ros', lambda: [])
    monkeypatch.setattr(doctor, 'motion_vectors', lambda: GOOD)
    findings = doctor.examine()
    assert doctor.exit_code(findings) == 0
    table = doctor.table(findings)
    assert 'no_such_dask' in table
    assert "pip install 'dask>=1.0', or run `make setup` (for mv_slapse batch)" in table
    assert 'NOT' not in table
