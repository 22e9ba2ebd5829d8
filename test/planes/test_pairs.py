"""Whether the camera stands still: by blocks, and by the parts of the picture that they fill."""

from mv_slapse.geometry.blocks import grid_centres
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.two_view import Pair
from mv_slapse.planes import pairs
from mv_slapse.records import CameraMotion, Extraction, MotionStatus
import numpy as np
import pytest

SIZE = 640, 480
K = np.array([[400.0, 0, 319.5], [0, 400.0, 239.5], [0, 0, 1]])
X = grid_centres(*SIZE)


def stands(kept, moves) -> bool:
    """Tell whether the camera stands by the blocks that are kept, of which some move 3 px."""
    x = X[kept]
    there = x + np.where(moves[kept], 3.0, 0.0)[:, None]
    n = len(x)
    blank = Extraction(1, 0, *SIZE, 0, K, CameraMotion(MotionStatus.UNKNOWN), x_cur=x,
                       x_prev=there, sigma=np.ones(n), block=np.full((n, 2), 16),
                       label=np.zeros(n, np.int8), plane_id=np.full(n, -1))
    return pairs.stands_still(
        Pair(to_rays(K, x), to_rays(K, there), there, blank.sigma, K), blank, 0.5)


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
