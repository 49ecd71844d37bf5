"""The compiled flow of a scene or of members: kernel, initial states and parameters.

Usually all entries of the reduced state, the parameters and the centre-of-mass path at the start
are copies: of the initial state, of the initial conditions, and of constants.  For scenes of one
structure, the indices of these copies are therefore computed once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any
from weakref import ref

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import InputError, UnsupportedOperationError
from ...common.machine_code import available_processors
from ...common.memo import once, recent
from ...forces.force_model import ForceModel
from ...forces.force_numbers import BaseInSpace, SpanNumbers
from ...forces.switch_times import time_within
from ...integrators.methods import Method
from ...integrators.stepping.compiling import compiled
from ...kernels.build import build_kernel, tangent_of, wide_rate, with_multipliers
from ...kernels.initial_conditions import (
    InitialConditions,
    InitialConditionsKernel,
    initial_conditions_kernel,
)
from ...kernels.kernel import Kernel, Layout, evaluate, evaluate_row, evaluate_runs, in_given_order
from ...reduction.base_parts import into_body, root_of
from ...reduction.tree.free_bodies import free_numbers
from ...scene.initial_state import GivenStates, finite_start
from ...system.coordinates import Indices
from ...system.state_fields import ShapeState, State
from ...system.system import System, nominal
from ..plan import NO_DIFFERENCES, MemberParameters, Plan
from ..reduced_flow import Sample, entry_name


@dataclass(frozen=True)
class Constants:
    """Numbers of a flow that do not depend on the initial state, (…) or (N, …).

    Attributes:
        gravity: Gravity, as in Plan, (…, 3) [m/s²].
        fall: Acceleration of the centre of mass in free fall, (…, k) [m/s²].
        bodies: Variable body parameters, (…, s).
        numbers: Force parameters, (…, p).
    """

    gravity: Array
    fall: Array
    bodies: Array
    numbers: Array


def assemble(
    layout: Layout, given: GivenStates, start: InitialConditions, constants: Constants, down: Array
) -> tuple[Array, Array, Array]:
    """Return the reduced states, (N, k), the parameters, (N, p), and the paths, (N, 3k).

    Args:
        layout: Layout of states and parameters.
        given: Initial states of N members.
        start: Their reduced initial conditions.
        constants: Further numbers.
        down: Directions of the weight in the body frame, (N, layout.base.down).
    Returns:
        The arrays.
    """
    base, N, k = layout.base, len(given.x), start.c0.shape[1]
    attitude = given.pose[:, k : k + base.attitude]
    y0 = np.concatenate(
        [
            *layout.shape_entries(given.x, start.pi), attitude, down,
            start.about[:, : base.momentum], np.zeros((N, base.push + layout.clock)),
        ],
        axis=1,
    )  # fmt: skip
    path = _fill(np.empty((N, 3 * k)), [start.c0, start.v0, constants.fall])
    parameters = _fill(
        np.empty((N, layout.parameters)),
        [
            start.fixed[:, : base.spin], start.pi[:, layout.constant_pi],
            constants.gravity[..., list(layout.gravity)], constants.bodies,
            path[:, : layout.com_path], constants.numbers,
        ],
    )  # fmt: skip
    return y0, parameters, path


def _fill(rows: Array, columns: list[Array]) -> Array:
    """Concatenate columns (N, …), or (…) if all members share them, into `rows`; return `rows`."""
    first = 0
    for column in columns:
        if width := column.shape[-1]:
            rows[:, first : first + width] = column
            first += width
    return rows


@dataclass(frozen=True, eq=False)
class PreparedStart:
    """The indices of all copies at the start of a flow, for scenes of one structure.

    Attributes:
        kernel: Weak reference to the kernel of the flow.  A structure does not keep kernels beyond
            those that a system keeps.
        constants: Zero, and the numbers that the scenes share, (c,).
        at: Indices of the reduced state (k,), the parameters (p,) and the path (3k,) in (constants,
            initial state, initial conditions).
        ends: Ends of the reduced state and of the parameters in `at`: k and k + p.
    """

    kernel: ref[Kernel]
    constants: Array
    at: Indices
    ends: tuple[int, int]

    def start(self, state: Array, conditions: Array) -> tuple[Array, Array, Array]:
        """Return the reduced state, the parameters and the path at the start.

        Args:
            state: Pose, shape, shape rate and body twist or momentum, one after another.
            conditions: Outputs of the kernel of initial conditions.
        Returns:
            The arrays, (k,), (p,) and (3k,).
        Raises:
            InputError: A number is not finite.
        """
        numbers = np.concatenate([self.constants, state, conditions])[self.at]
        finite_start(numbers)
        k, p = self.ends
        return numbers[:k], numbers[k:p], numbers[p:]


def prepare_start(
    kernel: Kernel, given: GivenStates, conditions: InitialConditionsKernel, constants: Constants
) -> PreparedStart | None:
    """Return the indices of all copies; None if some entries must be computed.

    Args:
        kernel: Kernel of the flow.
        given: An initial state.
        conditions: Kernel of initial conditions.
        constants: Further numbers, each (…).
    Returns:
        The indices.
    """
    layout = kernel.layout
    if layout.base.down or layout.lifted_balls:
        return None
    count = 1  # Index 0 holds the constant zero, for entries that start at zero.

    def indices(array: Array) -> Array:
        nonlocal count
        count += array.shape[-1]
        return np.arange(count - array.shape[-1], count, dtype=float)

    shared = {name: indices(array) for name, array in vars(constants).items()}
    pose, x, xdot, motion = (
        indices(a)[None] for a in (given.pose, given.x, given.xdot, given.motion)
    )
    outputs = conditions.split(np.arange(count, count + conditions.size, dtype=float)[None])
    states, down = GivenStates(pose, x, xdot, motion, None), np.empty((1, 0))
    arrays = assemble(layout, states, outputs, Constants(**shared), down)
    values = np.concatenate([np.zeros(1), *vars(constants).values()])
    entries = np.concatenate(arrays, axis=1)
    if not (np.isin(entries, np.arange(count + conditions.size))).all():
        return None
    ends = arrays[0].shape[1], arrays[0].shape[1] + arrays[1].shape[1]
    prepared = PreparedStart(ref(kernel), values, entries[0].astype(np.intp), ends)
    return prepared if _are_copies(prepared, layout, given, conditions, constants) else None


def _are_copies(
    prepared: PreparedStart,
    layout: Layout,
    given: GivenStates,
    conditions: InitialConditionsKernel,
    constants: Constants,
) -> bool:
    """Return whether all entries are copies, tested with random numbers."""
    rng, down = np.random.default_rng(0), np.empty((1, 0))
    pose, x, xdot, motion = (
        rng.random(a.shape) for a in (given.pose, given.x, given.xdot, given.motion)
    )
    states = GivenStates(pose, x, xdot, motion, None)
    outputs = rng.random((1, conditions.size))
    expected = assemble(layout, states, conditions.split(outputs), constants, down)
    state = [states.pose[0], states.x[0], states.xdot[0], states.motion[0]]
    copies = prepared.start(np.concatenate(state), outputs[0])
    return all(np.array_equal(a[0], b) for a, b in zip(expected, copies, strict=True))


_ROWS_OF_ONE_THREAD = 2**12  # number of members whose set-up is worth another thread
_OUTPUTS_AT_ONCE = 2**15  # Number of outputs per block, few enough to fit into the CPU's cache.
# Number of kernels that a System keeps.  Their machine code occupies two memory maps each.
MOST_KERNELS = 16
MOST_MODES = 128  # Number of kernels of modes with joints at rest, besides the others.


@dataclass(frozen=True, eq=False)
class CompiledFlow:
    """The flow of one scene, or of N members that share one kernel.

    Attributes:
        kernel: Machine code and layout.
        tables: Tables in the forces, of one run or of the members; None without forces.
        y0: Initial reduced states, (k,), or (N, k) for members.
        parameters: Parameters of the vector field, (p,) or (N, p).
        path: Initial position, velocity and free-fall acceleration of the centre of mass,
            (3k,) or (N, 3k) [m, m/s, m/s²].
    """

    kernel: Kernel
    tables: SpanNumbers | None
    y0: Array
    parameters: Array
    path: Array

    @classmethod
    def of_plan(cls, plan: Plan, *, all_momenta: bool = False) -> CompiledFlow:
        """Return the flow of a plan from its initial state.

        Args:
            plan: The plan.
            all_momenta: Whether constant momenta of symmetric balls are integrated, too.
        """
        initial, shared = plan.scene.given, plan.scene.shared
        of_twist = initial.mu is None
        conditions = once(
            shared,
            (InitialConditionsKernel, of_twist),
            lambda: _conditions_kernel(plan, initial, NO_DIFFERENCES),
        )
        state = np.concatenate([initial.pose, initial.x, initial.xdot, initial.motion], axis=1)
        values = np.empty((1, conditions.size))
        evaluate_row(conditions.code.address, conditions.own_numbers[None], state, values)
        zero = not any(values[0, conditions.about].tolist())

        def make() -> PreparedStart | None:
            flow_kernel = kernel_of(plan, zero_momentum=zero, all_momenta=all_momenta)
            constants = _constants(plan, NO_DIFFERENCES, flow_kernel)
            return prepare_start(flow_kernel, initial, conditions, constants)

        key = PreparedStart, type(plan.method), zero, of_twist, all_momenta
        prepared = once(shared, key, make)
        flow_kernel = None if prepared is None else prepared.kernel()
        if flow_kernel is None:
            flow_kernel = kernel_of(plan, zero_momentum=zero, all_momenta=all_momenta)
        if prepared is None:
            start = conditions.split(values)
            return _set_up(plan, initial, start, NO_DIFFERENCES, flow_kernel)[0]
        return cls(flow_kernel, _tables_of(plan), *prepared.start(state[0], values[0]))

    def __getitem__(self, members: object) -> CompiledFlow:
        """Return the flow of the selected member or members."""
        columns = (a[members] for a in (self.y0, self.parameters, self.path))  # type: ignore[call-overload]
        tables = None if self.tables is None else self.tables[members]
        return CompiledFlow(self.kernel, tables, *columns)

    def in_mode(self, plan: Plan) -> CompiledFlow:
        """Return the flow of the same run with other prescribed joints, without a state.

        Args:
            plan: Plan of the run's scene with other prescribed joints.
        Returns:
            The flow. Its base has the same constant momentum and centre-of-mass path.
        """
        zero = self.kernel.structure.zero_momentum
        kernel = kernel_of(plan, zero_momentum=zero, is_mode=True)
        layout, constants = kernel.layout, _constants(plan, NO_DIFFERENCES, kernel)
        columns = [
            self.parameters[: layout.base.spin], np.zeros(len(layout.constant_pi)),
            constants.gravity[list(layout.gravity)], constants.bodies,
            self.path[: layout.com_path], constants.numbers,
        ]  # fmt: skip
        y0 = np.zeros(layout.size)
        return CompiledFlow(kernel, _tables_of(plan), y0, np.concatenate(columns), self.path)

    def resumed(
        self, t: float, x: Array, pi: Array, before: CompiledFlow, y: Array
    ) -> CompiledFlow:
        """Return the flow from a state at any time, with the base of another flow of the run.

        Args:
            t: Time [s].
            x: Shape, (nx,) [rad | m | 1].
            pi: Canonical momenta in the frame of the centre of mass, (m,).
            before: Flow that provides the base.
            y: Its reduced state, (k,).
        Returns:
            The flow.
        """
        layout, other = self.kernel.layout, before.kernel.layout
        base = y[other.base_at : other.base_at + other.base.size]
        y0 = np.concatenate([*layout.shape_entries(x, pi), base, [t] * layout.clock])
        parameters, first = self.parameters.copy(), layout.base.spin
        parameters[first : first + len(layout.constant_pi)] = pi[layout.constant_pi]
        return replace(self, y0=y0, parameters=parameters)

    def canonical_momenta(
        self, t: float, y: Array, parameters: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return the shape, its rate, and its canonical momenta, from a reduced state (k,)."""
        parameters = self.parameters if parameters is None else parameters
        layout, where = self.kernel.layout, self.kernel.where
        y = y[: layout.size]
        outputs = self.kernel.evaluate_outputs(t, y, parameters, self.path)
        pi = np.empty(self.kernel.system.m)
        pi[list(layout.active)] = y[layout.pairs : layout.pairs + len(layout.active)]
        pi[layout.ball_pi] = y[layout.balls_at : layout.balls_at + len(layout.ball_pi)]
        first = layout.base.spin
        pi[layout.constant_pi] = parameters[first : first + len(layout.constant_pi)]
        pi[list(layout.prescribed)] = outputs[where.driven_pi]
        return np.array(outputs[where.fields["x"]]), np.array(outputs[where.xdot]), pi

    @property
    def system(self) -> System:
        """The system."""
        return self.kernel.system

    @property
    def forces(self) -> ForceModel | None:
        """Forces besides gravity; None if there are none."""
        return self.kernel.forces

    @property
    def position_entries(self) -> dict[int, int]:
        """Entry of the reduced state for each hinge or slide that moves, by index of its rate."""
        layout = self.kernel.layout
        entries = {v: k for k, v in enumerate(layout.active)}
        return entries | {v: 2 * layout.pairs + k for k, v in enumerate(layout.cyclic)}

    @property
    def numbers_at(self) -> slice:
        """Indices of the force parameters among `parameters`."""
        layout = self.kernel.layout
        return slice(layout.parameters - layout.numbers, layout.parameters)

    @property
    def clock(self) -> slice:
        """Index of the integrated time in a reduced state; empty if the time is not integrated."""
        layout = self.kernel.layout
        return slice(layout.size - layout.clock, layout.size)

    @property
    def numbers(self) -> Array:
        """Force parameters: a view of the last entries of `parameters`."""
        return self.parameters[..., self.numbers_at]

    def parameters_between(self, start: float | Array, stop: float | Array) -> Array:
        """Return a copy of the parameters for the table segments between two stops.

        For members, the stops may have an entry for each member, (N,).
        """
        parameters = self.parameters.copy()
        self._set_span(parameters, time_within(start, stop))
        return parameters

    def parameters_within(self, within: Array) -> Array:
        """Return a row of parameters for each time `within` a span (S,), (S, p)."""
        parameters = np.repeat(self.parameters[None], len(within), axis=0)
        self._set_span(parameters, within)
        return read_only(parameters)

    def _set_span(self, parameters: Array, within: float | Array) -> None:
        """Write the numbers that change from span to span; `within` is a time in each span [s]."""
        forces = self.kernel.forces
        if forces is None or self.tables is None or forces.within.start == forces.within.stop:
            return
        numbers = parameters[..., self.numbers_at]
        numbers[..., forces.within] = self.tables.at(within)

    def sample(self, t: float, y: Array, parameters: Array | None = None) -> Sample:
        """Return the state at time t that forces depend on; see `states`."""
        parameters = self.parameters if parameters is None else parameters
        return self._sample(self.kernel.evaluate_outputs(t, y, parameters, self.path))

    def samples(self, t: Array, y: Array, parameters: Array) -> Sample:
        """Return the states at times (T,) that forces depend on, from reduced states (T, k)."""
        return self._sample(self.outputs(t, y, parameters))

    def _sample(self, outputs: Array) -> Sample:
        """Extract the state that forces depend on from outputs of the kernel, (…, size)."""
        where = self.kernel.where
        weight, base = outputs[..., where.weight], None
        if not weight.shape[-1]:
            weight = np.zeros((*outputs.shape[:-1], 3))
        if self.kernel.layout.base_requested:
            fields = ("pose", "xi", "body_momentum", "spatial_momentum")
            base = BaseInSpace(*(outputs[..., where.fields[name]] for name in fields))
        x, xdot = outputs[..., where.fields["x"]], outputs[..., where.xdot]
        return Sample(x, xdot, outputs[..., where.xi], outputs[..., where.mu], weight, base)

    def outputs(self, t: Array, y: Array, parameters: Array | None = None) -> Array:
        """Return the kernel's outputs, (T, ·), at times (T,) and reduced states (T, k)."""
        kernel, layout = self.kernel, self.kernel.layout
        parameters = self.parameters if parameters is None else parameters
        inputs = y[:, : layout.size]
        if not layout.clock:
            inputs = np.concatenate([inputs, t[:, None]], axis=1)
        constants = np.concatenate([parameters, self.path])
        return evaluate(kernel.outputs.address, constants, inputs, kernel.where.size)

    def states(self, t: Array, y: Array, parameters: Array | None = None) -> State | ShapeState:
        """Compute full states from reduced states.

        Args:
            t: Times, (T,) [s].
            y: Reduced states, (T, k).
            parameters: Parameters at these times, (p,); the initial parameters if None.
        Returns:
            The states, without the base if the scene leaves it out.
        """
        system, where = self.kernel.system, self.kernel.where
        outputs = self.outputs(t, y, parameters)
        state_class = State if self.kernel.layout.base_requested else ShapeState
        fields = {
            name: in_given_order(name, outputs[..., entries], system)
            for name, entries in where.fields.items()
        }
        return state_class(t=t.copy(), **fields)

    def fill_states(
        self,
        t: Array,
        y: Array,
        members: Indices,
        fields: Mapping[str, Array],
        device: str | None = None,
    ) -> None:
        """Compute the states of N members at common times, on the CPU with the bits of `states`.

        Args:
            t: Times, (T,) [s].
            y: Reduced states, (N, T, k).
            members: Row of each member in `fields`, (N,).
            fields: Fields of State except the time, (M, T, …), of which the members' rows are
                filled.
            device: "cuda" for CUDA devices, None for the CPU. The CPU also computes what devices
                have no functions for.
        """
        if device is not None and fields:
            from ...kernels.device.device_code import fill_fields_on_device

            constants = np.concatenate([self.parameters, self.path], axis=1)
            with suppress(UnsupportedOperationError):
                fill_fields_on_device(self.kernel, constants, y, t, members, fields)
                return
        kernel, (N, T, _) = self.kernel, y.shape
        layout, where = kernel.layout, kernel.where
        times = t[:0] if layout.clock else t
        count = max(1, _OUTPUTS_AT_ONCE // (T * where.size))
        values = np.empty((min(count, N), T, where.size))
        for first in range(0, N, count):
            chunk = slice(first, min(first + count, N))
            outputs = values[: chunk.stop - first]
            constants = np.concatenate([self.parameters[chunk], self.path[chunk]], axis=1)
            evaluate_runs(kernel.outputs.address, constants, y[chunk], times, layout.size, outputs)
            for name, field in fields.items():
                entries = outputs[..., where.fields[name]]
                field[members[chunk]] = in_given_order(name, entries, kernel.system)

    def rates(self, t: Array, y: Array, parameters: Array) -> Array:  # noqa: ARG002
        """Return dy/dt, (T, k), at reduced states (T, k), which contain the time if needed."""
        return evaluate(self.kernel.rate.address, parameters, y, y.shape[1])

    def address(self, method: Method) -> int:
        """Return the address of the vector field with as many lanes as a method evaluates."""
        return rate_address(self.kernel, method)

    def tangent(self) -> int:
        """Return the address of the derivative of the vector field, compiled at first use."""
        return tangent_of(self.kernel).address

    def shape(self, t: float, y: Array, parameters: Array) -> Array:
        """Return the shape (nx,) of a reduced state (k,) at time t [s]."""
        outputs = self.kernel.evaluate_outputs(t, y, parameters, self.path)
        return np.asarray(outputs[self.kernel.where.fields["x"]])

    def entry_name(self, entry: int) -> str:
        """Return the name of an entry of the reduced state, for messages."""
        layout = self.kernel.layout
        return entry_name(
            self.kernel.system,
            layout.active,
            layout.cyclic,
            entry,
            layout.constant_pi,
            layout.prescribed,
        )


def rate_address(kernel: Kernel, method: Method) -> int:
    """Return the address of a kernel's vector field with as many lanes as a method evaluates."""
    lanes = method.lanes
    return (kernel.rate if lanes == 1 else wide_rate(kernel, lanes)).address


def kernel_of(
    plan: Plan,
    *,
    zero_momentum: bool,
    generic: bool = False,
    all_momenta: bool = False,
    is_mode: bool = False,
) -> Kernel:
    """Return the kernel of a plan, built once while it is among the most recent of its System.

    Args:
        plan: The plan.
        zero_momentum: Whether the initial angular momentum of the base is exactly zero.
        generic: Whether the variable parameters of the robot may take any value.
        all_momenta: Whether constant momenta of symmetric balls are integrated, too.
        is_mode: Whether joints rest at stops.  A motion may have more such modes than MOST_KERNELS,
            and its members or repetitions share them.
    Returns:
        The kernel; plans of the same structure and force expressions share it.
    Raises:
        InputError: The scene has joint stops, whose modes have kernels of their own.
    """
    if plan.scene.bounds:  # Runs with stops build kernels of their modes, whose scenes have none.
        raise InputError(
            "stops: only simulate, simulate_many, sweep, compare, flow and floquet take stops. "
            "Omit them here, or call one of these"
        )
    structure = plan.structure(
        zero_momentum=zero_momentum, generic=generic, all_momenta=all_momenta
    )
    system, forces = plan.system, plan.forces
    # Texts have cached hashes, unlike structures.
    key = once(structure, Kernel, lambda: repr((structure, None if forces is None else forces.key)))
    # Parameters are inputs of a kernel, so robots that differ only in parameters share it.
    owner = nominal(system)
    kept = (MOST_MODES, (Kernel, "modes")) if is_mode else (MOST_KERNELS, Kernel)
    kernel = recent(owner, key, lambda: build_kernel(system, structure, forces), *kept)
    if plan.method.multipliers and system.closure is not None:
        return once(kernel, with_multipliers, lambda: with_multipliers(kernel))
    return kernel


def flows_of(
    plan: Plan,
    given: GivenStates,
    own: MemberParameters = NO_DIFFERENCES,
    threads: int | None = 1,
) -> list[tuple[Indices, CompiledFlow]]:
    """Return separate flows for the members with and without angular momentum.

    Args:
        plan: The plan of all members.
        given: Initial states of the members, (N, …).
        own: Parameters in which the members differ from the plan.
        threads: Number of threads, which changes no bit; as many as processors if None.
    Returns:
        (sorted indices of members, their flow) for each of the two cases that has members.
    """
    conditions = _conditions_kernel(plan, given, own)
    states = np.concatenate([given.pose, given.x, given.xdot, given.motion], axis=1)
    values = np.empty((len(states), conditions.size))

    def evaluate_part(part: slice) -> None:
        numbers = None if own.robot is None else own.robot[part]
        conditions.evaluate(states[part], numbers, values[part])

    _in_parts(len(states), threads, evaluate_part)
    zeros = ~values[:, conditions.about].any(axis=1) & (not plan.momentum_changes)
    flows = []
    for zero in (False, True):
        indices = np.flatnonzero(zeros == zero)
        if indices.size:
            rows: Any = slice(None) if indices.size == len(states) else indices
            columns = given[rows], states[rows], values[rows], own[rows]
            kernel = kernel_of(plan, zero_momentum=zero, generic=own.robot is not None)
            flows.append((indices, _members_flow(plan, columns, conditions, kernel, threads)))
    return flows


def _members_flow(
    plan: Plan,
    columns: tuple[GivenStates, Array, Array, MemberParameters],
    conditions: InitialConditionsKernel,
    kernel: Kernel,
    threads: int | None,
) -> CompiledFlow:
    """Return the flow of N members, all with or all without angular momentum.

    Args:
        plan: The plan of all members.
        columns: Initial states, also in one array, (N, s), outputs of the initial conditions,
            (N, o), and parameters in which the members differ from the plan.
        conditions: Kernel of the initial conditions.
        kernel: Kernel of the members.
        threads: Number of threads; as many as processors if None.
    """
    given, states, values, own = columns
    constants, count = _constants(plan, own, kernel), len(states)
    of_first = Constants(*(a[0] if a.ndim == 2 else a for a in vars(constants).values()))
    prepared = prepare_start(kernel, given[:1], conditions, of_first)
    if prepared is None:
        return _set_up(plan, given, conditions.split(values), own, kernel)
    tables = _tables_of(plan) if own.tables is None else own.tables
    shared = prepared.constants[None]
    if any(a.ndim == 2 for a in vars(constants).values()):
        numbers = (np.zeros(1), *vars(constants).values())
        shared = np.concatenate([np.broadcast_to(a, (count, a.shape[-1])) for a in numbers], 1)
    k, p = prepared.ends
    arrays = [np.empty((count, size)) for size in (k, p - k, len(prepared.at) - p)]
    at, finite = prepared.at.astype(np.int64), list[bool]()

    def copy_part(part: slice) -> None:
        own_numbers = shared if len(shared) == 1 else shared[part]
        source = np.empty(shared.shape[1] + states.shape[1] + values.shape[1])
        y0, parameters, path = (a[part] for a in arrays)
        finite.append(
            _copy_starts(own_numbers, states[part], values[part], at, source, y0, parameters, path)
        )

    _in_parts(count, threads, copy_part)
    if not all(finite):
        finite_start(*arrays)
    return CompiledFlow(kernel, tables, *arrays)


@compiled
def _copy_starts(
    constants: Array,
    states: Array,
    values: Array,
    at: Indices,
    source: Array,
    y0: Array,
    parameters: Array,
    path: Array,
) -> bool:
    """Write reduced states, parameters and paths of members.

    Args:
        constants: As in PreparedStart, (N, c) or (1, c).
        states: Initial states, (N, s).
        values: Outputs of the initial conditions, (N, o).
        at: Indices of the entries of y0, parameters and path in a row of all these columns.
        source: Work space for such a row, (c + s + o,).
        y0: Reduced states, output.
        parameters: Parameters, output.
        path: Paths, output.
    Returns:
        Whether all numbers are finite.
    """
    c, s, total = constants.shape[1], states.shape[1], 0.0
    k, p = y0.shape[1], parameters.shape[1]
    for i in range(states.shape[0]):
        for j in range(c):
            source[j] = constants[i % constants.shape[0], j]
        for j in range(s):
            source[c + j] = states[i, j]
        for j in range(values.shape[1]):
            source[c + s + j] = values[i, j]
        for j in range(k):
            y0[i, j] = source[at[j]]
        for j in range(p):
            parameters[i, j] = source[at[k + j]]
        for j in range(path.shape[1]):
            path[i, j] = source[at[k + p + j]]
        for j in range(at.shape[0]):
            total += source[at[j]] - source[at[j]]  # NaN for infinities and NaN, else zero
    return total == 0.0


def _in_parts(count: int, threads: int | None, act: Callable[[slice], None]) -> None:
    """Call a function with parts of `count` rows, each in a thread of its own."""
    most = available_processors() if threads is None else threads
    size = max(_ROWS_OF_ONE_THREAD, -(-count // most))
    parts = [slice(first, min(first + size, count)) for first in range(0, count, size)]
    if len(parts) == 1:
        act(parts[0])
        return
    with ThreadPoolExecutor(len(parts)) as pool:
        list(pool.map(act, parts))


def has_no_momentum(plan: Plan) -> bool:
    """Return whether the angular momentum of a plan is zero and stays zero."""
    start = _initial_conditions(plan, plan.scene.given, NO_DIFFERENCES)
    return not plan.momentum_changes and not start.about.any()


def _initial_conditions(plan: Plan, given: GivenStates, own: MemberParameters) -> InitialConditions:
    kernel = _conditions_kernel(plan, given, own)
    return kernel(given.pose, given.x, given.xdot, given.motion, own.robot)


def _conditions_kernel(
    plan: Plan, given: GivenStates, own: MemberParameters
) -> InitialConditionsKernel:
    variables = plan.freed(generic=own.robot is not None)
    return initial_conditions_kernel(plan.system, "xi" if given.mu is None else "mu", variables)


def _set_up(
    plan: Plan, given: GivenStates, start: InitialConditions, own: MemberParameters, kernel: Kernel
) -> CompiledFlow:
    """Return the flow of N members, all with or all without angular momentum."""
    constants = _constants(plan, own, kernel)
    down = np.empty((len(given.x), 0))
    if kernel.layout.base.down:
        down = _down(plan, given.pose[:, plan.system.group.linear :], own)
    arrays = assemble(kernel.layout, given, start, constants, down)
    finite_start(*arrays)
    tables = _tables_of(plan) if own.tables is None else own.tables
    return CompiledFlow(kernel, tables, *arrays)


def _tables_of(plan: Plan) -> SpanNumbers | None:
    return None if plan.forces is None else plan.forces.tables


def _constants(plan: Plan, own: MemberParameters, kernel: Kernel) -> Constants:
    """Return the numbers of a flow that do not depend on the initial state."""
    if plan.method.steady_momentum and kernel.layout.base.momentum:
        raise InputError(
            f"{plan.method.name} needs a constant angular momentum, but gravity or a wrench "
            "changes it. Use another method, such as Gauss."
        )
    gravity, fall = own.gravity, own.fall
    if gravity is None or fall is None:
        gravity, fall = plan.gravity, root_of(plan.system).g
    variables = kernel.layout.freed
    bodies = free_numbers(plan.system, variables) if own.robot is None else own.robot
    numbers = plan.numbers if own.numbers is None else own.numbers
    return Constants(gravity, fall, bodies, numbers)


def _down(plan: Plan, attitude: Array, own: MemberParameters) -> Array:
    """Return the directions (N, 3), in the body frame, of the weight of pivoted bases."""
    weight = plan.weight
    if own.gravity is None:
        return into_body(attitude, weight / np.linalg.norm(weight))
    units = own.gravity / np.linalg.norm(own.gravity, axis=1)[:, None]
    directions = [into_body(q[None], unit) for q, unit in zip(attitude, units, strict=True)]
    return np.concatenate(directions)
