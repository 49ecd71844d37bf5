"""The compiled flow of a scene: kernel, parameters, and the full state behind a reduced one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...common.errors import InputError
from ...forces.acting import BaseInSpace
from ...integrators.methods import Method
from ...kernels.evaluate import evaluate
from ...kernels.initial_conditions import InitialConditions, initial_conditions_kernel
from ...kernels.kernel import Kernel
from ...kernels.tangent import tangent_of
from ...kernels.wide_rate import wide_rate
from ...reduction.base_parts import into_body, root_of
from ...reduction.tree.free_bodies import free_numbers
from ...scene.initial_state import GivenStates, finite_start
from ...system.coordinates import Indices
from ...system.state_fields import ShapeState, State
from ..entry_name import entry_name
from ..own_numbers import OwnNumbers
from ..plan import Plan
from ..sample import Sample
from .kernel_of_plan import kernel_of

_AT_ONCE = 512  # members that are set up together


class CompiledFlow:
    """The flow of a scene for the compiled integrators.

    kernel: machine code and layout.  y0: (k,) reduced state at the start.  parameters:
    (p,) what the kernel reads besides.  numbers: those of them that are in the forces; the
    torques that controllers hold are set in it as time goes on.
    """

    def __init__(self, plan: Plan) -> None:
        """Set up the flow from the plan's own initial state."""
        self._take(CompiledFlows(plan, plan.scene.given), 0)

    @classmethod
    def of(cls, flows: CompiledFlows, member: int) -> CompiledFlow:
        """Return one of many flows."""
        flow = cls.__new__(cls)
        flow._take(flows, member)
        return flow

    @classmethod
    def made(cls, kernel: Kernel, y0: Array, parameters: Array, line: Array) -> CompiledFlow:
        """Return the flow of a kernel from a reduced state (k,); see CompiledFlows."""
        flow = cls.__new__(cls)
        flow._keep(kernel, y0, parameters, line)
        return flow

    def _take(self, flows: CompiledFlows, member: int) -> None:
        row = (flows.y0[member], flows.parameters[member], flows.line[member])
        self._keep(flows.kernel, *row)

    def _keep(self, kernel: Kernel, y0: Array, parameters: Array, line: Array) -> None:
        self._system, self.kernel = kernel.system, kernel
        self.y0, self.parameters, self._line = y0, parameters, line
        layout = self.kernel.layout
        self.numbers = self.parameters[layout.parameters - layout.numbers :]

    def sample(self, t: float, y: Array, numbers: Array) -> Sample:
        """Return what forces see at one time."""
        where, parameters = self.kernel.where, self._with(numbers)
        out = self.kernel.evaluate_outputs(t, y, parameters, self._line)
        weight = out[where.weight] if where.weight.stop > where.weight.start else np.zeros(3)
        base = None
        if self.kernel.layout.base_requested:
            fields = ("pose", "xi", "body_momentum", "spatial_momentum")
            base = BaseInSpace(*(out[where.fields[name]] for name in fields))
        x, xdot = out[where.fields["x"]], out[where.xdot]
        return Sample(x, xdot, out[where.xi], out[where.mu], weight, base)

    def states(self, t: Array, y: Array, numbers: Array) -> State | ShapeState:
        """Return the full states at times t (T,) of reduced states y (T, k).

        numbers: (p,) those in the forces then.
        """
        kernel, where = self.kernel, self.kernel.where
        parameters = np.concatenate([self._with(numbers), self._line])
        rows = y[:, : kernel.layout.size]
        if not kernel.layout.clock:
            rows = np.concatenate([rows, t[:, None]], axis=1)
        out = evaluate(kernel.outputs.address, parameters, rows, where.size)
        kind = State if kernel.layout.base_requested else ShapeState
        fields = {name: where.read_field(name, out, self._system) for name in where.fields}
        return kind(t=t.copy(), **fields)

    def rates(self, t: Array, y: Array, numbers: Array) -> Array:  # noqa: ARG002
        """Return dy/dt (T, k) of reduced states y (T, k), which hold the time where it counts."""
        return evaluate(self.kernel.rate.address, self._with(numbers), y, y.shape[1])

    def address(self, method: Method) -> int:
        """Address of the vector field, in the form in which a method takes it."""
        return rate_address(self.kernel, method)

    def tangent(self) -> int:
        """Address of the derivative of the vector field, made when first asked for."""
        return tangent_of(self.kernel).address

    def shape(self, t: float, y: Array) -> Array:
        """Return the shape (m,) in a reduced state."""
        out = self.kernel.evaluate_outputs(t, y, self.parameters, self._line)
        return np.asarray(out[self.kernel.where.fields["x"]])

    def entry_name(self, entry: int) -> str:
        """Return what an entry of the reduced state is, for messages."""
        layout = self.kernel.layout
        return entry_name(self._system, list(layout.active), list(layout.cyclic), entry)

    def _with(self, numbers: Array) -> Array:
        """Return the parameters with these numbers in the forces."""
        return np.concatenate([self.parameters[: len(self.parameters) - len(numbers)], numbers])


