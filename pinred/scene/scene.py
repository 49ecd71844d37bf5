"""Scene: a frozen description of what to simulate, and the initial state it resolves to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..common.arrays import Array, as_floats, positive, read_only, vector
from ..common.errors import InputError, ShapeError
from ..forces.force import Force
from ..integrators.methods import METHODS, Method
from ..system.joints import is_prismatic
from ..system.system import InitialState, System, checked_system
from .initial_state import GivenStates, Start, start_of

if TYPE_CHECKING:
    from ..forces.force_model import ForceModel
    from ..forces.signals import Signal

Engine: TypeAlias = Literal["compiled", "pinocchio"]
WantedOutputs: TypeAlias = Literal["all", "shape"]
ENGINES: tuple[Engine, ...] = get_args(Engine)
OUTPUTS: tuple[WantedOutputs, ...] = get_args(WantedOutputs)
EVEN_TIMES = 201  # report times, where the scene does not say
DURATION = 2.0  # s, where neither scene nor robot says
TIGHTEST = 1e-14  # relative tolerance; below it round-off decides the step
# Momenta are integrated, and rates are wanted: where a light joint sits beside heavy ones, a
# small part of a large momentum is a ten times larger part of the light joint's rate.
MOMENTUM_MARGIN = 10.0
MOST_CALLS = 1_000_000  # of one controller; each ends a run of the integrator


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A system, its initial state, and how long and how accurately to follow it.

    x0, xdot0: (m,) shape and rate; if only one is given, the other is zero; if neither, they
    are those the robot comes with.  Either xi0, (r,) body twist of the base, or momentum,
    (r,) body momentum μ (or just 0); if neither, the robot's own with its own shape, else
    zero twist.  seed: a generic random state instead of all these.  pose0: pose of the base
    (identity).  duration: s; else up to the last of `times`, else what the robot comes with,
    else 2 s.  times: where to report, increasing (201 even ones).  rtol, atol: local error
    per step, relative and absolute.  springs: {joint: (stiffness [N·m/rad | N/m], rest
    [rad | m])}, short for forces.Spring.  forces: what else acts (see pinred.forces).
    prescribed: {joint: Signal}, joints that follow a plan (see pinred.signals); their
    entries in x0 and xdot0 are not read, and torques on them only relieve their drives.
    outputs: "all", or "shape" to leave out the base.
    method: an integrator with its own step or tolerances, such as pinred.Gauss(0.01), or "auto"
    for one that suits the scene, with rtol and atol (simulate(explain=True) says which and why).

    Raises InputError or ShapeError when it describes something that cannot be simulated.
    """

    system: System
    x0: ArrayLike | None = None
    xdot0: ArrayLike | None = None
    xi0: ArrayLike | None = None
    momentum: ArrayLike | None = None
    seed: int | None = None
    pose0: Any = None
    duration: float | None = None
    times: ArrayLike | None = None
    rtol: float = 1e-10
    atol: float = 1e-12
    springs: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    forces: Sequence[Force] | Force = ()
    prescribed: Mapping[str, Signal] = field(default_factory=dict)
    outputs: WantedOutputs = "all"
    method: Method | Literal["auto"] = "auto"

    def __post_init__(self) -> None:
        checked_system(self.system, "a scene")
        given = [k for k in ("x0", "xdot0", "xi0", "momentum") if getattr(self, k) is not None]
        if self.seed is not None and given:
            raise InputError(
                f"seed stands for a whole random state; do not give {given[0]} with it"
            )
        if self.xi0 is not None and self.momentum is not None:
            raise InputError("give xi0 or momentum, not both: each fixes the other")
        if self.seed is None and not given and self.system.initial is None:
            raise InputError(
                f"'{self.system.name}' comes with no initial state; "
                "give x0, xdot0, xi0 or momentum, or seed= for a random one"
            )
        if self.seed is not None:
            checked_seed(self.seed)
        if self.outputs not in OUTPUTS:
            raise InputError(f"outputs must be one of {', '.join(OUTPUTS)}, got {self.outputs!r}")
        if not (self.method == "auto" or isinstance(self.method, Method)):
            names = " or ".join(f"{name}(…)" for name in METHODS)
            raise InputError(f"method must be 'auto' or {names}, got {self.method!r}")
        for name in ("rtol", "atol"):
            object.__setattr__(self, name, positive(getattr(self, name), name))
        if self.rtol < TIGHTEST:
            raise InputError(f"rtol must be at least {TIGHTEST:g}, got {self.rtol:g}")
        if self.duration is not None:
            object.__setattr__(self, "duration", positive(self.duration, "duration"))
        object.__setattr__(self, "_times", read_only(self._checked_times()))
        self._check_forces()
        object.__setattr__(self, "_given", self._resolve())

    def _repr_html_(self) -> str:
        from ..common.html import card, line, numbers, table

        system, start = self.system, self.start
        rows = zip(system.shape_names, start.x.tolist(), start.xdot.tolist(), strict=True)
        forces: tuple[Force, ...] = vars(self)["forces"]
        acting = [
            *((f"spring {name}", str(spring)) for name, spring in self.springs.items()),
            *((force.label, repr(force)) for force in forces),
            *((f"prescribed {name}", repr(plan)) for name, plan in self.prescribed.items()),
        ]
        method = f", {self.method}" if self.method else ""
        return card(
            f"Scene of {system.name}",
            f"{self.end:g} s, {len(self.report_times)} times, rtol {self.rtol:g}, "
            f"atol {self.atol:g}{method}, outputs '{self.outputs}'",
            table("start", ["joint", "x", "rate"], rows),
            line(f"twist of the base: {numbers(start.xi)}"),
            line(f"pose of the base: {numbers(start.pose)}"),
            table("acting", ["", ""], acting),
        )

    @cached_property
    def start(self) -> Start:
        """The initial state, complete.  Raises SingularInertiaError or InputError."""
        return start_of(self.system, self.given)

    @property
    def given(self) -> GivenStates:
        """The initial state as it is given, with a leading axis of length one."""
        given: GivenStates = vars(self)["_given"]
        return given

    @property
    def report_times(self) -> Array:
        """The times to report, (T,) [s]."""
        times: Array = vars(self)["_times"]
        return times

    @property
    def tolerance(self) -> tuple[float, float]:
        """The integrator's (rtol, atol): a tenth of those asked for, as it integrates momenta."""
        return self.rtol / MOMENTUM_MARGIN, self.atol / MOMENTUM_MARGIN

    @property
    def force_model(self) -> ForceModel | None:
        """The forces besides gravity, and the prescribed joints; None if there are none."""
        model: ForceModel | None = vars(self)["_forces"]
        return model

    @property
    def end(self) -> float:
        """The time at which the simulation ends [s]; it starts at 0."""
        if self.duration is not None:
            return float(self.duration)
        return float(self.report_times[-1])

    def _check_forces(self) -> None:
        """Write the forces down, if there are any."""
        if not isinstance(self.springs, Mapping):
            raise InputError(f"springs must be {{joint: (stiffness, rest)}}, got {self.springs!r}")
        if not isinstance(self.prescribed, Mapping):
            raise InputError(f"prescribed must be {{joint: Signal}}, got {self.prescribed!r}")
        given = (self.forces,) if isinstance(self.forces, Force) else self.forces or ()
        if not isinstance(given, Iterable):
            raise InputError(f"forces must be a list of those of pinred.forces, got {given!r}")
        forces = tuple(given)
        object.__setattr__(self, "forces", forces)
        if not (self.springs or forces or self.prescribed):
            object.__setattr__(self, "_forces", None)
            return
        from ..forces.force_model import remembered_model  # needs CasADi

        model = remembered_model(self.system, self.springs, forces, self.prescribed)
        for signal in (*model.signals, *model.references):
            first, last = signal.span
            if not first <= 0.0 <= self.end <= last:
                raise InputError(
                    f"{signal!r} is defined from {first:g} to {last:g} s, "
                    f"but the scene goes from 0 to {self.end:g} s"
                )
        for controller, _ in model.held:
            if self.end / controller.period > MOST_CALLS:
                raise InputError(
                    f"a period of {controller.period:g} s would call {controller.name} more than "
                    f"{MOST_CALLS} times in {self.end:g} s"
                )
        object.__setattr__(self, "_forces", model)

    def _checked_times(self) -> Array:
        if self.times is None:
            own = self.system.initial.duration if self.system.initial else DURATION
            last = own if self.duration is None else float(self.duration)
            return np.linspace(0.0, last, EVEN_TIMES)
        times = np.atleast_1d(as_floats(self.times, "times")).copy()
        end = np.inf if self.duration is None else float(self.duration)
        if times.ndim != 1 or times.size == 0 or not np.isfinite(times).all():
            raise ShapeError("times must be a vector of finite times")
        if (np.diff(times) <= 0.0).any() or times[0] < 0.0 or times[-1] > end:
            raise InputError(
                f"times must increase from 0 or later to the duration at most ({end:g} s), "
                f"got {times[0]:g} … {times[-1]:g}"
            )
        if self.duration is None:
            positive(times[-1], "the last of times, which stands for the duration,")
        return times

    def _resolve(self) -> GivenStates:
        system = self.system
        pose = system.group.identity() if self.pose0 is None else system.group.pose(self.pose0)
        x = _or_zero(self.x0, system.m, "x0", system.shape_names)
        xdot = _or_zero(self.xdot0, system.m, "xdot0", system.shape_names)
        xi = _or_zero(self.xi0, system.r, "xi0")
        ready = system.initial if self.seed is None else random_state(system, self.seed)
        if ready is not None and self.x0 is None and self.xdot0 is None:
            x, xdot = ready.x, ready.xdot
            xi = ready.xi if self.xi0 is None else xi
        x, xdot = self.with_prescribed(x[None], xdot[None])
        if self.momentum is None:
            return GivenStates(pose[None], x, xdot, xi[None], None)
        # A plain 0 is short for the zero momentum of any group.
        zero = np.ndim(self.momentum) == 0 and self.momentum == 0
        mu = np.zeros(system.r) if zero else vector(self.momentum, system.r, "momentum")
        return GivenStates(pose[None], x, xdot, None, mu[None])

    def with_prescribed(self, x: Array, xdot: Array) -> tuple[Array, Array]:
        """Return initial shapes and rates (N, m) with those of the prescribed joints in them."""
        model = self.force_model
        if model is None or not model.joints:
            return x, xdot
        x, xdot, joints = x.copy(), xdot.copy(), list(model.joints)
        given = model.prescribed(0.0, model.numbers_from(0.0, self.end))
        x[:, joints], xdot[:, joints] = given.x, given.xdot
        return x, xdot


