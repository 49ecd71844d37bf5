"""Functions with their derivatives as machine code: values, tangents in lanes, adjoints.

A function here takes two columns, a and b.  Its tangent takes directions of both, SEEDS of them at
once as lanes; its adjoint takes a covector λ of the output and gives λᵀ∂/∂a and λᵀ∂/∂b.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.errors import KernelMismatch
from ..integrators.stepping.compiling import compiled
from ..integrators.stepping.kernel_call import SEEDS, call, call_adjoint, call_slopes
from .derived import derived_code
from .kernel import Kernel
from .machine.native import NativeCode, compile_object
from .reduced_graph import ReducedGraph

_TOLERANCE = 1e-9  # of the largest product of a slope and a direction
_TRIALS = 20


@dataclass(frozen=True)
class Differentiable:
    """A function (a, b) → out of a kernel's equations.

    name: of its machine code.  write: gives its expressions, as a Function.
    sample: random (a, b) at which it is tried.
    """

    kernel: Kernel
    name: str
    write: Callable[[ReducedGraph], ca.Function]
    sample: Callable[[np.random.Generator], tuple[Array, Array]]
    judge: Callable[[NativeCode], None]

    @cached_property
    def value(self) -> NativeCode:
        """Machine code (a, b, out)."""
        return self._made(
            f"{self.name}_value",
            lambda f: compile_object(_value(f), f"{self.name}_value"),
            self.judge,
        )

    @cached_property
    def tangent(self) -> NativeCode:
        """Machine code (a, b, directions of a, of b, out); entry i of direction j at 8 i + j."""

        def make(f: ca.Function) -> bytes:
            return compile_object(
                _tangent(f), f"{self.name}_tangent", wide=SEEDS, wide_inputs=(2, 3)
            )

        return self._made(f"{self.name}_tangent", make, lambda _: None)

    @cached_property
    def adjoint(self) -> NativeCode:
        """Machine code (a, b, λ, out); out holds the slopes by a, then those by b."""

        def make(f: ca.Function) -> bytes:
            return compile_object(_adjoint(f), f"{self.name}_adjoint")

        return self._made(f"{self.name}_adjoint", make, self._judge_adjoint)

    def wide_tangent(self, lanes: int) -> NativeCode:
        """Return (a, b, direction of a, of b, out) for so many a at once, each along one direction.

        Of a and its direction, and of the output, entry i of lane j stands at i lanes + j.
        """
        name = f"{self.name}_tangents{lanes}"

        def make(f: ca.Function) -> bytes:
            return compile_object(_tangent(f), name, wide=lanes, wide_inputs=(0, 2))

        return self._made(name, make, lambda _: None)

    def wide_adjoint(self, lanes: int) -> NativeCode:
        """Return (a, b, λ, out) for so many a and λ at once; see wide_tangent."""
        name = f"{self.name}_adjoints{lanes}"

        def make(f: ca.Function) -> bytes:
            return compile_object(_adjoint(f), name, wide=lanes, wide_inputs=(0, 2))

        return self._made(name, make, lambda _: None)

    def at(self, a: Array, b: Array, size: int) -> Array:
        """Return the value, (size,)."""
        out = np.empty(size)
        call_value(self.value.address, a, b, out)
        return out

    def forward(self, a: Array, b: Array, da: Array, db: Array, size: int) -> Array:
        """Return the derivatives (size, N) along directions (…, N) of a and b."""
        count = da.shape[1]
        out = np.empty((size, count))
        parts: Any = [np.zeros((len(column), SEEDS)) for column in (a, b)]
        slopes = np.empty((size, SEEDS))
        for first in range(0, count, SEEDS):
            some = slice(first, min(first + SEEDS, count))
            width = some.stop - first
            for part, whole in zip(parts, (da, db), strict=True):
                part[:, :width] = whole[:, some]
            along_a, along_b = (part.ravel() for part in parts)
            _call_forward(self.tangent.address, a, b, along_a, along_b, slopes.ravel())
            out[:, some] = slopes[:, :width]
        return out

    def reverse(self, a: Array, b: Array, covector: Array) -> tuple[Array, Array]:
        """Return the slopes of λᵀ out by a and by b."""
        out = np.empty(len(a) + len(b))
        _call_reverse(self.adjoint.address, a, b, covector, out)
        return out[: len(a)], out[len(a) :]

    def _made(
        self,
        name: str,
        make: Callable[[ca.Function], bytes],
        judge: Callable[[NativeCode], None],
    ) -> NativeCode:
        return derived_code(
            self.kernel, name, {name: SEEDS}, lambda graph: make(self.write(graph)), judge
        )

    def _judge_adjoint(self, native: NativeCode) -> None:
        """Compare λᵀ(J v) of the tangent with (λᵀJ) v of the adjoint at random states."""
        rng = np.random.default_rng(0)
        size = 0
        for _ in range(_TRIALS):
            a, b = self.sample(rng)
            size = size or self._size_of_output()
            covector = rng.normal(size=size)
            out = np.empty(len(a) + len(b))
            _call_reverse(native.address, a, b, covector, out)
            directions = np.eye(len(out))
            slopes = covector @ self.forward(a, b, directions[: len(a)], directions[len(a) :], size)
            if not (np.isfinite(slopes).all() and np.isfinite(out).all()):
                continue
            error = np.abs(out - slopes).max(initial=0.0)
            if not error <= _TOLERANCE * np.abs(slopes).max(initial=1e-300):
                raise KernelMismatch(
                    f"the adjoint of '{self.name}' of '{self.kernel.system.name}' disagrees with "
                    f"its tangent: off by {error:.3g}\nfound    {out}\nexpected {slopes}"
                )
            return

    def _size_of_output(self) -> int:
        graph = ReducedGraph(self.kernel.system, self.kernel.structure, self.kernel.forces)
        return int(self.write(graph).numel_out(0))


def _symbols(f: ca.Function) -> tuple[ca.SX, ca.SX]:
    return ca.SX.sym("a", f.numel_in(0)), ca.SX.sym("b", f.numel_in(1))


def _value(f: ca.Function) -> ca.Function:
    a, b = _symbols(f)
    return ca.Function("value", [a, b], [ca.densify(f(a, b))], {"cse": True})


def _tangent(f: ca.Function) -> ca.Function:
    a, b = _symbols(f)
    da, db = ca.SX.sym("da", f.numel_in(0)), ca.SX.sym("db", f.numel_in(1))
    out = f(a, b)
    slope = ca.jtimes(out, a, da) + ca.jtimes(out, b, db)
    return ca.Function("tangent", [a, b, da, db], [ca.densify(slope)], {"cse": True})


def _adjoint(f: ca.Function) -> ca.Function:
    a, b = _symbols(f)
    covector = ca.SX.sym("l", f.numel_out(0))
    both = ca.vertcat(a, b)
    slopes = ca.jtimes(f(a, b), both, covector, True)
    return ca.Function("adjoint", [a, b, covector], [ca.densify(slopes)], {"cse": True})


@compiled
def call_value(address: int, a: Array, b: Array, out: Array) -> None:
    """Let machine code of a value fill `out`."""
    call(address, a, b, out)


@compiled
def _call_forward(address: int, a: Array, b: Array, da: Array, db: Array, out: Array) -> None:
    call_slopes(address, a, b, da, db, out)


@compiled
def _call_reverse(address: int, a: Array, b: Array, covector: Array, out: Array) -> None:
    call_adjoint(address, a, b, covector, out)
