"""A flow as a function between plain vectors, also for batches, and as a CasADi Callback.

Inputs are vectors in the order of the flow's `inputs`; the output is one vector.  Poses and
quaternions of balls are written in their own coordinates, not in tangent coordinates, so that
derivatives match values.  Quaternions of balls in x0 may have any length: they are normalised, so
derivatives along a quaternion are zero.

In batches, inputs, directions and covectors have leading axes (…, size) that are broadcast.  Values
of a batch run in SIMD lanes; one integration serves all directions and covectors of the same
inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, TypeAlias

import casadi as ca
import numpy as np

from ...common.arrays import Array, as_floats, vectors
from ...common.errors import InputError, ShapeError
from ...common.names import brief, listed, nearest
from ...integrators.methods import Explicit
from ...kernels.flow_functions import Row, sizes_of
from .inputs import Given, Inputs
from .propagator import Propagator
from .run_and_adjoint import Run

# Up to this number of runs, one thread finishes before a second thread has started.
_RUNS_OF_ONE_THREAD = 32


class Columns:
    """A flow as a function of vectors.

    Attributes:
        flow: The flow.
        names: Names of the inputs.
        sizes: Number of entries of each input.
        starts: Values of the inputs in the scene, (size,) each.
        outputs: Slices of the fields of State in the output at one time.
        size: Number of entries of the output, with all times one after another.
    """

    def __init__(
        self, flow: Any, propagator: Propagator, inputs: Inputs, run: Callable[..., Run]
    ) -> None:
        """Determine the input and output vectors of a flow.

        Args:
            flow: The Flow.
            propagator: Kernels and runs of the flow.
            inputs: Inputs of the flow.
            run: Function that integrates the flow for {input: value} and returns the run.
        Raises:
            InputError: The flow has no inputs, or one of them is a pose.
        """
        if "pose0" in flow.inputs:
            raise InputError(
                "pose0 is an element of a group, and inputs must be vectors; leave it out of wrt="
            )
        if not flow.inputs:
            raise InputError("the flow has no inputs with derivatives; name some in wrt=")
        self.flow = flow
        self.names = tuple(flow.inputs)
        self.starts = [flow.own(name) for name in self.names]
        self.sizes = tuple(len(start) for start in self.starts)
        self._has_balls = len(flow.system.space.balls) > 0
        numbers: dict[str, Row] = {"pose": "pose_numbers"}
        if self._has_balls:
            numbers["x"] = "x_numbers"
        self._rows: tuple[Row, ...] = tuple(numbers.get(name, name) for name in flow.outputs)
        sizes = sizes_of(flow.system)
        ends = np.cumsum([0, *(sizes[outcome] for outcome in self._rows)]).tolist()
        self.outputs = dict(zip(flow.outputs, map(slice, ends, ends[1:]), strict=True))
        self._times = len(flow.t) if flow.over_times else 1
        self.size = ends[-1] * self._times
        self._propagator, self._inputs, self._run = propagator, inputs, run
        ends = np.cumsum([0, *self.sizes]).tolist()
        self._cuts, self._spans = ends[1:-1], list(map(slice, ends, ends[1:]))
        self._entries = self._propagator.entries(self.outputs)

    def value(self, *columns: Any) -> Array:
        """Compute the output.

        Args:
            *columns: Values of the inputs, in their order, (its size,) each.
        Returns:
            (size,).
        """
        return self._output(self._run(self._by_name(columns)))

    def value_of(self, column: Array) -> Array:
        """Return the output, (size,), for one vector that contains all inputs."""
        return self._output(self._run(self._split(column)))

    def jvp_of(self, column: Array, direction: Array) -> Array:
        """Return the derivative, (size,), along a direction; both arguments contain all inputs."""
        values = self._split(column)
        return self._jvp(self._run(values), values, direction[:, None])[:, 0]

    def vjp_of(self, column: Array, covector: Array) -> Array:
        """Return the derivatives of covector · output with respect to all inputs, in one vector."""
        values = self._split(column)
        return self._vjp(self._run(values, stages=True), values, covector)

    def values(
        self, *columns: Any, threads: int | None = None, device: Literal["cuda"] | None = None
    ) -> Array:
        """Compute the outputs for N inputs at once, in SIMD lanes if the method has them.

        The outputs agree with `value` within round-off times the growth along the flow.

        Args:
            *columns: Values of the inputs, in their order, (N, its size) or (1, its size) each.
            threads: Number of threads, None for the number of processors.
            device: "cuda" to integrate on CUDA devices; None for the CPU.
        Returns:
            (N, size).
        Raises:
            ShapeError: An input has the wrong number of axes.
            InputError: A device does not integrate this flow.
            IntegrationError: A run fails; the message names the first failing run.
        """
        batches, count = self._batches(columns)
        if device is not None:
            self._check_device(device, threads)
        if not count:
            return np.zeros((0, self.size))
        # Lanes store no steps at which loops are checked, and look for no impacts.
        alone = count == 1 or self.flow.system.loops or self.flow.scene.bounds
        if alone and device is None:
            return np.array([self.value(*row) for row in _rows(batches, count)])
        state, constants, _ = self._inputs_of_many(batches, count, derivatives=False)
        threads = 1 if threads is None and count <= _RUNS_OF_ONE_THREAD else threads
        outputs = self._propagator.outputs_of_many(state, constants, threads, device)
        return np.ascontiguousarray(outputs[..., self._entries].reshape(count, -1))

    def jacobians(
        self, *columns: Any, threads: int | None = None, device: Literal["cuda"] | None = None
    ) -> list[Array]:
        """Compute the derivatives of the output with respect to each input, for N inputs at once.

        With DOP853 and Tsit5, each direction of each run is integrated with the run, on threads of
        the CPU or of devices.  The derivatives agree with `jacobian` within round-off times the
        growth along the flow.  Other methods, and flows with closed loops, joint stops, or
        conditions on time that depend on parameters, run one after another on the CPU.

        Args:
            *columns: Values of the inputs, in their order, (N, its size) or (1, its size) each.
            threads: Number of threads, None for the number of processors.
            device: "cuda" to integrate on CUDA devices; None for the CPU.
        Returns:
            (N, size, its size) for each input.
        Raises:
            ShapeError: An input has the wrong number of axes.
            InputError: A device does not integrate this flow.
            IntegrationError: A run fails, or a derivative is not finite.
        """
        batches, count = self._batches(columns)
        if device is not None:
            self._check_device(device, threads)
        total = sum(self.sizes)
        if not count:
            derivatives = np.zeros((0, self.size, total))
        elif device is None and (count == 1 or self._only_alone):
            alone = [np.hstack(self.jacobian(*row)) for row in _rows(batches, count)]
            derivatives = np.array(alone)
        else:
            state, constants, basis = self._inputs_of_many(batches, count, derivatives=True)
            by_time = self._propagator.jacobians(
                state, constants, basis, self._rows, threads, device
            )
            derivatives = by_time.reshape(count, self.size, total)
        return np.split(derivatives, self._cuts, axis=2)

    @property
    def _only_alone(self) -> str:
        """The reason to differentiate runs one by one; "" if they can run together."""
        plan, method = self._propagator.plan, self._propagator.method
        if self.flow.system.loops:
            return "closed loops are checked at each step"
        if self.flow.scene.bounds:
            return "joints come to rest at their stops at different times"
        if plan.stops_vary:
            return "times at which forces switch depend on parameters"
        return "" if isinstance(method, Explicit) else f"the method is {method.name}"

    def _check_device(self, device: Any, threads: int | None) -> None:
        """Check that devices integrate this flow.  Raises InputError."""
        if device != "cuda":
            raise InputError(f"device: expected None or 'cuda', got {brief(device)}")
        if threads is not None:
            raise InputError(
                f"threads: expected None with a device, got {brief(threads)}. Omit it."
            )
        if why := self._only_alone:
            raise InputError(
                f"device: expected a flow by DOP853 or Tsit5 whose runs share a kernel, but {why}. "
                "Omit device, or choose one of these methods"
            )

    def _batches(self, columns: Sequence[Any]) -> tuple[list[Array], int]:
        """Return inputs of many runs, (N or 1, size) each, and N.  Raises ShapeError."""
        if len(columns) != len(self.names):
            raise InputError(self._describe_count(len(columns)))
        batches = [
            vectors(column, size, name)
            for column, size, name in zip(columns, self.sizes, self.names, strict=True)
        ]
        if any(batch.ndim != 2 for batch in batches):
            raise ShapeError("inputs of many runs must have shape (N, size), or (1, size)")
        return batches, _common_count([len(batch) for batch in batches])

    def _inputs_of_many(
        self, batches: Sequence[Array], count: int, *, derivatives: bool
    ) -> tuple[Array, Array, tuple[Array, Array]]:
        """Return states and constants of N inputs, and their derivatives (N or 1, …, inputs)."""
        by_name = dict(zip(self.names, batches, strict=True))
        if self._inputs.are_linear:
            state, constants = self._inputs.linear_columns(by_name, count)
            by_state, by_constants = self._inputs.basis(self._inputs.own)
            return state, constants, (by_state[None], by_constants[None])
        values = [dict(zip(self.names, row, strict=True)) for row in _rows(batches, count)]
        given = [self._inputs.given(named) for named in values]
        state = np.array([columns.state for columns in given])
        constants = np.array([columns.constants for columns in given])
        if not derivatives:
            return state, constants, (state[:0], constants[:0])
        bases = [self._basis(*each) for each in zip(given, values, strict=True)]
        by_state, by_constants = (np.array(parts) for parts in zip(*bases, strict=True))
        return state, constants, (by_state, by_constants)

    def jacobian(self, *columns: Any) -> list[Array]:
        """Compute the derivatives of the output with respect to each input.

        Args:
            *columns: Values of the inputs, in their order, (its size,) each.
        Returns:
            (size, its size) for each input.
        """
        values = self._by_name(columns)
        derivatives = self._jvp(self._run(values), values, np.eye(sum(self.sizes)))
        return np.split(derivatives, self._cuts, axis=1)

    def jvp(self, columns: Sequence[Any], along: Sequence[Any]) -> Array:
        """Compute the derivative of the output along directions of the inputs.

        Args:
            columns: Values of the inputs, (its size,) each.
            along: A direction of each input, (its size,) or (N, its size); eight directions
                are propagated at once, or a single one with limbs in SIMD lanes.
        Returns:
            (size,), or (N, size) for N directions.
        """
        values = self._by_name(columns)
        directions = [
            as_floats(direction, f"the direction of {name}")
            for direction, name in zip(along, self.names, strict=True)
        ]
        is_batch = any(direction.ndim == 2 for direction in directions)
        batches = [
            vectors(np.atleast_2d(direction), size, f"the direction of {name}")
            for direction, size, name in zip(directions, self.sizes, self.names, strict=True)
        ]
        count = _common_count([len(batch) for batch in batches])
        stacked = np.hstack([np.broadcast_to(batch, (count, batch.shape[1])) for batch in batches])
        derivatives = self._jvp(self._run(values), values, stacked.T).T
        return derivatives if is_batch else derivatives[0]

    def vjp(self, columns: Sequence[Any], covector: Any) -> list[Array]:
        """Compute the derivatives of covector · output with respect to each input.

        Args:
            columns: Values of the inputs, (its size,) each.
            covector: Weights of the output's entries, (size,) or (N, size).
        Returns:
            (its size,) for each input, or (N, its size) for N covectors.
        """
        values = self._by_name(columns)
        run = self._run(values, stages=True)
        weights = as_floats(covector, "the covector")
        covectors = vectors(np.atleast_2d(weights), self.size, "the covector")
        derivatives = np.array([self._vjp(run, values, entry) for entry in covectors])
        derivatives = derivatives.reshape(len(covectors), sum(self.sizes))
        return np.split(derivatives if weights.ndim == 2 else derivatives[0], self._cuts, axis=-1)

    def arranged(self, columns: Sequence[Any], named: Mapping[str, Any]) -> list[Any]:
        """Sort inputs into their order; missing inputs get their values in the scene.

        Args:
            columns: Values of the first inputs.
            named: Values of other inputs by name.
        Returns:
            A value for each input.
        Raises:
            InputError: There are too many values, an unknown name, or two values of one input.
        """
        if len(columns) > len(self.names):
            raise InputError(self._describe_count(len(columns)))
        values = [*columns, *self.starts[len(columns) :]]
        for name, value in named.items():
            if name not in self.names:
                raise InputError(
                    f"the flow has no input {brief(name)}; {nearest(name, list(self.names))}"
                    f"its inputs are {listed(list(self.names), 200)}"
                )
            k = self.names.index(name)
            if k < len(columns):
                raise InputError(f"the input '{name}' of a flow is given twice")
            values[k] = value
        return values

    def refuse_shape(self, k: int, shape: tuple[int, ...]) -> None:
        """Raise ShapeError if the shape of input k is not (its size,)."""
        size = self.sizes[k]
        if shape != (size,) and not (size == 1 and shape == ()):
            raise ShapeError(f"{self.names[k]} must have shape ({size},), got {shape}")

    def _describe_count(self, count: int) -> str:
        names = listed(list(self.names), 200)
        return f"the flow has {len(self.names)} inputs, {names}, and {count} were given"

    def _by_name(self, columns: Sequence[Any]) -> dict[str, Array]:
        if len(columns) != len(self.names):
            raise InputError(self._describe_count(len(columns)))
        arrays = [as_floats(column, name) for name, column in zip(self.names, columns, strict=True)]
        for k, array in enumerate(arrays):
            if array.shape[1:] != (1,):  # CasADi passes columns of shape (size, 1).
                self.refuse_shape(k, array.shape)
        return {name: array.reshape(-1) for name, array in zip(self.names, arrays, strict=True)}

    def _split(self, column: Array) -> dict[str, Array]:
        """Split one vector of all inputs into {name: value}."""
        return {name: column[span] for name, span in zip(self.names, self._spans, strict=True)}

    def _output(self, run: Run) -> Array:
        return np.asarray(self._propagator.outputs(run)[:, self._entries].ravel())

    def _basis(self, given: Given, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return derivatives (…, inputs) of the state and constants of a run at these inputs."""
        state, constants = self._inputs.basis(given)
        if not (self._has_balls and "x0" in values):
            return state, constants
        first = self._spans[self.names.index("x0")].start
        by_x = self.flow.system.space.frame_map(values["x0"])
        place = slice(first, first + len(by_x))
        return _with_columns(state, place, by_x), _with_columns(constants, place, by_x)

    def _jvp(self, run: Run, values: Mapping[str, Array], directions: Array) -> Array:
        """Return the derivatives (size, N) of the output along directions (inputs, N)."""
        state, constants = self._basis(run.given, values)
        derivatives = self._propagator.along(
            run, self._rows, state @ directions, constants @ directions
        )
        return np.asarray(derivatives.reshape(self.size, directions.shape[1]))

    def _vjp(self, run: Run, values: Mapping[str, Array], covector: Array) -> Array:
        """Return the derivatives (inputs,) of covector · output."""
        covectors = np.ascontiguousarray(covector).reshape(self._times, -1)
        by_state, by_constants = self._propagator.back(run, self._rows, covectors)
        state, constants = self._basis(run.given, values)
        return np.asarray(by_state @ state + by_constants @ constants)


