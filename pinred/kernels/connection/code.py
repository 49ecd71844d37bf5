"""Machine code of a connection, made when it is first asked for, judged, and kept on disk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ...common.arrays import Array
from ...common.memo import once
from ...integrators.stepping.compiling import compiled
from ..evaluate import evaluate
from ..machine.native import NativeCode, compile_object, load_object
from ..object_cache import ObjectCache, cache_key
from .connection_judge import judge_curvature, judge_local, judge_slope, judge_velocity
from .covariant import covariant_graph, judge_covariant
from .form import ConnectionForm
from .graphs import curvature_graph, local_graph, velocity_graph, velocity_slope_graph

_NONE = np.zeros(1)


@dataclass(frozen=True)
class Velocities:
    """Horizontal motion at N shapes and rates.

    xi: (N, r) body velocities −A ẋ.  health: (N,) of P_b (see graphs).  square: (N,) ẋᵀ M ẋ;
    NaN where there is no metric.
    """

    xi: Array
    health: Array
    square: Array


@dataclass(frozen=True)
class Locals:
    """The connection at N shapes.

    A: (N, r, m).  P: (N, r, r).  health: (N,).  M: (N, m, m), or None without a metric.
    """

    A: Array
    P: Array
    health: Array
    M: Array | None


@dataclass(frozen=True)
class Curvatures:
    """The two parts of the curvature at N shapes, B = exterior − bracket.

    exterior: (N, r, m, m), ∂_αA_β − ∂_βA_α.  bracket: (N, r, m, m), [A_α, A_β].  health: (N,).
    """

    exterior: Array
    bracket: Array
    health: Array


@dataclass(frozen=True, eq=False)
class ConnectionCode:
    """Machine code of one form.  Shapes x and rates ẋ are (N, m)."""

    form: ConnectionForm

    def velocities(self, x: Array, xdot: Array) -> Velocities:
        """Return the horizontal motions."""
        form, code = self.form, self._code("velocity", velocity_graph, judge_velocity)
        r = form.r
        out = evaluate(code.address, _NONE, np.hstack([x, xdot]), r + 1 + form.symmetric)
        square = out[:, r + 1] if form.symmetric else np.full(len(x), np.nan)
        return Velocities(out[:, :r], out[:, r], square)

    def velocity_slopes(self, x: Array, xdot: Array) -> Array:
        """Return the derivative of (ξ, ẋᵀ M ẋ) by (x, ẋ), (N, r + 1, 2m); r rows without M."""
        form, code = self.form, self._code("slope", velocity_slope_graph, judge_slope)
        rows, columns = form.r + form.symmetric, 2 * form.m
        out = evaluate(code.address, _NONE, np.hstack([x, xdot]), rows * columns)
        return np.swapaxes(out.reshape(len(x), columns, rows), 1, 2)

    def covariant_forces(
        self, x: Array, xdot: Array, xddot: Array, along: Array
    ) -> tuple[Array, Array]:
        """Return the covariant forces f of motions, (N, m), and the slopes of λᵀf, (N, 3m).

        along: λ (N, m).  The slopes are by (x, ẋ, ẍ).  Only where there is a metric.
        """
        code, m = self._code("covariant", covariant_graph, judge_covariant), self.form.m
        out = evaluate(code.address, _NONE, np.hstack([x, xdot, xddot, along]), 4 * m)
        return out[:, :m], out[:, m:]

    def locals(self, x: Array) -> Locals:
        """Return A, P_b and M."""
        form, code = self.form, self._code("local", local_graph, judge_local)
        r, m = form.r, form.m
        ends = np.cumsum([r * m, r * r, 1, m * m * form.symmetric])
        out = evaluate(code.address, _NONE, x, int(ends[-1]))
        return Locals(
            A=_columns(out[:, : ends[0]], r, m),
            P=_columns(out[:, ends[0] : ends[1]], r, r),
            health=out[:, ends[1]],
            M=_columns(out[:, ends[2] :], m, m) if form.symmetric else None,
        )

    def curvatures(self, x: Array) -> Curvatures:
        """Return the curvature in its two parts."""
        form, code = self.form, self._code("curvature", curvature_graph, judge_curvature)
        r, m = form.r, form.m
        out = evaluate(code.address, _NONE, x, 1 + r * m * (m - 1))
        exterior, bracket = np.empty((2, len(x), r, m, m))
        _spread(out, exterior, bracket)
        return Curvatures(exterior, bracket, out[:, 0])

    def curvature(self, x: Array, B: Array) -> Array:
        """Fill B (N, r, m, m) with the curvature; return the health of P_b, (N,)."""
        form, code = self.form, self._code("curvature", curvature_graph, judge_curvature)
        out = evaluate(code.address, _NONE, x, 1 + form.r * form.m * (form.m - 1))
        _spread_difference(out, B)
        return out[:, 0].copy()

    def _code(
        self,
        name: str,
        graph: Callable[[ConnectionForm], ca.Function],
        judge: Callable[[ConnectionForm, NativeCode], None],
    ) -> NativeCode:
        def make() -> NativeCode:
            cache, key = ObjectCache(), cache_key(self.form.key, f"connection {name}")
            code = cache.get(key)
            if code is None:
                code = compile_object(graph(self.form), name)
                cache.put(key, code)
            made = load_object(code, name)
            judge(self.form, made)
            return made

        return once(self, name, make)


@compiled
def _spread(out: Array, exterior: Array, bracket: Array) -> None:
    """Put the columns of pairs α < β, of both parts, where they belong."""
    count, r, m, _ = exterior.shape
    half = r * m * (m - 1) // 2
    for k in range(count):
        at = 1
        for a in range(m):
            for i in range(r):
                exterior[k, i, a, a] = bracket[k, i, a, a] = 0.0
            for b in range(a + 1, m):
                for i in range(r):
                    exterior[k, i, a, b] = out[k, at]
                    exterior[k, i, b, a] = -out[k, at]
                    bracket[k, i, a, b] = out[k, at + half]
                    bracket[k, i, b, a] = -out[k, at + half]
                    at += 1


@compiled
def _spread_difference(out: Array, B: Array) -> None:
    """Put the differences of both parts where they belong."""
    count, r, m, _ = B.shape
    half = r * m * (m - 1) // 2
    for k in range(count):
        at = 1
        for a in range(m):
            for i in range(r):
                B[k, i, a, a] = 0.0
            for b in range(a + 1, m):
                for i in range(r):
                    value = out[k, at] - out[k, at + half]
                    B[k, i, a, b] = value
                    B[k, i, b, a] = -value
                    at += 1


def _columns(flat: Array, rows: int, columns: int) -> Array:
    """Return matrices (N, rows, columns) of their entries by columns, (N, rows · columns)."""
    return np.swapaxes(flat.reshape(len(flat), columns, rows), 1, 2)
