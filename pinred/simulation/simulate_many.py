"""simulate_many(): one kind of scene from many initial states, over threads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, as_floats, dimensions, entries_of, vectors
from ..common.errors import InputError, IntegrationError, ShapeError
from ..common.plain_names import brief
from ..common.progress import Progress, shown
from ..common.signatures import shows_fields
from ..scene import forms
from ..scene.angles import refuse_vague
from ..scene.initial_state import GivenStates
from ..scene.options import SceneOptions
from ..scene.random_state import random_state
from ..scene.scene import Scene, checked_seed
from ..system.system import System, checked_system
from .plan import Plan, plan_of
from .simulate import as_scene
from .state import ShapeState, State, with_base

if TYPE_CHECKING:
    from .compiled.compiled_flow import CompiledFlow

_VARYING = ("x0", "xdot0", "xi0", "momentum", "pose0", "q0", "v0")
_BY_JOINT = ("x0", "xdot0")
_OF_Q = (("pose0", "pose"), ("x0", "x"))
_OF_V = (("xi0", "xi"), ("xdot0", "xdot"))


@dataclass(frozen=True)
class Failure:
    """A member that did not come to its end.  time: the last it reached [s]."""

    member: int
    time: float
    reason: str


class Trajectories:
    """Motions of one system from many initial states; `trajectories[i]` are the states of one.

    t: (T,) [s].  y: (N, T, k) reduced states, NaN at times that a member has not reached, and
    past the end of those that need fewer numbers.
    failures: the members that did not come to their end.
    """

    def __init__(self, t: Array, y: Array, batches: Sequence[Batch], failures: Sequence[Failure]):
        """Take the report times, reduced states, what makes full ones of them, and failures."""
        self.t, self.y, self.failures = t, y, tuple(failures)
        self._batches = tuple(batches)
        self._failed = {failure.member: failure for failure in failures}

    def __len__(self) -> int:
        return len(self.y)

    def __repr__(self) -> str:
        return f"Trajectories({len(self)} of {len(self.t)} times, {len(self.failures)} failed)"

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        rows = [(str(f.member), f.time, f.reason) for f in self.failures]
        return card(
            "Trajectories",
            f"{len(self)} of {len(self.t)} times to {self.t[-1]:g} s, {len(self.failures)} failed",
            table("members that did not come to their end", ["member", "t [s]", "reason"], rows),
        )

    def __getitem__(self, member: int) -> State:
        """Return the states of one member, over the report times.

        Raises IntegrationError if it did not come to its end, InputError if the base was left
        out.
        """
        return with_base(self.outputs(member), "these members")

    def outputs(self, member: int) -> State | ShapeState:
        """Return what the scenes ask for of one member, over the report times.

        Raises IntegrationError if it did not come to its end.
        """
        member = range(len(self))[member]
        if member in self._failed:
            failure = self._failed[member]
            raise IntegrationError(
                f"member {member} stopped at t = {failure.time:g} s: {failure.reason}"
            )
        for batch in self._batches:
            k = int(np.searchsorted(batch.members, member))
            if k < len(batch.members) and batch.members[k] == member:
                flow = batch.flow(k)
                return flow.states(self.t, self.y[member, :, : flow.y0.size], flow.numbers)
        raise IndexError(member)


@dataclass(frozen=True)
class Batch:
    """Members that share a kernel.  members: their indices, sorted.  flow: of the k-th of them."""

    members: NDArray[np.intp]
    flow: Callable[[int], CompiledFlow]


@shows_fields(Scene)
def simulate_many(
    system: System,
    *,
    threads: int | None = None,
    seeds: Sequence[int] | None = None,
    progress: Progress | bool | None = None,
    **options: Unpack[SceneOptions],
) -> Trajectories:
    """Simulate one system from many initial states, with one kernel, over threads.

    options: those of Scene; of x0, xdot0, xi0, momentum, pose0, q0 and v0, what has a leading
        axis (N, …) differs between members, and the rest is common.  By name, that is
        {joint: (N,) values}, beside which numbers are common.
    seeds: (N,) one random state each instead.  threads: as many as processors if None.
    progress: as in `simulate`; the part of the members that is done.

    The numbers are bit for bit those of `simulate` one at a time.  A member that fails is
    reported in `failures` and disturbs no other.
    Raises InputError or ShapeError for scenes that make no sense, and for those that have
    to be integrated in pieces: with controllers, or tables that have breaks.
    """
    checked_system(system, "simulate_many")
    if seeds is not None:
        drawn = entries_of(seeds)
        if drawn is None:
            raise InputError(f"seeds must be a list of whole numbers, got {brief(seeds)}")
        seeds = [checked_seed(seed) for seed in drawn]
    given = {
        name: forms.in_order(value, system, name) if name in _BY_JOINT else value
        for name, value in options.items()
    }
    common, varying, count = _members(given, seeds)
    if not count:
        raise InputError("simulate_many needs at least one member")
    # The first member as a scene of its own: it checks all that is common.
    first = {name: values[0] for name, values in varying.items()}
    if seeds is not None:
        first["seed"] = seeds[0]
    scene = as_scene(system, common | first, "simulate_many")
    plan = plan_of(scene)
    _refuse_stops(plan)
    starts = _given(scene, varying, count) if seeds is None else _drawn(scene, seeds)
    with shown(progress, f"simulating {count} of {system.name}") as done:
        return _run(plan, starts, threads, done)


def _refuse_stops(plan: Plan) -> None:
    """Raise InputError if a scene has to be integrated in pieces."""
    if plan.scene.events_given:
        raise InputError("simulate_many looks for no events; simulate one at a time")
    if plan.forces is not None and plan.forces.held:
        controller, _ = plan.forces.held[0]
        what = f"{controller.name} has to be called every {controller.period:g} s"
    elif len(plan.stops) > 1:
        what = f"a function of time is not smooth at t = {plan.stops[0]:g} s"
    else:
        return
    raise InputError(
        f"simulate_many integrates from start to end at once, but {what}; simulate one at a "
        "time, or use functions of time without breaks (Fourier, Expression)"
    )


def _members(
    options: Mapping[str, Any], seeds: Sequence[int] | None
) -> tuple[dict[str, Any], dict[str, Array], int]:
    """Return the options that are common, those that vary, (N, …), and N."""
    if seeds is not None:
        if "seed" in options:
            raise InputError("give seeds or seed, not both")
        return dict(options), {}, len(seeds)
    varying = {}
    for name in _VARYING:
        if options.get(name) is not None and dimensions(options[name]) == 2:
            varying[name] = as_floats(options[name], name)
    sizes = {name: len(values) for name, values in varying.items()}
    if len(set(sizes.values())) != 1:
        found = ", ".join(f"{name}: {size}" for name, size in sizes.items()) or "none"
        raise ShapeError(
            f"at least one of {', '.join(_VARYING)} must have shape (N, …), all with the same N; "
            f"the lengths are {found}"
        )
    common = {name: value for name, value in options.items() if name not in varying}
    return common, varying, next(iter(sizes.values()))


def _given(scene: Scene, varying: dict[str, Array], count: int) -> GivenStates:
    """Return the initial states of all members: the first one's where they do not vary."""
    system, own = scene.system, scene.given
    varying = dict(varying)
    if "q0" in varying:
        places = [forms.configuration(q, system) for q in varying.pop("q0")]
        varying |= {name: np.array([getattr(p, key) for p in places]) for name, key in _OF_Q}
    if "v0" in varying:
        motions = [forms.velocity(v, system) for v in varying.pop("v0")]
        varying |= {name: np.array([getattr(v, key) for v in motions]) for name, key in _OF_V}
    sizes = {"x0": system.m, "xdot0": system.m, "xi0": system.r, "momentum": system.r}

    def rows(name: str, first: Array | None) -> Array | None:
        if name in varying:
            return vectors(varying[name], sizes[name], name)
        return None if first is None else np.repeat(first, count, axis=0)

    x, xdot = rows("x0", own.x), rows("xdot0", own.xdot)
    assert x is not None
    assert xdot is not None
    pose = np.repeat(own.pose, count, axis=0)
    if "pose0" in varying:
        pose = np.array([system.group.pose(each) for each in varying["pose0"]])
    refuse_vague(np.abs(x).max(axis=0), system)
    x, xdot = scene.with_prescribed(x, xdot)
    return GivenStates(pose, x, xdot, rows("xi0", own.xi), rows("momentum", own.mu))


