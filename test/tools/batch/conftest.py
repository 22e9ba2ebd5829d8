"""Short rendered recordings, and two workers on loopback; made once."""

from pathlib import Path

import pytest

pytest.importorskip('distributed')

from mv_slapse.codec.encoding.encoder import Encoding, write_video  # noqa: E402
from mv_slapse.config import SceneSettings, Settings  # noqa: E402
from mv_slapse.simulation.street import Street, StreetSettings  # noqa: E402
from mv_slapse.simulation.truth import film  # noqa: E402
from mv_slapse.storage.camera_info import write_camera  # noqa: E402
from mv_slapse.tools.batch.manifest import Recording, recordings  # noqa: E402
from mv_slapse.tools.batch.task import code  # noqa: E402
from mv_slapse.tools.batch.workers import open_pool, Workers  # noqa: E402

STREET = StreetSettings(seed=3, n_frames=12, fps=15.0, width=320, height=240, focal=250.0,
                        movers=())
HEIGHT = STREET.camera_height


@pytest.fixture(scope='session')
def place(tmp_path_factory) -> Path:
    """Return a folder with a camera, the truth, and four recordings, of which one is broken."""
    folder = tmp_path_factory.mktemp('recordings')
    street = Street(STREET)
    pictures = list(film(street, folder / 'truth'))
    (folder / 'in').mkdir()
    for name, n_frames in (('a.mpg', 12), ('b.mpg', 11), ('c.mpg', 8)):
        write_video(folder / 'in' / name, pictures[:n_frames], STREET.fps, Encoding(b_frames=1))
    (folder / 'in' / 'text.mp4').write_text('no video')
    write_camera(folder / 'camera.yaml', street.camera)
    return folder


@pytest.fixture(scope='session')
def like(place) -> Recording:
    """Return what holds for all recordings."""
    return Recording('', camera=str(place / 'camera.yaml'),
                     report=False,
                     settings=Settings(scene=SceneSettings(camera_height=HEIGHT)))


@pytest.fixture
def items(place, like, tmp_path) -> list[Recording]:
    """Return the runs over the folder."""
    return recordings([str(place / 'in')], like, [], tmp_path, code())


@pytest.fixture(scope='session')
def pool():
    """Give two workers, which are to have one thread whatever their parent asks for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv('OPENBLAS_NUM_THREADS', raising=False)
        with open_pool(Workers(2)) as found:
            yield found
