"""Validation of a connection's machine code against an independent reference matrix."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...common.arrays import Array, central_differences
from ...common.machine_code import NativeCode
from ..kernel import columns_at, evaluate
from ..validation import TOLERANCE, require_agreement
from .connection_form import ConnectionForm

_TRIALS = 2  # number of shapes at which values are compared
_MOST_DRAWS = 100  # largest number of random shapes drawn to find trial shapes
# Smallest cond(P_b)⁻¹ of a trial shape: near singular shapes, both compared values are only
# round-off.
_LEAST_CONDITION = 1e-3
_STEP = 1e-3  # step of central differences, in own units; it amplifies round-off by 1/_STEP
_TOLERANCE = 1e-7  # relative tolerance of comparisons with differences


def validate_velocity(form: ConnectionForm, code: NativeCode) -> None:
    """Compare ξ and ẋᵀ M ẋ with the reference.  Raises KernelMismatch."""
    r = form.r
    for at, rng in trial_shapes(form):
        xdot = rng.normal(size=form.m)
        inputs = np.concatenate([at.x, at.steps * xdot])
        values = _evaluate_one(code, inputs, r + 1 + form.symmetric)
        A, M, size, largest = _reference_terms(form, at)
        velocity, scale = values[:r] / at.twists, np.abs(xdot).sum()
        _require(form, "the body velocity", velocity, -A @ xdot, size * scale)
        if form.symmetric:
            square = np.array([xdot @ M @ xdot])
            _require(form, "the metric", values[r + 1 :], square, largest * scale**2)


def validate_slope(form: ConnectionForm, code: NativeCode) -> None:
    """Compare derivatives by x with finite differences, derivatives by ẋ with A and M.

    Raises KernelMismatch.
    """
    r, m = form.r, form.m
    rows = r + form.symmetric
    for at, rng in trial_shapes(form):
        xdot = rng.normal(size=m)
        inputs = np.concatenate([at.x, at.steps * xdot])
        values = _evaluate_one(code, inputs, rows * 2 * m).reshape(2 * m, rows)
        values *= np.tile(at.steps, 2)[:, None]
        values[:, :r] /= at.twists
        expected = np.zeros((rows, 2 * m))
        A, M, size, largest = _reference_terms(form, at)
        dA, dM = _reference_derivatives(form, at)
        expected[:r, :m], expected[:r, m:] = -np.einsum("iba,b->ia", dA, xdot), -A
        scale = float(1.0 + xdot @ xdot) / _STEP
        _require(
            form, "the slope of its velocity", values.T[:r], expected[:r], size * scale, _TOLERANCE
        )
        if form.symmetric:
            expected[r, :m] = np.einsum("bca,b,c->a", dM, xdot, xdot)
            expected[r, m:] = 2.0 * M @ xdot
            _require(
                form,
                "the slope of its metric",
                values.T[r:],
                expected[r:],
                largest * scale,
                _TOLERANCE,
            )


def validate_columns(form: ConnectionForm, code: NativeCode) -> None:
    """Compare the matrix of the form F, A and M with the reference.  Raises KernelMismatch."""
    r, m = form.r, form.m
    rows = r + m * form.symmetric
    for at, _ in trial_shapes(form):
        columns = _evaluate_columns(code, m, at.x, rows + r + r * r + 1 + m * form.symmetric)
        F, Au, P, _, Mu = np.split(columns, np.cumsum([rows, r, r * r, 1]), axis=1)
        A, M, size, largest = _reference_terms(form, at)
        matrix = at.weights[:, None] * form.reference(at.x) * at.units
        F = at.weights * F[:m] * at.steps[:, None]
        P = at.weights[:r] * P[0].reshape(r, r) * at.twists[:, None]
        _require(form, "A", Au[:m] * at.steps[:, None] / at.twists, A.T, size)
        _require(form, "P_b", P, matrix[:r, :r].T, 1.0)
        _require(form, "the form", F, matrix[:, r:].T, 1.0)
        if form.symmetric:
            _require(form, "M", Mu[:m] * np.outer(at.steps, at.steps), M, largest)


def validate_column_derivatives(form: ConnectionForm, code: NativeCode) -> None:
    """Compare A with the reference, and ∂A with its differences.  Raises KernelMismatch."""
    r, m = form.r, form.m
    for at, _ in trial_shapes(form):
        columns = _evaluate_columns(code, m, at.x, r + 1 + r * m)[:m]
        A, _, size, _ = _reference_terms(form, at)
        dA, _ = _reference_derivatives(form, at)
        columns = columns * at.steps[:, None]
        _require(form, "A of the curvature", columns[:, :r] / at.twists, A.T, size)
        expected, scale = np.transpose(dA, (1, 2, 0)), (size + size**2) / _STEP
        derivatives = columns[:, r + 1 :].reshape(expected.shape) * at.steps[:, None] / at.twists
        _require(form, "the curvature", derivatives, expected, scale, _TOLERANCE)


def validate_locked_derivative(form: ConnectionForm, code: NativeCode) -> None:
    """Compare ∂(P_b ω)/∂x with differences of the reference.  Raises KernelMismatch."""
    r, m = form.r, form.m
    for at, rng in trial_shapes(form):
        omega = at.twists * rng.normal(size=r)
        values = _evaluate_one(code, np.concatenate([at.x, omega]), r * m).reshape(m, r).T

        def momentum(y: Array, omega: Array = omega, weights: Array = at.weights[:r]) -> Array:
            return np.asarray(weights * (form.reference(y)[:r, :r] @ omega))

        expected = _differences(form, momentum, at)
        scale = float(np.abs(omega / at.twists).sum()) / _STEP
        values = at.weights[:r, None] * values * at.steps
        _require(form, "the derivative of P_b", values, expected, scale, _TOLERANCE)


def validate_covariant(form: ConnectionForm, code: NativeCode) -> None:
    """Compare the covariant force and its gradient with finite differences.

    The reference of the force uses differences of the metric, and the reference of its gradient
    uses differences of the force.

    Raises KernelMismatch.
    """
    m = form.m
    for at, rng in trial_shapes(form):
        xdot, xddot, along = rng.normal(size=(3, m))
        rates = np.concatenate([xdot, xddot])

        def weighted_force(
            step: Array, at: TrialShape = at, rates: Array = rates, along: Array = along
        ) -> Array:
            x, stepped_rates = form.space.integrate(at.x, at.steps * step[:m]), rates + step[m:]
            motion = [x, np.tile(at.steps, 2) * stepped_rates, at.steps * along]
            values = _evaluate_one(code, np.concatenate(motion), 4 * m)
            return values[:m] @ (at.steps * along)[:, None]

        _, M, _, largest = _reference_terms(form, at)
        _, dM = _reference_derivatives(form, at)
        centrifugal = np.einsum("bcg,g,c->b", dM, xdot, xdot)
        centrifugal -= 0.5 * np.einsum("cda,c,d->a", dM, xdot, xdot)
        centrifugal += np.einsum("gab,b,g->a", form.space.structure, xdot, M @ xdot)
        inputs = [at.x, np.tile(at.steps, 3) * np.concatenate([rates, along])]
        values = _evaluate_one(code, np.concatenate(inputs), 4 * m) * np.tile(at.steps, 4)
        force, gradient = np.split(values, [m])
        expected, scale = M @ xddot + centrifugal, largest * float(1.0 + xdot @ xdot) / _STEP
        _require(form, "the covariant force", force, expected, scale, _TOLERANCE)
        (expected,) = central_differences(weighted_force, np.zeros(3 * m), _STEP)
        scale *= float(np.abs(along).sum())
        _require(form, "its derivative", gradient, expected, scale, _TOLERANCE, "its differences")


@dataclass(frozen=True)
class TrialShape:
    """A shape at which code is compared, in the robot's own units.

    Attributes:
        x: The shape, (nx,).
        twists: Size of each entry of the body twist, (r,): the robot's length, or one.
        steps: Size of each displacement along the frame, (m,): the robot's length, or one.
        weights: Factor on each row of the form that gives it the norm one, (rows,).
    """

    x: Array
    twists: Array
    steps: Array
    weights: Array

    @property
    def units(self) -> Array:
        """Size of each velocity, (n,)."""
        return np.concatenate([self.twists, self.steps])


def trial_shapes(form: ConnectionForm) -> Iterator[tuple[TrialShape, np.random.Generator]]:
    """Yield random shapes at which P_b is far from singular, with the generator that drew them."""
    rng, count, r = np.random.default_rng(0), 0, form.r
    units = np.where(form.is_linear, form.length, 1.0)
    for _ in range(_MOST_DRAWS):
        displacement = units[r:] * rng.uniform(-2.0, 2.0, form.m)
        x = form.space.integrate(form.space.neutral, displacement)
        matrix = form.reference(x) * units
        scale = np.linalg.norm(matrix[:r, :r], axis=1)
        if (
            not scale.all()
            or np.linalg.cond(matrix[:r, :r] / scale[:, None]) > 1.0 / _LEAST_CONDITION
        ):
            continue
        norms = np.linalg.norm(matrix, axis=1)
        yield TrialShape(x, units[:r], units[r:], 1.0 / np.where(norms > 0.0, norms, 1.0)), rng
        count += 1
        if count == _TRIALS:
            return


def _reference_terms(form: ConnectionForm, at: TrialShape) -> tuple[Array, Array, float, float]:
    """Return A and M of the reference, and the magnitudes of the terms that sum to A and to M."""
    r = form.r
    G = form.reference(at.x) * at.units
    A = np.asarray(np.linalg.solve(G[:r, :r], G[:r, r:]))
    M, largest = np.zeros((form.m, form.m)), 0.0
    size = np.abs(np.linalg.inv(G[:r, :r])) @ np.abs(G[:r, r:])
    if form.symmetric:
        G *= at.units[:, None]
        M = G[r:, r:] - G[r:, :r] @ A
        terms = np.abs(G[r:, r:]) + np.abs(G[r:, :r]) @ size
        largest = float(terms.max(initial=0.0))
    return A, M, float(size.max(initial=0.0)), largest


def _reference_derivatives(form: ConnectionForm, at: TrialShape) -> tuple[Array, Array]:
    """Return ∂A, (r, m, m), and ∂M, (m, m, m), along the frame, from finite differences."""
    r, m = form.r, form.m

    def terms(y: Array) -> Array:
        A, M, *_ = _reference_terms(form, replace(at, x=y))
        return np.concatenate([A.ravel(), M.ravel()])

    derivatives = _differences(form, terms, at)
    return derivatives[: r * m].reshape(r, m, m), derivatives[r * m :].reshape(m, m, m)


def _differences(form: ConnectionForm, function: Callable[[Array], Array], at: TrialShape) -> Array:
    """Return the derivative of a function of the shape along the frame, (k, m)."""

    def displaced(step: Array) -> Array:
        return function(form.space.integrate(at.x, at.steps * step))

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
    tolerance: float = TOLERANCE,
    reference: str = "Pinocchio",
) -> None:
    """Raise KernelMismatch if values differ; scale: magnitude of the terms that may cancel."""
    require_agreement(
        f"the machine code of {form.what}", term, values.ravel(), expected.ravel(), scale,
        tolerance, reference,
    )  # fmt: skip
