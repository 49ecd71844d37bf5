"""Numbers of forces: symbols for kernels, robot parameters, segments of tables, and evaluation.

Kernels take these symbols as inputs, so they need not be compiled again when the values change.
Robot parameters are needed because a wrench on a link depends on link frames, and inverse dynamics
depends on all inertias and on gravity.

A kernel sees one segment of each table, as numbers that change from span to span.  It does not
depend on the number of entries of a table, and tables of one kind share it.

At given numbers, CasADi Functions are evaluated in fixed arrays, which takes less time than their
usual calls.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from threading import local
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array, FrozenArrays, read_only
from ..common.errors import InputError
from ..common.parameter import Affine, Parameter, by_name
from ..reduction.potential import acting_gravity
from ..reduction.tree.body_frames import Body, bodies_of
from ..reduction.tree.free_bodies import (
    LINK,
    NOTHING,
    Freed,
    free_numbers,
    link_numbers,
    of_bodies,
    total_mass,
    with_free,
)
from ..reduction.tree.scalars import Scalar, Vec
from ..system.coordinates import Indices
from ..system.system import System
from .signals.signal import Table

_NEAR = 1e-2  # relative variation of numbers in formulas when kernels are tested
_AT_ONCE = 256  # number of evaluations that share a run


class SpanNumbers(ABC):
    """The numbers that change from span to span, of one run or of several runs.

    Attributes:
        size: Number of these numbers; the first one is the time `within` the span.
    """

    size: int

    @abstractmethod
    def at(self, within: Any, run: Indices | None = None) -> Array:
        """Return the numbers in spans.

        Args:
            within: A time in each span, (…) [s].
            run: Index of the run of each span, (…); None for one run, or for times whose first
                axis is that of all runs.
        Returns:
            The numbers, (…, size).
        """

    @abstractmethod
    def kinds(self, count: int) -> Indices:
        """Return a number for each of `count` runs, equal for runs with the same tables, (N,)."""

    @abstractmethod
    def __getitem__(self, runs: Any) -> SpanNumbers:
        """Return the numbers of the selected run or runs."""


class Tables(SpanNumbers):
    """The tables of one force model.

    Attributes:
        signals: The tables.
        starts: Index of the start of each table's segment among the numbers, (tables,).
        breaks: Sorted times at which a segment ends and the next begins, (B,) [s].
    """

    def __init__(self, signals: Sequence[Table] = ()) -> None:
        """Collect the segments; tables with equal times are looked up together."""
        self.signals = tuple(signals)
        widths = [table.width for table in signals]
        self.size = 1 + sum(widths)
        firsts = np.cumsum([1, *widths])
        groups: dict[bytes, list[int]] = {}
        for k, table in enumerate(signals):
            groups.setdefault(table.starts.tobytes(), []).append(k)
        self.starts = firsts[:-1]
        self._groups: list[tuple[Array, Indices | slice, Array]] = []
        for members in groups.values():
            columns = np.concatenate([np.arange(firsts[k], firsts[k + 1]) for k in members])
            rows = np.concatenate([signals[k].segments() for k in members], axis=1)
            where = slice(1, self.size) if len(groups) == 1 else columns
            self._groups.append((signals[members[0]].starts, where, rows))
        starts = [starts[1:] for starts, _, _ in self._groups]
        self.breaks = read_only(np.unique(np.concatenate(starts)) if starts else np.empty(0))

    def at(self, within: Any, run: Indices | None = None) -> Array:  # noqa: ARG002
        """Return the numbers in spans, (…, size); see SpanNumbers."""
        times = np.asarray(within, dtype=float)
        numbers = np.empty((*times.shape, self.size))
        numbers[..., 0] = times
        for starts, columns, rows in self._groups:
            # Before its first time, a table is extrapolated from its first segment.
            segment = np.maximum(np.searchsorted(starts, times, side="right") - 1, 0)
            numbers[..., columns] = rows[segment]
        return numbers

    def kinds(self, count: int) -> Indices:
        """Return zero for each of `count` runs, (N,)."""
        return np.zeros(count, dtype=np.intp)

    def __getitem__(self, runs: Any) -> Tables:
        return self

    @cached_property
    def digest(self) -> bytes:
        """Digest of all tables, equal for tables with equal segments."""
        digest = hashlib.sha256()
        for starts, columns, rows in self._groups:
            digest.update(repr((starts.shape, rows.shape)).encode())
            for array in (starts, np.arange(self.size)[columns], rows):
                digest.update(array.tobytes())
        return digest.digest()


class TablesOfRuns(SpanNumbers):
    """The tables of N runs of one kernel."""

    def __init__(self, tables: Sequence[Tables], which: Indices) -> None:
        """Store the tables.

        Args:
            tables: Distinct tables, each of the same size.
            which: Index of the tables of each run, (N,).
        """
        self._tables, self._which, self.size = tables, which, tables[0].size

    def at(self, within: Any, run: Indices | None = None) -> Array:
        """Return the numbers in spans, (…, size); see SpanNumbers."""
        times = np.asarray(within, dtype=float)
        if run is None:
            times = np.broadcast_to(times, (len(self._which), *times.shape[1:]))
            which = self._which
        else:
            which = self._which[run]
        numbers = np.empty((*times.shape, self.size))
        order = np.argsort(which, kind="stable")
        ends = np.searchsorted(which[order], np.arange(len(self._tables) + 1))
        for tables, first, last in zip(self._tables, ends[:-1], ends[1:], strict=True):
            rows = order[first:last]
            numbers[rows] = tables.at(times[rows])
        return numbers

    def kinds(self, count: int) -> Indices:  # noqa: ARG002
        """Return the index of the tables of each run, (N,)."""
        return self._which

    def __getitem__(self, runs: Any) -> SpanNumbers:
        which = self._which[runs]
        return self._tables[which] if np.ndim(which) == 0 else TablesOfRuns(self._tables, which)


def tables_of_runs(tables: Sequence[Tables]) -> SpanNumbers:
    """Return the tables of several runs, one Tables object each."""
    distinct = {id(table): table for table in tables}
    if len(distinct) == 1:
        return tables[0]
    index = {key: k for k, key in enumerate(distinct)}
    which = np.array([index[id(table)] for table in tables])
    return TablesOfRuns(tuple(distinct.values()), which)


class ForceNumbers:
    """Collection of all numbers in forces and signals, with their symbols and values.

    Attributes:
        symbols: One symbol per number, in the order of creation.
        in_formulas: Indices of the numbers that belong to formulas or tables.
    """

    def __init__(self, tables: Tables | None = None) -> None:
        """Create a collection with the numbers of tables that change from span to span, if any."""
        self.symbols: list[ca.SX] = []
        self._values: list[float] = []
        self._segments: dict[Table, list[ca.SX]] = {}
        if tables is not None:
            self._values += tables.at(0.0).tolist()
            self.symbols += [ca.SX.sym(f"p{slot}") for slot in range(tables.size)]
            first = 1
            for table in tables.signals:
                self._segments[table] = self.symbols[first : first + table.width]
                first += table.width
        self._slopes: list[tuple[int, Parameter, float]] = []
        self._slot_of: dict[Parameter, int] = {}
        self.in_formulas: list[int] = []

    def __len__(self) -> int:
        return len(self._values)

    def symbol(self, value: Any) -> Any:
        """Return the symbol of a number, a Parameter, or an Affine function of Parameters.

        For a table, the symbols of its segment are returned; the table itself if it is unknown.
        """
        if isinstance(value, Table):
            return self._segments.get(value, value)
        slot = len(self._values)
        if isinstance(value, Parameter):
            if value not in self._slot_of:
                self._slot_of[value] = slot
                self._slopes.append((slot, value, 1.0))
                self._values.append(value.value)
                self.symbols.append(value.symbol)
            return self.symbols[self._slot_of[value]]
        if isinstance(value, Affine):
            self.in_formulas.append(slot)
            self._slopes += [
                (slot, parameter, weight) for parameter, weight in value.weights.items()
            ]
            value = value.value
        self._values.append(value)
        self.symbols.append(ca.SX.sym(f"p{slot}"))
        return self.symbols[-1]

    def add(self, symbol: ca.SX, value: float) -> None:
        """Append a number that already has a symbol."""
        self.symbols.append(symbol)
        self._values.append(value)

    @property
    def values(self) -> Array:
        """Values of the numbers, (p,)."""
        return read_only(np.array(self._values))

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the Parameters among the numbers.

        Raises:
            InputError: Two Parameters have the same name.
        """
        parameters = list(dict.fromkeys(parameter for _, parameter, _ in self._slopes))
        names = [parameter.name for parameter in parameters]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise InputError(
                f"two Parameters have the name '{twice[0]}'; create one and use it in both "
                "places, or give them different names"
            )
        by_name(parameters)  # Refuses names that collide with those of vectors.
        return tuple(parameters)

    def slopes(self, parameters: tuple[Parameter, ...]) -> Array:
        """Return ∂numbers/∂parameters, (p, parameters), which is constant."""
        slopes = np.zeros((len(self), len(parameters)))
        for slot, parameter, slope in self._slopes:
            slopes[slot, parameters.index(parameter)] = slope
        return slopes


