"""CasADi expressions of a connection: body velocity, columns of A and M, and their derivatives."""

from __future__ import annotations

import casadi as ca

from ...reduction.tree.scalars import factor_ldl, solve_factored
from .form import ConnectionForm


def velocity_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, ẋ) → ξ = −A ẋ, (r,), then the health of P_b, then ẋᵀ M ẋ if there is a metric."""
    r, m = form.r, form.m
    x, xdot = ca.SX.sym("x", m), ca.SX.sym("xdot", m)
    F = form.values(x, ca.vertcat(ca.SX.zeros(r, 1), xdot))
    P = _locked(form, x)
    xi = -_solved(form, P, F[:r])
    out = [xi, health(form, P)]
    if form.symmetric:
        out.append(ca.dot(xdot, F[r:]) + ca.dot(F[:r], xi))
    return _function("velocity", ca.vertcat(x, xdot), out)


def velocity_slope_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, ẋ) → the derivative of (ξ, ẋᵀ M ẋ) by (x, ẋ), by columns."""
    velocity = velocity_graph(form)
    y = ca.SX.sym("y", 2 * form.m)
    out = velocity(y, ca.SX.sym("none"))
    rows = [*range(form.r), *range(form.r + 1, out.numel())]
    return _function("slope", y, [ca.vec(ca.densify(ca.jacobian(out[rows], y)))])


def column_graph(form: ConnectionForm) -> ca.Function:
    """Return x, joint rates u → F(x) (0, u), A u, P_b by columns, its health, and M u.

    M u is missing without a metric.  Evaluated at unit rates, these are columns of F, A and M.
    """
    r, m = form.r, form.m
    x, u = ca.SX.sym("x", m), ca.SX.sym("u", m)
    P = _locked(form, x)
    F = form.values(x, ca.vertcat(ca.SX.zeros(r, 1), u))
    Au = _solved(form, P, F[:r])
    outputs = [F, Au, ca.vec(P), health(form, P)]
    if form.symmetric and m:
        outputs.append(form.values(x, ca.vertcat(-Au, u))[r:])
    return _directional_function("columns", x, u, outputs)


def column_derivative_graph(form: ConnectionForm) -> ca.Function:
    """Return x, joint rates u → A u, the health of P_b, and ∂(A u)/∂x by columns, (r m,).

    From P_b A u = P_s u, the derivative is P_b⁻¹ ∂F/∂x at the constant velocity (−A u, u).
    """
    r, m = form.r, form.m
    x, u, xi = ca.SX.sym("x", m), ca.SX.sym("u", m), ca.SX.sym("xi", r)
    P = _locked(form, x)
    Au = _solved(form, P, form.values(x, ca.vertcat(ca.SX.zeros(r, 1), u))[:r])
    by_x = ca.densify(ca.jacobian(form.values(x, ca.vertcat(xi, u))[:r], x))
    derivative = _solved(form, P, ca.substitute(by_x, xi, -Au))
    outputs = [Au, health(form, P), ca.vec(derivative)]
    return _directional_function("column_derivatives", x, u, outputs)


