"""Surface integrals of the curvature, and how far they are from the true phase.

By Stokes' theorem a commutative group would be moved by exp(−∬B).  Others are not, and by how much
they are not depends on the frame: in a minimum-perturbation frame the integral is nearest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ..connections.connection import Connection
from ..gaits.gait import Gait
from ..phases.phase import phase
from .optimal_frame import OptimalFrame
from .patches import Disc

_TRUSTED = 0.05  # relative


@dataclass(frozen=True)
class CorrectedIntegral:
    """The corrected body-velocity integral of a gait, −∬B in some frame, beside the true phase.

    integral: (r,), a twist.  phase: (size,) of the gait in that frame.  log: (r,) its logarithm.
    error: |integral − log| over |log|, of the part that moves: translations if there are any, else
    rotations.  trusted: whether that is below five per cent.
    """

    integral: Array
    phase: Array
    log: Array
    error: float
    trusted: bool

    def __post_init__(self) -> None:
        freeze(self)


def corrected_integral(
    connection: Connection, gait: Gait, frame: OptimalFrame | None = None
) -> CorrectedIntegral:
    """Return −∬B over the disc that a Fourier gait spans, beside the true phase.

    frame: in which the curvature is taken, B′ = Ad_{h⁻¹}B; that of the base if not given.
    """
    group, disc = connection.group, Disc(gait)
    u = disc.nodes
    x = disc.shapes(u)
    slopes = disc.slopes(u)
    # B of the two parameters: only pairs of joints that the disc moves along enter.
    B = connection.grid(x).curvature
    two = np.einsum("niab,na,nb->ni", B, slopes[..., 0], slopes[..., 1])
    pose = phase(connection, gait).pose
    if frame is not None:
        own = isinstance(frame.patch, Disc)
        place = frame.pose_at(u) if own else frame.pose(x)
        two = (group.Ad(group.inverse(place)) @ two[..., None])[..., 0]
        h = frame.pose_at(np.array([[1.0, 0.0]]))[0] if own else frame.pose(gait.at(0.0)[0])
        pose = group.compose(group.compose(group.inverse(h), pose), h)
    integral = -(disc.weights @ two)
    log = group.log(pose)
    part = slice(0, group.linear) if group.linear else slice(0, None)
    size = float(np.linalg.norm(log[part]))
    error = float(np.linalg.norm((integral - log)[part])) / size if size > 0.0 else np.inf
    return CorrectedIntegral(integral, pose, log, error, bool(error < _TRUSTED))