def random_numbers(values: Array, in_formulas: list[int], rng: np.random.Generator) -> Array:
    """Return random numbers of the size of given ones, for tests of kernels.

    Numbers in formulas stay near their values.  Numbers that are zero get the size one.

    Args:
        values: Values of the numbers, (p,).
        in_formulas: Indices of the numbers that belong to formulas or tables.
        rng: Random generator.
    Returns:
        Numbers, (p,).
    """
    numbers = rng.normal(size=len(values))
    sizes = np.where(values == 0.0, 1.0, np.abs(values))
    near = values[in_formulas] * (1.0 + _NEAR * numbers[in_formulas])
    numbers *= sizes
    numbers[in_formulas] = near
    return numbers


class RobotSymbols:
    """The robot with symbols for gravity and for the parameters that may vary.

    Attributes:
        freed: Parameters with symbols, including the frames of links used so far.
        weighed: Whether any expression uses gravity so far.
    """

    def __init__(
        self, system: System, freed: Freed = NOTHING, movable: Collection[int] = ()
    ) -> None:
        """Create the symbols.

        Args:
            system: The robot.
            freed: Parameters of bodies that may vary.
            movable: Frames of links whose placements may vary.
        """
        self._system, self.freed, self._movable = system, freed, movable
        self._symbols = [ca.SX.sym(f"Y{k}") for k in range(freed.size)]
        self._gravity = [ca.SX.sym(f"g{axis}") for axis in "xyz"]
        self.weighed = False

    @cached_property
    def bodies(self) -> list[Body]:
        """The bodies, in the frames of the articulated sweep."""
        return with_free(bodies_of(self._system), replace(self.freed, links=()), self._symbols)

    @property
    def gravity(self) -> Vec:
        """Gravity that acts on the shape, in the root joint's fixed frame, (3,) [m/s²]."""
        self.weighed = True
        return list(self._gravity)

    @property
    def mass(self) -> Scalar:
        """Total mass of the bodies [kg]."""
        return total_mass(self.bodies) if self.freed.inertias else self._system.mass

    def place(self, frame: int) -> tuple[list[Vec], Vec]:
        """Return a link's axes as rows, and its origin, both in the frame of its body.

        Args:
            frame: Index of the link's frame.
        Returns:
            Three axes (3,), and the origin (3,) [m].
        """
        model_frame = self._system.sorted_model.frames[frame]
        numbers: list[Scalar]
        if frame not in self._movable:
            body = self.bodies[model_frame.parentJoint - 1]
            numbers = link_numbers(body, model_frame.placement).tolist()
        else:
            if frame not in self.freed.links:
                self.freed = replace(self.freed, links=(*self.freed.links, frame))
                self._symbols += [ca.SX.sym(f"link{frame}_{k}") for k in range(LINK)]
            numbers = self._symbols[self.freed.of_link(frame)]
        return [numbers[3 * k : 3 * k + 3] for k in range(3)], numbers[9:]

    @property
    def column(self) -> ca.SX:
        """All symbols, (freed.size + 3,): those of `freed`, then gravity."""
        return ca.vertcat(*self._symbols, *self._gravity)


