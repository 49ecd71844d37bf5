"""The interface of a reduced flow, the state that its forces see, and one segment of a solution.

Two classes implement ReducedFlow and ModeFlow: CompiledFlow and PinocchioFlow.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from ..common.arrays import Array
from ..forces.force_model import ForceModel
from ..forces.force_numbers import BaseInSpace, ForceInputs
from ..integrators.integrate import RunKeeper
from ..system.state_fields import ShapeState, State
from ..system.system import System
from .plan import Plan


@dataclass(frozen=True)
class Sample:
    """The state that forces depend on, in the frame of the centre of mass.

    At T times, all fields have a leading axis of length T.

    Attributes:
        x: Shape, (nx,) [rad | m | 1].
        xdot: Shape rate, (m,) [rad/s | m/s].
        xi: Body twist relative to the centre of mass, (r,) [m/s | rad/s].
        mu: Body momentum about the centre of mass, (r,) [N·s | N·m·s]; its linear part is zero.
        weight: Gravity force m g in the body frame if it rotates a pivoted base, else zero, (3,)
            [N].
        base: State of the base in the fixed frame, None if the scene leaves it out.
    """

    x: Array
    xdot: Array
    xi: Array
    mu: Array
    weight: Array
    base: BaseInSpace | None = None

    def force_inputs(self, t: float | Array, numbers: Array) -> ForceInputs:
        """Return the arguments of a ForceModel.

        Args:
            t: Time, or times (T,) [s].
            numbers: Force parameters, (p,) or (T, p).
        Returns:
            The arguments.
        """
        return ForceInputs(t, self.x, self.xdot, self.xi, self.mu, numbers, self.base)


def map_samples(function: Callable[..., Array], samples: Sequence[Sample]) -> Sample:
    """Return the sample whose fields are a function of the lists of fields of several samples."""
    fields = [(s.x, s.xdot, s.xi, s.mu, s.weight) for s in samples]
    base, bases = None, [s.base for s in samples if s.base is not None]
    if bases:
        in_space = [(b.pose, b.xi, b.mu, b.J) for b in bases]
        base = BaseInSpace(*map(function, zip(*in_space, strict=True)))
    x, xdot, xi, mu, weight = map(function, zip(*fields, strict=True))
    return Sample(x, xdot, xi, mu, weight, base)


class ReducedFlow(Protocol):
    """A vector field on reduced states, and the map from reduced to full states."""

    @property
    def y0(self) -> Array:
        """Initial reduced state, (k,)."""

    @property
    def parameters(self) -> Array:
        """Initial parameters of the vector field, (p,)."""

    @property
    def numbers_at(self) -> slice:
        """Indices of the force parameters among `parameters`."""

    @property
    def clock(self) -> slice:
        """Index of the integrated time in a reduced state; empty if the time is not integrated."""

    def sample(self, t: float, y: Array, parameters: Array) -> Sample:
        """Return the state at time t that forces depend on."""

    def samples(self, t: Array, y: Array, parameters: Array) -> Sample:
        """Return the states at times (T,) that forces depend on, from reduced states (T, k)."""

    def states(self, t: Array, y: Array, parameters: Array) -> State | ShapeState:
        """Return the full states at times (T,) from reduced states (T, k)."""

    def rates(self, t: Array, y: Array, parameters: Array) -> Array:
        """Return dy/dt, (T, k), at times (T,) and reduced states (T, k)."""


class ModeFlow(ReducedFlow, Protocol):
    """The flow of a run with joint stops, with some joints at rest at their stops."""

    @property
    def system(self) -> System:
        """The system."""

    @property
    def forces(self) -> ForceModel | None:
        """Forces besides gravity; None if there are none."""

    @property
    def numbers(self) -> Array:
        """Force parameters, (p,)."""

    @property
    def position_entries(self) -> dict[int, int]:
        """Entry of the reduced state for each hinge or slide that moves, by index of its rate."""

    def in_mode(self, plan: Plan) -> Self:
        """Return the flow of the same run with other prescribed joints, without a state."""

    def resumed(self, t: float, x: Array, pi: Array, before: Self, y: Array) -> Self:
        """Return the flow from a state at any time, with the base of another flow of the run.

        Args:
            t: Time [s].
            x: Shape, (nx,) [rad | m | 1].
            pi: Canonical momenta in the frame of the centre of mass, (m,).
            before: Flow that provides the base.
            y: Its reduced state, (k,).
        """

    def canonical_momenta(
        self, t: float, y: Array, parameters: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return the shape, its rate, and its canonical momenta, from a reduced state (k,)."""

    def parameters_between(self, start: float, stop: float) -> Array:
        """Return a copy of the parameters for the time between two stops."""


