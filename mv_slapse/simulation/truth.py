"""The truth of what is rendered, frame by frame and as the folder that ``eval`` reads.

A macroblock has the label of the surface that covers more than half of it. INFINITY is the sky
alone: whether a far wall shows parallax depends on the pair of frames, which is not known here.
"""

from collections.abc import Iterator
from dataclasses import asdict
import json
from pathlib import Path
from typing import NamedTuple

import cv2
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.records import Label
from mv_slapse.simulation.drawn import block_centres, labels
from mv_slapse.simulation.flight import Flight
from mv_slapse.simulation.render import Renderer
from mv_slapse.simulation.street import Plane, Street
from mv_slapse.simulation.surfaces import SKY
from mv_slapse.storage.tum import format_stamp, write_poses
import numpy as np

VISIBLE = 64   # a mover with fewer pixels is not visible
MOVERS_HEADER = ('stamp,id,x,y,width,height,px,py,pz,vx,vy,vz,ttc,n_macroblocks,range,'
                 'closing,aside')
CLOSING = 1e-3   # slower is not closing [m/s]
NONE = -2   # a block that no surface covers by more than half


class MoverTruth(NamedTuple):
    """A mover in one frame.

    Attributes
    ----------
    stamp, id : int, int
        [ns].
    box : (4,) ndarray
        x, y of the top left pixel, width, height of what is visible [px].
    position, velocity : (3,) float64
        Of the centre of the face towards the camera, in {W} [m], [m/s].
    time_to_contact : float
        Until the camera is in the plane of that face [s]; inf if it never will be.
    n_macroblocks : int
        Blocks it covers by more than half.
    range : float
        From the camera to that centre [m].
    closing : float
        Speed at which the camera nears the plane of that face [m/s].
    aside : float
        How far beside the camera's way its nearest corner is at contact, if both go on as they do
        [m]; 0: on it, inf: there is no contact, or the camera stands.
    """

    stamp: int
    id: int
    box: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    time_to_contact: float
    n_macroblocks: int
    range: float
    closing: float
    aside: float


class TruthRecorder:
    """Collects the truth of the frames that are rendered, and writes it."""

    def __init__(self, street: Street):
        """Start empty."""
        self._street = street
        self._rows: list[tuple[int, np.ndarray, np.ndarray]] = []
        self._movers: list[MoverTruth] = []
        self._surfaces: list[np.ndarray] = []
        self._labels: list[np.ndarray] = []

    def add(self, i: int, surface: np.ndarray):
        """Take frame i, of whose pixels ``surface`` (H, W) tells what they show."""
        street = self._street
        blocks = block_surfaces(surface)
        label = np.where(blocks == NONE, Label.UNKNOWN, labels(street, blocks, street.time(i)))
        self._rows.append((street.stamp(i), *street.pose(i)))
        self._movers += mover_truths(street, i, surface, blocks)
        self._surfaces.append(np.where(blocks == NONE, SKY, blocks).astype(np.int32))
        self._labels.append(label.astype(np.int8))

    def write(self, folder: Path):
        """Write ground_truth.tum, scene.json, movers.csv and truth_labels.npz."""
        folder.mkdir(parents=True, exist_ok=True)
        write_poses(folder / 'ground_truth.tum', self._rows)
        (folder / 'scene.json').write_text(json.dumps(scene(self._street), indent=1) + '\n')
        rows = [MOVERS_HEADER, *(_row(mover) for mover in self._movers)]
        (folder / 'movers.csv').write_text('\n'.join(rows) + '\n')
        x, y = block_centres(self._street.camera.width, self._street.camera.height).T
        np.savez_compressed(folder / 'truth_labels.npz',
                            stamp=np.array([row[0] for row in self._rows]) * 1e-9, x=x, y=y,
                            label=np.array(self._labels), plane=np.array(self._surfaces))


def film(street: Street, folder: Path) -> Iterator[np.ndarray]:
    """Yield the grey pictures (H, W) uint8 of a street; after the last the truth is written."""
    recorder = TruthRecorder(street)
    for i, frame in enumerate(Renderer(street).frames()):
        recorder.add(i, frame.surface)
        yield frame.image
    recorder.write(Path(folder))


def film_flight(flight: Flight, folder: Path) -> Iterator[np.ndarray]:
    """Yield the grey pictures (H, W) uint8 of a flight; after the last its poses are written."""
    yield from flight.pictures()
    folder.mkdir(parents=True, exist_ok=True)
    write_poses(folder / 'ground_truth.tum', (
        (round(i * 1e9 / flight.settings.fps), *flight.pose(i))
        for i in range(flight.settings.n_frames)))


