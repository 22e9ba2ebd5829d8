from mv_slapse.tools.batch import page
import pytest


@pytest.mark.parametrize('values', [(2.9, 2.9000000000000057), (0.0, 0.0), (1.0, 7.0)])
def test_values_of_any_spread_are_drawn(tmp_path, values):
    rows = [{'name': f'r{i}', 'status': 'failed', 'duration_s': value}
            for i, value in enumerate(values)]
    page.write(rows, tmp_path)
    assert (tmp_path / page.PAGE).read_text().count('<img ') == 1