class CompiledFlows:
    """Flows of one plan from many initial states, all with or all without momentum.

    kernel: of all of them.  y0: (N, k).  parameters: (N, p).  line: (N, 3k) where their
    centres of mass begin, how fast, and how they fall.
    """

    kernel: Kernel
    y0: Array
    parameters: Array
    line: Array

    def __init__(self, plan: Plan, given: GivenStates) -> None:
        """Set up the flows.  given: (N, …)."""
        start = _started(plan, given, None)
        self._begin(plan, given, start, zero=not start.about.any())

    @classmethod
    def several(
        cls,
        plan: Plan,
        given: GivenStates,
        members: Indices,
        own: OwnNumbers | None = None,
        *,
        zero: bool,
    ) -> CompiledFlows:
        """Set up the flows of some members, a few at a time: memory beside them stays small."""
        parts = [members[k : k + _AT_ONCE] for k in range(0, len(members), _AT_ONCE)]
        flows = cls.__new__(cls)
        for n, part in enumerate(parts):
            some = given[part]
            new = cls.__new__(cls)
            theirs = None if own is None else own[part]
            new._begin(plan, some, _started(plan, some, theirs), theirs, zero=zero)
            if n == 0:
                flows.kernel = new.kernel
                for name in ("y0", "parameters", "line"):
                    columns = getattr(new, name).shape[1]
                    setattr(flows, name, np.empty((len(members), columns)))
            rows = slice(n * _AT_ONCE, n * _AT_ONCE + len(part))
            for name in ("y0", "parameters", "line"):
                getattr(flows, name)[rows] = getattr(new, name)
        return flows

    @classmethod
    def made(cls, kernel: Kernel, y0: Array, parameters: Array, line: Array) -> CompiledFlows:
        """Return the flows of a kernel from reduced states (N, k)."""
        flows = cls.__new__(cls)
        flows.kernel, flows.y0, flows.parameters, flows.line = kernel, y0, parameters, line
        return flows

    def _begin(
        self,
        plan: Plan,
        given: GivenStates,
        start: InitialConditions,
        own: OwnNumbers | None = None,
        *,
        zero: bool,
    ) -> None:
        x, N = given.x, len(given.x)
        any_robot = own is not None and own.robot is not None
        self.kernel = kernel_of(plan, zero_momentum=zero, generic=any_robot)
        layout = self.kernel.layout
        parts = layout.base
        if plan.method.steady_momentum and parts.momentum:
            raise InputError(
                f"{plan.method.name} needs a constant angular momentum, and here gravity or a "
                "wrench changes it; Gauss and the others take that"
            )
        active, cyclic = list(layout.active), list(layout.cyclic)
        attitude = given.pose[:, plan.system.group.linear :]
        pieces = [x[:, active], start.pi[:, active], x[:, cyclic], attitude[:, : parts.attitude]]
        if parts.down:
            pieces.append(_down(plan, attitude, own))
        pieces += [start.about[:, : parts.momentum], np.zeros((N, parts.push + layout.clock))]
        self.y0 = np.concatenate(pieces, axis=1)
        spin, before = parts.spin, parts.spin + len(cyclic)
        self.parameters = np.empty((N, layout.parameters))
        self.parameters[:, :spin] = start.fixed[:, :spin]
        self.parameters[:, spin:before] = start.pi[:, cyclic]
        after = before + len(layout.gravity)
        self.parameters[:, before:after] = plan.acting.gravity[list(layout.gravity)]
        bodies: Array | None = None if own is None else own.robot
        if bodies is None:
            bodies = free_numbers(plan.system, layout.freed)
        self.parameters[:, after : after + layout.freed.size] = bodies
        after += layout.freed.size
        k = plan.system.group.linear
        self.line = np.empty((N, 3 * k))
        self.line[:, :k], self.line[:, k : 2 * k] = start.c0, start.v0
        self.line[:, 2 * k :] = root_of(plan.system).g
        numbers = plan.numbers
        if own is not None:
            if own.gravity is not None and own.fall is not None:
                self.parameters[:, before : before + len(layout.gravity)] = own.gravity[
                    :, list(layout.gravity)
                ]
                self.line[:, 2 * k :] = own.fall
            if own.numbers is not None:
                numbers = own.numbers
        self.parameters[:, after : after + layout.com_path] = self.line[:, : layout.com_path]
        self.parameters[:, after + layout.com_path :] = numbers
        finite_start(self.y0, self.parameters, self.line)


