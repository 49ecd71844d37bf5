"""The judge of a connection's machine code: the form as its reference has it, by Pinocchio."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...common.arrays import Array
from ..evaluate import evaluate
from ..machine.native import NativeCode
from ..validation import require_agreement
from .form import ConnectionForm

_TRIALS = 2
_HEALTHY = 1e-3  # of the trial shapes: near a singular one, both sides only have round-off
_TRIED = 100
_STEP = 1e-3  # of differences of order 6, whose round-off is that of the terms over it
_SLOPE = 1e-7  # relative, of differences


def judge_velocity(form: ConnectionForm, code: NativeCode) -> None:
    """Compare ξ and ẋᵀ M ẋ.  Raises KernelMismatch."""
    r = form.r
    for x, rng in shapes_to_judge(form):
        xdot = rng.normal(size=form.m)
        found = _one(code, np.concatenate([x, xdot]), r + 1 + form.symmetric)
        A, M, size = _expected(form, x)
        require_agreement(
            who(form), "the body velocity", found[:r], -A @ xdot, size * np.abs(xdot).sum()
        )
        if form.symmetric:
            require_agreement(
                who(form), "the metric", found[r + 1 :], np.array([xdot @ M @ xdot]), 0.0
            )


def judge_slope(form: ConnectionForm, code: NativeCode) -> None:
    """Compare the derivatives by x with differences of the reference, those by ẋ with A and M."""
    r, m = form.r, form.m
    rows = r + form.symmetric
    for x, rng in shapes_to_judge(form):
        xdot = rng.normal(size=m)
        found = _one(code, np.concatenate([x, xdot]), rows * 2 * m).reshape(2 * m, rows).T
        expected = np.zeros((rows, 2 * m))
        A, M, size = _expected(form, x)
        dA, dM = _slopes(form, x)
        expected[:r, :m], expected[:r, m:] = -np.einsum("iba,b->ia", dA, xdot), -A
        if form.symmetric:
            expected[r, :m] = np.einsum("bca,b,c->a", dM, xdot, xdot)
            expected[r, m:] = 2.0 * M @ xdot
        noise = max(size, float(np.abs(M).max(initial=0.0))) * (1.0 + xdot @ xdot) / _STEP
        what = "the slope of its velocity"
        require_agreement(who(form), what, found.ravel(), expected.ravel(), noise, _SLOPE)


def judge_local(form: ConnectionForm, code: NativeCode) -> None:
    """Compare A, P_b and M."""
    r, m = form.r, form.m
    for x, _ in shapes_to_judge(form):
        found = _one(code, x, r * m + r * r + 1 + m * m * form.symmetric)
        A, M, size = _expected(form, x)
        P = form.reference(x)[:r, :r]
        require_agreement(who(form), "A", found[: r * m], A.T.ravel(), size)
        require_agreement(
            who(form), "P_b", found[r * m : r * m + r * r], P.T.ravel(), np.abs(P).max()
        )
        if form.symmetric:
            require_agreement(who(form), "M", found[r * m + r * r + 1 :], M.ravel(), 0.0)


def judge_curvature(form: ConnectionForm, code: NativeCode) -> None:
    """Compare dA and the brackets, dA with differences of the reference."""
    r, m = form.r, form.m
    first, second = np.triu_indices(m, 1)
    for x, _ in shapes_to_judge(form):
        found = _one(code, x, 1 + 2 * r * len(first))[1:]
        A, _, size = _expected(form, x)
        dA, _ = _slopes(form, x)
        exterior = (np.swapaxes(dA, 1, 2) - dA)[:, first, second]
        bracket = form.group.bracket(A.T[first], A.T[second])
        both = np.concatenate([exterior.T.ravel(), bracket.ravel()])
        require_agreement(who(form), "the curvature", found, both, (size + size**2) / _STEP, _SLOPE)


def who(form: ConnectionForm) -> str:
    """Return what a message calls the machine code of a form."""
    return f"the machine code of {form.what}"


def _one(code: NativeCode, y: Array, size: int) -> Array:
    return np.asarray(evaluate(code.address, np.zeros(1), y[None], size)[0])


def shapes_to_judge(form: ConnectionForm) -> Iterator[tuple[Array, np.random.Generator]]:
    """Yield random shapes at which P_b is far from singular."""
    rng, judged = np.random.default_rng(0), 0
    for _ in range(_TRIED):
        x = rng.uniform(-2.0, 2.0, form.m)
        P = form.reference(x)[: form.r, : form.r]
        scale = np.linalg.norm(P, axis=1)
        if not scale.all() or np.linalg.cond(P / scale[:, None]) > 1.0 / _HEALTHY:
            continue
        yield x, rng
        judged += 1
        if judged == _TRIALS:
            return


def metric_slopes(form: ConnectionForm, x: Array) -> tuple[Array, Array]:
    """Return M (m, m) by the reference, and ∂M (m, m, m) by differences, ∂ last."""
    return _expected(form, x)[1], _slopes(form, x)[1]


def _expected(form: ConnectionForm, x: Array) -> tuple[Array, Array, float]:
    """Return A and M by the reference, and the size of the terms of which A is a sum."""
    r = form.r
    G = form.reference(x)
    A = np.asarray(np.linalg.solve(G[:r, :r], G[:r, r:]))
    M = G[r:, r:] - G[r:, :r] @ A if form.symmetric else np.zeros((form.m, form.m))
    size = np.abs(np.linalg.inv(G[:r, :r])) @ np.abs(G[:r, r:])
    return A, M, float(size.max(initial=0.0))


def _slopes(form: ConnectionForm, x: Array) -> tuple[Array, Array]:
    """Return ∂A and ∂M by central differences of order 6, ∂ last."""
    dA, dM = np.zeros((form.r, form.m, form.m)), np.zeros((form.m, form.m, form.m))
    for k in range(form.m):
        for step, weight in ((1, 45.0), (2, -9.0), (3, 1.0)):
            for sign in (1.0, -1.0):
                moved = x.copy()
                moved[k] += sign * step * _STEP
                A, M, _ = _expected(form, moved)
                dA[..., k] += sign * weight / (60.0 * _STEP) * A
                dM[..., k] += sign * weight / (60.0 * _STEP) * M
    return dA, dM
