"""Validation of a connection's machine code against an independent reference matrix."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ...common.arrays import Array
from ...common.differences import central_differences
from ...common.machine_code import NativeCode
from ..evaluate import columns_at, evaluate
from ..validation import require_agreement
from .connection_form import ConnectionForm

_TRIALS = 2  # number of shapes at which values are compared
_MOST_DRAWS = 100  # largest number of random shapes drawn to find trial shapes
# Smallest cond(P_b)⁻¹ of a trial shape: near singular shapes, both compared values are only
# round-off.
_LEAST_CONDITION = 1e-3
_STEP = 1e-3  # step of central differences [rad | m]; it amplifies round-off by 1/_STEP
_TOLERANCE = 1e-7  # relative tolerance of comparisons with differences


def validate_velocity(form: ConnectionForm, code: NativeCode) -> None:
    """Compare ξ and ẋᵀ M ẋ with the reference.  Raises KernelMismatch."""
    r = form.r
    for x, rng in trial_shapes(form):
        xdot = rng.normal(size=form.m)
        values = _evaluate_one(code, np.concatenate([x, xdot]), r + 1 + form.symmetric)
        A, M, size = _reference_terms(form, x)
        scale = size * np.abs(xdot).sum()
        _require(form, "the body velocity", values[:r], -A @ xdot, scale)
        if form.symmetric:
            _require(form, "the metric", values[r + 1 :], np.array([xdot @ M @ xdot]))


def validate_slope(form: ConnectionForm, code: NativeCode) -> None:
    """Compare derivatives by x with finite differences, derivatives by ẋ with A and M.

    Raises KernelMismatch.
    """
    r, m = form.r, form.m
    rows = r + form.symmetric
    for x, rng in trial_shapes(form):
        xdot = rng.normal(size=m)
        values = _evaluate_one(code, np.concatenate([x, xdot]), rows * 2 * m).reshape(2 * m, rows)
        expected = np.zeros((rows, 2 * m))
        A, M, size = _reference_terms(form, x)
        dA, dM = _reference_derivatives(form, x)
        expected[:r, :m], expected[:r, m:] = -np.einsum("iba,b->ia", dA, xdot), -A
        if form.symmetric:
            expected[r, :m] = np.einsum("bca,b,c->a", dM, xdot, xdot)
            expected[r, m:] = 2.0 * M @ xdot
        scale = max(size, float(np.abs(M).max(initial=0.0))) * float(1.0 + xdot @ xdot) / _STEP
        _require(form, "the slope of its velocity", values.T, expected, scale, _TOLERANCE)


def validate_columns(form: ConnectionForm, code: NativeCode) -> None:
    """Compare the matrix of the form F, A and M with the reference.  Raises KernelMismatch."""
    r, m = form.r, form.m
    rows = r + m * form.symmetric
    for x, _ in trial_shapes(form):
        columns = _evaluate_columns(code, m, x, rows + r + r * r + 1 + m * form.symmetric)
        F, Au, P, _, Mu = np.split(columns, np.cumsum([rows, r, r * r, 1]), axis=1)
        A, M, size = _reference_terms(form, x)
        matrix = form.reference(x)
        scale = float(np.abs(matrix).max())
        _require(form, "A", Au[:m], A.T, size)
        _require(form, "P_b", P[0].reshape(r, r), matrix[:r, :r].T, scale)
        _require(form, "the form", F[:m], matrix[:, r:].T, scale)
        if form.symmetric:
            _require(form, "M", Mu[:m], M)


def validate_column_derivatives(form: ConnectionForm, code: NativeCode) -> None:
    """Compare A with the reference, and ∂A with its differences.  Raises KernelMismatch."""
    r, m = form.r, form.m
    for x, _ in trial_shapes(form):
        columns = _evaluate_columns(code, m, x, r + 1 + r * m)[:m]
        A, _, size = _reference_terms(form, x)
        dA, _ = _reference_derivatives(form, x)
        _require(form, "A of the curvature", columns[:, :r], A.T, size)
        expected, scale = np.transpose(dA, (1, 2, 0)), (size + size**2) / _STEP
        derivatives = columns[:, r + 1 :].reshape(expected.shape)
        _require(form, "the curvature", derivatives, expected, scale, _TOLERANCE)


def validate_locked_derivative(form: ConnectionForm, code: NativeCode) -> None:
    """Compare ∂(P_b ω)/∂x with differences of the reference.  Raises KernelMismatch."""
    r, m = form.r, form.m
    for x, rng in trial_shapes(form):
        omega = rng.normal(size=r)
        values = _evaluate_one(code, np.concatenate([x, omega]), r * m).reshape(m, r).T

        def momentum(y: Array, omega: Array = omega) -> Array:
            return np.asarray(form.reference(y)[:r, :r] @ omega)

        expected = _differences(form, momentum, x)
        scale = float(np.abs(form.reference(x)[:r, :r]).max() * np.abs(omega).sum()) / _STEP
        _require(form, "the derivative of P_b", values, expected, scale, _TOLERANCE)


def validate_covariant(form: ConnectionForm, code: NativeCode) -> None:
    """Compare the covariant force and its gradient with finite differences.

    The reference of the force uses differences of the metric, and the reference of its gradient
    uses differences of the force.

    Raises KernelMismatch.
    """
    m = form.m
    for x, rng in trial_shapes(form):
        xdot, xddot, along = rng.normal(size=(3, m))
        rates = np.concatenate([xdot, xddot])

        def weighted_force(
            step: Array, x: Array = x, rates: Array = rates, along: Array = along
        ) -> Array:
            motion = [form.space.integrate(x, step[:m]), rates + step[m:], along]
            values = _evaluate_one(code, np.concatenate(motion), 4 * m)
            return values[:m] @ along[:, None]

        _, M, _ = _reference_terms(form, x)
        _, dM = _reference_derivatives(form, x)
        centrifugal = np.einsum("bcg,g,c->b", dM, xdot, xdot)
        centrifugal -= 0.5 * np.einsum("cda,c,d->a", dM, xdot, xdot)
        centrifugal += np.einsum("gab,b,g->a", form.space.structure, xdot, M @ xdot)
        values = _evaluate_one(code, np.concatenate([x, rates, along]), 4 * m)
        force, gradient = np.split(values, [m])
        expected = M @ xddot + centrifugal
        _require(form, "the covariant force", force, expected, 0.0, _TOLERANCE)
        (expected,) = central_differences(weighted_force, np.zeros(3 * m), _STEP)
        _require(form, "its derivative", gradient, expected, 0.0, _TOLERANCE)


def trial_shapes(form: ConnectionForm) -> Iterator[tuple[Array, np.random.Generator]]:
    """Yield random shapes at which P_b is far from singular, with the generator that drew them."""
    rng, count = np.random.default_rng(0), 0
    for _ in range(_MOST_DRAWS):
        x = form.space.random(rng, 2.0)
        P = form.reference(x)[: form.r, : form.r]
        scale = np.linalg.norm(P, axis=1)
        if not scale.all() or np.linalg.cond(P / scale[:, None]) > 1.0 / _LEAST_CONDITION:
            continue
        yield x, rng
        count += 1
        if count == _TRIALS:
            return


def _reference_terms(form: ConnectionForm, x: Array) -> tuple[Array, Array, float]:
    """Return A and M of the reference, and the magnitude of the terms that sum to A."""
    r = form.r
    G = form.reference(x)
    A = np.asarray(np.linalg.solve(G[:r, :r], G[:r, r:]))
    M = G[r:, r:] - G[r:, :r] @ A if form.symmetric else np.zeros((form.m, form.m))
    size = np.abs(np.linalg.inv(G[:r, :r])) @ np.abs(G[:r, r:])
    return A, M, float(size.max(initial=0.0))


def _reference_derivatives(form: ConnectionForm, x: Array) -> tuple[Array, Array]:
    """Return ∂A, (r, m, m), and ∂M, (m, m, m), along the frame, from finite differences."""
    r, m = form.r, form.m

    def terms(y: Array) -> Array:
        A, M, _ = _reference_terms(form, y)
        return np.concatenate([A.ravel(), M.ravel()])

    derivatives = _differences(form, terms, x)
    return derivatives[: r * m].reshape(r, m, m), derivatives[r * m :].reshape(m, m, m)


def _differences(form: ConnectionForm, function: Callable[[Array], Array], x: Array) -> Array:
    """Return the derivative of a function of the shape along the frame, (k, m)."""
    if not form.space.balls:
        return central_differences(function, x, _STEP)

    def displaced(step: Array) -> Array:
        return function(form.space.integrate(x, step))

    return central_differences(displaced, np.zeros(form.m), _STEP)


def _evaluate_one(code: NativeCode, y: Array, size: int) -> Array:
    return np.asarray(evaluate(code.address, np.zeros(1), y[None], size)[0])


def _evaluate_columns(code: NativeCode, m: int, x: Array, size: int) -> Array:
    """Return the outputs for all unit joint rates at one shape, (max(m, 1), size)."""
    ((_, outputs),) = columns_at(code.address, x[None], size, m)
    return np.asarray(outputs[0])


def _require(
    form: ConnectionForm,
    term: str,
    values: Array,
    expected: Array,
    scale: float = 0.0,
    tolerance: float | None = None,
) -> None:
    """Raise KernelMismatch if values differ; scale: magnitude of the terms that may cancel."""
    who = f"the machine code of {form.what}"
    options = () if tolerance is None else (tolerance,)
    require_agreement(who, term, values.ravel(), expected.ravel(), scale, *options)
