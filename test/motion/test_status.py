"""What a pair can be used for: whether the camera stands still, and what shows its vehicle."""

from dataclasses import replace

from mv_slapse.config import ExtractionSettings
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.motion import status
from mv_slapse.records import CameraMotion, Extraction, Label, MotionStatus
from mv_slapse.simulation.drawn import draw
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
import pytest

SIZE = 640, 480
K = np.array([[400.0, 0, 319.5], [0, 400.0, 239.5], [0, 0, 1]])
X = grid_centres(*SIZE)


def stands(kept, moves) -> bool:
    """Tell whether the camera stands by the blocks that are kept, of which some move 3 px."""
    there = X + np.where(moves, 3.0, 0.0)[:, None]
    whole = Extraction(1, 0, *SIZE, 0, K, CameraMotion(MotionStatus.UNKNOWN), x_cur=X,
                       x_prev=there)
    return status.stands_still(whole, np.flatnonzero(kept), 0.5)


def test_most_blocks_must_stand():
    everywhere = np.ones(len(X), bool)
    assert stands(everywhere, np.zeros(len(X), bool))
    assert not stands(everywhere, np.ones(len(X), bool))


@pytest.mark.parametrize('share', [0.2, 0.4])
def test_movers_in_two_fifths_of_the_picture_let_it_stand(share):
    assert stands(np.ones(len(X), bool), X[:, 0] < share * SIZE[0])


def test_a_bonnet_that_has_most_of_the_vectors_is_no_standing_camera(rng):
    bonnet = X[:, 1] > 0.7 * SIZE[1]
    kept = bonnet | (rng.uniform(size=len(X)) < 0.35)
    assert np.mean(bonnet[kept]) > 0.5
    assert not stands(kept, ~bonnet)


@pytest.mark.parametrize('side', ['own_left', 'own_right', 'own_top', 'own_bottom'])
def test_the_vehicle_itself_fills_a_margin_of_the_picture(side):
    x = np.array([[320.0, 240], [20, 240], [620, 240], [320, 20], [320, 460]])
    blank = Extraction(1, 0, *SIZE, 0, K, CameraMotion(MotionStatus.UNKNOWN))
    rows = status.scene(blank, x, replace(ExtractionSettings(), **{side: 0.05}))
    gone = 1 + ['own_left', 'own_right', 'own_top', 'own_bottom'].index(side)
    assert set(rows) == set(range(5)) - {gone}


def test_without_margins_blocks_that_the_edge_cuts_are_used():
    blank = Extraction(1, 0, 1242, 374, 0, K, CameraMotion(MotionStatus.UNKNOWN))
    x = grid_centres(1242, 374)
    assert np.any(x[:, 1] >= 374)
    assert len(status.scene(blank, x, ExtractionSettings())) == len(x)
    kept = status.scene(blank, x, ExtractionSettings(own_bottom=0.01))
    assert np.all(x[kept, 1] < 374)


@pytest.mark.parametrize(('bottom', 'least', 'most'), [(0.0, 0.5, 1.0), (0.3, 0.0, 0.0)])
def test_what_shows_the_vehicle_has_no_label(rng, bottom, least, most):
    street = Street(StreetSettings(seed=3, n_frames=12))
    extractor = PlaneExtractor(street.camera, ExtractionSettings(own_bottom=bottom))
    for j in (4, 8):
        shown = extractor.extract(draw(street, j - 4, j, rng, 0.3, 0.0).correspondences)
        margin = shown.x_cur[:, 1] > 0.72 * shown.height
        assert least <= np.mean(shown.label[margin] != Label.UNKNOWN) <= most
        assert np.mean(shown.label[~margin] == Label.STATIONARY) > 0.5
