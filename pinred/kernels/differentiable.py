"""Machine code of functions derived from a kernel's equations, with first derivatives.

A function takes two columns a and b.  Its tangent (forward mode) takes directions of both columns
and evaluates SEEDS directions at once in SIMD lanes.  Its adjoint (reverse mode) takes a
covector λ of the result and returns
λᵀ∂/∂a and λᵀ∂/∂b.

CasADi's derivatives do not support the symbols that represent lane operations (`Mark`).  The
operations of vector fields whose identical branches are in SIMD lanes are therefore recorded as
nodes, in execution order, and differentiated here.  In forward mode, the tangent of a value in
lanes has the same lanes: SIMD lanes serve the branches of the robot for one direction.

In reverse mode, the backward sweep visits every node from the last to the first, and propagates the
adjoint of the result to the operands.  Instructions on values in lanes are propagated in lanes.  If
lanes contribute to the adjoint of a scalar, their contributions are summed once, when the sweep
reaches the scalar.  The adjoint of a number extracted from a lane is added to that lane, and the
adjoint of a sum over lanes is added to all lanes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array, central_differences
from ..common.errors import InputError, KernelMismatch
from ..common.machine_code import NativeCode
from ..integrators.stepping.intrinsics import SEEDS
from ..reduction.tree.identical_branches import Lanes, Mark
from ..reduction.tree.scalars import Scalar, add, mul
from .build import derived_code, round_off_near
from .kernel import Kernel, call_at_each, call_forward, call_in_batches, call_reverse, call_value
from .machine.native import compile_object
from .reduced_graph import ReducedGraph
from .validation import ROUND_OFF, require_agreement

_STEP = 1e-3  # step of the finite differences, relative to the sizes of the columns
_TOLERANCE = 1e-7  # tolerance of directional derivatives, relative to the terms that sum to them
_TRIALS, _REQUIRED = 40, 2  # number of random points to try, and of points that must be comparable


@dataclass(frozen=True)
class Sample:
    """Random columns at which a function is validated, with sizes in the robot's own units.

    Attributes:
        a: First column.
        b: Second column.
        sizes_a: Size of each entry of a.
        sizes_b: Size of each entry of b.
        sizes: Size of each entry of the result.
    """

    a: Array
    b: Array
    sizes_a: Array
    sizes_b: Array
    sizes: Array


@dataclass(frozen=True)
class Differentiable:
    """A function (a, b) → result that is derived from a kernel's equations.

    Attributes:
        kernel: The kernel, already validated against Pinocchio.
        name: Name of the function and prefix of its machine code.
        write: Function that builds the CasADi Function (a, b) → result from the reduced graph.
        sample: Function that draws a random sample for the validation, or None if the forces are
            undefined there.
        judge: Function that validates the machine code of the value.
        limbs: Whether the adjoint computes identical branches of the robot in SIMD lanes. `pair`
            and `joined` always do.
    """

    kernel: Kernel
    name: str
    write: Callable[[ReducedGraph], ca.Function]
    sample: Callable[[np.random.Generator], Sample | None]
    judge: Callable[[NativeCode], None]
    limbs: bool = False

    @cached_property
    def value(self) -> NativeCode:
        """Machine code (a, b, result) of the function itself."""
        name = f"{self.name}_value"
        return self._code(name, lambda f: compile_object(_value(f), name), self.judge)

    @cached_property
    def tangent(self) -> NativeCode:
        """Machine code (a, b, directions of a, of b, result); entry i of direction j at 8 i + j."""
        # Direction j is j times the first direction, so that the test detects exchanged lanes.
        sizes = np.arange(1.0, SEEDS + 1.0)
        return self._tangent_code(f"{self.name}_tangent", sizes, (2, 3))

    @cached_property
    def pair(self) -> NativeCode:
        """Machine code (a, b, direction of a, of b, out); out: the result, then its derivative."""
        name = f"{self.name}_pair"
        return self._code(
            name,
            lambda _: self._compile_in_lanes(name, tangent_in_lanes),
            lambda native: self._validate_pair(name, partial(call_forward, native.address)),
        )

    @cached_property
    def joined(self) -> NativeCode:
        """Machine code ((a, δa), (b, δb), out) for one direction; out: as of `pair`."""
        name = f"{self.name}_joined"

        def validate(native: NativeCode) -> None:
            def call_joined(a: Array, b: Array, da: Array, db: Array, out: Array) -> None:
                both = np.concatenate([a, da]), np.concatenate([b, db])
                call_value(native.address, *both, out)

            self._validate_pair(name, call_joined)

        differentiate = partial(tangent_in_lanes, joined=True)
        return self._code(name, lambda _: self._compile_in_lanes(name, differentiate), validate)

    @cached_property
    def adjoint(self) -> NativeCode:
        """Machine code (a, b, λ, result) of the adjoint; result: λᵀ∂f/∂a, then λᵀ∂f/∂b."""
        name = f"{self.name}_adjoint"
        if not self.limbs:
            return self._adjoint_code(name, 1)
        return self._adjoint_code(name, 1, lambda _: self._compile_in_lanes(name, adjoint_in_lanes))

    def wide_tangent(self, lanes: int) -> NativeCode:
        """Return the tangent for several columns a at once, each along one direction.

        Entry i of lane j has index i · lanes + j in a, its direction and the result; b and its
        direction are common to all lanes.

        Args:
            lanes: Number of columns a.
        Returns:
            Machine code (a, b, direction of a, of b, result).
        """
        return self._tangent_code(f"{self.name}_tangents{lanes}", np.ones(lanes), (0, 2))

    def wide_adjoint(self, lanes: int) -> NativeCode:
        """Return the adjoint for several columns a and covectors at once; see wide_tangent.

        Args:
            lanes: Number of columns a.
        Returns:
            Machine code (a, b, λ, result).
        """
        return self._adjoint_code(f"{self.name}_adjoints{lanes}", lanes)

    def at(self, a: Array, b: Array, size: int) -> Array:
        """Evaluate the function.

        Args:
            a: First column.
            b: Second column.
            size: Length of the result.
        Returns:
            (size,): the result.
        """
        result = np.empty(size)
        call_value(self.value.address, a, b, result)
        return result

    def forward(self, a: Array, b: Array, da: Array, db: Array, size: int) -> Array:
        """Compute directional derivatives.

        Args:
            a: First column.
            b: Second column.
            da: N directions of a, (…, N).
            db: N directions of b, (…, N).
            size: Length of the result.
        Returns:
            (size, N): the derivatives.
        """
        count = da.shape[1]
        result = np.empty((size, count))
        batches = -(-count // SEEDS)
        seeds_a, seeds_b, lanes = (np.zeros((batches, k * SEEDS)) for k in (len(a), len(b), size))
        call_in_batches(
            self.tangent.address if count else 0, a, b, np.ascontiguousarray(da),
            np.ascontiguousarray(db), seeds_a, seeds_b, lanes, result,
        )  # fmt: skip
        return result

    def forward_many(self, a: Array, b: Array, da: Array, db: Array, size: int) -> Array:
        """Compute directional derivatives at N points.

        Args:
            a: First columns, (N, …).
            b: Second columns, (N, …).
            da: D directions of a at each point, (N, …, D), or (1, …, D) at all points.
            db: D directions of b at each point, (N, …, D), or (1, …, D) at all points.
            size: Length of the result.
        Returns:
            (N, size, D): the derivatives.
        """
        count = da.shape[2]
        batches = -(-count // SEEDS)
        lanes = np.empty((len(a), batches, size * SEEDS))
        if count:
            call_at_each(
                self.tangent.address, np.ascontiguousarray(a), np.ascontiguousarray(b),
                _in_lanes(da, batches), _in_lanes(db, batches), lanes,
            )  # fmt: skip
        by_lane = lanes.reshape(len(a), batches, size, SEEDS).transpose(0, 2, 1, 3)
        return by_lane.reshape(len(a), size, batches * SEEDS)[..., :count]

    def reverse(self, a: Array, b: Array, covector: Array) -> tuple[Array, Array]:
        """Compute the derivatives of λᵀ f with respect to a and to b.

        Args:
            a: First column.
            b: Second column.
            covector: λ, as long as the result of the function.
        Returns:
            λᵀ∂f/∂a and λᵀ∂f/∂b.
        """
        derivatives = np.empty(len(a) + len(b))
        call_reverse(self.adjoint.address, a, b, covector, derivatives)
        return derivatives[: len(a)], derivatives[len(a) :]

    def _code(
        self,
        name: str,
        compile_code: Callable[[ca.Function], bytes],
        validate: Callable[[NativeCode], None],
    ) -> NativeCode:
        return derived_code(
            self.kernel,
            name,
            {name: SEEDS},
            lambda graph: compile_code(self.write(graph)),
            validate,
        )

    def _tangent_code(self, name: str, sizes: Array, wide_inputs: tuple[int, ...]) -> NativeCode:
        """Return forward-mode code; lane j is validated with direction j = sizes[j] · direction."""
        lanes = len(sizes)

        def compile_code(f: ca.Function) -> bytes:
            return compile_object(_tangent(f), name, wide=lanes, wide_inputs=wide_inputs)

        def validate(native: NativeCode) -> None:
            def derivative(at: Sample, da: Array, db: Array, covector: Array) -> Array:
                result = np.empty(len(covector) * lanes)
                wide_a, wide_b, wide_da, wide_db = (
                    np.outer(column, sizes).ravel() if k in wide_inputs else column
                    for k, column in enumerate((at.a, at.b, da, db))
                )
                call_forward(native.address, wide_a, wide_b, wide_da, wide_db, result)
                return np.asarray(covector @ result.reshape(-1, lanes) / sizes)

            self._validate_derivative(name, derivative)

        return self._code(name, compile_code, validate)

    def _adjoint_code(
        self, name: str, lanes: int, compile_code: Callable[[ca.Function], bytes] | None = None
    ) -> NativeCode:
        """Return reverse-mode code, compiled with compile_code instead of the default if set."""

        def compile_default(f: ca.Function) -> bytes:
            return compile_object(_adjoint(f), name, wide=lanes, wide_inputs=(0, 2))

        def validate(native: NativeCode) -> None:
            def derivative(at: Sample, da: Array, db: Array, covector: Array) -> Array:
                result = np.empty((len(at.a) + len(at.b)) * lanes)
                wide_a, wide_covector = (np.repeat(column, lanes) for column in (at.a, covector))
                call_reverse(native.address, wide_a, at.b, wide_covector, result)
                return np.asarray(np.concatenate([da, db]) @ result.reshape(-1, lanes))

            self._validate_derivative(name, derivative)

        return self._code(name, compile_code or compile_default, validate)

    def _compile_in_lanes(
        self, name: str, differentiate: Callable[[ca.Function, list[Mark], Lanes, str], ca.Function]
    ) -> bytes:
        """Compile a derivative with identical branches in SIMD lanes."""
        value_lanes, lanes, kernel = Lanes(), Lanes(), self.kernel
        graph = ReducedGraph(kernel.system, kernel.structure, kernel.forces, value_lanes)
        value = self.write(graph)
        derivative = differentiate(value, value_lanes.marks[value.name()], lanes, name)
        return compile_object(derivative, name, lanes.marks[name])

    def _validate_pair(self, name: str, evaluate: Callable[..., None]) -> None:
        """Compare a result and its derivative with the validated code.

        Args:
            name: Name of the machine code.
            evaluate: Function (a, b, δa, δb, out) that writes the result, then its derivative.
        Raises:
            KernelMismatch: One of them differs.
            InputError: The finite differences are inaccurate at most points.
        """

        def derivative(at: Sample, da: Array, db: Array, covector: Array) -> Array:
            both = np.empty((2, len(covector)))
            evaluate(at.a, at.b, da, db, both.ravel())
            values = partial(values_near, self._reference, at)
            expected = values(np.zeros(len(at.a))) / at.sizes
            if np.isfinite(expected).all():
                noise = round_off_near(lambda step: values(step) / at.sizes, len(at.a))
                require_agreement(
                    f"'{name}' of '{self.kernel.system.name}'", "the value",
                    both[0] / at.sizes, expected, noise / ROUND_OFF,
                    reference=f"the code of '{self.name}'",
                )  # fmt: skip
            return np.atleast_1d(covector @ both[1])

        self._validate_derivative(name, derivative)

    def _validate_derivative(self, name: str, derivative: Callable[..., Array]) -> None:
        """Compare λᵀ(∂f/∂a δa + ∂f/∂b δb) with finite differences of λᵀf.

        Args:
            name: Name of the machine code.
            derivative: Function of (sample, δa, δb, λ) that returns the derivative of each lane.
        Raises:
            KernelMismatch: The derivatives differ.
            InputError: The finite differences are inaccurate at most points.
        """
        rng, compared = np.random.default_rng(0), 0
        for _ in range(_TRIALS):
            at = self.sample(rng)
            if at is None:
                continue
            # Without units, each row has the same weight, however small the robot is.
            da, db = (size * rng.normal(size=len(size)) for size in (at.sizes_a, at.sizes_b))
            covector = rng.normal(size=len(at.sizes)) / at.sizes
            with np.errstate(all="ignore"):
                rough, columns = (
                    _difference(self._reference, at, da, db, h) for h in (2.0 * _STEP, _STEP)
                )
                values = derivative(at, da, db, covector)
                noise = self._noise_of(at, covector)
                bound = _TOLERANCE * (np.abs(covector) @ np.abs(columns)) + noise / _STEP
                expected, doubted = float(covector @ columns), float(covector @ rough)
            if not (abs(doubted - expected) <= bound and np.isfinite(values).all()):
                continue  # finite differences fail where a force has a kink
            error = np.abs(values - expected)
            if not (error <= 10.0 * bound).all():
                lane = int(error.argmax())
                raise KernelMismatch(
                    f"the code '{name}' of '{self.kernel.system.name}' disagrees with differences "
                    f"of the code '{self.name}' in lane {lane}: got {values[lane]:.12g}, expected "
                    f"{expected:.12g}"
                )
            compared += 1
            if compared == _REQUIRED:
                return
        raise InputError(
            f"the forces on '{self.kernel.system.name}' have no derivatives at "
            f"{_TRIALS - compared} of {_TRIALS} random states"
        )

    def _noise_of(self, at: Sample, covector: Array) -> float:
        """Estimate the round-off of λᵀf at a sample."""

        def weighted(displacement: Array) -> Array:
            return covector * values_near(self._reference, at, displacement)

        terms = np.abs(weighted(np.zeros(len(at.a)))).sum()
        observed = round_off_near(lambda step: weighted(step).sum(keepdims=True), len(at.a))
        return float(ROUND_OFF * terms + observed)

    @property
    def _reference(self) -> int:
        """Address of the validated machine code of the function itself."""
        return (self.kernel.rate if self.name == "rate" else self.value).address


def values_near(address: int, at: Sample, displacement: Array) -> Array:
    """Evaluate machine code at a displacement of a, which is relative to the sizes of its entries.

    Args:
        address: Address of the machine code.
        at: The sample.
        displacement: Displacement of each entry of a.
    Returns:
        The result, as long as at.sizes.
    """
    result = np.empty(len(at.sizes))
    call_value(address, at.a + at.sizes_a * displacement, at.b, result)
    return result


def _difference(address: int, at: Sample, da: Array, db: Array, h: float) -> Array:
    """Compute the derivative of a function along a direction by central differences of order 6."""

    def value(s: Array) -> Array:
        result = np.empty(len(at.sizes))
        call_value(address, at.a + s * da, at.b + s * db, result)
        return result

    return central_differences(value, np.zeros(1), h)[:, 0]


def _symbols(f: ca.Function) -> tuple[ca.SX, ca.SX]:
    return ca.SX.sym("a", f.numel_in(0)), ca.SX.sym("b", f.numel_in(1))


def _value(f: ca.Function) -> ca.Function:
    a, b = _symbols(f)
    return ca.Function("value", [a, b], [ca.densify(f(a, b))], {"cse": True})


def _tangent(f: ca.Function) -> ca.Function:
    a, b = _symbols(f)
    da, db = ca.SX.sym("da", f.numel_in(0)), ca.SX.sym("db", f.numel_in(1))
    result = f(a, b)
    derivative = ca.jtimes(result, a, da) + ca.jtimes(result, b, db)
    return ca.Function("tangent", [a, b, da, db], [ca.densify(derivative)], {"cse": True})


def _adjoint(f: ca.Function) -> ca.Function:
    a, b = _symbols(f)
    covector = ca.SX.sym("l", f.numel_out(0))
    both = ca.vertcat(a, b)
    derivatives = ca.jtimes(f(a, b), both, covector, True)
    return ca.Function("adjoint", [a, b, covector], [ca.densify(derivatives)], {"cse": True})


def _in_lanes(directions: Array, batches: int) -> Array:
    """Arrange directions (N, n, D) in the layout of tangent kernels, (N, batches, n SEEDS)."""
    points, n, count = directions.shape
    padded = np.zeros((points, n, batches * SEEDS))
    padded[..., :count] = directions
    by_batch = padded.reshape(points, n, batches, SEEDS).transpose(0, 2, 1, 3)
    return np.ascontiguousarray(by_batch).reshape(points, batches, n * SEEDS)


@dataclass
class Node:
    """A node of the computational graph: a scalar, or a value with one number per lane.

    Attributes:
        value: CasADi expression of the value.
        width: Number of lanes.
        parents: Operands, with the derivative of the value with respect to each.
        mark: The lane operation that created the value, or None for an ordinary operation.
        tangent: Derivative of the value along a direction of the inputs.
        adjoint: Sum of the adjoint contributions received so far.
        from_lanes: Adjoint contributions to a scalar that are not yet summed over the lanes.
        lanes: Number of lanes of `from_lanes`.
        from_extracts: Adjoint of each number that was extracted from a lane of this value.
    """

    value: Scalar
    width: int = 1
    parents: list[tuple[Node, Any]] = field(default_factory=list)
    mark: Mark | None = None
    tangent: Scalar = 0.0
    adjoint: Scalar = 0.0
    from_lanes: Scalar = 0.0
    lanes: int = 1
    from_extracts: list[Scalar] | None = None


def record(
    rate: ca.Function, marks: list[Mark], lanes: Lanes, y: ca.SX, p: ca.SX
) -> tuple[list[Node], dict[tuple[int, int], Node], dict[int, Node]]:
    """Record the nodes of a vector field.

    Args:
        rate: Vector field (y, parameters, symbols) → (operands, ẏ), built with another Lanes
            object.
        marks: Lane operations of `rate`, one per symbol.
        lanes: Lanes object that receives the same lane operations.
        y: Symbols of the state.
        p: Symbols of the parameters.
    Returns:
        All nodes in execution order; the input nodes by (0 for y or 1 for p, entry); and the output
        nodes by row.
    """
    tape: list[Node] = []
    inputs: dict[tuple[int, int], Node] = {}
    outputs: dict[int, Node] = {}
    registers: dict[int, Node] = {}  # node currently stored in each register
    marked: list[Node] = []
    operands: list[Node] = []
    for k in range(rate.n_instructions()):
        op, arguments = rate.instruction_id(k), rate.instruction_input(k)
        if op == ca.OP_CONST:
            node = Node(float(rate.instruction_constant(k)))
        elif op == ca.OP_INPUT:
            which, entry = arguments
            if which == 2:
                node = marked[entry]
            else:
                if (which, entry) not in inputs:
                    inputs[which, entry] = Node((y, p)[which][entry])
                node = inputs[which, entry]
        elif op == ca.OP_OUTPUT:
            which, row = rate.instruction_output(k)
            if which == 1:
                outputs[row] = registers[arguments[0]]
                continue
            operands.append(registers[arguments[0]])
            mark = marks[len(marked)]
            if len(operands) == len(mark.operands):
                marked.append(_mark_node(mark, operands, lanes))
                tape.append(marked[-1])
                operands = []
            continue
        else:
            node = _operation_node(op, [registers[i] for i in arguments])
            tape.append(node)
        registers[rate.instruction_output(k)[0]] = node
    return tape, inputs, outputs


def _operation_node(op: int, parents: list[Node]) -> Node:
    values = [ca.SX(parent.value) for parent in parents]
    result = ca.SX.unary(op, values[0]) if len(values) == 1 else ca.SX.binary(op, *values)
    pairs = list(zip(parents, _local_derivatives(op, values), strict=True))
    return Node(result, max(parent.width for parent in parents), pairs)


def _local_derivatives(op: int, values: list[ca.SX]) -> list[Scalar]:
    """Return the derivative of an operation with respect to each operand; constants are floats."""
    if op not in _RULES:
        symbols = [ca.SX.sym("a"), ca.SX.sym("b")][: len(values)]
        result = ca.SX.unary(op, *symbols) if len(values) == 1 else ca.SX.binary(op, *symbols)
        rules = [ca.densify(ca.jacobian(result, symbol)) for symbol in symbols]
        _RULES[op] = ca.Function("rule", symbols, rules)
    results = _RULES[op](*values)
    derivatives = [results] if len(values) == 1 else list(results)
    return [float(entry) if entry.is_constant() else entry for entry in derivatives]


_RULES: dict[int, ca.Function] = {}  # by operation code: its partial derivatives


def _mark_node(mark: Mark, operands: list[Node], lanes: Lanes) -> Node:
    if mark.kind == "pack":
        value = lanes.pack([operand.value for operand in operands])
        width = mark.width
    elif mark.kind == "lane":
        value, width = lanes.lane(operands[0].value, mark.lane, mark.width), 1
    else:
        value, width = lanes.sum(operands[0].value, mark.width), 1
    return Node(value, width, [(operand, 1.0) for operand in operands], mark)


def tangent_in_lanes(
    rate: ca.Function, marks: list[Mark], lanes: Lanes, name: str, *, joined: bool = False
) -> ca.Function:
    """Build a vector field together with its derivative along one direction.

    Args:
        rate: Vector field (y, parameters, symbols) → (operands, ẏ), built with another Lanes
            object.
        marks: Lane operations of `rate`, one per symbol.
        lanes: Lanes object that receives the lane operations of the derivative.
        name: Name of the Function.
        joined: Whether each column is followed by its direction in one input.
    Returns:
        Function (y, parameters, δy, δparameters) → (ẏ, δẏ), or ((y, δy), (parameters,
        δparameters)) → (ẏ, δẏ).
    """
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    directions = ca.SX.sym("dy", y.numel()), ca.SX.sym("dp", p.numel())
    tape, inputs, outputs = record(rate, marks, lanes, y, p)
    for (which, entry), node in inputs.items():
        node.tangent = directions[which][entry]
    for node in tape:
        node.tangent = _tangent_of(node, lanes)
    rows = [outputs[row] for row in range(rate.numel_out(1))]
    both = [*(node.value for node in rows), *(node.tangent for node in rows)]
    columns = [y, p, *directions]
    if joined:
        columns = [ca.vertcat(*pair) for pair in zip((y, p), directions, strict=True)]
    return lanes.function(name, columns, ca.vertcat(ca.SX(0, 1), *both))


def joined_tangent(rate: ca.Function, name: str) -> ca.Function:
    """Build a vector field with its derivative, without lanes; see `tangent_in_lanes`.

    Args:
        rate: Vector field (y, parameters) → ẏ.
        name: Name of the Function.
    Returns:
        Function ((y, δy), (parameters, δparameters), nothing) → (nothing, (ẏ, δẏ)).
    """
    y, p = rate.sx_in()
    none = ca.SX(0, 1)
    plain = ca.Function("rate", [y, p, none], [none, ca.densify(rate(y, p))], {"cse": True})
    return tangent_in_lanes(plain, [], Lanes(), name, joined=True)


def _tangent_of(node: Node, lanes: Lanes) -> Scalar:
    """Return the tangent of a node from the tangents of its operands."""
    mark, tangent = node.mark, 0.0
    if mark is None:
        for parent, derivative in node.parents:
            tangent = add(tangent, mul(parent.tangent, derivative))
        return tangent
    operands = [parent.tangent for parent, _ in node.parents]
    if mark.kind == "pack":
        return lanes.pack(operands)
    (packed,) = operands
    if mark.kind == "lane":
        return lanes.lane(packed, mark.lane, mark.width)
    return lanes.sum(packed, mark.width)


def adjoint_in_lanes(rate: ca.Function, marks: list[Mark], lanes: Lanes, name: str) -> ca.Function:
    """Build the reverse-mode derivative of a vector field with identical branches in lanes.

    Args:
        rate: Vector field (y, parameters, symbols) → (operands, ẏ), built with another Lanes
            object.
        marks: Lane operations of `rate`, one per symbol.
        lanes: Lanes object that receives the lane operations of the adjoint.
        name: Name of the adjoint Function.
    Returns:
        Function (y, parameters, λ) → derivatives of λᵀ ẏ with respect to y, followed by those
        with respect to the parameters.
    """
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    covector = ca.SX.sym("l", rate.numel_out(1))
    tape, inputs, outputs = record(rate, marks, lanes, y, p)
    for row, node in outputs.items():
        node.adjoint = add(node.adjoint, covector[row])
    for node in reversed(tape):
        _propagate(node, lanes)
    adjoints = [_total_adjoint(inputs[which, k], lanes) if (which, k) in inputs else 0.0
              for which, column in ((0, y), (1, p)) for k in range(column.numel())]  # fmt: skip
    return lanes.function(name, [y, p, covector], ca.vertcat(ca.SX(0, 1), *adjoints))


def _propagate(node: Node, lanes: Lanes) -> None:
    """Add the adjoint of a node to the adjoints of its operands."""
    adjoint = _total_adjoint(node, lanes)
    if isinstance(adjoint, float) and adjoint == 0.0:
        return
    mark = node.mark
    if mark is None:
        for parent, rule in node.parents:
            product = mul(adjoint, rule)
            if node.width > 1 and parent.width == 1:
                parent.from_lanes = add(parent.from_lanes, product)
                parent.lanes = node.width
            else:
                parent.adjoint = add(parent.adjoint, product)
    elif mark.kind == "pack":
        for lane, (parent, _) in enumerate(node.parents):
            parent.adjoint = add(parent.adjoint, lanes.lane(adjoint, lane, mark.width))
    else:
        ((parent, _),) = node.parents
        if mark.kind == "sum":
            parent.adjoint = add(parent.adjoint, adjoint)
        else:
            if parent.from_extracts is None:
                parent.from_extracts = [0.0] * mark.width
            parent.from_extracts[mark.lane] = add(parent.from_extracts[mark.lane], adjoint)


def _total_adjoint(node: Node, lanes: Lanes) -> Scalar:
    """Return the total adjoint of a node."""
    adjoint = node.adjoint
    if not (isinstance(node.from_lanes, float) and node.from_lanes == 0.0):
        adjoint = add(adjoint, lanes.sum(node.from_lanes, node.lanes))
    if node.from_extracts is not None:
        adjoint = add(adjoint, lanes.pack(node.from_extracts))
    return adjoint