def _with_columns(matrix: Array, place: slice, change: Array) -> Array:
    """Return a matrix whose columns at `place` are multiplied by another matrix from the right."""
    columns = [matrix[:, : place.start], matrix[:, place] @ change, matrix[:, place.stop :]]
    return np.hstack(columns)


def _rows(batches: Sequence[Array], count: int) -> Iterator[list[Array]]:
    """Yield the inputs of each of N runs from batches (N, size) or (1, size)."""
    for k in range(count):
        yield [batch[k % len(batch)] for batch in batches]


def _common_count(counts: Sequence[int]) -> int:
    """Return the common batch length; length 1 broadcasts.  Raises ShapeError if lengths differ."""
    distinct = {count for count in counts if count != 1}
    if len(distinct) > 1:
        raise ShapeError(f"inputs must have equally many rows, or one, got {sorted(distinct)}")
    return distinct.pop() if distinct else 1


FIRST_ORDER = "flows only have first derivatives, but a second derivative was requested"


class Batched:
    """A flow between vectors with leading axes.

    Attributes:
        columns: The flow between single vectors.
    """

    def __init__(self, columns: Columns) -> None:
        """Wrap a flow between single vectors."""
        self.columns = columns

    def value(self, columns: Sequence[Any]) -> Array:
        """Return the output for each of the inputs, (…, size)."""
        lead = _lead(columns)
        if not lead:
            return self.columns.value(*columns)
        flat = [a.reshape(-1, a.shape[-1]) for a in _wide(columns, lead)]
        return self.columns.values(*flat).reshape(*lead, self.columns.size)

    def along(self, columns: Sequence[Any], directions: Sequence[Any]) -> Array:
        """Return the derivatives along directions of the inputs, (…, size)."""
        lead = _lead([*columns, *directions])
        derivatives = np.zeros((*lead, self.columns.size))
        for place, inputs, seeds in _runs(columns, directions, lead):
            flat = [seed.reshape(-1, seed.shape[-1]) for seed in seeds]
            derivatives[place] = self.columns.jvp(inputs, flat).reshape(derivatives[place].shape)
        return derivatives

    def back(self, columns: Sequence[Any], covector: Any) -> list[Array]:
        """Return the derivatives of covector · output with respect to each input, (…, its size)."""
        lead = _lead([*columns, covector])
        slopes = [np.zeros((*lead, size)) for size in self.columns.sizes]
        for place, inputs, (seed,) in _runs(columns, [covector], lead):
            gradients = self.columns.vjp(inputs, seed.reshape(-1, seed.shape[-1]))
            for result, slope in zip(slopes, gradients, strict=True):
                result[place] = slope.reshape(result[place].shape)
        return slopes


