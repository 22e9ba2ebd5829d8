"""The table of ``make evaluate``, on one short rendered street."""

from mv_slapse.tools import evaluate


def test_a_street_gives_a_row_for_each_encoding_with_its_errors(tmp_path):
    output = tmp_path / 'results.md'
    code = evaluate.main(['--data', str(tmp_path / 'none'), '--streets', '1', '--frames', '24',
                          '-o', str(output)])
    rows = [line for line in output.read_text().splitlines() if line.startswith('| street 0')]
    assert code == 0
    assert len(rows) == len(evaluate.ENCODINGS)
    for line in rows:
        cells = [cell.strip() for cell in line.strip('|').split('|')]
        assert len(cells) == len(evaluate.COLUMNS) + 1
        assert int(cells[1]) > 3
        assert 0 < float(cells[2]) < 5


def test_a_refusal_is_a_row_that_says_why():
    line = evaluate.row('clip', {'error': 'not a video'})
    assert line.startswith('| clip | not a video |')
    assert line.count('|') == len(evaluate.COLUMNS) + 2