@dataclass(frozen=True)
class Segment:
    """The solution between two stops, during which the parameters are constant.

    Attributes:
        end: End time [s].
        step_ends: Function that returns the times of the step ends, including the ends of the parts
            of long steps, (K,) [s].
        at: Dense output: function from times (T,) within the segment to reduced states (T, k).
        parameters: Parameters of the vector field, (p,).
        steps: Number of accepted steps.
        evaluations: Number of evaluations of the vector field.
    """

    end: float
    step_ends: Callable[[], Array]
    at: Callable[[Array], Array]
    parameters: Array
    steps: int
    evaluations: int

    @classmethod
    def stored(
        cls,
        knots: Array,
        at: Callable[[Array], Array],
        parameters: Array,
        steps: int,
        evaluations: int,
    ) -> Segment:
        """Return a segment with stored times of the step ends (K,) [s]; see the attributes."""
        return cls(float(knots[-1]), lambda: knots, at, parameters, steps, evaluations)

    @property
    def knots(self) -> Array:
        """Times of the step ends, (K,) [s]."""
        return self.step_ends()

    def until(self, count: int, end: float) -> Segment:
        """Return the segment with its first step ends only, the last of which is replaced.

        Args:
            count: Number of step ends.
            end: Time that replaces the last of them [s].
        """

        def step_ends() -> Array:
            return np.append(self.knots[: count - 1], end)

        # Long steps have several parts; a step that ends in one of them counts.
        steps = -((1 - count) * self.steps // (len(self.knots) - 1))
        return replace(self, end=end, step_ends=step_ends, steps=steps)


class Integrate(Protocol):
    """A function that integrates a flow from one stop to the next."""

    def __call__(
        self,
        start: float,
        end: float,
        y0: Array,
        parameters: Array,
        watch: Callable[[Segment], bool] | None = None,
        keeper: RunKeeper | None = None,
    ) -> Segment:
        """Integrate from a reduced state at the start.

        Args:
            start: Start time [s].
            end: End time [s].
            y0: Reduced state at the start, (k,).
            parameters: Parameters of the vector field, (p,); the caller must not change them
                afterwards.
            watch: Called repeatedly, and before a failure is raised, with the segment so far; if
                `watch` returns True, the integration stops.
            keeper: Saves the run at its pauses, and continues a saved run; compiled engine only.
        Returns:
            The segment.
        Raises:
            IntegrationError: The integration failed.
        """


def entry_name(
    system: System,
    active: Sequence[int],
    cyclic: Sequence[int],
    entry: int,
    constant: Collection[int] = (),
    driven: Collection[int] = (),
) -> str:
    """Return the name of an entry of a reduced state, for messages.

    Args:
        system: The system.
        active: Indices of the hinges and slides whose positions and momenta come first.
        cyclic: Indices of the cyclic joints, whose positions follow; then come the balls.
        entry: Index of the entry.
        constant: Indices of the momenta of balls that are not entries, because they are constant.
        driven: Indices of the prescribed joints, which have no entry.
    Returns:
        A noun phrase.
    """
    names = system.shape_names
    entries = [f"the position of joint '{names[k]}'" for k in active]
    entries += [f"the momentum of joint '{names[k]}'" for k in active]
    entries += [f"the position of joint '{names[k]}'" for k in cyclic]
    balls = [joint for joint in system.space.balls if joint.v.start not in driven]
    for joint in balls:
        rates = range(joint.v.start, joint.v.stop)
        entries += [
            f"the momentum of ball joint '{joint.name}'" for k in rates if k not in constant
        ]
    for joint in balls:
        entries += [f"the attitude of ball joint '{joint.name}'"] * 4
    root = f"the motion of the root joint '{system.root_name}'"
    return entries[entry] if entry < len(entries) else root
