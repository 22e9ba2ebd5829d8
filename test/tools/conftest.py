"""A short rendered street, as video, camera file, truth and results; made once."""

from dataclasses import dataclass
from pathlib import Path

from mv_slapse.codec.encoding.encoder import Encoding, write_video
from mv_slapse.config import SceneSettings, Settings
from mv_slapse.simulation.street import Street, StreetSettings
from mv_slapse.simulation.truth import film
from mv_slapse.storage.camera_info import read_camera, write_camera
from mv_slapse.tools import main as command_line
from mv_slapse.tools.run import run
import pytest

N_FRAMES = 21
SETTINGS = StreetSettings(seed=3, n_frames=N_FRAMES, fps=15.0, width=480, height=352, focal=375.0,
                          movers=('oncoming',))


@dataclass(frozen=True)
class Clip:
    """Paths of what was rendered, and of a run on it."""

    video: Path
    camera: Path
    truth: Path
    out: Path


@pytest.fixture(scope='session')
def clip(tmp_path_factory) -> Clip:
    folder = tmp_path_factory.mktemp('clip')
    made = Clip(folder / 'video.mpg', folder / 'camera.yaml', folder / 'truth', folder / 'out')
    street = Street(SETTINGS)
    write_video(made.video, film(street, made.truth), SETTINGS.fps, Encoding(b_frames=1))
    write_camera(made.camera, street.camera)
    run(made.video, read_camera(made.camera),
        Settings(scene=SceneSettings(camera_height=SETTINGS.camera_height)), made.out)
    return made


@pytest.fixture
def call(capsys):
    """Run the command line; return exit code, standard output and error."""
    def called(*arguments):
        code = command_line.main([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return called
