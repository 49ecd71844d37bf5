"""Functions with their derivatives as machine code: values, tangents in lanes, adjoints.

A function here takes two columns, a and b.  Its tangent takes directions of both, SEEDS of them at
once as lanes; its adjoint takes a covector λ of the output and gives λᵀ∂/∂a and λᵀ∂/∂b.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError, KernelMismatch
from ..integrators.stepping.compiling import compiled
from ..integrators.stepping.kernel_call import SEEDS, call, call_adjoint, call_slopes
from ..integrators.stepping.kernel_call import from_lanes, to_lanes
from ..reduction.tree.limbs import Lanes
from .adjoint_lanes import adjoint_in_lanes
from .derived_code import derived_code
from .kernel import Kernel
from .machine.native import NativeCode, compile_object
from .reduced_graph import ReducedGraph

_STEP = 1e-3  # of differences, for states of size one
_TOLERANCE = 1e-7  # of slopes along a direction
_LEAST = 1e-3  # of a direction's entries
_TRIALS, _NEEDED = 40, 2
_SIZES = np.arange(1.0, SEEDS + 1.0)  # of the directions in lanes


@dataclass(frozen=True)
class Differentiable:
    """A function (a, b) → out of a kernel's equations.

    name: of its machine code.  write: gives its expressions, as a Function.
    sample: random (a, b) at which it is tried.  limbs: whether limbs are lanes of its adjoint.
    """

    kernel: Kernel
    name: str
    write: Callable[[ReducedGraph], ca.Function]
    sample: Callable[[np.random.Generator], tuple[Array, Array]]
    judge: Callable[[NativeCode], None]
    limbs: bool = False

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

        def judge(native: NativeCode) -> None:
            def slope(a: Array, b: Array, da: Array, db: Array, covector: Array) -> float:
                out = np.empty(len(covector) * SEEDS)
                seeds = [np.outer(part, _SIZES).ravel() for part in (da, db)]
                _call_forward(native.address, a, b, seeds[0], seeds[1], out)
                return _of_lanes(covector @ out.reshape(-1, SEEDS) / _SIZES)

            self._judge_slopes(slope)

        return self._made(f"{self.name}_tangent", make, judge)

    @cached_property
    def adjoint(self) -> NativeCode:
        """Machine code (a, b, λ, out); out holds the slopes by a, then those by b."""
        name = f"{self.name}_adjoint"

        def make(f: ca.Function) -> bytes:
            return compile_object(_adjoint(f), name)

        def make_in_lanes(_: ca.Function) -> bytes:
            of_rate, own = Lanes(), Lanes()
            kernel = self.kernel
            graph = ReducedGraph(kernel.system, kernel.structure, kernel.forces, of_rate)
            rate = self.write(graph)
            whole = adjoint_in_lanes(rate, of_rate.marks[rate.name()], own, name)
            return compile_object(whole, name, own.marks[name])

        def judge(native: NativeCode) -> None:
            def slope(a: Array, b: Array, da: Array, db: Array, covector: Array) -> float:
                out = np.empty(len(a) + len(b))
                _call_reverse(native.address, a, b, covector, out)
                return float(out @ np.concatenate([da, db]))

            self._judge_slopes(slope)

        return self._made(name, make_in_lanes if self.limbs else make, judge)

    def wide_tangent(self, lanes: int) -> NativeCode:
        """Return (a, b, direction of a, of b, out) for so many a at once, each along one direction.

        Of a and its direction, and of the output, entry i of lane j stands at i lanes + j.
        """
        name = f"{self.name}_tangents{lanes}"

        def make(f: ca.Function) -> bytes:
            return compile_object(_tangent(f), name, wide=lanes, wide_inputs=(0, 2))

        def judge(native: NativeCode) -> None:
            def slope(a: Array, b: Array, da: Array, db: Array, covector: Array) -> float:
                out = np.empty(len(covector) * lanes)
                wide = (np.repeat(part, lanes) for part in (a, da))
                _call_forward(native.address, next(wide), b, next(wide), db, out)
                return _of_lanes(covector @ out.reshape(-1, lanes))

            self._judge_slopes(slope)

        return self._made(name, make, judge)

    def wide_adjoint(self, lanes: int) -> NativeCode:
        """Return (a, b, λ, out) for so many a and λ at once; see wide_tangent."""
        name = f"{self.name}_adjoints{lanes}"

        def make(f: ca.Function) -> bytes:
            return compile_object(_adjoint(f), name, wide=lanes, wide_inputs=(0, 2))

        def judge(native: NativeCode) -> None:
            def slope(a: Array, b: Array, da: Array, db: Array, covector: Array) -> float:
                out = np.empty((len(a) + len(b)) * lanes)
                wide = [np.repeat(part, lanes) for part in (a, covector)]
                _call_reverse(native.address, wide[0], b, wide[1], out)
                return _of_lanes(np.concatenate([da, db]) @ out.reshape(-1, lanes))

            self._judge_slopes(slope)

        return self._made(name, make, judge)

    def at(self, a: Array, b: Array, size: int) -> Array:
        """Return the value, (size,)."""
        out = np.empty(size)
        call_value(self.value.address, a, b, out)
        return out

    def forward(self, a: Array, b: Array, da: Array, db: Array, size: int) -> Array:
        """Return the derivatives (size, N) along directions (…, N) of a and b."""
        count = da.shape[1]
        out = np.empty((size, count))
        batches = -(-count // SEEDS)
        along_a, along_b, slopes = (np.zeros((batches, k * SEEDS)) for k in (len(a), len(b), size))
        _call_in_batches(
            self.tangent.address if count else 0, a, b, np.ascontiguousarray(da),
            np.ascontiguousarray(db), along_a, along_b, slopes, out,
        )  # fmt: skip
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

    def _judge_slopes(self, slope: Callable[..., float]) -> None:
        """Compare λᵀ(∂f/∂a δa + ∂f/∂b δb) with differences of λᵀf, where these agree.

        slope: of (a, b, δa, δb, λ).  Raises KernelMismatch.
        """
        rng, size, judged = np.random.default_rng(0), self._size_of_output(), 0
        address = (self.kernel.rate if self.name == "rate" else self.value).address
        for _ in range(_TRIALS):
            a, b = self.sample(rng)
            # Small inertias are moved by less than they are.
            da, db = (rng.normal(size=len(v)) * np.clip(np.abs(v), _LEAST, 1.0) for v in (a, b))
            covector = rng.normal(size=size)
            with np.errstate(all="ignore"):
                rough, expected = (
                    _difference(address, a, b, da, db, covector, h) for h in (2.0 * _STEP, _STEP)
                )
                found = slope(a, b, da, db, covector)
            most = _TOLERANCE * max(1.0, abs(expected))
            if not (abs(rough - expected) <= most and np.isfinite(found)):
                continue  # where a force has a kink, or is not defined, differences say nothing
            if not abs(found - expected) <= 10.0 * most:
                raise KernelMismatch(
                    f"a derivative of '{self.name}' of '{self.kernel.system.name}' disagrees with "
                    f"its differences: {found:.12g}, and not {expected:.12g}"
                )
            judged += 1
            if judged == _NEEDED:
                return
        raise InputError(
            f"the forces on '{self.kernel.system.name}' have no derivatives at "
            f"{_TRIALS - judged} of {_TRIALS} random states"
        )

    def _size_of_output(self) -> int:
        graph = ReducedGraph(self.kernel.system, self.kernel.structure, self.kernel.forces)
        return int(self.write(graph).numel_out(0))


def _difference(
    address: int, a: Array, b: Array, da: Array, db: Array, covector: Array, h: float
) -> float:
    """Return the derivative of λᵀf along a direction by central differences of order 6."""
    total, out = 0.0, np.empty(len(covector))
    for k, weight in ((1, 45.0), (2, -9.0), (3, 1.0)):
        for sign in (1.0, -1.0):
            step = sign * k * h
            call_value(address, a + step * da, b + step * db, out)
            total += sign * weight * float(covector @ out)
    return total / (60.0 * h)


def _of_lanes(found: Array) -> float:
    """Return what all lanes give alike; NaN where they do not."""
    same = np.abs(found - found[0]).max() <= _TOLERANCE * max(1.0, abs(float(found[0])))
    return float(found[0]) if same else np.nan


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
def repeat_adjoint(
    address: int, a: Array, b: Array, covector: Array, out: Array, count: int
) -> None:
    """Evaluate an adjoint `count` times, to be timed."""
    for _ in range(count):
        call_adjoint(address, a, b, covector, out)


@compiled
def _call_forward(address: int, a: Array, b: Array, da: Array, db: Array, out: Array) -> None:
    call_slopes(address, a, b, da, db, out)


@compiled
def _call_in_batches(
    address: int,
    a: Array,
    b: Array,
    da: Array,
    db: Array,
    along_a: Array,
    along_b: Array,
    slopes: Array,
    out: Array,
) -> None:
    """Fill out (size, N) with the slopes along directions (…, N), SEEDS at once."""
    to_lanes(da, along_a)
    to_lanes(db, along_b)
    for k in range(slopes.shape[0]):
        call_slopes(address, a, b, along_a[k], along_b[k], slopes[k])
    from_lanes(slopes, out)


@compiled
def _call_reverse(address: int, a: Array, b: Array, covector: Array, out: Array) -> None:
    call_adjoint(address, a, b, covector, out)