def numbers_of(system: System, freed: Freed, *, weighed: bool) -> Array:
    """Return the values of a system's parameters in the order of `RobotSymbols.column`.

    Gravity is zero unless it is used.

    Args:
        system: The robot.
        freed: Parameters with symbols.
        weighed: Whether gravity is used.
    Returns:
        Values, (freed.size + 3,).
    Raises:
        SymmetryError: Gravity is used and breaks the symmetry.
    """
    gravity = acting_gravity(system) if weighed else np.zeros(3)
    return read_only(np.concatenate([free_numbers(system, freed), gravity]))


def numbers_in(
    bodies: Sequence[Body], system: System, freed: Freed, links: Mapping[int, Sequence[Scalar]]
) -> list[Scalar]:
    """Return the parameters `freed` of given bodies, as numbers or symbols.

    Args:
        bodies: The bodies.
        system: The robot.
        freed: Parameters with symbols.
        links: Frames of links that vary, by index; all other link frames are taken from the system.
    Returns:
        Values, (freed.size,).
    """
    values, frames = of_bodies(bodies, freed), system.sorted_model.frames
    for frame in freed.links:
        link_values = links.get(frame)
        if link_values is None:
            body = bodies[frames[frame].parentJoint - 1]
            link_values = link_numbers(body, frames[frame].placement).tolist()
        values += link_values
    return values


