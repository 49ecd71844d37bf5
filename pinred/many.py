"""simulate_many(): one kind of scene from many initial states, over threads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import Array, as_floats
from .errors import InputError, IntegrationError, ShapeError
from .motion import stops_of
from .scene import Scene
from .simulation import as_scene
from .state import ShapeState, State, with_base
from .system import System, checked_system

if TYPE_CHECKING:
    from .engine.flow import CompiledFlow

_VARYING = ("x0", "xdot0", "xi0", "momentum", "pose0")


@dataclass(frozen=True)
class Failure:
    """A member that did not come to its end.  time: the last it reached [s]."""

    member: int
    time: float
    reason: str


class Trajectories:
    """Motions of one system from many initial states; `trajectories[i]` are the states of one.

    t: (T,) [s].  y: (N, T, k) reduced states, NaN at times that a member has not reached.
    failures: the members that did not come to their end.
    """

    def __init__(
        self, t: Array, y: Array, flows: Sequence[CompiledFlow], failures: Sequence[Failure]
    ) -> None:
        """Take the report times, reduced states, what makes full ones of them, and failures."""
        self.t, self.y, self.failures = t, y, tuple(failures)
        self._flows = tuple(flows)

    def __len__(self) -> int:
        return len(self.y)

    def __repr__(self) -> str:
        return f"Trajectories({len(self)} of {len(self.t)} times, {len(self.failures)} failed)"

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
        for failure in self.failures:
            if failure.member == range(len(self))[member]:
                raise IntegrationError(
                    f"member {member} stopped at t = {failure.time:g} s: {failure.reason}"
                )
        flow = self._flows[member]
        y = np.array(self.y[member, :, : flow.y0.size])
        return flow.states(self.t, y, flow.numbers)


def simulate_many(
    system: System,
    *,
    threads: int | None = None,
    seeds: Sequence[int] | None = None,
    **options: Any,
) -> Trajectories:
    """Simulate one system from many initial states, with one kernel, over threads.

    options: those of Scene; of x0, xdot0, xi0, momentum and pose0, what has a leading axis
        (N, …) differs between members, and the rest is common.
    seeds: (N,) one random state each instead.  threads: as many as processors if None.

    The numbers are bit for bit those of `simulate` one at a time.  A member that fails is
    reported in `failures` and disturbs no other.
    Raises InputError or ShapeError for scenes that make no sense, and for those that have
    to be integrated in pieces: with controllers, or tables that have breaks.
    """
    checked_system(system, "simulate_many")
    scenes = [as_scene(system, each, "simulate_many") for each in _members(options, seeds)]
    if scenes:
        _refuse_stops(scenes[0])
    return _run(scenes, threads)


def _refuse_stops(scene: Scene) -> None:
    """Raise InputError if a scene has to be integrated in pieces."""
    forces = scene.force_model
    if forces is not None and forces.held:
        what = f"{forces.held[0][0].name} has to be called every {forces.held[0][0].period:g} s"
    elif len(stops_of(scene)) > 1:
        what = f"a function of time is not smooth at t = {stops_of(scene)[0]:g} s"
    else:
        return
    raise InputError(
        f"simulate_many integrates from start to end at once, but {what}; simulate one at a "
        "time, or use functions of time without breaks (Fourier, Expression)"
    )


def _members(options: dict[str, Any], seeds: Sequence[int] | None) -> list[dict[str, Any]]:
    """Return the options of each member."""
    if seeds is not None:
        if "seed" in options:
            raise InputError("give seeds or seed, not both")
        return [{**options, "seed": int(seed)} for seed in seeds]
    varying = {}
    for name in _VARYING:
        if options.get(name) is not None and np.ndim(options[name]) == 2:
            varying[name] = as_floats(options[name], name)
    sizes = {name: len(values) for name, values in varying.items()}
    if len(set(sizes.values())) != 1:
        found = ", ".join(f"{name}: {size}" for name, size in sizes.items()) or "none"
        raise ShapeError(
            f"at least one of {', '.join(_VARYING)} must have shape (N, …), all with the same N; "
            f"the lengths are {found}"
        )
    count = next(iter(sizes.values()))
    common = {name: value for name, value in options.items() if name not in varying}
    return [
        {**common, **{name: values[i] for name, values in varying.items()}} for i in range(count)
    ]


def _run(scenes: list[Scene], threads: int | None) -> Trajectories:
    from .engine.flow import CompiledFlow
    from .engine.run import integrate_many

    if not scenes:
        raise InputError("simulate_many needs at least one member")
    flows = [CompiledFlow(scene) for scene in scenes]
    t = scenes[0].report_times
    width = max(1, flows[0].y0.size)  # of every member: they differ in momentum only
    y = np.full((len(flows), len(t), width), np.nan)
    failures: list[Failure] = []
    # Members without momentum have a kernel of their own.
    kernels = {id(flow.kernel): flow.kernel for flow in flows}
    for key in kernels:
        members = [i for i, flow in enumerate(flows) if id(flow.kernel) == key]
        found = integrate_many([flows[i] for i in members], scenes[0], threads)
        y[members] = found.y
        failures += [Failure(members[k], time, reason) for k, time, reason in found.failures]
    return Trajectories(t, y, flows, sorted(failures, key=lambda failure: failure.member))
