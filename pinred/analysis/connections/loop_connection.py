"""The reduction and the connections of robots with closed loops, over independent joints.

Independent joint rates u̇ determine all joint rates, ẋ = G u̇.  The loops are functions of the
shape, so symmetry and locked inertia are unchanged, and the other quantities are pulled back:
A G, Gᵀ M G and Gᵀ B G, without further terms.  Derivatives ∂_c are taken along column c of G.

Many closed shapes are computed at once, with the maps to all joint rates.  The loops are evaluated
by CasADi for all shapes together.  Shapes are followed along straight lines from a grid of shapes;
where such a line passes a singular shape, they are followed one by one (see
system/loops/independent_joints.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, rows, vector
from ...common.errors import InputError, SingularInertiaError, UnsupportedOperationError
from ...common.memo import once, recent
from ...common.names import quoted
from ...kernels.connection.connection_code import ConnectionCode, Curvatures, Locals, Velocities
from ...reduction.pointwise_reduction import InertiaSplit, PointwiseReduction, ReducedShape
from ...reduction.potential import Springs
from ...reduction.tree.body_frames import bodies_of
from ...reduction.tree.loop_constraints import constraint_values, jacobian_function, rate_map
from ...system.loops.independent_joints import LoopChart, loop_chart
from ...system.loops.loop_assembly import CLOSED, describe_gap, loop_gaps, rate_units
from ...system.system import System, checked_system

_STEP = 0.1  # longest step along a line [rad | fraction of the loops' length]
_CELL = 0.2  # distance between shapes from which lines start [rad | fraction of the length]
_ANCHORS = 64  # largest number of such shapes that are kept
_ITERATIONS = 12  # largest number of Newton steps
_CLOSED = 1e-13  # largest change of a joint in the last Newton step [rad | m]
_LONGEST = 0.5  # longest correction of a step [rad | fraction of the loops' length]
_SINGULAR = 1e-5  # least singular value of J_D, relative to J, above which G needs no check


@dataclass(frozen=True, eq=False)
class ClosedPath:
    """Maps from independent coordinates to closed shapes, for many shapes at once.

    Attributes:
        chart: Independent joints.
    """

    chart: LoopChart

    def shapes(self, u: Array) -> Array:
        """Return the closed shapes, (N, nx), with independent coordinates u (N, d)."""
        anchor = self._anchor(u[0]) if len(u) else None
        shapes = None if anchor is None else self._along_lines(anchor, u)
        return self.chart.shapes(u) if shapes is None else shapes

    def _anchor(self, u: Array) -> Array | None:
        """Return the closed shape, (nx,), at the centre of the cell of u; None if there is none."""
        closure = self._system.closure
        assert closure is not None
        size = _CELL * rate_units(self._system, closure.length)[self.chart.independent]
        cell = np.round(u / size)

        def make() -> Array | None:
            try:
                return np.asarray(self.chart.shapes((cell * size)[None])[0])
            except SingularInertiaError:
                return None

        key = (self.chart.names, cell.tobytes())
        return recent(self._system, key, make, _ANCHORS, ClosedPath)

    def regularity(self, shapes: Array) -> Array:
        """Return the smallest singular values of J_D at shapes (N, nx), relative to J, (N,)."""
        J = self._jacobians(shapes)
        return np.asarray(self._least(J) / np.linalg.norm(J, axis=(1, 2)))

    def tangents(self, shapes: Array) -> Array:
        """Return G, (N, m, d), at closed shapes (N, nx).

        Raises:
            SingularInertiaError: The independent joints do not determine the others at a shape.
        """
        chart, count = self.chart, len(shapes)
        J = self._jacobians(shapes)
        J_D, J_I = J[:, :, chart.dependent], J[:, :, chart.independent]
        G = np.zeros((count, chart.system.m, len(chart.independent)))
        G[:, chart.independent] = np.eye(len(chart.independent))
        is_doubtful = ~(self._least(J) > _SINGULAR * np.linalg.norm(J, axis=(1, 2)))
        regular = np.flatnonzero(~is_doubtful)
        G[np.ix_(regular, chart.dependent)] = -np.linalg.solve(J_D[regular], J_I[regular])
        for k in np.flatnonzero(is_doubtful).tolist():
            G[k] = chart.tangent(shapes[k])
        return G

    def turned(self, shapes: Array, G: Array, rates: Array) -> Array:
        """Return ∂_c G u̇, (N, m, d), with the index c last.

        Args:
            shapes: Closed shapes, (N, nx).
            G: Maps to all rates, (N, m, d).
            rates: Rates of all joints ẋ = G u̇, (N, m).
        """
        chart, (count, m, d) = self.chart, G.shape
        rotated = np.zeros((count, m, d))
        if not count:
            return rotated
        columns = np.swapaxes(G, 1, 2).reshape(-1, m)
        inputs = (np.repeat(shapes, d, axis=0).T, columns.T, np.repeat(rates, d, axis=0).T)
        bends = np.array(self._bend(*inputs)).T.reshape(count, d, -1)
        J_D = self._jacobians(shapes)[:, :, chart.dependent]
        rotated[:, chart.dependent] = -np.linalg.solve(J_D, np.swapaxes(bends, 1, 2))
        return rotated

    def accelerations(
        self, shapes: Array, G: Array, rates: Array, uddot: Array
    ) -> tuple[Array, Array]:
        """Return the accelerations ẍ of all joints, and their derivatives.

        They solve J_D ẍ_D = −J_I ü − (∂J/∂x ẋ) ẋ.

        Args:
            shapes: Closed shapes, (N, nx).
            G: Maps to all rates, (N, m, d).
            rates: Rates of all joints ẋ = G u̇, (N, m).
            uddot: Accelerations of the independent joints ü, (N, d).
        Returns:
            ẍ (N, m), and its derivatives with respect to (u, u̇, ü), (N, m, 3d).
        """
        chart, (count, m, d) = self.chart, G.shape
        acceleration = np.einsum("nma,na->nm", G, uddot)
        J, slopes = self._jacobians(shapes), np.zeros((count, m, 3 * d))
        bend = np.array(self._bend(shapes.T, rates.T, rates.T)).T
        J_D = J[:, :, chart.dependent]
        acceleration[:, chart.dependent] -= np.linalg.solve(J_D, bend[..., None])[..., 0]
        inputs = (shapes.T, rates.T, acceleration.T)
        by_shape, by_rate = (
            np.swapaxes(np.array(block).T.reshape(count, m, -1), 1, 2)
            for block in self._functions[2].map(count)(*inputs)
        )
        rotated = self.turned(shapes, G, rates)
        right = np.concatenate([by_shape @ G + by_rate @ rotated, by_rate @ G], axis=-1)
        slopes[:, chart.dependent, : 2 * d] = -np.linalg.solve(J_D, right)
        slopes[:, :, 2 * d :] = G
        return acceleration, slopes

    def _along_lines(self, first: Array, u: Array) -> Array | None:
        """Follow lines from a closed shape; None if one passes a singular shape."""
        chart, system = self.chart, self._system
        closure, space = system.closure, system.space
        assert closure is not None
        at = space.coordinates_of(chart.independent.tolist())
        unit = rate_units(system, closure.length)
        span = u - first[at]
        distance = np.abs(span / unit[chart.independent]).max(initial=0.0)
        steps = max(1, int(np.ceil(distance / _STEP)))
        x = np.tile(first, (len(u), 1))
        side = np.linalg.slogdet(self._jacobians(first[None])[:, :, chart.dependent])[0]
        for _ in range(steps):
            change = np.zeros((len(u), system.m))
            change[:, chart.independent] = span / steps
            J = self._jacobians(x)
            residual = (J[:, :, chart.independent] @ (span / steps)[:, :, None])[..., 0]
            for _ in range(_ITERATIONS):
                J_D = J[:, :, chart.dependent]
                if not np.abs(np.linalg.det(J_D)).min() > 0.0:
                    return None
                step = -np.linalg.solve(J_D, residual[..., None])[..., 0]
                change[:, chart.dependent] = step
                if not np.abs(step / unit[chart.dependent]).max() <= _LONGEST:
                    return None
                x = space.integrate(x, change)
                size = float(np.abs(step).max())
                change[:] = 0.0
                J, residual = self._jacobians(x), np.array(self._functions[0](x.T)).T
                if size <= _CLOSED:
                    break
            if size > 100.0 * _CLOSED:
                return None
            if (np.linalg.slogdet(J[:, :, chart.dependent])[0] != side).any():
                return None
        x[:, at] = u
        return x

    def _least(self, J: Array) -> Array:
        """Return the smallest singular value of J_D, (N,)."""
        values = np.linalg.svd(J[:, :, self.chart.dependent], compute_uv=False)
        return np.asarray(values[:, -1])

    @property
    def _system(self) -> System:
        assert isinstance(self.chart.system, System)
        return self.chart.system

    def _jacobians(self, shapes: Array) -> Array:
        """Return the Jacobians of the independent equations, (N, c, m)."""
        function, count = jacobian_function(self._system), len(shapes)
        rank, m = self.chart.dependent.size, self._system.m
        if not count:
            return np.empty((0, rank, m))
        columns = np.array(function.map(count)(shapes.T))
        return np.swapaxes(columns.T.reshape(count, m, rank), 1, 2)

    @property
    def _bend(self) -> ca.Function:
        return self._functions[1]

    @property
    def _functions(self) -> tuple[ca.Function, ca.Function, ca.Function]:
        """CasADi functions of φ(x), of (∂J/∂x a) b along rates a and b, and of slopes.

        The slopes are those of J ẍ + (∂J/∂x ẋ) ẋ with respect to x and ẋ.
        """
        system = self._system

        def make() -> tuple[ca.Function, ca.Function, ca.Function]:
            x, a, b = (ca.SX.sym(name, size) for name, size in
                       (("x", system.nx), ("a", system.m), ("b", system.m)))  # fmt: skip
            entries = ca.vertsplit(x)
            E = rate_map(system, entries)
            phi = ca.vertcat(*constraint_values(system, bodies_of(system), entries))
            bend = ca.jtimes(ca.jtimes(phi, x, E @ b), x, E @ a)
            inertial = ca.jtimes(phi, x, E @ b) + ca.jtimes(ca.jtimes(phi, x, E @ a), x, E @ a)
            slopes = [ca.jacobian(inertial, x) @ E, ca.jacobian(inertial, a)]
            options = {"cse": True}
            return (
                ca.Function("phi", [x], [ca.densify(phi)], options),
                ca.Function("bend", [x, a, b], [ca.densify(bend)], options),
                ca.Function("slopes", [x, a, b], list(map(ca.densify, slopes)), options),
            )

        return once(system, ClosedPath, make)


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
        rotated = self._path.turned(shapes, G, rates)
        by_shape = slopes[:, :, :m] @ G + slopes[:, :, m:] @ rotated
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
        rotated, weighed = (self._path.turned(shapes, G, value) for value in (rates, weights))
        gradient = np.einsum("nm,nmc->nc", by_acceleration, bent)
        gradient[:, :d] += np.einsum("nm,nmc->nc", by_shape, G)
        gradient[:, :d] += np.einsum("nm,nmc->nc", by_rate, rotated)
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


@checks_arguments
@dataclass(frozen=True, eq=False)
class ClosedShape(FrozenArrays):
    """The reduction at one closed shape of a robot with loops; arrays are read-only.

    Attributes:
        x: Shape, (nx,) [rad | m | 1].
        independent: Labels of the independent rates, (d,).
        G: Map from independent rates to all shape rates, ẋ = G u̇, (m, d).
        locked_inertia: Locked inertia I, (r, r).
        local_connection: Local connection A G, (r, d).
        reduced_metric: Reduced metric Gᵀ M G, (d, d).
        curvature: Curvature Gᵀ B G, (r, d, d), with [:, a, b] = B_ab.
        com: Centre of mass in the root body's frame, (3,) [m].
        dG: Derivative ∂G, (m, d, d), with the derivative index last.
        dI: Derivative ∂I, (r, r, d), with the derivative index last.
        dA: Derivative ∂(A G), (r, d, d), with the derivative index last.
        dM: Derivative ∂(Gᵀ M G), (d, d, d), with the derivative index last.
        tree: Reduction of the open tree at this shape, in all rates.
    """

    x: Array
    independent: tuple[str, ...]
    G: Array
    locked_inertia: Array
    local_connection: Array
    reduced_metric: Array
    curvature: Array
    com: Array
    dG: Array
    dI: Array
    dA: Array
    dM: Array
    tree: ReducedShape

    @property
    def potential(self) -> float:
        """Potential V [J].  Raises SymmetryError if gravity breaks the symmetry."""
        return self.tree.potential

    def amended_potential(self, mu: ArrayLike) -> float:
        """Compute the amended potential V + ½ μᵀ I⁻¹ μ.

        Args:
            mu: Body momentum, (r,) [N s | N m s].
        Returns:
            The amended potential [J].
        """
        mu = vector(mu, len(self.locked_inertia), "mu")
        return self.potential + 0.5 * float(mu @ np.linalg.solve(self.locked_inertia, mu))


@checks_arguments
class LoopReduction:
    """The reduction of a robot with closed loops, in independent joint rates.

    An instance owns Pinocchio work space, so use one per thread.
    """

    def __init__(
        self,
        system: System,
        *,
        independent: Sequence[str] | None = None,
        springs: Springs | None = None,
    ) -> None:
        """Choose the independent joints.

        Args:
            system: System with closed loops.
            independent: Names of the independent joints, as many as `System.shape_dim`.  None:
                they are chosen where the loops were assembled.  `at` replaces them at their dead
                points.
            springs: Springs that are added to V(x), {joint: (stiffness [N·m/rad | N/m],
                rest [rad | m])}.
        Raises:
            InputError: The system has no loops, or the independent joints are not valid.
            SingularInertiaError: The independent joints do not determine the others.
        """
        self.system = checked_system(system, "LoopReduction", loops=True)
        if not system.loops:
            raise InputError("LoopReduction: expected a robot with loops. Use Reduction.")
        self._chart = loop_chart(system, independent)
        self._tree = PointwiseReduction(system.open_tree(), springs=springs)

    def __repr__(self) -> str:
        return f"LoopReduction({self.system!r}, independent={self.independent})"

    @property
    def independent(self) -> tuple[str, ...]:
        """Labels of the independent rates, (d,)."""
        return self._chart.names

    def shape(self, u: ArrayLike) -> Array:
        """Return the closed shape with given independent coordinates.

        Args:
            u: Independent coordinates, (d,) [rad | m].
        Returns:
            Shape, (nx,) [rad | m | 1], connected with the assembled shape.
        Raises:
            SingularInertiaError: The loops do not close there.
            InputError: An independent rate is an axis of a ball.
        """
        u = vector(u, self.system.shape_dim, "u", self.independent)
        return np.asarray(self._chart.shapes(u[None])[0])

    def at(self, x: ArrayLike) -> ClosedShape:
        """Compute all quantities at one closed shape.

        At a dead point, where the independent joints do not determine the others, other independent
        joints replace them; `ClosedShape.independent` names them.

        Args:
            x: Closed shape, (nx,) [rad | m | 1].
        Returns:
            The quantities.
        Raises:
            InputError: A loop is open at x; the message names it and its gap.
            SingularInertiaError: The equations of the loops are dependent at x.
        """
        tree = self._tree.at(x)
        self._refuse_open(tree.x)
        chart = self._chart.regular_at(tree.x)
        G = chart.tangent(tree.x)
        dG = np.stack([chart.tangent_rate(tree.x, column, G) for column in G.T], axis=-1)
        A, M = tree.local_connection, tree.reduced_metric
        dM = np.einsum("mnp,ma,nb,pc->abc", tree.dM, G, G, G)
        by_basis = np.einsum("mac,mn,nb->abc", dG, M, G)
        return ClosedShape(
            x=tree.x,
            independent=chart.names,
            G=G,
            locked_inertia=tree.locked_inertia,
            local_connection=A @ G,
            reduced_metric=G.T @ M @ G,
            curvature=np.einsum("imn,ma,nb->iab", tree.curvature, G, G),
            com=tree.com,
            dG=dG,
            dI=tree.dI @ G,
            dA=np.einsum("imp,ma,pc->iac", tree.dA, G, G) + np.einsum("im,mac->iac", A, dG),
            dM=dM + by_basis + by_basis.transpose(1, 0, 2),
            tree=tree,
        )

    def split(self, x: ArrayLike) -> InertiaSplit:
        """Compute I, A G, GᵀMG, the mass matrix and the centre of mass at one closed shape.

        Args:
            x: Closed shape, (nx,) [rad | m | 1].
        Returns:
            The quantities without derivatives, in the rates of `independent`.
        Raises:
            InputError: A loop is open at x; the message names it and its gap.
            SingularInertiaError: The independent joints do not determine the others at x.
        """
        tree = self._tree.split(x)
        self._refuse_open(tree.x)
        G = self._chart.tangent(tree.x)
        (m, d), r = G.shape, tree.r
        T = np.zeros((r + m, r + d))
        T[:r, :r], T[r:, r:] = np.eye(r), G
        return InertiaSplit(
            x=tree.x,
            mass_matrix=T.T @ tree.mass_matrix @ T,
            locked_inertia=tree.locked_inertia,
            local_connection=tree.local_connection @ G,
            reduced_metric=G.T @ tree.reduced_metric @ G,
            com=tree.com,
        )

    def _refuse_open(self, x: Array) -> None:
        """Raise InputError if a loop is open at shape x (nx,)."""
        system, closure = self.system, self.system.closure
        assert closure is not None
        gaps = loop_gaps(system, x, closure.length)
        if gaps.max() > 1e3 * CLOSED:
            raise InputError(
                f"x: expected a closed shape of {quoted(system.name)}, but "
                f"{describe_gap(system, gaps, closure.length)}. LoopReduction.shape returns one."
            )
