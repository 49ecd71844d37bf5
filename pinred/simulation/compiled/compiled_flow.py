"""The compiled flow of a scene or of members: kernel, initial states and parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import InputError
from ...common.memo import once, recent
from ...forces.force_values import BaseInSpace
from ...forces.switch_times import time_within
from ...integrators.methods import Method
from ...kernels.build import build_kernel
from ...kernels.derived_code import tangent_of, wide_rate
from ...kernels.evaluate import evaluate
from ...kernels.initial_conditions import InitialConditions, initial_conditions_kernel
from ...kernels.kernel import Kernel
from ...reduction.base_parts import into_body, root_of
from ...reduction.tree.free_bodies import free_numbers
from ...scene.initial_state import GivenStates, finite_start
from ...system.coordinates import Indices
from ...system.state_fields import ShapeState, State
from ...system.variants import nominal
from ..plan import NO_DIFFERENCES, MemberParameters, Plan
from ..reduced_flow import entry_name
from ..sample import Sample

# Number of members that are set up together, limited to bound the memory.
_AT_ONCE = 512
# Number of kernels that a System keeps.  Their machine code occupies two memory maps each.
MOST_KERNELS = 16


@dataclass(frozen=True, eq=False)
class CompiledFlow:
    """The flow of one scene, or of N members that share one kernel.

    Attributes:
        kernel: Machine code and layout.
        y0: Initial reduced states, (k,), or (N, k) for members.
        parameters: Parameters of the vector field, (p,) or (N, p).
        path: Initial position, velocity and free-fall acceleration of the centre of mass,
            (3k,) or (N, 3k) [m, m/s, m/s²].
    """

    kernel: Kernel
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
        states = plan.scene.given
        start = _initial_conditions(plan, states, NO_DIFFERENCES)
        zero = not start.about.any()
        kernel = kernel_of(plan, zero_momentum=zero, all_momenta=all_momenta)
        return _set_up(plan, states, start, NO_DIFFERENCES, kernel)[0]

    def __getitem__(self, members: object) -> CompiledFlow:
        """Return the flow of the selected member or members."""
        columns = (a[members] for a in (self.y0, self.parameters, self.path))  # type: ignore[call-overload]
        return CompiledFlow(self.kernel, *columns)

    @property
    def numbers_at(self) -> slice:
        """Indices of the force parameters among `parameters`."""
        layout = self.kernel.layout
        return slice(layout.parameters - layout.numbers, layout.parameters)

    @property
    def numbers(self) -> Array:
        """Force parameters: a view of the last entries of `parameters`."""
        return self.parameters[..., self.numbers_at]

    def parameters_between(self, start: float | Array, stop: float | Array) -> Array:
        """Return a copy of the parameters for the table segments between two stops.

        For members, the stops may have a row for each member, (N, 1).
        """
        parameters, forces = self.parameters.copy(), self.kernel.forces
        if forces is not None:
            numbers = parameters[..., self.numbers_at]
            numbers[..., forces.within] = time_within(start, stop)
        return parameters

    def parameters_within(self, within: Array) -> Array:
        """Return a row of parameters for each time `within` a span (S,), (S, p)."""
        rows, forces = np.repeat(self.parameters[None], len(within), axis=0), self.kernel.forces
        if forces is not None:
            numbers = rows[:, self.numbers_at]
            numbers[:, forces.within] = within[:, None]
        return read_only(rows)

    def sample(self, t: float, y: Array, parameters: Array | None = None) -> Sample:
        """Return the state at time t that forces depend on; see `states`."""
        parameters = self.parameters if parameters is None else parameters
        where = self.kernel.where
        outputs = self.kernel.evaluate_outputs(t, y, parameters, self.path)
        weight = outputs[where.weight] if where.weight.stop > where.weight.start else np.zeros(3)
        base = None
        if self.kernel.layout.base_requested:
            fields = ("pose", "xi", "body_momentum", "spatial_momentum")
            base = BaseInSpace(*(outputs[where.fields[name]] for name in fields))
        x, xdot = outputs[where.fields["x"]], outputs[where.xdot]
        return Sample(x, xdot, outputs[where.xi], outputs[where.mu], weight, base)

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
        fields = {name: where.read_field(name, outputs, system) for name in where.fields}
        return state_class(t=t.copy(), **fields)

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
    plan: Plan, *, zero_momentum: bool, generic: bool = False, all_momenta: bool = False
) -> Kernel:
    """Return the kernel of a plan, built once while it is among the most recent of its System.

    Args:
        plan: The plan.
        zero_momentum: Whether the initial angular momentum of the base is exactly zero.
        generic: Whether the variable parameters of the robot may take any value.
        all_momenta: Whether constant momenta of symmetric balls are integrated, too.
    Returns:
        The kernel; plans of the same structure and force expressions share it.
    """
    kind = plan.kind(zero_momentum=zero_momentum, generic=generic, all_momenta=all_momenta)
    system, structure, forces = kind.system, kind.structure, kind.forces
    # Texts have cached hashes, unlike structures.
    key = once(kind, Kernel, lambda: repr((structure, None if forces is None else forces.key)))
    # Parameters are inputs of a kernel, so robots that differ only in parameters share it.
    owner = nominal(system)
    return recent(owner, key, lambda: build_kernel(system, structure, forces), MOST_KERNELS, Kernel)


def flows_of(
    plan: Plan, given: GivenStates, own: MemberParameters = NO_DIFFERENCES
) -> list[tuple[Indices, CompiledFlow]]:
    """Return separate flows for the members with and without angular momentum.

    Args:
        plan: The plan of all members.
        given: Initial states of the members, (N, …).
        own: Parameters in which the members differ from the plan.
    Returns:
        (sorted indices of members, their flow) for each of the two cases that has members.
    """
    members: dict[bool, list[Indices]] = {False: [], True: []}
    flows: dict[bool, list[CompiledFlow]] = {False: [], True: []}
    for first in range(0, len(given.x), _AT_ONCE):
        chunk = slice(first, first + _AT_ONCE)
        start = _initial_conditions(plan, given[chunk], own[chunk])
        zeros = ~start.about.any(axis=1) & (not plan.acting.momentum_changes)
        for zero in (False, True):
            indices = np.flatnonzero(zeros == zero)
            if indices.size:
                conditions = InitialConditions(*(rows[indices] for rows in vars(start).values()))
                states, parameters = given[chunk][indices], own[chunk][indices]
                members[zero].append(first + indices)
                kernel = kernel_of(plan, zero_momentum=zero, generic=parameters.robot is not None)
                flows[zero].append(_set_up(plan, states, conditions, parameters, kernel))
    return [
        (np.concatenate(members[zero]), _stacked(chunks))
        for zero, chunks in flows.items()
        if chunks
    ]


def has_no_momentum(plan: Plan) -> bool:
    """Return whether the angular momentum of a plan is zero and stays zero."""
    start = _initial_conditions(plan, plan.scene.given, NO_DIFFERENCES)
    return not plan.acting.momentum_changes and not start.about.any()


def _stacked(flows: list[CompiledFlow]) -> CompiledFlow:
    """Merge several flows into one flow with all their members."""
    if len(flows) == 1:
        return flows[0]
    columns = zip(*((flow.y0, flow.parameters, flow.path) for flow in flows), strict=True)
    return CompiledFlow(flows[0].kernel, *map(np.concatenate, columns))


def _initial_conditions(plan: Plan, given: GivenStates, own: MemberParameters) -> InitialConditions:
    freed = plan.freed(generic=own.robot is not None)
    kernel = initial_conditions_kernel(plan.system, "xi" if given.mu is None else "mu", freed)
    return kernel(given.pose, given.x, given.xdot, given.motion, own.robot)


def _set_up(
    plan: Plan, given: GivenStates, start: InitialConditions, own: MemberParameters, kernel: Kernel
) -> CompiledFlow:
    """Return the flow of N members, all with or all without angular momentum."""
    x, N, system = given.x, len(given.x), plan.system
    layout, base = kernel.layout, kernel.layout.base
    if plan.method.steady_momentum and base.momentum:
        raise InputError(
            f"{plan.method.name} needs a constant angular momentum, but gravity or a wrench "
            "changes it. Use another method, such as Gauss."
        )
    attitude = given.pose[:, system.group.linear :]
    state = [*layout.shape_entries(x, start.pi), attitude[:, : base.attitude]]
    if base.down:
        state.append(_down(plan, attitude, own))
    state += [start.about[:, : base.momentum], np.zeros((N, base.push + layout.clock))]
    gravity, fall = own.gravity, own.fall
    if gravity is None or fall is None:
        gravity, fall = plan.acting.gravity, root_of(system).g
    bodies = free_numbers(system, layout.freed) if own.robot is None else own.robot
    numbers = plan.numbers if own.numbers is None else own.numbers
    path = _fill(np.empty((N, 3 * system.group.linear)), [start.c0, start.v0, fall])
    parameters = _fill(
        np.empty((N, layout.parameters)),
        [
            start.fixed[:, : base.spin], start.pi[:, layout.constant_pi],
            gravity[..., list(layout.gravity)], bodies, path[:, : layout.com_path], numbers,
        ],
    )  # fmt: skip
    y0 = np.concatenate(state, axis=1)
    finite_start(y0, parameters, path)
    return CompiledFlow(kernel, y0, parameters, path)


def _fill(rows: Array, columns: list[Array]) -> Array:
    """Concatenate columns (N, …), or (…) if all members share them, into `rows`; return `rows`."""
    first = 0
    for column in columns:
        if width := column.shape[-1]:
            rows[:, first : first + width] = column
            first += width
    return rows


def _down(plan: Plan, attitude: Array, own: MemberParameters) -> Array:
    """Return the directions (N, 3), in the body frame, of the weight of pivoted bases."""
    weight = plan.acting.weight
    if own.gravity is None:
        return into_body(attitude, weight / np.linalg.norm(weight))
    units = own.gravity / np.linalg.norm(own.gravity, axis=1)[:, None]
    directions = [into_body(q[None], unit) for q, unit in zip(attitude, units, strict=True)]
    return np.concatenate(directions)
