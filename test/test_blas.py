"""The limit of BLAS threads: within it there is one, and afterwards as many as before."""

from threading import Barrier, Thread

from mv_slapse import blas
from mv_slapse.blas import one_thread
import numpy as np
import pytest


@pytest.fixture
def libraries():
    """Return the BLAS libraries of this process with two threads each, where they can."""
    found = blas.libraries()
    before = [library.threads() for library in found]
    for library in found:
        library.set_threads(2)
    if not found or any(library.threads() != 2 for library in found):
        pytest.skip('the BLAS library here has one thread at most')
    yield found
    for library, number in zip(found, before, strict=True):
        library.set_threads(number)


def threads(libraries) -> set[int]:
    return {library.threads() for library in libraries}


def test_the_library_of_numpy_is_found():
    built_with = np.show_config(mode='dicts')['Build Dependencies']['blas']['name']
    if 'openblas' not in built_with:
        pytest.skip(f'numpy uses {built_with}')
    assert blas.libraries()


def test_a_verb_has_one_thread_and_gives_the_number_back(libraries):
    def verb(value, *, other):
        return value, other, threads(libraries)

    assert one_thread(verb)(1, other=2) == (1, 2, {1})
    assert threads(libraries) == {2}


def test_the_number_is_given_back_after_an_error(libraries):
    @one_thread
    def fails():
        raise KeyError('name')

    with pytest.raises(KeyError, match='name'):
        fails()
    assert threads(libraries) == {2}


def test_a_verb_within_a_verb_does_not_end_the_limit(libraries):
    @one_thread
    def outer():
        one_thread(int)()
        return threads(libraries)

    assert outer() == {1}
    assert threads(libraries) == {2}


def test_verbs_of_two_threads_of_the_program_overlap(libraries):
    """The first one in leaves first: the other must not compute with more from then on."""
    entered, left, seen = Barrier(2, timeout=20), Barrier(2, timeout=20), []

    @one_thread
    def first():
        entered.wait()

    @one_thread
    def second():
        entered.wait()
        left.wait()
        seen.append(threads(libraries))

    def leave():
        first()
        left.wait()

    others = [Thread(target=leave), Thread(target=second)]
    for other in others:
        other.start()
    for other in others:
        other.join()
    assert seen == [{1}]
    assert threads(libraries) == {2}
