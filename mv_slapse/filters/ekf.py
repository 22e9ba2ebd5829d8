"""Extended Kalman filter over a state whose blocks come and go.

Notation of Thrun et al., Probabilistic Robotics: mean mu, covariance P, Jacobians F and H,
noise Q and R, innovation z - h(mu).
"""

from collections.abc import Hashable
from functools import cache
import math

from mv_slapse.kernels.binding import compiled
import numpy as np

CONFIDENCE = 0.99  # beyond which what was supposed is given up
ROUNDING = 1e-6  # by which an eigenvalue of the correlations may lie below zero


class State:
    """Mean and covariance with named blocks, such as ``'camera'`` and one for each plane id.

    ``lasting`` (n, m) is what errors that last, such as a wrong camera height, have done to the
    mean: one column for each, for one standard deviation of it. They are not estimated (a Schmidt
    or consider filter): ``P`` is what random errors leave, and the sum is in ``total``.
    """

    def __init__(self, n_lasting: int = 0):
        """Start without blocks."""
        self.mu = np.zeros(0)
        self.P = np.zeros((0, 0))
        self.lasting = np.zeros((0, n_lasting))
        self._blocks: dict[Hashable, slice] = {}

    def index(self, name: Hashable) -> slice:
        """Return where a block lies in mu and P."""
        return self._blocks[name]

    @property
    def total(self) -> np.ndarray:
        """Return the covariance with lasting errors in it."""
        return self.P + self.lasting @ self.lasting.T

    def covariance(self, name: Hashable) -> np.ndarray:
        """Return the covariance of a block."""
        at = self._blocks[name]
        return self.P[at, at] + self.lasting[at] @ self.lasting[at].T

    def add(self, name: Hashable, mu: np.ndarray, P: np.ndarray):
        """Append a block that is independent of the rest."""
        if name in self._blocks:
            raise KeyError(f'the state has a block {name!r} already')
        n = len(self.mu)
        self._blocks[name] = slice(n, n + len(mu))
        self.mu = np.concatenate((self.mu, mu))
        self.lasting = np.concatenate((self.lasting, np.zeros((len(mu), self.lasting.shape[1]))))
        before, self.P = self.P, np.zeros((len(self.mu), len(self.mu)))
        self.P[:n, :n], self.P[n:, n:] = before, P

    def remove(self, name: Hashable):
        """Marginalise a block out: its rows and columns go, the rest keeps its values."""
        gone = self._blocks.pop(name)
        size = gone.stop - gone.start
        self.mu = np.delete(self.mu, gone)
        self.lasting = np.delete(self.lasting, gone, 0)
        self.P = np.delete(np.delete(self.P, gone, 0), gone, 1)
        for other, at in self._blocks.items():
            if at.start > gone.start:
                self._blocks[other] = slice(at.start - size, at.stop - size)


def consider(state: State, H: np.ndarray, column: int) -> np.ndarray:
    """Make what is not known of H mu (n,) an error that lasts; return what such do to it (m,).

    The column must be empty. The covariance in all stays the same.
    """
    gone = state.P @ H
    sigma = np.sqrt(H @ gone)
    state.lasting[:, column] = gone / sigma
    state.P = _symmetric(state.P - np.outer(gone, gone) / sigma**2)
    return H @ state.lasting


def estimate_again(state: State, column: int):
    """Make an error that lasts one that is estimated again; the covariance in all stays."""
    state.P = state.P + np.outer(state.lasting[:, column], state.lasting[:, column])
    state.lasting[:, column] = 0


def predict_rows(state: State, rows: np.ndarray, F: np.ndarray, Q: np.ndarray):
    """Move the covariance where the transition is the identity but for r rows (r,) int.

    F (r, n) holds these rows of df/dmu, Q (r, r) their noise; the mean stays.
    """
    state.P, state.lasting = compiled.predict_rows(state.P, state.lasting, rows, F, Q)


def repair(state: State) -> bool:
    """Make P a covariance where rounding has left none; return whether that was so.

    Judged by its correlations, for the units of its elements differ.
    """
    if compiled.is_covariance(state.P, ROUNDING):
        return False
    sigma = np.sqrt(np.maximum(np.diagonal(state.P), 0))
    unit = np.where(sigma > 0, sigma, 1)
    values, vectors = np.linalg.eigh(state.P / unit[:, None] / unit)
    state.P = _symmetric(unit[:, None] * (vectors * np.maximum(values, 0) @ vectors.T) * unit)
    return True


def squared_distance(innovation: np.ndarray, S: np.ndarray) -> float:
    """Return the squared Mahalanobis distance of an innovation with covariance S."""
    solved = compiled.ldlt_solve(np.ascontiguousarray(S), innovation)
    return np.inf if solved is None else float(innovation @ solved)


@cache
def chi2_bound(confidence: float, dof: int) -> float:
    """Return what a squared distance of ``dof`` dimensions stays below at a confidence."""
    low, high = 0.0, 1.0
    while _beyond(high, dof) > 1 - confidence:
        low, high = high, 2 * high
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if _beyond(middle, dof) > 1 - confidence else (low, middle)
    return high


def _beyond(squared, dof):
    """Return the share of squared distances beyond one: closed forms, and a step of two up."""
    half = 0.5 * squared
    order = 0.5 * (dof % 2) or 1.0
    total = math.exp(-half) if dof % 2 == 0 else math.erfc(math.sqrt(half))
    while order < 0.5 * dof:
        total += math.exp(order * math.log(half) - half - math.lgamma(order + 1)) if half else 0.0
        order += 1.0
    return total


def _symmetric(P: np.ndarray) -> np.ndarray:
    """Remove what rounding adds to the skew part."""
    return 0.5 * (P + P.T)