def _lead(arrays: Sequence[Any]) -> tuple[int, ...]:
    return np.broadcast_shapes(*(a.shape[:-1] for a in arrays))


def _wide(arrays: Sequence[Any], lead: tuple[int, ...]) -> list[Any]:
    return [np.broadcast_to(a, (*lead, a.shape[-1])) for a in arrays]


def _runs(
    columns: Sequence[Any], seeds: Sequence[Any], lead: tuple[int, ...]
) -> Iterator[tuple[Any, list[Any], list[Any]]]:
    """Yield the result indices, the inputs, and the directions or covectors of each integration."""
    if 0 in lead:
        return
    shape = _lead(columns)
    shape = (1,) * (len(lead) - len(shape)) + shape
    columns, seeds = _wide(columns, shape), _wide(seeds, lead)
    for index in np.ndindex(shape):
        place = tuple(slice(None) if size == 1 else i for i, size in zip(index, shape, strict=True))
        yield place, [a[index] for a in columns], [a[place] for a in seeds]


_Evaluation: TypeAlias = Callable[[Sequence[Array]], Sequence[Array]]
_Arguments: TypeAlias = Sequence[tuple[str, ca.Sparsity]]


class ArrayCallback(ca.Callback):
    """A CasADi Function that calls a Python function from arrays to arrays."""

    def __init__(
        self, name: str, inputs: _Arguments, outputs: _Arguments, evaluate: _Evaluation
    ) -> None:
        """Build the Function.

        Args:
            name: Name of the Function.
            inputs: Name and sparsity of each input.
            outputs: Name and sparsity of each output.
            evaluate: Function from the inputs to the outputs.
        """
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._evaluate = inputs, outputs, evaluate
        self.construct(name, {})

    def get_n_in(self) -> int:
        """Return the number of inputs."""
        return len(self._inputs)

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return len(self._outputs)

    def get_name_in(self, i: int) -> str:
        """Return the name of input i."""
        return self._inputs[i][0]

    def get_name_out(self, i: int) -> str:
        """Return the name of output i."""
        return self._outputs[i][0]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of input i."""
        return self._inputs[i][1]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """Return the shape of output i."""
        return self._outputs[i][1]

    def eval(self, arguments: Any) -> list[Any]:
        """Compute the outputs."""
        arrays = [np.array(argument) for argument in arguments]
        return [ca.DM(result) for result in self._evaluate(arrays)]


def dense(name: str, rows: int, columns: int = 1) -> tuple[str, ca.Sparsity]:
    """Return the name and the sparsity of a dense argument."""
    return name, ca.Sparsity.dense(rows, columns)


class FlowCallback(ArrayCallback):
    """A flow as a CasADi Function with derivatives of first order.

    Its inputs are the inputs of the flow, as columns with their names; its output is the column
    `y`.  The Function has a Jacobian and forward and reverse derivatives.  Keep the object alive
    as long as expressions use it, because CasADi does not keep it alive.

    Attributes:
        columns: The flow between vectors, with the order of inputs and outputs.
    """

    def __init__(self, columns: Columns, name: str) -> None:
        """Build the Function.

        Args:
            columns: The flow between vectors.
            name: Name of the Function.
        """
        self.columns = columns
        self._derivatives: list[Any] = []  # CasADi does not keep derivatives alive.
        # CasADi rejects dots in names.
        names = [name.replace(".", "_") for name in columns.names]
        inputs = [dense(name, size, 1) for name, size in zip(names, columns.sizes, strict=True)]
        outputs = [dense("y", columns.size, 1)]
        super().__init__(name, inputs, outputs, lambda values: [columns.value(*values)])

    def has_jacobian(self) -> bool:
        """Return True, because `get_jacobian` provides a Jacobian."""
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, _options: Any) -> ca.Function:
        """Return the Jacobian as a Function of the inputs and the output.

        Args:
            name: Name of the Function.
            inames: Names of its inputs.
            onames: Names of its outputs.
        Returns:
            The Jacobian; it takes the output as an argument, but does not read it.
        """
        columns = self.columns

        def evaluate(values: Sequence[Array], _: Sequence[Array]) -> Sequence[Array]:
            return columns.jacobian(*values)

        shapes = [(columns.size, size) for size in columns.sizes]
        return self._derivative(name, inames, onames, [], shapes, evaluate)

    def has_forward(self, _count: int) -> bool:
        """Return True, because `get_forward` provides forward derivatives."""
        return True

    def get_forward(
        self, count: int, name: str, inames: Any, onames: Any, _options: Any
    ) -> ca.Function:
        """Return the derivatives along `count` directions, one in each column.

        Args:
            count: Number of directions.
            name: Name of the Function.
            inames: Names of its inputs.
            onames: Names of its outputs.
        Returns:
            Function of the inputs, the output and the directions.
        """
        columns = self.columns

        def evaluate(values: Sequence[Array], directions: Sequence[Array]) -> Sequence[Array]:
            return [columns.jvp(values, [direction.T for direction in directions]).T]

        directions = [(size, count) for size in columns.sizes]
        shapes = [(columns.size, count)]
        return self._derivative(name, inames, onames, directions, shapes, evaluate)

    def has_reverse(self, _count: int) -> bool:
        """Return True, because `get_reverse` provides reverse derivatives."""
        return True

    def get_reverse(
        self, count: int, name: str, inames: Any, onames: Any, _options: Any
    ) -> ca.Function:
        """Return the derivatives of `count` products covector · output, one in each column.

        Args:
            count: Number of covectors.
            name: Name of the Function.
            inames: Names of its inputs.
            onames: Names of its outputs.
        Returns:
            Function of the inputs, the output and the covectors.
        """
        columns = self.columns

        def evaluate(values: Sequence[Array], covectors: Sequence[Array]) -> Sequence[Array]:
            return [derivative.T for derivative in columns.vjp(values, covectors[0].T)]

        covectors = [(columns.size, count)]
        shapes = [(size, count) for size in columns.sizes]
        return self._derivative(name, inames, onames, covectors, shapes, evaluate)

    def _derivative(
        self,
        name: str,
        inames: Sequence[str],
        onames: Sequence[str],
        seeds: Sequence[tuple[int, int]],
        shapes: Sequence[tuple[int, int]],
        evaluate: Callable[[Sequence[Array], Sequence[Array]], Sequence[Array]],
    ) -> ca.Function:
        """Build a derivative Function and store it, because CasADi does not keep it alive.

        Args:
            name: Name of the Function.
            inames: Names of its inputs.
            onames: Names of its outputs.
            seeds: Shapes of the arguments after the inputs and the output of the flow.
            shapes: Shapes of the results.
            evaluate: Function of the inputs and the seeds.
        Returns:
            Function of the inputs, the output and the seeds.
        """
        count = len(self.columns.sizes)
        sparsities = [
            *(ca.Sparsity.dense(size, 1) for size in self.columns.sizes),
            ca.Sparsity(self.columns.size, 1),  # The output, which no derivative reads.
            *(ca.Sparsity.dense(*shape) for shape in seeds),
        ]
        outputs = [dense(name, *shape) for name, shape in zip(onames, shapes, strict=True)]
        derivative: ca.Function = ArrayCallback(
            name, list(zip(inames, sparsities, strict=True)), outputs,
            lambda arguments: evaluate(arguments[:count], arguments[count + 1 :]),
        )  # fmt: skip
        self._derivatives.append(derivative)
        return derivative
