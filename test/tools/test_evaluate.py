"""The table of ``make evaluate``, on one short rendered street."""

from mv_slapse.tools import evaluate


def test_a_street_gives_a_row_for_each_encoding_with_its_errors(tmp_path):
    output = tmp_path / 'results.md'
    code = evaluate.main(['--data', str(tmp_path / 'none'), '--streets', '1', '--frames', '24',
                          '--only', 'street', '-o', str(output)])
    lines = output.read_text().splitlines()
    middle = lines.index('## Moving obstacles')
    rows = [line for line in lines[:middle] if line.startswith('| street 0')]
    assert code == 0
    assert len(rows) == len(evaluate.ENCODINGS)
    assert sum(line.startswith('| street 0') for line in lines[middle:]) == len(rows)
    for line in rows:
        cells = [cell.strip() for cell in line.strip('|').split('|')]
        assert len(cells) == len(evaluate.COLUMNS) + 1
        assert int(cells[1]) > 3
        assert 0 < float(cells[2]) < 5


def test_an_encoding_alone_is_rendered_for_each_kind_of_street(tmp_path):
    cases = list(evaluate.streets(tmp_path, 1, 4, only='mpeg2'))
    assert [case.name for case in cases] == [f'{kind} 0/mpeg2.mpg' for kind in evaluate.TRAFFIC]
    assert all(case.video.exists() for case in cases)


def test_a_refusal_is_a_row_that_says_why():
    line = evaluate.row('clip', {'error': 'not a video'})
    assert line.startswith('| clip | not a video |')
    assert line.count('|') == len(evaluate.COLUMNS) + 2
