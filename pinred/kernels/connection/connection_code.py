"""Machine code of a connection: compiled at first use, validated, and cached."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, rows
from ...common.errors import ShapeError
from ...common.machine_code import NativeCode, load_object
from ...common.memo import once
from ...common.object_cache import ObjectCache, cache_key
from ...integrators.stepping.compiling import compiled
from ..kernel import WIDTH, columns_at, evaluate
from ..machine.native import compile_object
from .connection_form import (
    ConnectionForm,
    column_derivative_graph,
    column_graph,
    covariant_graph,
    locked_derivative_graph,
    velocity_graph,
    velocity_slope_graph,
)
from .connection_validation import (
    validate_column_derivatives,
    validate_columns,
    validate_covariant,
    validate_locked_derivative,
    validate_slope,
    validate_velocity,
)

_NONE = np.zeros(1)


@dataclass(frozen=True)
class Velocities:
    """Horizontal motions at N shapes and shape rates.

    Attributes:
        xi: Body twists ξ = −A ẋ, (N, r).
        health: Distance of P_b from singularity, (N,); see `connection_form.health`.
        square: Squared norm ẋᵀ M ẋ in the metric M, (N,); NaN if the form defines no metric.
    """

    xi: Array
    health: Array
    square: Array


@dataclass(frozen=True)
class Locals:
    """The connection, and its metric if it has one, at N shapes.

    Attributes:
        matrix: The matrix of the form F, (N, r, n), or (N, n, n) if F is symmetric.
        A: Local connection, (N, r, m).
        health: Distance of P_b from singularity, (N,); see `connection_form.health`.
        M: Metric on shape space, (N, m, m), or None if F is not symmetric.
    """

    matrix: Array
    A: Array
    health: Array
    M: Array | None

    @property
    def P(self) -> Array:
        """The block P_b of the form that multiplies body twists, (N, r, r)."""
        r = self.A.shape[1]
        return self.matrix[:, :r, :r]


@dataclass(frozen=True)
class Curvatures:
    """The two terms of the curvature at N shapes, B = exterior − bracket.

    Attributes:
        exterior: ∂_αA_β − ∂_βA_α − c^γ_αβ A_γ, (N, r, m, m); c is zero without balls.
        bracket: [A_α, A_β], (N, r, m, m).
        health: Distance of P_b from singularity, (N,); see `connection_form.health`.
    """

    exterior: Array
    bracket: Array
    health: Array


@dataclass(frozen=True, eq=False)
class ConnectionCode:
    """Machine code of one connection form.

    Shapes x are (N, nx) [rad | m], and shape rates ẋ are (N, m) [rad/s | m/s], along the frame of
    the shape space.  Derivatives with respect to x are derivatives along this frame.
    """

    form: ConnectionForm

    def velocities(self, x: Array, xdot: Array) -> Velocities:
        """Compute the horizontal motions."""
        form, code = self.form, self._code("velocity", velocity_graph, validate_velocity)
        r, states = form.r, self._states(x, xdot)
        values = evaluate(code.address, _NONE, states, r + 1 + form.symmetric)
        square = values[:, r + 1] if form.symmetric else np.full(len(x), np.nan)
        return Velocities(values[:, :r], values[:, r], square)

    def velocity_slopes(self, x: Array, xdot: Array) -> Array:
        """Return the derivative of (ξ, ẋᵀ M ẋ) with respect to (x, ẋ), (N, r + 1, 2m).

        Without a metric, the derivative is that of ξ, (N, r, 2m).
        """
        form, code = self.form, self._code("slope", velocity_slope_graph, validate_slope)
        size, columns = form.r + form.symmetric, 2 * form.m
        values = evaluate(code.address, _NONE, self._states(x, xdot), size * columns)
        return _matrices(values, size, columns)

    def covariant_forces(
        self, x: Array, xdot: Array, xddot: Array, along: Array
    ) -> tuple[Array, Array]:
        """Compute the covariant forces f of motions, and the gradients of λᵀf.

        The form must have a metric.

        Args:
            x: Shapes, (N, nx).
            xdot: Shape rates, (N, m).
            xddot: Shape accelerations, (N, m).
            along: Weights λ, (N, m).
        Returns:
            f (N, m), and the derivatives of λᵀf with respect to (x, ẋ, ẍ), (N, 3m).
        """
        code, m = self._code("covariant", covariant_graph, validate_covariant), self.form.m
        values = evaluate(code.address, _NONE, np.hstack([x, xdot, xddot, along]), 4 * m)
        return values[:, :m], values[:, m:]

    def locals(self, x: Array) -> Locals:
        """Compute the matrix of the form, the local connection A, and the metric M."""
        r, m, symmetric = self.form.r, self.form.m, self.form.symmetric
        x = rows(x, self.form.nx, "x")
        size, metric = (r + m, m) if symmetric else (r, 0)
        matrix, A = np.empty((len(x), size, r + m)), np.empty((len(x), r, m))
        health, M = np.empty(len(x)), np.empty((len(x), metric, metric))
        code = self._code("columns", column_graph, validate_columns, wide=True)
        for chunk, columns in columns_at(code.address, x, size + r + r * r + 1 + metric, m):
            _unpack(columns, matrix[chunk], A[chunk], health[chunk], M[chunk])
        return Locals(matrix, A, health, M if symmetric else None)

    def curvatures(self, x: Array) -> Curvatures:
        """Compute the two terms of the curvature separately."""
        x = rows(x, self.form.nx, "x")
        exterior, bracket = np.zeros((2, len(x), self.form.r, self.form.m, self.form.m))
        health = self._add_curvature(x, exterior, bracket, 1.0)
        return Curvatures(exterior, bracket, health)

    def curvature(self, x: Array) -> tuple[Array, Array]:
        """Return the curvature, (N, r, m, m), and the health of P_b, (N,)."""
        B = np.zeros((len(x), self.form.r, self.form.m, self.form.m))
        return B, self._add_curvature(x, B, B, -1.0)

    def locked_derivatives(self, x: Array, omega: Array) -> Array:
        """Return ∂(P_b ω)/∂x at constant body twists ω (N, r), (N, r, m)."""
        r, m = self.form.r, self.form.m
        code = self._code("locked_derivative", locked_derivative_graph, validate_locked_derivative)
        return _matrices(evaluate(code.address, _NONE, np.hstack([x, omega]), r * m), r, m)

    def _add_curvature(self, x: Array, exterior: Array, bracket: Array, sign: float) -> Array:
        """Write the exterior and sign · bracket term to arrays of zeros; return P_b's health."""
        r, m = self.form.r, self.form.m
        name = "column_derivatives"
        code = self._code(name, column_derivative_graph, validate_column_derivatives, wide=True)
        constants = self.form.group.ad(np.eye(r))  # [a, i, b]: entry i of [e_a, e_b]
        entries = np.ascontiguousarray(np.argwhere(constants))
        factors, health = sign * constants[tuple(entries.T)], np.empty(len(x))
        for chunk, columns in columns_at(code.address, x, r + 1 + r * m, m):
            _antisymmetrise(columns, entries, factors, exterior[chunk], bracket[chunk])
            if self.form.space.balls:
                structure = self.form.space.structure
                exterior[chunk] -= np.einsum("ngi,gab->niab", columns[:, :, :r], structure)
            health[chunk] = columns[:, 0, r]
        return health

    def _states(self, x: Array, xdot: Array) -> Array:
        """Return shapes and their rates side by side, (N, nx + m)."""
        x, xdot = rows(x, self.form.nx, "x"), rows(xdot, self.form.m, "xdot")
        if len(x) != len(xdot):
            raise ShapeError(f"x and xdot differ in length, {len(x)} and {len(xdot)}")
        return np.hstack([x, xdot])

    def _code(
        self,
        name: str,
        graph: Callable[[ConnectionForm], ca.Function],
        validate: Callable[[ConnectionForm, NativeCode], None],
        *,
        wide: bool = False,
    ) -> NativeCode:
        """Return validated machine code; if wide, one SIMD lane computes each direction."""

        def make() -> NativeCode:
            code = cached_code(self.form.key, name, lambda: graph(self.form), wide=wide)
            validate(self.form, code)
            return code

        return once(self, name, make)


