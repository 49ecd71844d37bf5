"""Connections of robots with closed loops, over independent joints.

Closed shapes x(u) have rates ẋ = G u̇.  Values of the open tree's connection are pulled back along
this map: A G, Gᵀ M G and Gᵀ B G.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...common.arrays import Array, rows
from ...common.errors import InputError, UnsupportedOperationError
from ...kernels.connection.connection_code import ConnectionCode, Curvatures, Locals, Velocities
from ...system.loops.loop_chart import LoopChart, loop_chart
from ...system.system import System
from .closed_path import ClosedPath


@dataclass(frozen=True, eq=False)
class LoopConnectionCode(ConnectionCode):
    """Values of a connection over the independent coordinates u, (N, d), of closed shapes.

    Attributes:
        form: Form of the open tree, with the space of the independent coordinates.
        tree: Machine code of the open tree's connection.
        chart: Independent joints.
    """

    tree: ConnectionCode = field(repr=False)
    chart: LoopChart = field(repr=False)

    def velocities(self, x: Array, xdot: Array) -> Velocities:
        """Compute the horizontal motions."""
        shapes, G = self._closed(x)
        return self.tree.velocities(shapes, np.einsum("nma,na->nm", G, xdot))

    def velocity_slopes(self, x: Array, xdot: Array) -> Array:
        """Return the derivative of (ξ, ẋᵀ M ẋ) with respect to (u, u̇), (N, r + 1, 2d)."""
        shapes, G = self._closed(x)
        rates = np.einsum("nma,na->nm", G, xdot)
        slopes, m = self.tree.velocity_slopes(shapes, rates), self.tree.form.m
        by_rate = slopes[:, :, m:] @ G
        turned = self._path.turned(shapes, G, rates)
        by_shape = slopes[:, :, :m] @ G + slopes[:, :, m:] @ turned
        return np.concatenate([by_shape, by_rate], axis=-1)

    def covariant_forces(
        self, x: Array, xdot: Array, xddot: Array, along: Array
    ) -> tuple[Array, Array]:
        """Compute the forces Gᵀf on the independent joints, and the gradients of λᵀGᵀf."""
        shapes, G = self._closed(x)
        rates, weights = (np.einsum("nma,na->nm", G, value) for value in (xdot, along))
        acceleration, bent = self._path.accelerations(shapes, G, rates, xddot)
        force, slope = self.tree.covariant_forces(shapes, rates, acceleration, weights)
        m, d = self.tree.form.m, self.form.m
        by_shape, by_rate, by_acceleration = (slope[:, k * m : (k + 1) * m] for k in range(3))
        turned, weighed = (self._path.turned(shapes, G, value) for value in (rates, weights))
        gradient = np.einsum("nm,nmc->nc", by_acceleration, bent)
        gradient[:, :d] += np.einsum("nm,nmc->nc", by_shape, G)
        gradient[:, :d] += np.einsum("nm,nmc->nc", by_rate, turned)
        gradient[:, :d] += np.einsum("nm,nmc->nc", force, weighed)
        gradient[:, d : 2 * d] += np.einsum("nm,nmc->nc", by_rate, G)
        return np.einsum("nma,nm->na", G, force), gradient

    def locals(self, x: Array) -> Locals:
        """Compute the matrix of the form, the local connection, and the metric."""
        shapes, G = self._closed(x)
        terms, r, d = self.tree.locals(shapes), self.form.r, self.form.m
        T = np.zeros((len(G), r + self.tree.form.m, r + d))
        T[:, :r, :r], T[:, r:, r:] = np.eye(r), G
        matrix = terms.matrix @ T
        if self.form.symmetric:
            matrix = np.swapaxes(T, 1, 2) @ matrix
        M = None if terms.M is None else np.swapaxes(G, 1, 2) @ terms.M @ G
        return Locals(matrix, terms.A @ G, terms.health, M)

    def curvatures(self, x: Array) -> Curvatures:
        """Compute the two terms of the curvature separately."""
        shapes, G = self._closed(x)
        B, health = self._pulled_back(shapes, G)
        A = self.tree.locals(shapes).A @ G
        constants = self.form.group.ad(np.eye(self.form.r))  # [a, i, b]: entry i of [e_a, e_b]
        bracket = np.einsum("cid,nca,ndb->niab", constants, A, A)
        return Curvatures(B + bracket, bracket, health)

    def curvature(self, x: Array) -> tuple[Array, Array]:
        """Return the curvature, (N, r, d, d), and the health of P_b, (N,)."""
        return self._pulled_back(*self._closed(x))

    def locked_derivatives(self, x: Array, omega: Array) -> Array:
        """Return ∂(P_b ω)/∂u at constant body twists ω (N, r), (N, r, d)."""
        shapes, G = self._closed(x)
        return self.tree.locked_derivatives(shapes, omega) @ G

    def state(self, u: Array, udot: Array) -> tuple[Array, Array]:
        """Return shape (nx,) and rates (m,) of all joints at coordinates and rates (d,)."""
        shapes, G = self._closed(u[None])
        return shapes[0], G[0] @ udot

    @property
    def chart_system(self) -> System:
        """The robot."""
        assert isinstance(self.chart.system, System)
        return self.chart.system

    def _closed(self, u: Array) -> tuple[Array, Array]:
        """Return closed shapes, (N, nx), and their maps G, (N, m, d)."""
        shapes = self._path.shapes(rows(u, self.form.nx, "x"))
        return shapes, self._path.tangents(shapes)

    @property
    def _path(self) -> ClosedPath:
        return ClosedPath(self.chart)

    def _pulled_back(self, shapes: Array, G: Array) -> tuple[Array, Array]:
        B, health = self.tree.curvature(shapes)
        return np.einsum("nimp,nma,npb->niab", B, G, G), health


def code_with_loops(
    system: System,
    independent: Sequence[str] | None,
    code_of: Callable[[System], ConnectionCode],
) -> ConnectionCode:
    """Return the values of a connection, over independent joints if a robot has loops.

    The loops act between the links of the robot, so they change neither the momenta nor the drag
    of the whole robot, and no wheel constraint.

    Args:
        system: The system.
        independent: Names of the independent joints; None: chosen at the assembled shape.
        code_of: Function that returns the connection of a system without loops.
    Returns:
        The values of the connection.
    Raises:
        InputError: The independent joints are not valid, or one is an axis of a ball.
    """
    if not system.loops:
        if independent is not None:
            raise InputError("independent: expected none, because the robot has no loops")
        return code_of(system)
    tree, chart = code_of(system.open_tree()), loop_chart(system, independent)
    form = replace(tree.form, space=chart.space(), what=f"{tree.form.what} with closed loops")
    return LoopConnectionCode(form, tree, chart)


def refuse_moved_loops(code: ConnectionCode, what: str) -> None:
    """Raise UnsupportedOperationError if a connection with closed loops is to be changed."""
    if isinstance(code, LoopConnectionCode):
        names = ", ".join(loop.name for loop in code.chart_system.loops)
        raise UnsupportedOperationError(
            f"{what}: closed loops are not supported here, and '{code.chart_system.name}' has the "
            f"loops {names}. Use the connection in the frame of the robot's root."
        )