@dataclass(frozen=True)
class BaseInSpace:
    """Pose, twist and momenta of the base in space, i.e. relative to the root joint's fixed frame.

    See SeenState for their definitions.

    Attributes:
        pose: Pose, (size,).
        xi: Body twist, (r,).
        mu: Body momentum, (r,).
        J: Spatial momentum, (r,).
    """

    pose: Array
    xi: Array
    mu: Array
    J: Array


@dataclass(frozen=True)
class ForceInputs:
    """The state that forces depend on, and the numbers in the forces: see Symbols.

    At T times, t has the shape (T,), and all others have a leading axis of length T.

    Attributes:
        t: Time [s].
        x: Shape, (m,).
        xdot: Shape rate, (m,).
        xi: Body twist relative to the centre of mass, (r,).
        mu: Body momentum about the centre of mass, (r,).
        numbers: Values of the numbers in the forces (see ForceModel.numbers), (p,).
        base: The base in space; required if forces depend on its pose or motion.
    """

    t: float | Array
    x: Array
    xdot: Array
    xi: Array
    mu: Array
    numbers: Array
    base: BaseInSpace | None = None


@dataclass(frozen=True)
class Acting:
    """The sum of all forces at one state, or at T states with a leading axis.

    Attributes:
        torque: Torques on the joints, −∂V/∂x included, (m,).
        wrench: Wrench on the base, (r,).
    """

    torque: Array
    wrench: Array


@dataclass(frozen=True)
class Prescribed(FrozenArrays):
    """Motion of k prescribed joints at one time, or at T times with a leading axis.

    Attributes:
        x: Positions, (k,).
        xdot: Rates, (k,).
        xddot: Accelerations, (k,).
    """

    x: Array
    xdot: Array
    xddot: Array


class FunctionBuffers:
    """Arrays that a CasADi Function of dense inputs and outputs reads and writes in place.

    Attributes:
        inputs: One array of numbers for each input, column by column.
        outputs: One array (rows, columns) for each output, which each run overwrites.
    """

    def __init__(self, function: ca.Function, shared: Mapping[int, Array] | None = None) -> None:
        """Allocate the arrays.

        Args:
            function: The Function.
            shared: Arrays to use for inputs by index, such as outputs of another Function.
        """
        f, values = function, shared or {}
        buffer: Any
        buffer, self._run = f.buffer()
        self._kept = function, buffer  # `_run` holds only pointers to them
        self.inputs = [values.get(k, np.zeros(f.nnz_in(k))) for k in range(f.n_in())]
        self.outputs = [np.zeros(f.size_out(k), order="F") for k in range(f.n_out())]
        for set_view, arrays in ((buffer.set_arg, self.inputs), (buffer.set_res, self.outputs)):
            for k, array in enumerate(arrays):
                if array.size:
                    entries: Any = array.ravel(order="K")  # a view
                    set_view(k, memoryview(entries))

    def run(self) -> None:
        """Evaluate the outputs."""
        self._run()


class Numeric:
    """A CasADi Function of dense inputs and outputs, callable from any thread."""

    def __init__(self, function: ca.Function) -> None:
        """Store the Function; work arrays are allocated at the first call of each thread."""
        self._function = function
        self._local = local()

    def __call__(self, *arguments: Array | float) -> list[Array]:
        """Evaluate the Function; return a new array (rows, columns) for each output."""
        work = self._local
        if not hasattr(work, "buffers"):
            work.buffers = FunctionBuffers(self._function)
        buffers: FunctionBuffers = work.buffers
        for array, argument in zip(buffers.inputs, arguments, strict=True):
            array[:] = argument
        buffers.run()
        return [array.copy() for array in buffers.outputs]

    def at_all(self, *arguments: Array) -> list[Array]:
        """Evaluate the Function at T arguments.

        Args:
            arguments: An array (T, rows) for each input, or (rows,) if all T share it.
        Returns:
            A new array (T, rows, columns) for each output.
        """
        count, f = max(len(a) for a in arguments if a.ndim == 2), self._function
        at_once = min(count, _AT_ONCE)
        buffers = FunctionBuffers(f.map(at_once))
        sizes = [f.size_out(k) for k in range(f.n_out())]
        outputs = [np.empty((count, columns, rows)) for rows, columns in sizes]
        for first in range(0, count, at_once):
            chunk = slice(first, min(first + at_once, count))
            for array, argument in zip(buffers.inputs, arguments, strict=True):
                rows = array.reshape(at_once, argument.shape[-1])
                rows[: chunk.stop - first] = argument[chunk] if argument.ndim == 2 else argument
            buffers.run()
            for output, column in zip(outputs, buffers.outputs, strict=True):
                results = column.T.reshape(at_once, *output.shape[1:])
                output[chunk] = results[: chunk.stop - first]
        return [output.swapaxes(1, 2) for output in outputs]
