"""Lengths of vectors."""

from mv_slapse.geometry.vector import norm
import numpy as np


def test_norm_is_numpys_bit_by_bit(rng):
    for vector in rng.normal(size=(100, 3)):
        assert norm(vector) == np.linalg.norm(vector)