def cached_code(
    key: str | bytes, name: str, graph: Callable[[], ca.Function], *, wide: bool = False
) -> NativeCode:
    """Return machine code from the cache on disk, or compile it.

    Args:
        key: Key that identifies the graph.
        name: Name of the compiled function.
        graph: Function that returns the CasADi Function to compile.  Its inputs are (x, none), or
            (x, none, u) if wide.
        wide: Whether the last input is one of WIDTH directions, evaluated in SIMD lanes.
    Returns:
        The code.  The caller must validate it.
    """
    width, inputs = (WIDTH, (2,)) if wide else (1, (0,))
    binary = ObjectCache().get_or_compile(
        cache_key(key, f"connection {name} {width}"),
        lambda: compile_object(graph(), name, wide=width, wide_inputs=inputs),
        "the terms of a connection",
    )
    return load_object(binary, name)


@compiled
def _unpack(columns: Array, matrix: Array, A: Array, health: Array, M: Array) -> None:
    """Fill the terms of `Locals` from the outputs of `column_graph`.

    Symmetric matrices among these outputs are symmetric only up to round-off, so they are
    symmetrised.
    """
    r, m, rows, metric = A.shape[1], A.shape[2], matrix.shape[1], M.shape[1]
    for k in range(len(columns)):
        locked = rows + r
        health[k] = columns[k, 0, locked + r * r]
        for j in range(r):
            for i in range(r):
                matrix[k, i, j] = columns[k, 0, locked + r * j + i]
        for j in range(m):
            for i in range(r):
                A[k, i, j] = columns[k, j, rows + i]
                matrix[k, i, r + j] = columns[k, j, i]
        for j in range(metric):
            for i in range(r):
                matrix[k, r + j, i] = columns[k, j, i]
            for i in range(metric):
                both = columns[k, j, r + i] + columns[k, i, r + j]
                matrix[k, r + i, r + j] = 0.5 * both
                both = columns[k, j, locked + r * r + 1 + i] + columns[k, i, locked + r * r + 1 + j]
                M[k, i, j] = 0.5 * both


