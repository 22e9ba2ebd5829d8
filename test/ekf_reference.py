"""Prediction and update of a filter in general, for the comparison with the special ones."""

from mv_slapse.filters.ekf import State
import numpy as np


def predict(state: State, mu, F, Q):
    """Move the state to its predicted mean mu = f(state.mu), where F = df/dmu at state.mu."""
    P = F @ state.P @ F.T + Q
    state.mu, state.P, state.lasting = mu, 0.5 * (P + P.T), F @ state.lasting


def update(state: State, innovation, H, R):
    """Correct the state by an innovation z - h(mu), where H = dh/dmu; Joseph form."""
    S = H @ state.P @ H.T + R
    K = np.linalg.solve(S, H @ state.P).T
    I_KH = np.eye(len(state.mu)) - K @ H
    P = I_KH @ state.P @ I_KH.T + K @ R @ K.T
    state.mu, state.P = state.mu + K @ innovation, 0.5 * (P + P.T)
    state.lasting = I_KH @ state.lasting
