"""Jumps of derivatives: at stops whose times depend on Parameters, and at impacts of joints.

If a condition on time changes at t*, the state after t* depends on t* itself: with the rates f⁻
before and f⁺ after the stop, δy jumps by (f⁻ − f⁺) δt*. The derivative of t* follows from the
argument g of the condition, δt* = −g_p δp / g_t.

At impacts, rests and releases of joints at their stops, the mode of a motion changes, and modes
have different reduced states. Their common variables are
z = (x, π, base, constant momenta, t), of which the state of each mode contains a part. At an event
at time t*, with the derivatives δy⁻ at fixed time before it:

1. The time changes by δt* = (δb − δx_i) / ẋ_i⁻, so the state at the event changes by δy⁻ + f⁻ δt*.
2. Momenta of joints at rest follow from ẋ_R(z⁻) = 0.
3. Impulses λ change z⁻ to z⁺ = z⁻ + Eλ. They follow from ẋ_k(z⁺) + e_k ẋ_k(z⁻) = 0, with 0 in
   place of e_k for joints that come to rest.
4. The state of the next mode at fixed time changes by its part of δz⁺, minus f⁺ δt*.

The rates ẋ = ∂h/∂π are affine in π, so that ∂ẋ_k/∂π_j is an entry of M⁻¹, and step 3 contains the
derivative of M⁻¹. Together, the steps are the saltation matrix. At a release the rates of the state
do not jump, so steps 1 and 4 cancel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ...integrators.integrate import Solution
from ...integrators.stepping.run_state import unit_alone
from ...kernels.flow_functions import outcome_of, reference_size
from ...kernels.kernel import Kernel, Layout, evaluate
from ...scene.stop import Bound
from ...system.coordinates import Indices
from ...system.system import System
from ..compiled.compiled_flow import CompiledFlow
from ..plan import Plan, Span

_SAME = 1e-9  # derivatives of switch times with a smaller relative difference are equal


@dataclass(frozen=True)
class Jump:
    """The jump of derivatives at a stop whose time depends on force parameters.

    Attributes:
        time: Time of the stop [s].
        change: Rate of the state before the stop minus the rate after it, (n,).
        slopes: Derivative of the time with respect to the force parameters, (C, p): one row for
            each of the conditions that change at this time.
    """

    time: float
    change: Array
    slopes: Array

    def delay(self, numbers: Array) -> Array:
        """Return derivatives of the time along directions (p, N) of the force parameters, (N,).

        Raises:
            InputError: The time has no derivative.
        """
        delays = self.slopes @ numbers
        scale = np.abs(self.slopes) @ np.abs(numbers)
        same = np.abs(delays - delays[0]) <= _SAME * scale.max(axis=0)
        if not (np.isfinite(delays).all() and same.all()):
            raise InputError(
                f"a flow has no derivative where several conditions on time change at once with "
                f"different derivatives, or where one only touches its threshold, as here at "
                f"t = {self.time:g} s; move one of them"
            )
        return np.asarray(delays[0])

    def only_slopes(self) -> Array:
        """Return the derivative of the time by the force parameters, (p,).  Raises InputError."""
        return self.delay(np.eye(self.slopes.shape[1]))


def jumps_of(
    kernel: Kernel, plan: Plan, numbers: Array, spans: Sequence[Span], solutions: Sequence[Solution]
) -> dict[int, Jump]:
    """Return the jumps of derivatives in a run.

    Args:
        kernel: Kernel of the run.
        plan: Plan of the scene.
        numbers: Force parameters of the run, (p,).
        spans: Time spans between the stops of the run.
        solutions: Solution over each span.
    Returns:
        The jumps by the index of the span that begins with them.
    """
    if not plan.stops_vary or len(spans) < 2 or plan.forces is None:
        return {}
    slopes = plan.forces.switching.slopes(np.array([span.stop for span in spans]), numbers)
    jumps = {}
    for k in range(len(spans) - 1):
        y = solutions[k + 1].states[0].copy()
        unit_alone(y, kernel.layout.quaternions)
        params = [solution.params for solution in solutions[k : k + 2]]
        jump = jump_between(kernel, params, y, float(spans[k].stop), slopes[k])
        if jump is not None:
            jumps[k + 1] = jump
    return jumps


def jump_between(
    kernel: Kernel, params: Sequence[Array], y: Array, time: float, slopes: Array
) -> Jump | None:
    """Return the jump of derivatives at a stop, or None if there is none.

    Args:
        kernel: Kernel of the run.
        params: Its parameters before and after the stop, (p,) each.
        y: State at the stop, with unit quaternions, (n,).
        time: Time of the stop [s].
        slopes: Derivatives of the time; see Jump.
    """
    if not slopes.any():
        return None
    before, after = (evaluate(kernel.rate.address, p, y[None], len(y))[0] for p in params)
    change = before - after
    return Jump(time, change, slopes) if change.any() else None


_TINY = 1e-9  # Impulse or rate that counts as zero, relative to that of the joint that hits.


@dataclass(frozen=True)
class Slots:
    """Places of a mode's variables among z.

    Attributes:
        state: Places of the entries of the reduced state, (k,).
        constant: Places of the constant momenta among its parameters, (c,).
        size: Number of entries of z.
    """

    state: Indices
    constant: Indices
    size: int

    @classmethod
    def of(cls, system: System, layout: Layout) -> Slots:
        """Return the places of the variables of a layout."""
        nx, first = system.nx, system.nx + system.m
        base = first + np.arange(layout.base.size)
        spin = first + layout.base.size + np.arange(layout.base.spin)
        size = first + layout.base.size + layout.base.spin + 1
        momenta = [nx + k for k in (*layout.active, *layout.ball_pi)]
        active, balls = momenta[: len(layout.active)], momenta[len(layout.active) :]
        state = [
            *layout.active_x, *active, *layout.cyclic_x, *balls, *layout.ball_x, *base,
            *[size - 1] * layout.clock,
        ]  # fmt: skip
        constant = [*spin, *(nx + k for k in layout.constant_pi)]
        return cls(np.array(state, dtype=np.intp), np.array(constant, dtype=np.intp), size)


@dataclass(frozen=True)
class Side:
    """A mode at an event.

    Attributes:
        flow: Flow of the mode, with the parameters at the event.
        slots: Places of its variables among z.
        y: Reduced state, (k,).
        rest: The stops at which joints rest.
    """

    flow: CompiledFlow
    slots: Slots
    y: Array
    rest: tuple[Bound, ...]

    @cached_property
    def rates(self) -> Array:
        """Rates of the reduced state, (k,)."""
        size = self.flow.kernel.layout.size
        if not size:
            return np.zeros(0)
        address = self.flow.kernel.rate.address
        return np.asarray(evaluate(address, self.flow.parameters, self.y[None, :size], size)[0])


@dataclass(frozen=True)
class StopInputs:
    """The numbers of joint stops as inputs of a flow.

    Attributes:
        places: Index of each number by its name; see `stop_numbers`.
        fixed: Indices of the numbers without derivatives.
    """

    places: Mapping[str, int]
    fixed: tuple[int, ...] = ()

    def position(self, bound: Bound) -> tuple[int, float]:
        """Return the index of the position of a bound, and its derivative by this number."""
        return self.places[f"{bound.joint}.stop.{bound.side}"], 1.0 / bound.ratio

    def restitution(self, bound: Bound) -> int:
        """Return the index of the restitution of a bound."""
        return self.places[f"{bound.joint}.stop.restitution"]


@dataclass(frozen=True)
class Contact:
    """The stops that joints touch at an event.

    Attributes:
        t: Time [s].
        hits: Stops of moving joints with an impulse.
        restitution: Ratio of the rates after and before, for each of `hits`; 0 for joints that come
            to rest, (K,).
        pressed: Stops at which joints were at rest, and which got an impulse.
        numbers: Numbers of stops that are inputs.
        moves: Whether the time of the event depends on the state: False at the start.
        least_depth: Least distance [rad | m] by which the joint that hits must pass its stop if
            there were none.
    """

    t: float
    hits: tuple[Bound, ...] = ()
    restitution: tuple[float, ...] = ()
    pressed: frozenset[Bound] = frozenset()
    numbers: StopInputs = field(default_factory=lambda: StopInputs({}))
    moves: bool = True
    least_depth: float = 0.0


class Rates:
    """The rates ẋ of joints as functions of z and of the constants, without any joint at rest.

    Attributes:
        xdot: Rates, (m,).
        by_z: Derivatives of some of them with respect to z, (K, size).
        by_constants: Derivatives with respect to the other parameters, (K, q).
    """

    def __init__(self, flow: CompiledFlow, slots: Slots, joints: Sequence[int]) -> None:
        """Evaluate at the state of a flow; `joints` are the indices of the K rates."""
        kernel = flow.kernel
        layout, m = kernel.layout, kernel.system.m
        function = outcome_of(kernel, ("xdot",))
        a = np.concatenate([flow.y0[: layout.size], np.zeros(1 + reference_size(kernel.system))])
        b = np.concatenate([flow.parameters, flow.path])
        head = len(slots.constant)
        self.xdot = function.at(a, b, m)
        self.by_z = np.zeros((len(joints), slots.size))
        self.by_constants = np.zeros((len(joints), layout.parameters - head))
        for index, j in enumerate(joints):
            by_a, by_b = function.reverse(a, b, np.eye(m)[j])
            self.by_z[index, slots.state] = by_a[: layout.size]
            self.by_z[index, slots.constant] = by_b[:head]
            self.by_constants[index] = by_b[head : layout.parameters]

    def along(self, Z: Array) -> Array:
        """Return the derivatives (K, N) of the rates along N columns of (z, constants)."""
        size, q = self.by_z.shape[1], self.by_constants.shape[1]
        return np.asarray(self.by_z @ Z[:size] + self.by_constants @ Z[size : size + q])


@dataclass(frozen=True)
class ImpactJump:
    """The derivatives of state and constant momenta after an event.

    Attributes:
        matrix: Derivatives with respect to (state, constant momenta, other parameters of the mode
            without joints at rest, numbers of stops) before the event, (k⁺ + c⁺, k⁻ + c⁻ + q + s).
        before: Number of entries k⁻ of the state before the event.
        flow: Flow after the event, with its state.
    """

    matrix: Array
    before: int
    flow: CompiledFlow


def jump_of(
    free: Side, before: Side, after: Side, contact: Contact, delay: Array | None = None
) -> ImpactJump:
    """Return the jump of derivatives at an event.

    Args:
        free: The mode without joints at rest, with any state.
        before: The mode before the event, with its state.
        after: The mode after the event, with any state.
        contact: The stops that joints touch.
        delay: Derivatives of the time of the event with respect to the parameters of `free` after
            its constant momenta, (q,), if forces switch there; None if they do not.
    Returns:
        The jump.
    Raises:
        InputError: The derivative is one-sided, or does not exist.
    """
    t, nx, slots = contact.t, free.flow.kernel.system.nx, free.slots
    bounds, rest = (*before.rest, *contact.hits), len(before.rest)
    x, _, pi = before.flow.canonical_momenta(t, before.y)
    for bound in bounds:
        x[bound.x] = bound.position
    joints = [bound.v for bound in bounds]
    momenta = [nx + v for v in joints]
    earlier = Rates(free.flow.resumed(t, x, pi, before.flow, before.y), slots, joints)
    numbers = contact.numbers
    Z, timing = _inputs(free, before, delay, len(numbers.places))
    first = len(Z) - len(numbers.places)  # row of the first number of a stop
    for bound in before.rest:
        place, slope = numbers.position(bound)
        Z[bound.x] = slope * Z[first + place]
    if rest:  # The momenta of joints at rest follow from the other variables.
        block = earlier.by_z[:rest, momenta[:rest]]
        Z[momenta[:rest]] -= np.linalg.solve(block, earlier.along(Z)[:rest])
    if contact.moves and contact.hits:
        (hit,) = contact.hits
        _refuse_grazing(hit, earlier.xdot[hit.v], float(earlier.along(Z)[-1, -1]), contact)
        place, slope = numbers.position(hit)
        timing = (slope * Z[first + place] - Z[hit.x])[:-1] / earlier.xdot[hit.v]
    Z = Z[:, :-1] + np.outer(Z[:, -1], timing)  # at the varied time of the event
    if contact.hits:
        e = np.array([*[0.0] * rest, *contact.restitution])
        acting, doubtful = _acting(bounds, earlier, momenta, e, contact)
        places = [momenta[k] for k in acting]
        block = earlier.by_z[np.ix_(acting, places)]
        impulses = np.linalg.solve(block, -((1.0 + e) * earlier.xdot[joints])[acting])
        pi[[joints[k] for k in acting]] += impulses
        later = Rates(free.flow.resumed(t, x, pi, before.flow, before.y), slots, joints)
        residual = later.along(Z) + e[:, None] * earlier.along(Z)
        for k, bound in enumerate(contact.hits, start=rest):
            # If the joint comes to rest, the momentum that this changes is left out.
            residual[k] += earlier.xdot[bound.v] * Z[first + numbers.restitution(bound)]
        residual = residual[acting]
        changes = -np.linalg.solve(later.by_z[np.ix_(acting, places)], residual)
        names = {k: bounds[acting[k]].joint for k in doubtful}
        last = changes.shape[1] - len(numbers.places)
        varied = np.delete(changes, [last + place for place in numbers.fixed], axis=1)
        _refuse_doubtful(names, np.sqrt(np.diag(block))[:, None] * varied, t)
        Z[places] += changes
    flow = after.flow.resumed(t, x, pi, before.flow, before.y)
    arrived = Side(flow, after.slots, flow.y0, after.rest)
    state = Z[after.slots.state] - np.outer(arrived.rates, timing)
    matrix = np.vstack([state, Z[after.slots.constant]])
    return ImpactJump(matrix, len(before.slots.state), flow)


def _inputs(free: Side, before: Side, delay: Array | None, stops: int) -> tuple[Array, Array]:
    """Return derivatives of (z, constants) by the inputs of a jump and by time, and of the time.

    Momenta of joints at rest are left out.

    Args:
        free: The mode without joints at rest.
        before: The mode before the event.
        delay: As for `jump_of`.
        stops: Number s of the numbers of stops.
    Returns:
        (size + q + s, N + 1) and (N,), for N inputs.
    """
    size, n, c = free.slots.size, len(before.slots.state), len(before.slots.constant)
    q = free.flow.kernel.layout.parameters - len(free.slots.constant) + stops
    Z = np.zeros((size + q, n + c + q + 1))
    Z[before.slots.state, np.arange(n)] = 1.0
    Z[before.slots.constant, n + np.arange(c)] = 1.0
    Z[size + np.arange(q), n + c + np.arange(q)] = 1.0
    Z[before.slots.state, -1] = before.rates
    Z[size - 1, -1] = 1.0
    timing = np.zeros(n + c + q)
    if delay is not None:
        timing[n + c :] = delay
    return Z, timing


def _acting(
    bounds: Sequence[Bound], earlier: Rates, momenta: Sequence[int], e: Array, contact: Contact
) -> tuple[list[int], list[int]]:
    """Return the indices of bounds with impulses, and the places among them of doubtful ones.

    A joint at rest that an impact neither presses against its stop nor moves is doubtful.
    """
    count = len(bounds)
    G, u = earlier.by_z[:, momenta], earlier.xdot[[bound.v for bound in bounds]]
    acting = [k for k in range(count) if bounds[k] in contact.pressed or bounds[k] in contact.hits]
    impulse = np.zeros(count)
    impulse[acting] = np.linalg.solve(G[np.ix_(acting, acting)], -((1.0 + e) * u)[acting])
    sizes = np.sqrt(np.diag(G))
    least = _TINY * float(np.abs(impulse * sizes).max())
    rates = np.abs(G @ impulse) / sizes
    doubtful = [
        k
        for k in range(count)
        if bounds[k] not in contact.hits
        and (abs(impulse[k]) * sizes[k] if k in acting else rates[k]) <= least
    ]
    acting = sorted({*acting, *doubtful})
    return acting, [acting.index(k) for k in doubtful]


def _refuse_grazing(hit: Bound, rate: float, acceleration: float, contact: Contact) -> None:
    """Reject an impact that a small change would avoid."""
    away = hit.sign * acceleration
    if away > 0.0 and rate**2 <= 2.0 * away * contact.least_depth:
        raise InputError(
            f"stops: joint '{hit.joint}' grazes its {hit.side} stop at t = {contact.t:g} s, where "
            "a flow has no derivative. Change the motion or the stop"
        )


def _refuse_doubtful(doubtful: Mapping[int, str], changes: Array, t: float) -> None:
    """Reject an impact at which it depends on the direction whether a joint leaves its stop."""
    for k, name in doubtful.items():
        if np.abs(changes[k]).max() > _TINY * np.abs(changes).max():
            raise InputError(
                f"stops: the impact at t = {t:g} s neither presses joint '{name}' against its stop "
                "nor moves it away, so a flow has a derivative on each side only. Change the "
                "motion or the stops"
            )
