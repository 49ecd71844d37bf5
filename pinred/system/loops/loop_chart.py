"""Independent joints as coordinates of the closed shapes of a robot with loops.

With independent joints I and dependent joints D, closed shapes have the rates ẋ = G u̇ with

    G = [1; −J_D⁻¹ J_I],   ∂_c G = [0; −J_D⁻¹ (∂_c J) G],

where J are the independent equations of the loops, and ∂_c is the derivative along column c of G.
The chart is singular where J_D is: at the dead points of a mechanism.  Other independent joints
are regular there, unless the equations of the loops are dependent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...common.errors import InputError, SingularInertiaError
from ...common.names import brief, listed, quoted
from ..coordinates import ShapeSpace, shape_space
from ..joints import HINGE, SLIDE
from .loop_assembly import rate_units, scaled_jacobian
from .looped_system import LoopedSystem, loop_jacobian, loop_jacobian_rate, loop_values

_SINGULAR = 1e-7  # smallest singular value of J_D, relative to that of J, away from dead points
_DEAD = 1e-4  # the same ratio, below which other independent joints replace those of the chart
_STEP = 0.1  # longest step along which a closed shape is followed [rad | fraction of the length]
_SHORTEST = 1e-4  # shortest such step, near dead points
_ITERATIONS = 20  # largest number of Newton steps
_CLOSED = 1e-13  # largest change of a joint in the last Newton step [rad | m]
_LONGEST = 1.0  # longest Newton step [rad | fraction of the length]
_BALL = 1e-3  # weight of a ball's rates, which are dependent if possible


@dataclass(frozen=True, eq=False)
class LoopChart:
    """Independent joints of a robot with loops.

    Attributes:
        system: The system, with loops.
        independent: Indices of the independent rates, (d,).
        dependent: Indices of the dependent rates, (k,).
    """

    system: LoopedSystem
    independent: NDArray[np.intp]
    dependent: NDArray[np.intp]

    @property
    def names(self) -> tuple[str, ...]:
        """Labels of the independent rates, (d,)."""
        return tuple(self.system.space.names[k] for k in self.independent)

    def space(self) -> ShapeSpace:
        """Return the space of the independent coordinates.  Raises InputError for axes of balls."""
        self._coordinates()
        units = [self.system.space.units[k] for k in self.independent]
        return shape_space(self.names, [SLIDE if unit == "m" else HINGE for unit in units])

    def regular_at(self, x: Array) -> LoopChart:
        """Return this chart, or other independent joints at a dead point of these.

        Args:
            x: Closed shape, (nx,) [rad | m].
        Returns:
            A chart that is regular at x.
        Raises:
            SingularInertiaError: The equations of the loops are dependent at x, so no chart is.
        """
        if self.regularity(x) > _DEAD:
            return self
        scaled, _ = self._scaled(x)
        singular = np.linalg.svd(scaled, compute_uv=False).min(initial=np.inf)
        if not singular > _SINGULAR * np.linalg.norm(scaled):
            loops = listed([loop.name for loop in self.system.loops], 6)
            raise SingularInertiaError(
                f"the equations of the loops {loops} of '{self.system.name}' become dependent at "
                f"x = {x}, where motions can continue in several ways. Stay away from this shape."
            )
        return LoopChart(self.system, *_pivoted(self.system, x))

    def regularity(self, x: Array) -> float:
        """Return the smallest singular value of J_D at x (nx,), relative to the size of J."""
        scaled, least = self._scaled(x)
        return least / max(float(np.linalg.norm(scaled)), 1e-300)

    def near(self, x: Array, u: Array) -> Array:
        """Return the closed shape near a shape x (nx,), with independent coordinates u (d,).

        Raises:
            SingularInertiaError: The loops do not close there.
        """
        at = self._coordinates()
        x = x.copy()
        x[at] = u
        closed = self._follow(x, np.zeros(len(at)))
        closed[at] = u
        return closed

    def tangent(self, x: Array) -> Array:
        """Return G at a closed shape x (nx,), (m, d).

        Raises:
            SingularInertiaError: The independent joints do not determine the others there.
        """
        G = np.zeros((self.system.m, len(self.independent)))
        G[self.independent] = np.eye(len(self.independent))
        G[self.dependent] = -self._solve(x, self._jacobian(x)[:, self.independent])
        return G

    def tangent_rate(self, x: Array, xdot: Array, G: Array) -> Array:
        """Return the time derivative of G, (m, d), at rates ẋ = G u̇ (m,)."""
        closure = self.system.closure
        assert closure is not None
        rate = np.zeros_like(G)
        change = loop_jacobian_rate(self.system, x, xdot)[closure.rows]
        rate[self.dependent] = -self._solve(x, change @ G)
        return rate

    def shapes(self, u: Array) -> Array:
        """Return the closed shapes, (N, nx), with independent coordinates u (N, d).

        They are followed from the closed shape that was assembled, so they depend continuously on
        u.

        Raises:
            SingularInertiaError: The loops do not close there.
        """
        at, closure = self._coordinates(), self.system.closure
        assert closure is not None
        unit = rate_units(self.system, closure.length)[self.independent]
        x, shapes = closure.x, np.empty((len(u), self.system.space.nx))
        for k, target in enumerate(u):
            step = _STEP
            while (span := target - x[at]).any():
                share = min(1.0, step / float(np.abs(span / unit).max()))
                goal = target if share == 1.0 else x[at] + share * span
                try:
                    x = self._follow(x, goal - x[at])
                except SingularInertiaError:
                    # Near a dead point, the other joints move faster than the independent ones.
                    if (step := 0.25 * step) < _SHORTEST:
                        raise
                    continue
                x[at] = goal
                step = min(_STEP, 2.0 * step)
            shapes[k] = x
        return shapes

    def _follow(self, x: Array, step: Array) -> Array:
        """Return the closed shape at a displacement of the independent joints from x (nx,)."""
        space, closure = self.system.space, self.system.closure
        assert closure is not None
        change = np.zeros(self.system.m)
        change[self.independent] = step
        J = self._jacobian(x)
        residual = loop_values(self.system, x)[closure.rows] + J[:, self.independent] @ step
        last = np.inf
        side = np.linalg.slogdet(J[:, self.dependent])[0]
        for _ in range(_ITERATIONS):
            try:
                change[self.dependent] = -np.linalg.solve(J[:, self.dependent], residual)
            except np.linalg.LinAlgError:
                break
            x, size = space.integrate(x, change), float(np.abs(change).max())
            if not size <= _LONGEST * closure.length and not size <= _LONGEST:
                break
            if size <= _CLOSED or (size < 1e-10 and size >= last):
                # A change of sign reveals that the step has passed a singular shape.
                if np.linalg.slogdet(J[:, self.dependent])[0] != side:
                    break
                return np.asarray(x)
            J, residual = self._jacobian(x), loop_values(self.system, x)[closure.rows]
            change[self.independent], last = 0.0, size
        raise SingularInertiaError(self._singular(x))

    def _jacobian(self, x: Array) -> Array:
        assert self.system.closure is not None
        return np.asarray(loop_jacobian(self.system, x)[self.system.closure.rows])

    def _solve(self, x: Array, right: Array) -> Array:
        """Return J_D⁻¹ times a vector or matrix.  Raises SingularInertiaError at dead points."""
        scaled, least = self._scaled(x)
        if not least > _SINGULAR * np.linalg.norm(scaled):
            raise SingularInertiaError(self._singular(x))
        return np.asarray(np.linalg.solve(self._jacobian(x)[:, self.dependent], right))

    def _scaled(self, x: Array) -> tuple[Array, float]:
        """Return J without units, (k, m), and the smallest singular value of its J_D."""
        closure = self.system.closure
        assert closure is not None
        scaled = scaled_jacobian(self.system, x, closure.length)[closure.rows]
        singular = np.linalg.svd(scaled[:, self.dependent], compute_uv=False)
        return scaled, float(singular.min(initial=np.inf))

    def _singular(self, x: Array) -> str:
        loops = listed([loop.name for loop in self.system.loops], 6)
        return (
            f"the loops {loops} of '{self.system.name}' do not determine the other joints from "
            f"{listed(self.names)} near x = {x}. Choose other independent joints (independent=), "
            "or stay away from this shape."
        )

    def _coordinates(self) -> list[int]:
        """Return the indices of the independent coordinates in x.  Raises InputError for balls."""
        balls = {*self.system.space.ball_v.tolist()} & {*self.independent.tolist()}
        if balls:
            name = self.system.space.names[min(balls)]
            raise InputError(
                f"independent: {quoted(name)} is an axis of a ball joint, which has no coordinate "
                "of its own. Replace the ball by three hinges, or lock it."
            )
        return self.system.space.coordinates_of(self.independent.tolist())


def loop_chart(system: LoopedSystem, independent: Sequence[str] | None = None) -> LoopChart:
    """Choose the independent joints of a robot with loops.

    Args:
        system: The system, with loops.
        independent: Names of the independent joints, as many as `shape_dim`, in the order of the
            coordinates u.  None: a pivoted QR factorisation at the
            assembled shape chooses the dependent joints.
    Returns:
        The chart.
    Raises:
        InputError: A joint is unknown, or the number of joints is wrong.
        SingularInertiaError: The joints do not determine the others at the assembled shape, or the
            equations of the loops are dependent there.
    """
    closure, names = system.closure, system.space.names
    assert closure is not None
    if independent is None:
        chosen, dependent = _pivoted(system, closure.x)
    else:
        for name in independent:
            if name not in names:
                raise InputError(
                    f"independent: no joint {brief(name)}. The joints are {listed(names, 60)}."
                )
        chosen = np.array([names.index(name) for name in independent], dtype=np.intp)
        if len(chosen) != system.shape_dim or len({*independent}) != len(chosen):
            raise InputError(
                f"independent: expected {system.shape_dim} joints, each once, got "
                f"{listed(independent, 60)}. The joints are {listed(names, 60)}."
            )
        dependent = np.setdiff1d(np.arange(system.m), chosen)
    chart = LoopChart(system, chosen.astype(np.intp), dependent.astype(np.intp))
    chart.regular_at(closure.x)
    chart.tangent(closure.x)
    return chart


def _pivoted(system: LoopedSystem, x: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return independent (d,) and dependent (k,) rates by a pivoted QR factorisation at x."""
    from scipy.linalg import qr

    closure = system.closure
    assert closure is not None
    J = scaled_jacobian(system, x, closure.length)[closure.rows]
    J /= np.maximum(np.linalg.norm(J, axis=1, keepdims=True), 1e-300)
    weight = np.ones(system.m)
    weight[system.space.ball_v] = 1.0 / _BALL
    _, _, order = qr(J * weight, mode="economic", pivoting=True)
    dependent = np.sort(order[: closure.rank]).astype(np.intp)
    return np.setdiff1d(np.arange(system.m), dependent).astype(np.intp), dependent
