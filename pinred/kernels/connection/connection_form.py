"""The linear form of velocities that defines a connection, and the expressions derived from it.

A connection on G × B is given by a form F(x) (ξ, ẋ) = P_b(x) ξ + P_s(x) ẋ with r rows: momenta,
drag forces, or the slip of wheels.  Horizontal motions are those on which F vanishes,
so ξ = −A ẋ with A = P_b⁻¹ P_s.  A symmetric form, such as momenta or drag, has m additional rows
for the shape.  Its full
matrix G defines a metric on shape space, M = G_ss − Aᵀ P_b A.

Shape rates are components along the frame of the shape space, and derivatives with respect to the
shape are derivatives along this frame.  Without balls these are ordinary derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...lie.group import Group
from ...reduction.tree.scalars import as_scalars, factor_ldl, quaternion_rate, solve_spd
from ...system.coordinates import ShapeSpace, shape_space
from ...system.joints import HINGE, SLIDE


@dataclass(frozen=True, eq=False)
class ConnectionForm:
    """A form F of velocities v = (ξ, ẋ) on G × B, as CasADi expressions with a reference.

    Attributes:
        group: The group G.
        space: Shape space, with coordinates x, (nx,), and rates along its frame, (m,).
        what: Short description of the form, for messages.
        values: Function (x, v) → F(x) v, (r,), or (n,) if the form is symmetric.
        locked: Function x → P_b in column-major order, (r²,).
        reference: Returns the matrix of F at a shape, (r, n) or (n, n), independently of the
            expressions.  Machine code is validated against it.
        symmetric: Whether the form is symmetric and thus defines a metric on shape space.
        momentum: Whether F is a momentum, so that the spatial momentum is conserved.
    """

    group: Group
    space: ShapeSpace
    what: str
    values: ca.Function
    locked: ca.Function
    reference: Callable[[Array], Array]
    symmetric: bool
    momentum: bool = False

    @property
    def r(self) -> int:
        """Dimension of the group."""
        return self.group.dim

    @property
    def m(self) -> int:
        """Dimension of shape space."""
        return self.space.m

    @property
    def nx(self) -> int:
        """Number of shape coordinates."""
        return self.space.nx

    @property
    def joints(self) -> tuple[str, ...]:
        """Labels of the shape rates, (m,)."""
        return self.space.names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of displacements along the frame, (m,)."""
        return self.space.units

    @property
    def is_linear(self) -> NDArray[np.bool_]:
        """Whether each velocity is a translation, (n,)."""
        base = np.arange(self.r) < self.group.linear
        return np.append(base, np.array([unit == "m" for unit in self.units], dtype=bool))

    @cached_property
    def length(self) -> float:
        """Length by which rotations and translations have similar weight in F, a power of 2 [m]."""
        linear, matrix = self.is_linear, self.reference(self.space.neutral)
        if self.symmetric:
            diagonal = np.diag(matrix)
            forward, turning = (float(np.sqrt(diagonal[k].sum())) for k in (linear, ~linear))
        else:
            sizes = (
                np.linalg.norm(matrix[:, linear], axis=1),
                np.linalg.norm(matrix[:, ~linear], axis=1),
            )
            forward, turning = (float(size[np.multiply(*sizes) > 0.0].sum()) for size in sizes)
        if forward == 0.0 or turning == 0.0:
            return 1.0
        return float(2.0 ** np.round(np.log2(turning / forward)))

    @property
    def key(self) -> bytes:
        """Key of the form's machine code in the cache: the serialised expressions."""
        axes = f"{self.group.name} {self.group.axes} {self.symmetric or self.length}"
        if self.space.balls:
            axes += f" balls {[(ball.x.start, ball.v.start) for ball in self.space.balls]}"
        return f"{axes} {self.values.serialize()} {self.locked.serialize()}".encode()


def form_of(
    group: Group,
    joints: tuple[str, ...],
    units: tuple[str, ...],
    what: str,
    values: Callable[[ca.SX, ca.SX], ca.SX],
    reference: Callable[[Array], Array],
    *,
    symmetric: bool,
    momentum: bool = False,
    locked: Callable[[ca.SX], ca.SX] | None = None,
    space: ShapeSpace | None = None,
) -> ConnectionForm:
    """Create a ConnectionForm from functions of CasADi symbols.

    Args:
        group: The group G.
        joints: Labels of the shape rates, (m,).
        units: Units of the shape rates' displacements, (m,).
        what: Short description of the form, for messages.
        values: Function that returns F(x) v for symbols x and v.
        reference: Function that returns the matrix of F at a shape; see `ConnectionForm`.
        symmetric: Whether the form is symmetric.
        momentum: Whether F is a momentum.
        locked: Function that returns P_b, (r, r), for a symbol x.  It is useful if it takes fewer
            operations than the default, the derivative of `values`.
        space: Shape space; by default a product of hinges and slides.
    Returns:
        The form.
    """
    if space is None:
        space = shape_space(joints, [SLIDE if unit == "m" else HINGE for unit in units])
    r = group.dim
    x, v = ca.SX.sym("x", space.nx), ca.SX.sym("v", r + space.m)
    F = values(x, v)
    P = ca.jacobian(F[:r], v[:r]) if locked is None else locked(x)
    return ConnectionForm(
        group=group,
        space=space,
        what=what,
        values=ca.Function("values", [x, v], [ca.densify(F)]),
        locked=ca.Function("locked", [x], [ca.densify(ca.vec(P))]),
        reference=reference,
        symmetric=symmetric,
        momentum=momentum,
    )


