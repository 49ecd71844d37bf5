"""First loops from the curvature: small ellipses that turn the base as wanted, to leading order.

A small loop x₀ − c + c cos φ + s sin φ moves the base by exp(−Σ_{a<b} B_ab S_ab), with the bivector
S = π (c sᵀ − s cᵀ) of its area and the curvature B at x₀.
"""

from __future__ import annotations

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.gaits.gait import Gait
from ...common.arrays import Array
from ...common.errors import InputError

_MOST = 0.7  # of the room that joints have, at most
_ASIDE = 0.3  # of that room
_FITS = 1e-6  # of the turn, that may be missing


def first_loop(connection: Connection, start: Array, turn: Array, limits: Array) -> Gait:
    """Return the ellipse from a shape (m,) whose least bivector turns the base by `turn`.

    turn: (turns,) rotation vector or angle [rad].  limits: (m, 2), within which it is shrunk.
    Raises InputError if the curvature there does not turn the base so.
    """
    m = connection.m
    room = np.maximum(np.minimum(limits[:, 1] - start, start - limits[:, 0]), 1e-3)
    S = np.zeros((m, m))
    a, b = np.triu_indices(m, 1)
    # Where the curvature at the start turns nothing so, as of rods in a line, that beside it does.
    beside = _ASIDE * room * np.where(np.arange(m) % 2, -1.0, 1.0)
    for near in (start, start + _ASIDE * room, start + beside):
        B = connection.curvature(near)[connection.group.linear :, a, b]  # (turns, pairs)
        least = np.linalg.lstsq(-B, turn, rcond=1e-9)[0]
        if np.linalg.norm(B @ least + turn) <= _FITS * np.linalg.norm(turn):
            break
    else:
        raise InputError("small loops from this shape do not turn the base so; start elsewhere")
    S[a, b], S[b, a] = least, -least
    # S = Σ σ (u vᵀ − v uᵀ); its leading plane has the singular vectors u and Sᵀu / σ.
    u, sizes, _ = np.linalg.svd(S)
    c = u[:, 0]
    s = S.T @ c
    s = s / max(float(np.linalg.norm(s)), 1e-300)
    radius = np.sqrt(float(sizes[0]) / np.pi)
    reach = np.max(2.0 * np.abs(c) / room + np.abs(s) / room)
    radius = min(radius, _MOST / float(reach))
    return Gait.fourier(start - radius * c, [radius * c], [radius * s])