def locked_derivative_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, ω) → ∂(P_b ω)/∂x at constant body twist ω (r,), by columns, (r m,)."""
    x, omega = ca.SX.sym("x", form.m), ca.SX.sym("omega", form.r)
    derivative = ca.jacobian(_locked(form, x) @ omega, x)
    return _function("locked_derivative", ca.vertcat(x, omega), [ca.vec(ca.densify(derivative))])


def covariant_graph(form: ConnectionForm) -> ca.Function:
    """Return (x, ẋ, ẍ, λ) → the force f (m,), then the derivative of λᵀf by (x, ẋ, ẍ), (3m,).

    A motion of a shape with the Lagrangian ½ ẋᵀMẋ needs f_α = d/dt (M ẋ)_α − ½ ẋᵀ ∂_αM ẋ, M times
    its covariant acceleration.  If M is the reduced metric of inertia and nothing else acts, f are
    the joint torques at zero momentum.
    """
    m, none = form.m, ca.SX.sym("none")
    motion, along = ca.SX.sym("motion", 3 * m), ca.SX.sym("along", m)
    state, rate = motion[: 2 * m], motion[m:]
    square = velocity_graph(form)(state, none)[-1]
    slope = 0.5 * ca.gradient(square, motion)
    by_rate = slope[m : 2 * m]
    force = ca.jtimes(by_rate, motion, ca.vertcat(rate, ca.SX.zeros(m))) - slope[:m]
    derivative = ca.gradient(ca.dot(along, force), motion)
    out = ca.densify(ca.vertcat(force, derivative))
    return ca.Function("covariant", [ca.vertcat(motion, along), none], [out], {"cse": True})


def _locked(form: ConnectionForm, x: ca.SX) -> ca.SX:
    return ca.reshape(form.locked(x), form.r, form.r)


def _solved(form: ConnectionForm, P: ca.SX, right: ca.SX) -> ca.SX:
    """Return P⁻¹ right, (r, k)."""
    r, k = form.r, right.shape[1]
    if not k:
        return ca.SX(r, 0)
    if not form.symmetric:
        return _by_minors(P, right) if r <= 3 else ca.solve(P, right)
    L, _, inverse = factor_ldl(_rows(P))
    columns = [
        solve_factored(L, inverse, [_scalar(right[i, j]) for i in range(r)]) for j in range(k)
    ]
    solved: ca.SX = ca.vertcat(*(entry for column in columns for entry in column))
    return solved.reshape((r, k))


def _rows(P: ca.SX) -> list[list[ca.SX | float]]:
    return [[_scalar(P[i, j]) for j in range(P.shape[1])] for i in range(P.shape[0])]


def _scalar(value: ca.SX) -> ca.SX | float:
    """Return an entry, as a float if it is a constant: then products with 0 and 1 disappear."""
    return float(value) if value.is_constant() else value


def _by_minors(P: ca.SX, right: ca.SX) -> ca.SX:
    """Return P⁻¹ right by Cramer's rule, which needs no pivots."""
    return ca.densify(_adjugate(P) @ right / ca.det(P))


def _adjugate(P: ca.SX) -> ca.SX:
    if P.shape[0] == 1:
        return ca.SX(1.0)
    if P.shape[0] == 2:
        return ca.blockcat([[P[1, 1], -P[0, 1]], [-P[1, 0], P[0, 0]]])
    columns = [P[:, k] for k in range(3)]
    rows = [ca.cross(columns[(k + 1) % 3], columns[(k + 2) % 3]).T for k in range(3)]
    adjugate: ca.SX = ca.vertcat(*rows)
    return adjugate


def health(form: ConnectionForm, P: ca.SX) -> ca.SX:
    """Return how far P is from singular: 0 where it is, at best 1, or ±1 of one not symmetric.

    Of a symmetric one, the least part of a diagonal entry that the rows before it do not
    explain; of another, det P over the product of the norms of its rows.
    """
    if form.symmetric:
        _, D, _ = factor_ldl(_rows(P))
        least = ca.SX(1)
        for k, pivot in enumerate(D):
            least = ca.fmin(least, pivot / P[k, k])
        return least
    size = ca.SX(1)
    for k in range(form.r):
        size = size * ca.norm_2(P[k, :])
    return ca.det(P) / size


def _directional_function(name: str, x: ca.SX, u: ca.SX, outputs: list[ca.SX]) -> ca.Function:
    """Return the Function of shape, no parameters, and joint rates, to be compiled for lanes."""
    column = ca.densify(ca.vertcat(*outputs))
    return ca.Function(name, [x, ca.SX.sym("none"), u], [column], {"cse": True})


def _function(name: str, y: ca.SX, out: list[ca.SX]) -> ca.Function:
    column = ca.densify(ca.vertcat(ca.SX(0, 1), *out))
    return ca.Function(name, [y, ca.SX.sym("none")], [column], {"cse": True})