def velocity_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, ẋ) → ξ = −A ẋ, (r,), then the health of P_b, then ẋᵀ M ẋ if there is a metric."""
    r, m = form.r, form.m
    x, xdot = ca.SX.sym("x", form.nx), ca.SX.sym("xdot", m)
    F = form.values(x, ca.vertcat(ca.SX.zeros(r, 1), xdot))
    P = _locked(form, x)
    xi = -solve_locked(form, P, F[:r])
    outputs = [xi, health(form, P)]
    if form.symmetric:
        outputs.append(ca.dot(xdot, F[r:]) + ca.dot(F[:r], xi))
    return _function("velocity", ca.vertcat(x, xdot), outputs)


def momentum_velocity_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, ẋ, μ) → ξ = P_b⁻¹ (μ − P_s ẋ), (r,), at body momentum μ."""
    r, m = form.r, form.m
    x, xdot, mu = ca.SX.sym("x", form.nx), ca.SX.sym("xdot", m), ca.SX.sym("mu", r)
    F = form.values(x, ca.vertcat(ca.SX.zeros(r, 1), xdot))
    xi = solve_locked(form, _locked(form, x), mu - F[:r])
    return _function("velocity", ca.vertcat(x, xdot, mu), [xi])


def velocity_slope_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, ẋ) → the derivative of (ξ, ẋᵀ M ẋ) in (x, ẋ), in column-major order."""
    y = ca.SX.sym("y", form.nx + form.m)
    values = velocity_graph(form)(y, ca.SX.sym("none"))
    without_health = [*range(form.r), *range(form.r + 1, values.numel())]
    derivative = along_frame(form, ca.jacobian(values[without_health], y), y)
    return _function("slope", y, [ca.vec(ca.densify(derivative))])


def column_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, joint rates u) → F(x) (0, u), A u, P_b by columns, health of P_b, and M u.

    M u is omitted if there is no metric.  At unit rates u, these outputs contain columns of the
    matrices F, A and M.
    """
    r, m = form.r, form.m
    x, u = ca.SX.sym("x", form.nx), ca.SX.sym("u", m)
    P = _locked(form, x)
    F = form.values(x, ca.vertcat(ca.SX.zeros(r, 1), u))
    Au = solve_locked(form, P, F[:r])
    outputs = [F, Au, ca.vec(P), health(form, P)]
    if form.symmetric and m:
        outputs.append(form.values(x, ca.vertcat(-Au, u))[r:])
    return _directional_function("columns", x, u, outputs)


def column_derivative_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, joint rates u) → A u, the health of P_b, and ∂(A u)/∂x by columns, (r m,).

    From P_b A u = P_s u, the derivative is P_b⁻¹ ∂F/∂x at the constant velocity (−A u, u).
    """
    r, m = form.r, form.m
    x, u, xi = ca.SX.sym("x", form.nx), ca.SX.sym("u", m), ca.SX.sym("xi", r)
    P = _locked(form, x)
    Au = solve_locked(form, P, form.values(x, ca.vertcat(ca.SX.zeros(r, 1), u))[:r])
    by_x = ca.jacobian(form.values(x, ca.vertcat(xi, u))[:r], x)
    by_x = ca.densify(along_frame(form, by_x, x))
    derivative = solve_locked(form, P, ca.substitute(by_x, xi, -Au))
    outputs = [Au, health(form, P), ca.vec(derivative)]
    return _directional_function("column_derivatives", x, u, outputs)


def locked_derivative_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, ω) → ∂(P_b ω)/∂x at constant body twist ω (r,), by columns, (r m,)."""
    x, omega = ca.SX.sym("x", form.nx), ca.SX.sym("omega", form.r)
    derivative = along_frame(form, ca.jacobian(_locked(form, x) @ omega, x), x)
    return _function("locked_derivative", ca.vertcat(x, omega), [ca.vec(ca.densify(derivative))])