def rate_address(kernel: Kernel, method: Method) -> int:
    """Return the address of a kernel's vector field, in the form in which a method takes it."""
    lanes = method.lanes
    return (kernel.rate if lanes == 1 else wide_rate(kernel, lanes)).address


def _down(plan: Plan, attitude: Array, own: OwnNumbers | None) -> Array:
    """Return the directions (N, 3) of a weight that turns a pivoted base, in the body's frame."""
    weight = plan.acting.weight
    if own is None or own.gravity is None:
        return into_body(attitude, weight / np.linalg.norm(weight))
    units = own.gravity / np.linalg.norm(own.gravity, axis=1)[:, None]
    rows = [into_body(q[None], unit) for q, unit in zip(attitude, units, strict=True)]
    return np.concatenate(rows)


def flows_of(
    plan: Plan, given: GivenStates, own: OwnNumbers | None = None
) -> list[tuple[Indices, CompiledFlows]]:
    """Return the flows of many initial states (N, …): of members with momentum, and without.

    Each with the indices of the members, sorted.  own: numbers that the members have for
    themselves.
    """
    still = without_momentum(plan, given, own)
    groups = [(np.flatnonzero(~still), False), (np.flatnonzero(still), True)]
    return [
        (members, CompiledFlows.several(plan, given, members, own, zero=zero))
        for members, zero in groups
        if members.size
    ]


def without_momentum(
    plan: Plan, given: GivenStates, own: OwnNumbers | None = None
) -> NDArray[np.bool_]:
    """Return which initial states (N, …) have no angular momentum, nor will ever have any."""
    still = np.full(len(given.x), not plan.acting.momentum_changes)
    for k in range(0, len(still) if still.any() else 0, _AT_ONCE):
        some = slice(k, k + _AT_ONCE)
        theirs = None if own is None else own[some]
        still[some] = ~_started(plan, given[some], theirs).about.any(axis=1)
    return still


def _started(plan: Plan, given: GivenStates, own: OwnNumbers | None) -> InitialConditions:
    robot = None if own is None else own.robot
    freed = plan.freed(generic=robot is not None)
    kernel = initial_conditions_kernel(plan.system, "xi" if given.mu is None else "mu", freed)
    return kernel(given.pose, given.x, given.xdot, given.motion, robot)