def checked_seed(seed: Any) -> int:
    """Return a seed as a whole number from 0.  Raises InputError."""
    if isinstance(seed, bool) or not (isinstance(seed, (int, np.integer)) and seed >= 0):
        raise InputError(f"seed must be a whole number from 0, got {seed!r}")
    return int(seed)


def random_state(system: System, seed: int) -> InitialState:
    """Return a generic state: moderate, within the joints' limits, with no symmetry in it."""
    rng = np.random.default_rng(seed)
    joints = [system.model.joints[i] for i in range(2, system.model.njoints)]
    reach = np.array([0.1 if is_prismatic(joint) else 0.6 for joint in joints])
    low, high = -reach, reach.copy()
    for k, joint in enumerate(joints):
        least, most = (
            limit[joint.idx_q]
            for limit in (system.model.lowerPositionLimit, system.model.upperPositionLimit)
        )
        if joint.nq == 1 and least < most:
            middle = max(least, min(0.0, most))
            low[k], high[k] = max(least, middle - reach[k]), min(most, middle + reach[k])
    scale = np.where(np.arange(system.r) < system.group.linear, 0.1, 0.6)
    return InitialState(
        x=rng.uniform(low, high),
        xdot=rng.normal(size=system.m) * reach,
        xi=rng.normal(size=system.r) * scale,
        duration=DURATION,
    )


def _or_zero(value: ArrayLike | None, size: int, what: str, labels: Any = ()) -> Array:
    return np.zeros(size) if value is None else vector(value, size, what, labels)