def covariant_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, ẋ, ẍ, λ) → the force f, (m,), then the derivative of λᵀf in (x, ẋ, ẍ), (3m,).

    With the Lagrangian ½ ẋᵀMẋ, a motion requires the force f_α = d/dt (M ẋ)_α − ½ ẋᵀ ∂_αM ẋ, which
    is M times the covariant acceleration.  The frame of a ball adds c^γ_αβ ẋ^β (M ẋ)_γ.  If M is
    the reduced metric of inertia and no other forces act, f are the joint torques at zero momentum.
    """
    nx, m, none = form.nx, form.m, ca.SX.sym("none")
    motion, weights = ca.SX.sym("motion", nx + 2 * m), ca.SX.sym("along", m)
    x, xdot, xddot = motion[:nx], motion[nx : nx + m], motion[nx + m :]
    square = velocity_graph(form)(motion[: nx + m], none)[-1]
    energy_gradient = 0.5 * ca.gradient(square, motion)
    momentum = energy_gradient[nx : nx + m]
    state_rate = ca.vertcat(coordinate_rates(form.space, x, xdot), xddot, ca.SX.zeros(m))
    momentum_rate = ca.jtimes(momentum, motion, state_rate)
    force = momentum_rate - along_frame(form, energy_gradient[:nx].T, x).T
    for ball in form.space.balls:
        force[ball.v] += ca.cross(xdot[ball.v], momentum[ball.v])
    derivative = along_frame(form, ca.gradient(ca.dot(weights, force), motion).T, motion).T
    return _function("covariant", ca.vertcat(motion, weights), [force, derivative])


def coordinate_rates(space: ShapeSpace, x: ca.SX, xdot: ca.SX) -> ca.SX:
    """Return the derivatives of the coordinates by time, (nx,), for rates along the frame, (m,)."""
    rates: list[ca.SX] = []
    for joint in space.joints:
        if joint.kind.is_ball:
            rates += quaternion_rate(ca.vertsplit(x[joint.x]), ca.vertsplit(xdot[joint.v]))
        else:
            rates.append(xdot[joint.v])
    return ca.vertcat(ca.SX(0, 1), *rates)


def along_frame(form: ConnectionForm, derivative: ca.SX, x: ca.SX) -> ca.SX:
    """Convert derivatives with respect to coordinates to derivatives along the frame.

    Args:
        form: The form, whose shape space has the frame.
        derivative: Derivatives with respect to x, (k, nx), or to (x, further arguments).
        x: Symbols whose first entries are the coordinates.
    Returns:
        Derivatives along the frame, (k, m), followed by those with respect to further arguments.
    """
    if not form.space.balls:
        return derivative
    xdot = ca.SX.sym("xdot", form.m)
    rate_map = ca.jacobian(coordinate_rates(form.space, x[: form.nx], xdot), xdot)
    return ca.horzcat(derivative[:, : form.nx] @ rate_map, derivative[:, form.nx :])


def _locked(form: ConnectionForm, x: ca.SX) -> ca.SX:
    return ca.reshape(form.locked(x), form.r, form.r)


def solve_locked(form: ConnectionForm, P: ca.SX, right: ca.SX) -> ca.SX:
    """Return P_b⁻¹ right as a CasADi expression, with the same accuracy in all units.

    Args:
        form: The form.
        P: P_b, (r, r).
        right: Right sides, (r, k).
    Returns:
        (r, k).
    """
    if form.symmetric or not right.numel():
        return solve_spd(P, right)
    if form.r <= 3:  # Cramer's rule needs no pivoting
        return ca.densify(ca.adj(P) @ right / ca.det(P))
    scaled, sizes, units = _without_units(form, P)
    return ca.densify(ca.diag(units) @ ca.solve(scaled, ca.diag(1.0 / sizes) @ right))


def _without_units(form: ConnectionForm, P: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return P_b with rows of norm one for twists in the robot's units, the norms, and the units.

    The rows of a form that is not symmetric may have different units: slips and momenta.
    """
    units = ca.SX([form.length] * form.group.linear + [1.0] * (form.r - form.group.linear))
    scaled = P @ ca.diag(units)
    sizes = ca.vertcat(*(ca.norm_2(row) for row in ca.vertsplit(scaled)))
    return ca.densify(ca.diag(1.0 / sizes) @ scaled), sizes, units


def health(form: ConnectionForm, P: ca.SX) -> ca.SX:
    """Return a scaled distance of P from singularity: 0 if P is singular, at most 1 in magnitude.

    If the form is symmetric, the result is the smallest pivot of P, relative to the diagonal
    entry.  Otherwise it is the determinant of P with rows of norm one, for twists in the robot's
    units, which may be negative.
    """
    if not form.symmetric:
        return ca.det(_without_units(form, P)[0])
    _, D, _ = factor_ldl([as_scalars(row.T) for row in ca.vertsplit(P)])
    least = ca.SX(1)
    for k, pivot in enumerate(D):
        least = ca.fmin(least, pivot / P[k, k])
    return least


def _directional_function(name: str, x: ca.SX, u: ca.SX, outputs: list[ca.SX]) -> ca.Function:
    """Return a Function (x, no parameters, u), to be compiled for several directions u."""
    column = ca.densify(ca.vertcat(*outputs))
    return ca.Function(name, [x, ca.SX.sym("none"), u], [column], {"cse": True})


def _function(name: str, y: ca.SX, outputs: list[ca.SX]) -> ca.Function:
    """Return a Function (y, no parameters) → all outputs in one column."""
    column = ca.densify(ca.vertcat(ca.SX(0, 1), *outputs))
    return ca.Function(name, [y, ca.SX.sym("none")], [column], {"cse": True})
