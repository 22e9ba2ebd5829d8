"""Is the covariance of the pose honest? Errors of many short drives against it.

Streets of as many seeds are driven with the errors of vectors that ``simulation.noise`` draws; no
pictures. For each key frame from the first pose on the normalised squared error of the pose (NEES,
six degrees of freedom) is averaged over the drives: its mean is 6 where the covariance says what
errors are made, and the mean of 100 drives lies between 5.34 and 6.70 with 95 % probability. With
free scale the first way is the unit of length, so that the first pose has five degrees of freedom:
between 4.40 and 5.64.
"""

import argparse
from dataclasses import asdict, dataclass, replace
import json

from mv_slapse.config import ExtractionSettings, SceneSettings
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry import rotation
from mv_slapse.geometry.camera import Camera
from mv_slapse.records import WITH_POSE
from mv_slapse.scene.filter import SceneFilter
from mv_slapse.simulation.noise import NoisyVectors, VectorNoise
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
from scipy.stats import chi2

STEP = 3  # frames at 30 Hz: key frames at 10 Hz
LATEST = 20  # key frames after which a drive has its first pose, as a camera height tells metres
MOVERS = ('slower', 'faster', 'oncoming')


@dataclass(frozen=True)
class Consistency:
    """What drives of one kind gave.

    Attributes
    ----------
    kind : str
    drives, steps : int
    mean : float
        NEES of the pose over all drives and steps.
    share : float
        Steps whose mean over the drives lies in the bounds.
    low, high : float
        The bounds of six degrees of freedom: 95 % of the mean of so many drives.
    plane_share : float
        Observations of known planes whose squared distance from the prediction is below its
        95 % bound (NIS).
    by_step : tuple of float
        Mean NEES of each step.
    """

    kind: str
    drives: int
    steps: int
    mean: float
    share: float
    low: float
    high: float
    plane_share: float
    by_step: tuple[float, ...]


def drive(seed: int, steps: int, movers: tuple[str, ...], height_known: bool):
    """Return the NEES of each step and the squared distances of known planes of one drive.

    Steps count from the first pose on: with a camera height there is none before its metres.
    """
    last = STEP * (steps + LATEST * height_known)
    street = Street(StreetSettings(seed=seed, n_frames=last + 1, movers=movers))
    rng = np.random.default_rng(seed)
    heave = SceneSettings().camera_height_sigma if height_known else 0.0
    noise = VectorNoise(heave=heave, heave_time=SceneSettings().camera_height_time)
    vectors = NoisyVectors(street, noise, rng)
    camera = calibrated(street.camera, rng)
    height = street.settings.camera_height * (1 + rng.normal(0, height_error()))
    height *= height_known
    extractor = PlaneExtractor(camera, ExtractionSettings(), height)
    scene = SceneFilter(SceneSettings(camera_height=height))
    # With free scale the first baseline is the unit.
    unit = 1.0 if height_known else np.linalg.norm(street.pose(STEP)[1])
    nees, distances = [], []
    for i in range(0, last, STEP):
        estimate, _ = scene.step(extractor.extract(vectors.pair(i, i + STEP)))
        if estimate.status not in WITH_POSE:
            continue
        R, t = street.pose(i + STEP)
        error = np.r_[t / unit - estimate.t_world_from_cam,
                      rotation.log(R @ estimate.R_world_from_cam.T)]
        nees.append(error @ np.linalg.solve(estimate.pose_covariance, error))
        distances += scene.distances.values()
        if len(nees) == steps:
            break
    return nees, distances


def calibrated(camera: Camera, rng: np.random.Generator) -> Camera:
    """Return a camera as a calibration shows it: with a focal length as unsure as supposed."""
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= 1 + rng.normal(0, SceneSettings().focal_sigma)
    return replace(camera, K=K)


def height_error() -> float:
    """Return how far a measured camera height is off, as the filter supposes.

    What vectors show too near or too far counts as an error of the height, and is drawn with them.
    """
    return float(np.sqrt(SceneSettings().camera_height_bias**2 - VectorNoise().depth_bias**2))


def measure(kind: str, drives: int, steps: int, movers: tuple[str, ...],
            height_known: bool, first_seed: int = 0) -> Consistency:
    """Drive as many streets, of seeds from ``first_seed`` on."""
    results = [drive(seed, steps, movers, height_known)
               for seed in range(first_seed, first_seed + drives)]
    by_step = np.mean([nees for nees, _ in results], axis=0)
    low, high = bounds(drives, steps, height_known)
    distances = np.concatenate([found for _, found in results])
    return Consistency(
        kind, drives, steps, float(by_step.mean()),
        float(np.mean((by_step > low) & (by_step < high))), float(low[-1]), float(high[-1]),
        float(np.mean(distances < chi2.ppf(0.95, 3))), tuple(float(v) for v in by_step))


def bounds(drives: int, steps: int, height_known: bool) -> np.ndarray:
    """Return the bounds (2, steps) of the mean NEES, 95 % of so many drives."""
    freedom = np.full(steps, 6)
    freedom[0] = 6 if height_known else 5  # The length of the first way is the unit.
    return chi2.ppf([[0.025], [0.975]], freedom * drives) / drives


def text(found: Consistency) -> str:
    """Return what was found in words."""
    return (f'{found.kind}: {found.drives} drives of {found.steps} key frames: mean NEES '
            f'{found.mean:.2f}, {100 * found.share:.0f} % of steps in '
            f'[{found.low:.2f}, {found.high:.2f}], planes within 95 %: '
            f'{100 * found.plane_share:.1f} %\n  by step: '
            + ' '.join(f'{value:.1f}' for value in found.by_step))


def main(arguments: list[str] | None = None) -> int:
    """Measure each kind of drive and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--drives', type=int, default=100)
    parser.add_argument('--steps', type=int, default=30)
    parser.add_argument('--first-seed', type=int, default=0, help='of the first drive')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    options = parser.parse_args(arguments)
    kinds = {'free scale': ((), False), 'camera height': ((), True),
             'camera height, movers': (MOVERS, True)}
    found = []
    for kind, (movers, height_known) in kinds.items():
        found.append(measure(kind, options.drives, options.steps, movers, height_known,
                             options.first_seed))
        if not options.json:
            print(text(found[-1]), flush=True)
    if options.json:
        print(json.dumps({'consistency': [asdict(one) for one in found]}))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