@compiled
def _antisymmetrise(
    columns: Array, entries: NDArray[np.intp], factors: Array, exterior: Array, bracket: Array
) -> None:
    """Compute both terms of the curvature from the columns A_α and their derivatives ∂A_α.

    columns: (N, m, r + 1 + r m), with entry (i, β) of ∂_β A_iα at r + 1 + r β + i.  entries,
    factors: indices (a, i, b) and values of the structure constants.  The outputs may be one array,
    which then contains the sum.  They must be zero initially.
    """
    r, m = exterior.shape[1], exterior.shape[2]
    for k in range(len(exterior)):
        for alpha in range(m):
            for beta in range(alpha + 1, m):
                for i in range(r):
                    by_alpha = columns[k, beta, r + 1 + r * alpha + i]
                    by_beta = columns[k, alpha, r + 1 + r * beta + i]
                    exterior[k, i, alpha, beta] = by_alpha - by_beta
                for e in range(len(entries)):
                    a, i, b = entries[e]
                    term = factors[e] * columns[k, alpha, a] * columns[k, beta, b]
                    bracket[k, i, alpha, beta] += term
        for i in range(r):
            for alpha in range(m):
                for beta in range(alpha):
                    exterior[k, i, alpha, beta] = -exterior[k, i, beta, alpha]
                    bracket[k, i, alpha, beta] = -bracket[k, i, beta, alpha]


def _matrices(flat: Array, rows: int, columns: int) -> Array:
    """Reshape column-major entries, (N, rows · columns), to matrices, (N, rows, columns)."""
    return np.swapaxes(flat.reshape(len(flat), columns, rows), 1, 2)