def block_surfaces(surface: np.ndarray) -> np.ndarray:
    """Return the surface (M,) that covers more than half of each macroblock, else NONE.

    ``surface`` (H, W) int is that of each pixel; blocks cut by the border do not count.
    """
    rows, columns = surface.shape[0] // MACROBLOCK, surface.shape[1] // MACROBLOCK
    whole = surface[:rows * MACROBLOCK, :columns * MACROBLOCK] - SKY
    ids = np.flatnonzero(np.bincount(whole.ravel()))   # np.unique would sort all pixels
    number = np.zeros(ids[-1] + 1, int)
    number[ids] = np.arange(len(ids))
    tiled = number[whole].reshape(rows, MACROBLOCK, columns, MACROBLOCK).swapaxes(1, 2)
    tiled = tiled.reshape(-1, MACROBLOCK ** 2)
    cell = np.arange(len(tiled))[:, None] * len(ids) + tiled
    counts = np.bincount(cell.ravel(), minlength=len(tiled) * len(ids)).reshape(-1, len(ids))
    return np.where(counts.max(1) > MACROBLOCK ** 2 / 2, ids[counts.argmax(1)] + SKY, NONE)


def mover_truths(street: Street, i: int, surface: np.ndarray,
                 blocks: np.ndarray) -> list[MoverTruth]:
    """Return the visible movers of frame i, given what pixels and blocks show."""
    found = []
    for id_ in (car.id for car in street.movers):
        rows, columns = np.nonzero(surface == id_)
        if len(rows) < VISIBLE:
            continue
        x, y = columns.min(), rows.min()
        box = np.array([x, y, columns.max() - x + 1, rows.max() - y + 1])
        position, velocity, *contact = _kinematics(street, id_, i)
        found.append(MoverTruth(street.stamp(i), id_, box, position, velocity, contact[0],
                                int(np.sum(blocks == id_)), *contact[1:]))
    return found


def scene(street: Street) -> dict:
    """Return the content of scene.json: planes and movers in {W}."""
    return {
        'schema_version': 1, 'camera_height': street.settings.camera_height,
        'width': street.camera.width, 'height': street.camera.height, 'fps': street.settings.fps,
        'planes': [{'id': plane.id, 'name': plane.name, 'normal': plane.normal.tolist(),
                    'depth': plane.depth, 'polygon': outline(plane).tolist(),
                    'parts': plane.corners.reshape(-1, 4, 3).round(4).tolist()}
                   for plane in street.planes],
        'movers': [{'id': car.id, 'name': car.name} for car in street.movers],
        'settings': asdict(street.settings)}


def outline(plane: Plane) -> np.ndarray:
    """Return the convex hull (M, 3) of all parts of a plane in {W} [m]."""
    first = np.eye(3)[np.abs(plane.normal).argmin()]
    u = np.cross(plane.normal, first)
    u /= np.linalg.norm(u)
    basis = np.stack([u, np.cross(plane.normal, u)])
    flat = (plane.corners @ basis.T).astype(np.float32)
    hull = cv2.convexHull(flat, returnPoints=False)[:, 0]
    return plane.corners[hull]


def _kinematics(street: Street, id_: int, i: int):
    """Return what a mover does by the face towards the camera.

    Position and velocity in {W}, time to contact, range, closing speed and aside.
    """
    time, h = street.time(i), 1e-4
    eye = street.ride.pose(time)[1]
    # The camera's way has no closed derivative where it sways on an arc; h^2 errors are < 1e-6.
    eye_velocity = (street.ride.pose(time + h)[1] - street.ride.pose(time - h)[1]) / (2 * h)
    car = street.mover(id_)
    face = car.face_towards(eye, time)
    gap = face.normal @ (eye - face.centre)
    closing = face.normal @ (face.velocity - eye_velocity)
    contact = gap / closing if closing > CLOSING and gap > 0 else np.inf
    met = (car.quads(time).corners().reshape(-1, 3) - eye) + contact * (
        face.velocity - eye_velocity) if np.isfinite(contact) else None
    R, t = street.R_world_from_street, street.t_world_from_street
    return (R @ face.centre + t, R @ face.velocity, float(contact),
            float(np.linalg.norm(face.centre - eye)), float(closing),
            _aside(met, eye_velocity))


def _aside(met: np.ndarray | None, eye_velocity: np.ndarray) -> float:
    """Return how far beside the camera's way the nearest of corners (N, 3) before it lies."""
    speed = np.hypot(eye_velocity[0], eye_velocity[2])
    if met is None or speed < CLOSING:
        return float('inf')
    beside = (met[:, 0] * eye_velocity[2] - met[:, 2] * eye_velocity[0]) / speed
    return float(max(beside.min(), -beside.max(), 0.0))


def _row(mover: MoverTruth) -> str:
    numbers = [*mover.box, *mover.position, *mover.velocity, mover.time_to_contact]
    values = ','.join(f'{value:.9g}' for value in numbers)
    last = ','.join(f'{value:.9g}' for value in (mover.range, mover.closing, mover.aside))
    return f'{format_stamp(mover.stamp)},{mover.id},{values},{mover.n_macroblocks},{last}'
