"""Surface integrals of the curvature, compared with the phase.

If the group were commutative, the phase would be exp(−∬B) by Stokes' theorem. For other groups, the
error of this approximation depends on the frame of the curvature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.html import Rows, Summary
from ...common.waiting import Wait
from ..connections.connection_source import ConnectionSource, connection_of
from ..gaits.gait import Gait
from ..phases.phase import phase
from .optimal_frame import OptimalFrame
from .patches import Disc

_TRUSTED = 0.05  # relative error below which the integral is trusted


@checks_arguments
@dataclass(frozen=True, repr=False)
class CorrectedIntegral(Summary, FrozenArrays):
    """The corrected body-velocity integral −∬B of a gait, and the true phase.

    Attributes:
        integral: −∬B, a twist, (r,).
        phase: Phase of the gait in the same frame, (size,).
        log: Logarithm of the phase, (r,).
        error: |integral − log| / |log|, of the translations, or of the rotations if there are none.
        trusted: Whether the error is below five per cent.
    """

    integral: Array
    phase: Array
    log: Array
    error: float
    trusted: bool

    def title(self) -> str:
        """Return the first line of the text."""
        return "corrected integral −∬B of a gait, against its phase"

    def rows(self) -> Rows:
        """Return the rows of the text."""
        judgement = "trusted" if self.trusted else f"not trusted: above {_TRUSTED:g}"
        return [
            ("integral", _numbers(self.integral)),
            ("log of the phase", _numbers(self.log)),
            ("phase", _numbers(self.phase)),
            ("relative error", f"{self.error:.3g}, {judgement}"),
        ]


def _numbers(values: Array) -> str:
    return ", ".join(f"{value:.9g}" for value in values)


@checks_arguments
@Wait("integrates the curvature over a gait")
def corrected_integral(
    connection: ConnectionSource, gait: Gait, frame: OptimalFrame | None = None
) -> CorrectedIntegral:
    """Compute −∬B over the disc spanned by a Fourier gait, and the true phase.

    Args:
        connection: Connection that lifts the gait, or a System for its mechanical connection.
        gait: Gait that is one Fourier series.
        frame: Frame of the curvature, B′ = Ad_{h⁻¹}B; by default the base frame.
    Returns:
        Integral, phase and relative error.
    """
    connection = connection_of(connection, "corrected_integral").in_chart()
    group, disc = connection.group, Disc(gait)
    u = disc.nodes
    x = disc.shapes(u)
    slopes = disc.slopes(u)
    # Pull the curvature back to the two parameters of the disc.
    B = connection.grid(x).curvature
    density = np.einsum("niab,na,nb->ni", B, slopes[..., 0], slopes[..., 1])
    pose = phase(connection, gait).pose
    if frame is not None:
        is_disc = isinstance(frame.patch, Disc)
        frame_poses = frame.pose_at(u) if is_disc else frame.pose(x)
        density = (group.Ad(group.inverse(frame_poses)) @ density[..., None])[..., 0]
        h = frame.pose_at(np.array([[1.0, 0.0]]))[0] if is_disc else frame.pose(gait.at(0.0)[0])
        pose = group.compose(group.compose(group.inverse(h), pose), h)
    integral = -(disc.weights @ density)
    log = group.log(pose)
    components = slice(0, group.linear) if group.linear else slice(0, None)
    size = float(np.linalg.norm(log[components]))
    error = float(np.linalg.norm((integral - log)[components])) / size if size > 0.0 else np.inf
    return CorrectedIntegral(integral, pose, log, error, bool(error < _TRUSTED))