def _drawn(scene: Scene, seeds: Sequence[int]) -> GivenStates:
    """Return the random initial states of seeds."""
    states = [random_state(scene.system, seed) for seed in seeds]
    x, xdot, xi = (np.array([getattr(s, name) for s in states]) for name in ("x", "xdot", "xi"))
    x, xdot = scene.with_prescribed(x, xdot)
    return GivenStates(np.repeat(scene.given.pose, len(states), axis=0), x, xdot, xi, None)


def _run(
    plan: Plan, given: GivenStates, threads: int | None, progress: Progress | None
) -> Trajectories:
    from .compiled.compiled_flow import CompiledFlow, flows_of
    from .compiled.integrator import integrate_many

    t, count = plan.scene.report_times, len(given.x)
    kinds = flows_of(plan, given)  # members without momentum have a kernel of their own
    runs, before = [], 0
    for members, flows in kinds:
        done = progress and partial(_part, progress, before / count, len(members) / count)
        runs.append(integrate_many(flows, plan, threads, done))
        before += len(members)
    y = runs[0].y  # the results are there once, if all members are of one kind
    if len(runs) > 1:
        y = np.full((count, len(t), max(run.y.shape[2] for run in runs)), np.nan)
        for (members, _), run in zip(kinds, runs, strict=True):
            y[members, :, : run.y.shape[2]] = run.y
    failures = [
        Failure(int(members[k]), time, reason)
        for (members, _), run in zip(kinds, runs, strict=True)
        for k, time, reason in run.failures
    ]
    batches = [Batch(members, partial(CompiledFlow.of, flows)) for members, flows in kinds]
    return Trajectories(t, y, batches, sorted(failures, key=lambda failure: failure.member))


def _part(progress: Progress, before: float, share: float, part: float) -> None:
    """Tell how much of the whole is done, of which a share is at work."""
    progress(before + share * part)
