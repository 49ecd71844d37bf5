"""Wong's equations: the motion of a charge on shape space, whose closed solutions are extremals.

A path of least length for its displacement obeys ∇_ẋ ẋ = M⁻¹⟨μ, B(·, ẋ)⟩ with the curvature B and
the charge μ, the body momentum that the displacement costs.  Its spatial components J = Ad*_{g⁻¹} μ
are constant.  With the canonical momentum p = M u + Aᵀμ, u = ẋ, the equations need no curvature:

    ẋ = u = M⁻¹(p − Aᵀμ),   ṗ = ½ uᵀ∂M u + ⟨μ, ∂A u⟩,   ġ = −g A u,   μ = Ad_gᵀ J.

The speed |u|_M is constant.  Batches of motions are integrated together, with common steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...analysis.connections.connection import Connection
from ...common.arrays import Array
from ...common.errors import IntegrationError, SingularInertiaError

_RELATIVE, _ABSOLUTE = 1e-13, 1e-14  # tolerances of the integrator


@dataclass(frozen=True, eq=False)
class Motions:
    """N states of Wong's equations.

    Attributes:
        x: Shapes, (N, m).
        p: Canonical momenta p = M u + Aᵀμ, (N, m).
        pose: Poses of the base, (N, size).
        charge: Spatial charges J, (N, r).
    """

    x: Array
    p: Array
    pose: Array
    charge: Array


@dataclass(frozen=True, eq=False)
class WongEquations:
    """Wong's equations of a connection with a metric.

    Attributes:
        connection: The connection.
    """

    connection: Connection

    def body_charges(self, pose: Array, charge: Array) -> Array:
        """Return the body charges μ = Ad_gᵀ J, (N, r), for poses (N, size) and J (N, r)."""
        Ad = self.connection.group.Ad(pose)
        return np.asarray(np.einsum("nab,na->nb", Ad, charge))

    def rates(self, motions: Motions) -> tuple[Array, Array, Array]:
        """Compute the rates of states.

        Args:
            motions: The states.
        Returns:
            ẋ = u (N, m), ṗ (N, m) and ġ (N, size).
        """
        connection = self.connection
        r, m = connection.r, connection.m
        mu = self.body_charges(motions.pose, motions.charge)
        A, M, _ = connection.locals_at(motions.x)
        right = motions.p - np.einsum("nra,nr->na", A, mu)
        u = np.asarray(np.linalg.solve(np.asarray(M), right[..., None])[..., 0])
        slopes = connection.horizontal_slopes(motions.x, u)[:, :, :m]
        force = 0.5 * slopes[:, r] - np.einsum("nr,nra->na", mu, slopes[:, :r])
        twist = -np.einsum("nra,na->nr", A, u)
        return u, force, connection.group.rate(motions.pose, twist)

    def momenta(self, x: Array, u: Array, pose: Array, charge: Array) -> Array:
        """Return the canonical momenta p = M u + Aᵀμ, (N, m), of shape rates u (N, m)."""
        A, M, _ = self.connection.locals_at(x)
        mu = self.body_charges(pose, charge)
        return np.asarray(
            np.einsum("nab,nb->na", np.asarray(M), u) + np.einsum("nra,nr->na", A, mu)
        )

    def flow(self, start: Motions, duration: float) -> Motions:
        """Integrate a batch of motions with DOP853.

        Args:
            start: Initial states.
            duration: Duration.
        Returns:
            The final states.
        Raises:
            IntegrationError: The integration failed, or a motion meets a singular shape.
        """
        from scipy.integrate import solve_ivp

        m, count = self.connection.m, len(start.x)

        def states(y: Array) -> Motions:
            rows = y.reshape(count, -1)
            return Motions(rows[:, :m], rows[:, m : 2 * m], rows[:, 2 * m :], start.charge)

        def rate(_: float, y: Array) -> Array:
            return np.hstack(self.rates(states(y))).ravel()

        y = np.hstack([start.x, start.p, start.pose]).ravel()
        try:
            run = solve_ivp(
                rate, (0.0, duration), y, method="DOP853", rtol=_RELATIVE, atol=_ABSOLUTE,
                first_step=min(duration, 0.01),
            )  # fmt: skip
        except (SingularInertiaError, FloatingPointError, np.linalg.LinAlgError) as error:
            raise IntegrationError(f"an extremal meets a singular shape: {error}") from error
        if not run.success:
            raise IntegrationError(f"Wong's equations could not be integrated: {run.message}")
        end = states(run.y[:, -1])
        return Motions(end.x, end.p, self.connection.group.normalize(end.pose), end.charge)
