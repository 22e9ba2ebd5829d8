import cv2
from mv_slapse.geometry.camera import to_rays
from mv_slapse.simulation import textures
from mv_slapse.simulation.render import Renderer
from mv_slapse.simulation.ripmap import Atlas
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.simulation.surfaces import cast, SKY
import numpy as np
import pytest

SETTINGS = StreetSettings(seed=2, noise=0.0, vibration=2.0)


@pytest.fixture(scope='module')
def street():
    return Street(SETTINGS)


@pytest.fixture(scope='module')
def renderer(street):
    return Renderer(street)


def pixels(camera):
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.c_[x.ravel(), y.ravel()].astype(float)


def test_each_pixel_shows_what_its_ray_meets_first(street, renderer):
    surface = renderer.frame(30).surface.ravel()
    quads = street.quads_in_camera(30)
    first, _ = cast(quads, to_rays(street.camera.K, pixels(street.camera)))
    expected = np.where(first < 0, SKY, quads.surface[first])
    assert np.mean(surface != expected) < 2e-4   # rounding along edges


@pytest.mark.parametrize(('i', 'j'), [(20, 21), (60, 64)])
def test_a_plane_looks_the_same_through_the_homography_it_induces(street, renderer, i, j):
    K = street.camera.K
    (R_i, t_i), (R_j, t_j) = street.pose(i), street.pose(j)
    before, now = renderer.frame(i), renderer.frame(j)
    seen = [plane for plane in street.planes if np.sum(now.surface == plane.id) > 4000]
    assert len(seen) >= 4
    for plane in seen:
        n, d = R_j.T @ plane.normal, plane.depth + plane.normal @ t_j
        H = K @ (R_i.T @ R_j - np.outer(R_i.T @ (t_j - t_i), n) / d) @ np.linalg.inv(K)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpPerspective(before.image, H, (640, 480), flags=flags)
        came_from = cv2.warpPerspective(before.surface.astype(np.float32), H, (640, 480),
                                        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
                                        borderValue=-9)
        both = ((now.surface == plane.id) & (came_from == plane.id)).astype(np.uint8)
        both = cv2.erode(both, np.ones((5, 5))) > 0
        difference = np.abs(warped.astype(float) - now.image)[both]
        shifted = np.abs(np.roll(warped, 2, 1).astype(float) - now.image)[both]
        assert difference.mean() < 5
        assert difference.mean() < 0.6 * shifted.mean()


def test_noise_has_the_stated_size_and_belongs_to_the_frame():
    settings = StreetSettings(seed=2, noise=3.0, vibration=2.0)
    noisy = Renderer(Street(settings))
    plain = Renderer(Street(SETTINGS)).frame(5).image.astype(float)
    first, again, other = (noisy.frame(i).image for i in (5, 5, 6))
    assert (first - plain).std() == pytest.approx(3.0, abs=0.1)
    np.testing.assert_array_equal(first, again)
    assert np.corrcoef((first - plain).ravel(), (other - plain).ravel())[0, 1] < 0.5


def test_the_same_seed_renders_the_same_picture_and_another_one_does_not(renderer):
    again = Renderer(Street(SETTINGS)).frame(12).image
    other = Renderer(Street(StreetSettings(seed=3))).frame(12).image
    np.testing.assert_array_equal(renderer.frame(12).image, again)
    assert np.mean(again != other) > 0.5


def test_tiles_repeat_without_a_seam(rng):
    for name, tile in zip(textures.NAMES, textures.tiles(rng), strict=True):
        if textures.TILE_SIZE[name] == 1:
            continue
        step = np.abs(np.diff(tile.astype(float), axis=1)).mean(0)
        seam = np.abs(tile[:, 0].astype(float) - tile[:, -1]).mean()
        assert seam <= step.max() + 1, name


def test_an_atlas_averages_over_the_footprint_along_each_axis(rng):
    tile = np.tile(np.repeat([40, 200], 2), 256).astype(np.uint8) * np.ones((1024, 1), np.uint8)
    atlas = Atlas([tile])
    u = np.array([[0.25 / 256, 2.25 / 1024, 0.3]], np.float32)
    v, none = np.full_like(u, 0.4), np.zeros_like(u)
    texture = np.zeros(u.shape, int)
    sharp = atlas.sample(texture, (u, v), (none, none + 0.1))
    blurred = atlas.sample(texture, (u, v), (none + 0.1, none))
    np.testing.assert_allclose(sharp[0, :2], [40, 200], atol=42)
    assert sharp[0, 1] - sharp[0, 0] > 100
    np.testing.assert_allclose(blurred, 120, atol=2)
