"""The expressions of a connection: body velocity, A, metric, and curvature with its two parts."""

from __future__ import annotations

import casadi as ca

from ...reduction.tree.momenta import bracket
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


def local_graph(form: ConnectionForm) -> ca.Function:
    """Return x → A, P_b, the health of P_b, and M if there is a metric, by columns."""
    r, m = form.r, form.m
    x, P, S = _parts(form)
    A = _solved(form, P, S[:r, :])
    out = [ca.vec(A), ca.vec(P), health(form, P)]
    if form.symmetric:
        out.append(ca.vec(S[r:, :] - S[:r, :].T @ A) if m else ca.SX(0, 1))
    return _function("local", x, out)


def curvature_graph(form: ConnectionForm) -> ca.Function:
    """Return x → the health of P_b, then dA_αβ and [A_α, A_β], each (r,), for every α < β."""
    r, m = form.r, form.m
    x, P, S = _parts(form)
    A = _solved(form, P, S[:r, :])
    dP, dS = ca.jacobian(ca.vec(P), x), ca.jacobian(ca.vec(S[:r, :]), x)
    twisted, brackets = [], []
    for a in range(m):
        for b in range(a + 1, m):
            moved = dS[r * b : r * b + r, a] - dS[r * a : r * a + r, b]
            moved -= ca.reshape(dP[:, a], r, r) @ A[:, b] - ca.reshape(dP[:, b], r, r) @ A[:, a]
            twisted.append(moved)
            brackets.append(bracket(form.group, A[:, a], A[:, b]))
    columns = _solved(form, P, ca.horzcat(*twisted)) if twisted else ca.SX(r, 0)
    out = [health(form, P), ca.vec(columns), *brackets]
    return _function("curvature", x, out)


def _parts(form: ConnectionForm) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return x, P_b (r, r), and the columns of the form that joint rates have, (r or n, m)."""
    r, m = form.r, form.m
    x, v = ca.SX.sym("x", m), ca.SX.sym("v", r + m)
    F = form.values(x, v)
    return x, _locked(form, x), ca.densify(ca.jacobian(F, v[r:]))


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


def _function(name: str, y: ca.SX, out: list[ca.SX]) -> ca.Function:
    column = ca.densify(ca.vertcat(ca.SX(0, 1), *out))
    return ca.Function(name, [y, ca.SX.sym("none")], [column], {"cse": True})
