"""Closed shapes of many independent coordinates at once, with the maps to all joint rates.

The loops are evaluated by CasADi for all shapes together.  Shapes are followed along straight lines
from a grid of shapes; where such a line passes a singular shape, they are followed one by one (see
system/loops/loop_chart.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ...common.arrays import Array
from ...common.errors import SingularInertiaError
from ...common.memo import once, recent
from ...reduction.tree.body_frames import bodies_of
from ...reduction.tree.loop_constraints import constraint_values, jacobian_function, rate_map
from ...system.loops.loop_assembly import rate_units
from ...system.loops.loop_chart import LoopChart
from ...system.system import System

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
        turned = np.zeros((count, m, d))
        if not count:
            return turned
        columns = np.swapaxes(G, 1, 2).reshape(-1, m)
        inputs = (np.repeat(shapes, d, axis=0).T, columns.T, np.repeat(rates, d, axis=0).T)
        bends = np.array(self._bend(*inputs)).T.reshape(count, d, -1)
        J_D = self._jacobians(shapes)[:, :, chart.dependent]
        turned[:, chart.dependent] = -np.linalg.solve(J_D, np.swapaxes(bends, 1, 2))
        return turned

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
        turned = self.turned(shapes, G, rates)
        right = np.concatenate([by_shape @ G + by_rate @ turned, by_rate @ G], axis=-1)
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
                J, residual = self._jacobians(x), self._residuals(x)
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

    def _residuals(self, shapes: Array) -> Array:
        return np.array(self._functions[0](shapes.T)).T

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
