"""A ground that many pairs contradict is none, however many blocks of one pair show it."""

from dataclasses import replace

from canyon import HEIGHT, K, motion, views, WIDTH
from mv_slapse.config import ExtractionSettings
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import Correspondences, SegmentKind
from mv_slapse.surfaces.height import GRID, HeightBelief
import numpy as np
import pytest

TENTH = 100_000_000  # ns


def pair(number, rng):
    scene = views(*motion('ahead without turning'), rng, 0.1)
    n = len(scene.pair)
    return Correspondences(
        (number + 1) * TENTH, number * TENTH, WIDTH, HEIGHT, SegmentKind.PP, 0, '',
        scene.x_cur.astype(np.float32), scene.x_prev.astype(np.float32),
        np.full(n, 0.1, np.float32), np.ones(n, np.float32), np.full((n, 2), 16, np.uint8))


def believing(height):
    """Return what pairs have told that are sure of a height [baseline]."""
    p = np.exp(-0.5 * np.square((GRID - np.log(height)) / 0.01))
    return HeightBelief(p / p.sum())


@pytest.mark.parametrize(('height', 'is_told'), [(1.6, True), (1.2, False), (2.0, False)])
def test_a_ground_that_many_pairs_contradict_is_not_told(rng, height, is_told, monkeypatch):
    monkeypatch.setattr(HeightBelief, 'seen', lambda self, *_: self)
    extractor = PlaneExtractor(Camera(WIDTH, HEIGHT, K), ExtractionSettings())
    for number in range(3):
        extractor._memory = replace(extractor._memory, height=believing(1.6))
        assert any(plane.is_ground for plane in extractor.extract(pair(number, rng)).planes)
    extractor._memory = replace(extractor._memory, height=believing(height))
    found = [plane for plane in extractor.extract(pair(3, rng)).planes if plane.is_ground]
    assert bool(found) == is_told
    for plane in found:
        assert 1 / np.linalg.norm(plane.plane) == pytest.approx(1.6, rel=0.02)
