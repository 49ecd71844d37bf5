"""A flow between plain columns of numbers, as other people's languages want it.

Inputs are columns in the order of the flow's `inputs`; the output is one column.  A pose in it has
its own coordinates, not those of its tangent, so that values and derivatives belong together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...common.arrays import Array, as_floats, vectors
from ...common.errors import InputError, ShapeError
from ...common.names import nearest
from ...common.plain_names import brief, listed
from ...kernels.flow_functions import Row, sizes_of
from .propagator import Run

_FEW = 32  # runs that one thread has done before others have begun


class Columns:
    """A flow as a function of columns.

    names, sizes: of its inputs.  starts: their values in the scene.  size: of the output, of all
    times one after another.  outputs: the places of State's fields in that of one time.
    """

    def __init__(self, flow: Any) -> None:
        """Take a Flow.  Raises InputError for inputs that are no vectors."""
        if "pose0" in flow.inputs:
            raise InputError(
                "pose0 is a point of a group, and no vector of which this could be a function; "
                "make the flow without it among wrt"
            )
        if not flow.inputs:
            raise InputError("the flow has no inputs with derivatives; name some as wrt=")
        self.flow = flow
        self.names, self.sizes = tuple(flow.inputs), tuple(flow.inputs.values())
        self.starts = [flow.own(name) for name in self.names]
        self.outputs, at = {}, 0
        self._rows: tuple[Row, ...] = tuple(
            "pose_numbers" if name == "pose" else name for name in flow.outputs
        )
        sizes = sizes_of(flow.system)
        for name, row in zip(flow.outputs, self._rows, strict=True):
            self.outputs[name] = slice(at, at + sizes[row])
            at += sizes[row]
        self._times = len(flow.t) if flow.over_times else 1
        self.size = at * self._times
        self._propagator, self._inputs = flow.propagator, flow.input_map
        self._cuts = np.cumsum(self.sizes)[:-1]
        ends = np.cumsum(self.sizes).tolist()
        self._spans = [slice(end - size, end) for end, size in zip(ends, self.sizes, strict=True)]
        self._picks = self._propagator.entries(self.outputs)

    def value(self, *columns: Any) -> Array:
        """Return the output, (size,)."""
        return self._output(self.flow.run(self._named(columns)))

    def value_of(self, column: Array) -> Array:
        """Return the output of all inputs one after another, (size,)."""
        return self._output(self.flow.run(self._cut(column)))

    def along_of(self, column: Array, direction: Array) -> Array:
        """Return the derivative (size,) along a direction of all inputs one after another."""
        return self._along(self.flow.run(self._cut(column)), direction[:, None])[:, 0]

    def back_of(self, column: Array, covector: Array) -> Array:
        """Return the derivatives of covector · output by all inputs one after another."""
        return self._back(self.flow.run(self._cut(column), stages=True), covector)

    def values(self, *columns: Any, threads: int | None = None) -> Array:
        """Return the outputs (N, size) of N inputs at once: (N, size) columns, or (1, size).

        They run in lanes where the method has them, and are those of `value` within round-off
        times the stretch of the flow.  threads: as many as processors if None.
        Raises IntegrationError for the first that fails.
        """
        rows = [
            vectors(column, size, name)
            for column, size, name in zip(columns, self.sizes, self.names, strict=True)
        ]
        if any(row.ndim != 2 for row in rows):
            raise ShapeError("inputs of many runs must have shape (N, size), or (1, size)")
        count = _common([len(row) for row in rows])
        if not count:
            return np.zeros((0, self.size))
        if count == 1:
            return self.value(*(row[0] for row in rows))[None]
        given = [
            self._inputs.given(
                {name: row[k % len(row)] for name, row in zip(self.names, rows, strict=True)}
            )
            for k in range(count)
        ]
        state, constants = (
            np.array([getattr(each, part) for each in given]) for part in ("state", "constants")
        )
        threads = 1 if threads is None and count <= _FEW else threads
        return self._taken(self._propagator.outputs_of_many(state, constants, threads))

    def jacobian(self, *columns: Any) -> list[Array]:
        """Return the derivatives of the output by each input, (size, its size)."""
        run = self.flow.run(self._named(columns))
        found = self._along(run, np.eye(sum(self.sizes)))
        return np.split(found, self._cuts, axis=1)

    def jvp(self, columns: Sequence[Any], along: Sequence[Any]) -> Array:
        """Return the derivative of the output along directions of the inputs, (size,).

        Of directions (N, …), eight of which run at once, they are (N, size).
        """
        run = self.flow.run(self._named(columns))
        directions = [
            as_floats(each, f"the direction of {name}")
            for each, name in zip(along, self.names, strict=True)
        ]
        many = any(each.ndim == 2 for each in directions)
        parts = [
            vectors(np.atleast_2d(each), size, f"the direction of {name}")
            for each, size, name in zip(directions, self.sizes, self.names, strict=True)
        ]
        count = _common([len(part) for part in parts])
        whole = np.hstack([np.broadcast_to(part, (count, part.shape[1])) for part in parts])
        found = self._along(run, whole.T).T
        return found if many else found[0]

    def vjp(self, columns: Sequence[Any], covector: Any) -> list[Array]:
        """Return the derivatives of covector · output by each input, (its size,).

        Of covectors (N, size) they are (N, its size).
        """
        run = self.flow.run(self._named(columns), stages=True)
        given = as_floats(covector, "the covector")
        covectors = vectors(np.atleast_2d(given), self.size, "the covector")
        found = np.array([self._back(run, each) for each in covectors])
        found = found.reshape(len(covectors), sum(self.sizes))
        return np.split(found if given.ndim == 2 else found[0], self._cuts, axis=-1)

    def arranged(self, columns: Sequence[Any], named: Mapping[str, Any]) -> list[Any]:
        """Return columns in the order of the inputs; what is not given stays the scene's.

        Raises InputError for more of them, and for names that there are not.
        """
        if len(columns) > len(self.names):
            raise InputError(
                f"the flow has {len(self.names)} inputs, {listed(list(self.names), 200)}, and "
                f"{len(columns)} were given"
            )
        out = [*columns, *self.starts[len(columns) :]]
        for name, value in named.items():
            if name not in self.names:
                raise InputError(
                    f"the flow has no input {brief(name)}; {nearest(name, list(self.names))}"
                    f"its inputs are {listed(list(self.names), 200)}"
                )
            k = self.names.index(name)
            if k < len(columns):
                raise InputError(f"the input '{name}' of a flow is given twice")
            out[k] = value
        return out

    def refuse_shape(self, k: int, shape: tuple[int, ...]) -> None:
        """Raise ShapeError for an input of another shape than (its size,)."""
        size = self.sizes[k]
        if shape != (size,) and not (size == 1 and shape == ()):
            raise ShapeError(f"{self.names[k]} must have shape ({size},), got {shape}")

    def _named(self, columns: Sequence[Any]) -> dict[str, Array]:
        if len(columns) != len(self.names):
            self.arranged(columns, {})
            raise InputError(
                f"the flow has {len(self.names)} inputs, {listed(list(self.names), 200)}, and "
                f"{len(columns)} were given"
            )
        arrays = [as_floats(column, name) for name, column in zip(self.names, columns, strict=True)]
        for k, array in enumerate(arrays):
            if array.shape[1:] != (1,):  # a column of CasADi
                self.refuse_shape(k, array.shape)
        return {name: array.reshape(-1) for name, array in zip(self.names, arrays, strict=True)}

    def _taken(self, outputs: Array) -> Array:
        """Return the output (N, size) of the outputs (N, T, ·) of kernels."""
        return np.ascontiguousarray(outputs[..., self._picks].reshape(len(outputs), -1))

    def _output(self, run: Run) -> Array:
        return np.asarray(self._propagator.outputs(run)[:, self._picks].ravel())

    def _cut(self, column: Array) -> dict[str, Array]:
        """Return the inputs in a column by name."""
        return {name: column[span] for name, span in zip(self.names, self._spans, strict=True)}

    def _along(self, run: Run, directions: Array) -> Array:
        """Return the derivatives (size, N) of the output along directions (inputs, N)."""
        state, constants = self._inputs.basis(run.given)
        found = self._propagator.along(run, self._rows, state @ directions, constants @ directions)
        return np.asarray(found.reshape(self.size, directions.shape[1]))

    def _back(self, run: Run, covector: Array) -> Array:
        """Return the slopes (inputs,) of covector · output."""
        whole = np.ascontiguousarray(covector).reshape(self._times, -1)
        by_state, by_constants = self._propagator.back(run, self._rows, whole)
        state, constants = self._inputs.basis(run.given)
        return np.asarray(by_state @ state + by_constants @ constants)


def _common(counts: Sequence[int]) -> int:
    """Return how many there are if each has so many or one.  Raises ShapeError."""
    others = {count for count in counts if count != 1}
    if len(others) > 1:
        raise ShapeError(f"inputs must have equally many rows, or one, got {sorted(others)}")
    return others.pop() if others else 1
