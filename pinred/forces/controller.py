"""Controllers: any Python function in the loop, called at equal times and held in between."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..common.arrays import Array, as_floats, positive
from ..common.errors import InputError
from ..common.plain_names import brief
from ..system.force_interface import SeenState
from .arguments import takes_state
from .force import Limit, Named, Symbols, Terms, checked, limited


@dataclass(frozen=True)
class Command:
    """What a controller gives, where torques alone do not say it.

    torque: {joint: torque} or one for each of its joints; none if None.  wrench: r entries on the
    base in its own frame, [linear; angular], at its origin.  width: for how long of the period all
    of it is held [s], then nothing acts; to the next call if None, or if that comes first.  A
    thruster that fires for a part of each period is a wrench with a width.
    """

    torque: Mapping[str, float] | ArrayLike | None = None
    wrench: ArrayLike | None = None
    width: float | None = None


class _Stateless:
    def __repr__(self) -> str:
        return "none"


STATELESS = _Stateless()


@dataclass(frozen=True)
class Held:
    """What is held.  values: torques of the joints, then the wrench.  width: s, or None."""

    values: Array
    width: float | None


@dataclass(frozen=True)
class Controller(Named):
    """Torques and wrenches from any Python function, called every `period` seconds and held.

    function: (t, x, xdot, mu), the numbers of Symbols, or one SeenState with pose, twist and
    momenta of the base (see arguments.py), → {joint: torque}, a torque for each of its joints, or
    a Command.  x["hinge"] and xdot["hinge"] are entries by joint, as x[0] is; arrays made of them
    are plain.  joints: those whose torques it gives; all if None, or none if it gives a wrench.
    wrench: whether its Commands have wrenches on the base, of which momentum is then integrated.
    state0: the first state of a controller that keeps one, anything that can be copied; its
    function is update(t, state, measurement) → (action, state), with a SeenState as measurement.
    Every simulation begins with a copy of it.

    What it gave is kept with the motion (Trajectory.actions), and `compare` takes it from there
    instead of calling it again.
    """

    function: Callable[..., Any]
    period: float
    joints: tuple[str, ...] | None = None
    limit: Limit | None = None
    name: str = "controller"
    wrench: bool = field(default=False, kw_only=True)
    state0: Any = field(default=STATELESS, kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "period", positive(self.period, f"the period of {self.name}"))
        checked(self.name, "a function of (t, x, xdot, mu) or of a state", self.function)
        if not isinstance(self.wrench, bool):
            raise InputError(
                f"wrench of {self.name} must be True or False, got {brief(self.wrench)}; "
                "the wrench itself stands in the Command that it gives"
            )
        if not self.keeps_state:
            takes_state(self.function, self.name)
        if self.joints is None:
            if self.wrench:
                object.__setattr__(self, "joints", ())
            return
        if isinstance(self.joints, str) or not isinstance(self.joints, Sequence):
            raise InputError(f"joints of {self.name} must be a list of names, got {self.joints!r}")
        object.__setattr__(self, "joints", tuple(self.joints))
        if len(set(self.joints)) < len(self.joints):
            raise InputError(f"joints of {self.name} must differ, got {', '.join(self.joints)}")
        if not (self.joints or self.wrench):
            raise InputError(f"{self.name} has no joints and gives no wrench: it does nothing")

    @property
    def keeps_state(self) -> bool:
        """Whether it has a state of its own."""
        return not isinstance(self.state0, _Stateless)

    @property
    def sees_base(self) -> bool:
        """Whether it is given the pose of the base."""
        return self.keeps_state or takes_state(self.function, self.name)

    def driven(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the joints whose torques it gives; names: of all shape joints."""
        return names if self.joints is None else self.joints

    def count(self, names: tuple[str, ...], r: int) -> int:
        """Return how many numbers it gives."""
        return len(self.driven(names)) + (r if self.wrench else 0)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return what is held: numbers that are set anew at every sample."""
        torque = {s.joint(name, self.name): number(0.0) for name in self.driven(s.names)}
        wrench = [number(0.0) for _ in range(s.mu.numel())] if self.wrench else None
        return Terms(torque=limited(self.limit, s, torque, number, self.name), wrench=wrench)

    def sample(self, seen: SeenState, about: Array, state: Any) -> tuple[Any, Any]:
        """Return what it gives at one time, and its new state.

        seen: numbers.  about: (r,) μ about the centre of mass, which functions of four arguments
        are given.  Raises InputError.
        """
        if self.keeps_state:
            given = self.function(seen.t, state, seen)
            if not (isinstance(given, tuple) and len(given) == 2):
                raise InputError(
                    f"{self.name} keeps a state, so it must give (action, state), "
                    f"but gave {brief(given)} at t = {seen.t:g} s"
                )
            return given
        if self.sees_base:
            return self.function(seen), state
        return self.function(seen.t, seen.x, seen.xdot, about.copy()), state

    def held(self, given: Any, names: tuple[str, ...], r: int, t: float) -> Held:
        """Return what it gave as numbers.  Raises InputError."""
        command = given if isinstance(given, Command) else Command(torque=given)
        if command.wrench is not None and not self.wrench:
            raise InputError(
                f"{self.name} gave a wrench at t = {t:g} s; say so beforehand with "
                "Controller(…, wrench=True), for momentum is then integrated"
            )
        parts = [self._torques(command.torque, names, t)]
        if self.wrench:
            wrench = [0.0] * r if command.wrench is None else command.wrench
            parts.append(self._checked(wrench, r, "a wrench of {} finite entries", t))
        width = command.width
        if width is not None:
            width = float(self._checked([width], 1, "one width [s]", t)[0])
            if width < 0.0:
                raise InputError(f"{self.name} gave a width of {width:g} s at t = {t:g} s")
        return Held(np.concatenate(parts), width)

    def _torques(self, given: Any, names: tuple[str, ...], t: float) -> Array:
        wanted = self.driven(names)
        if given is None and (self.wrench or not wanted):
            return np.zeros(len(wanted))
        if isinstance(given, Mapping):
            unknown = [name for name in given if name not in wanted]
            if unknown:
                raise InputError(
                    f"{self.name} gave a torque for '{unknown[0]}' at t = {t:g} s; "
                    f"its joints are {', '.join(wanted) or 'none'}"
                )
            given = [given.get(name, 0.0) for name in wanted]
        return self._checked(given, len(wanted), f"{{}} finite torques ({', '.join(wanted)})", t)

    def _checked(self, given: Any, count: int, wanted: str, t: float) -> Array:
        values = as_floats(given, f"what {self.name} gave at t = {t:g} s")
        if values.shape != (count,) or not np.isfinite(values).all():
            raise InputError(
                f"{self.name} must give {wanted.format(count)}, but gave {given!r} at t = {t:g} s"
            )
        return values
