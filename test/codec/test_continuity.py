from mv_slapse.codec.places import Continuity, KEPT, Place
import pytest

STEP = 40


def shown(places, stamps=None, order=None):
    """Return the damage of pictures that are decoded and shown in order."""
    follow = Continuity()
    for i, place in enumerate(places):
        follow.add(i, place)
    stamps = stamps or [STEP * i for i in range(len(places))]
    return [bool(follow.damage(i, stamps[i])) for i in (order or range(len(places)))]


def counted(*counts, turn=32, sequence=0):
    return [Place(sequence, count, turn=turn) for count in counts]


@pytest.mark.parametrize(('counts', 'holes'), [
    (range(0, 40, 2), []), (range(20), []), ([0, 2, 4, 8, 10], [3]), ([0, 2, 4, 6, 2], [4]),
    ([0, 2, 4, 6, 38, 40, 42], [4])])
def test_a_hole_in_the_counts_is_found_whatever_the_step(counts, holes):
    assert [i for i, hole in enumerate(shown(counted(*counts))) if hole] == holes


def test_a_count_that_does_not_count_pictures_is_not_believed():
    counts = [0, 3, 4, 9, 11, 18, 21, 22, 30, 37, 39, 45]
    assert not any(shown(counted(*counts))[6:])


def test_where_counting_begins_anew_stamps_tell():
    places = [*counted(*range(0, 20, 2)), *counted(0, 2, 4, sequence=1)]
    stamps = [STEP * (i + 2 * (i > 9)) for i in range(13)]
    assert [i for i, hole in enumerate(shown(places, stamps)) if hole] == [10]
    assert not any(shown(places))


def test_a_sequence_that_was_never_shown_or_lacks_its_beginning_is_a_loss():
    assert shown([*counted(0, 2), *counted(0, 2, sequence=2)])[2]
    assert shown([*counted(0, 2), *counted(2, 4, sequence=1)])[2]


def test_counted_pictures_may_come_late():
    """A camera that pauses has lost nothing, unless the count may have turned over."""
    places = counted(*range(0, 60, 2))
    pause = [STEP * (i + 4 * (i > 20)) for i in range(30)]
    turned = [STEP * (i + 16 * (i > 20)) for i in range(30)]
    assert not any(shown(places, pause))
    assert [i for i, hole in enumerate(shown(places, turned)) if hole] == [21]


def test_a_sequence_whose_beginning_was_lost_with_as_many_pictures_is_a_loss():
    """The third group's header is lost, and as many pictures as a group has."""
    places = [place for group in range(2) for place in counted(
        *range(12), turn=1024, sequence=group)]
    places = [*places[:18], *counted(*range(6, 12), turn=1024, sequence=1)]
    stamps = [STEP * (i + 12 * (i > 17)) for i in range(24)]
    assert [i for i, hole in enumerate(shown(places, stamps)) if hole] == [18]


def test_without_counts_a_long_step_is_a_loss_and_two_like_it_another_rate():
    steps = [1] * 10 + [3] + [1] * 5 + [2] * 6
    stamps = [STEP * sum(steps[:i + 1]) for i in range(len(steps))]
    holes = [i for i, hole in enumerate(shown([Place()] * len(steps), stamps)) if hole]
    assert holes == [10, 16, 17]


@pytest.mark.parametrize('late', [1, 2, 9])
def test_damage_waits_for_the_next_picture_that_comes_out(late):
    follow = Continuity()
    for i in range(12):
        follow.add(i, Place(0, i, reason='lost' if i == 2 else ''))
    assert not follow.damage(1, STEP)
    assert follow.damage(2 + late, 2 * STEP) == 'lost'
    assert follow.damage(3 + late, 3 * STEP) == ''


def test_what_is_kept_of_packets_without_pictures_is_bounded():
    follow = Continuity()
    for i in range(1000):
        follow.add(i, Place(reason='lost'))
    assert len(follow._places) <= KEPT + 1
    assert len(follow._events) <= KEPT + 1
