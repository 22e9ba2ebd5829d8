"""The index of an MCAP file, on the disk until the file is complete."""

from io import BytesIO

from mcap.reader import make_reader
from mv_slapse.storage.bag_writer import McapFile
from mv_slapse.storage.waiting_index import WaitingIndex


def test_entries_come_back_in_order(tmp_path, rng):
    entries = [rng.bytes(int(n)) for n in rng.integers(0, 300, 20)]
    index = WaitingIndex(tmp_path)
    for k, entry in enumerate(entries):
        index.append(BytesIO(entry))
        if k == 9:
            assert [one.getvalue() for one in index] == entries[:10]
    assert len(index) == 20
    assert [one.getvalue() for one in index] == entries
    assert [one.tell() for one in index] == [len(entry) for entry in entries]
    assert not list(tmp_path.iterdir())
    index.close()


def test_a_file_of_many_chunks_has_its_whole_index(tmp_path, rng):
    file = McapFile(tmp_path / 'a.mcap')
    for stamp in range(40):
        file.write('/a', 'std_msgs/msg/String', {'data': rng.bytes(50_000).hex()}, stamp)
    file.close()
    with (tmp_path / 'a.mcap').open('rb') as stream:
        summary = make_reader(stream).get_summary()
        assert [chunk.message_start_time for chunk in summary.chunk_indexes] == [0, 11, 22, 33]
        assert summary.statistics.chunk_count == 4
        late = make_reader(stream).iter_messages(starting_at=33)
        assert [message.log_time for _, _, message in late] == [*range(33, 40)]
