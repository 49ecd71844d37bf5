"""simulate_many(): many motions of one system, as many at once as there are lanes, over threads."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from ..common.arrays import Array, entries_of
from ..common.errors import InputError, IntegrationError
from ..common.plain_names import brief
from ..common.progress import Progress, shown
from ..common.signatures import shows_fields
from ..scene.option_checks import check_seed
from ..scene.scene import Scene
from ..scene.scene_options import SceneOptions
from ..system.system import System, checked_system
from .members.groups import Group, Members, of_scenes
from .members.trajectories import Batch, Failure, Trajectories
from .members.varied import Varied
from .simulate import trajectory_of
from .trajectory import Trajectory

if TYPE_CHECKING:
    from .compiled.compiled_flow import CompiledFlows
    from .compiled.integrate_members import ManyRuns


@shows_fields(Scene)
def simulate_many(
    system: System | Scene | Sequence[Scene],
    *,
    members: Mapping[str, Any] | None = None,
    seeds: Sequence[int] | None = None,
    threads: int | None = None,
    progress: Progress | bool | None = None,
    explain: bool = False,
    **options: Unpack[SceneOptions],
) -> Trajectories:
    """Simulate many motions of one system, with one kernel, in lanes and over threads.

    system: a System; or a Scene, whose options then stand where none are given; or a list of
        Scenes of one System with the same times, which are the members.
    options: those of Scene; of x0, xdot0, xi0, momentum, pose0, q0 and v0, what has a leading
        axis (N, …) differs between members, and of parameters={name: …}, what has (N,) values; the
        rest is common.  By joint, that is {joint: (N,) values}, beside which numbers are common.
    members: {name: (N, …) values} of the same, of Parameters, and of gravity, (N, 3) in the world
        frame [m/s²].
    seeds: (N,) one random state each instead.  threads: as many as processors if None.
    progress: as in `simulate`; the part of the members that is done.
    explain: print how the members run.

    With DOP853 and Tsit5, eight members run at once, sixteen of small robots, each with steps of
    its own.  A member's numbers are the same to the bit beside any others, in any order and on any
    number of threads.  They are those of `simulate` within round-off times the stretch of the flow;
    with other methods they are those of `simulate` to the bit.  Where `simulate` would choose
    AdaptiveGauss, members are given to DOP853, which costs less of many.  Members with controllers,
    events, or plans of joints that have breaks run one by one, as in `simulate`.
    A member that fails is reported in `failures` and disturbs no other.
    Raises InputError or ShapeError for scenes that make no sense.
    """
    if isinstance(system, (System, Scene)):
        found = Varied(system, options, members, _checked(seeds)).members()
    else:
        scenes = entries_of(system)
        if scenes is None:
            checked_system(system, "simulate_many")
        given = {**options, "members": members, "seeds": seeds}
        for name, value in given.items():
            if value is not None:
                raise InputError(f"a list of Scenes says all itself; do not give {name} beside it")
        if not scenes:
            raise InputError("simulate_many needs at least one member")
        found = of_scenes(scenes)
    if explain:
        print(_explained(found))
    name = found.groups[0].plan.system.name
    with shown(progress, f"simulating {found.count} of {name}") as done:
        return _run(found, threads, done)


def _checked(seeds: Sequence[int] | None) -> list[int] | None:
    if seeds is None:
        return None
    drawn = entries_of(seeds)
    if drawn is None:
        raise InputError(f"seeds must be a list of whole numbers, got {brief(seeds)}")
    return [check_seed(seed) for seed in drawn]


def _explained(found: Members) -> str:
    """Return how members run, a line for each group."""
    from .compiled.compiled_flow import flows_of
    from .compiled.integrate_members import lanes_of

    lines = []
    for group in found.groups:
        plan = group.plan
        if why := group.one_by_one:
            lines.append(f"{len(group.members)} members one by one, {plan.method.name}: {why}")
            continue
        for members, flows in flows_of(plan, group.given, group.own):
            lanes = lanes_of(plan.method, flows.kernel)
            how = f"{lanes} at once in lanes" if lanes else "one after another"
            lines.append(
                f"{len(members)} members {how}, {plan.method.name}, "
                f"{flows.kernel.layout.size} numbers each"
            )
    return "\n".join(lines)


class _Results:
    """What has become of members so far."""

    def __init__(self, count: int, progress: Progress | None) -> None:
        self.count, self.done, self._progress = count, 0, progress
        self.batches: list[Batch] = []
        self.y: list[Array] = []  # of each batch
        self.single: dict[int, Trajectory] = {}
        self.failures: list[Failure] = []

    def tell(self, part: float, share: int) -> None:
        """Tell how much of the whole is done, of which so many members are at work."""
        if self._progress is not None:
            self._progress((self.done + share * part) / self.count)


def _run(found: Members, threads: int | None, progress: Progress | None) -> Trajectories:
    from .compiled.compiled_flow import flows_of
    from .compiled.integrate_members import integrate_members

    results = _Results(found.count, progress)
    for group in found.groups:
        if group.one_by_one:
            _one_by_one(found, group, results)
            continue
        # Members without momentum have a kernel of their own.
        for some, flows in flows_of(group.plan, group.given, group.own):
            told = partial(results.tell, share=len(some)) if progress is not None else None
            began = time.perf_counter()
            runs = integrate_members(flows, group.plan, threads, told)
            wall = (time.perf_counter() - began) / len(some)
            _keep(results, group, some, flows, runs, wall)
    failures = sorted(results.failures, key=lambda failure: failure.member)
    y = _together(found, results)
    return Trajectories(found.scene_of, y, results.batches, results.single, failures)


def _keep(
    results: _Results, group: Group, some: Any, flows: CompiledFlows, runs: ManyRuns, wall: float
) -> None:
    members, method = group.members[some], group.plan.method.name
    results.batches.append(Batch(members, flows, method, runs.steps, runs.evaluations, wall))
    results.y.append(runs.y)
    results.failures += [Failure(int(members[k]), at, why) for k, at, why in runs.failures]
    results.done += len(members)


def _one_by_one(found: Members, group: Group, results: _Results) -> None:
    """Run members that stop on their way."""
    for member in group.members.tolist():
        try:
            results.single[member] = trajectory_of(found.scene_of(member))
        except IntegrationError as error:
            time = getattr(error, "time", float("nan"))
            results.failures.append(Failure(member, time, str(error)))
        results.done += 1
        results.tell(0.0, 0)


def _together(found: Members, results: _Results) -> Array:
    """Return the reduced states of all members, (N, T, k)."""
    if len(results.batches) == 1 and not results.single and len(results.y[0]) == found.count:
        return results.y[0]  # they are there once
    times = found.scene_of(0).report_times
    parts = [(batch.members, y) for batch, y in zip(results.batches, results.y, strict=True)]
    parts += [
        (np.array([member]), _up_to(traj, times)[None]) for member, traj in results.single.items()
    ]
    most = max((y.shape[2] for _, y in parts), default=0)
    whole = np.full((found.count, len(times), most), np.nan)
    for members, y in parts:
        whole[members, :, : y.shape[2]] = y
    return whole


def _up_to(traj: Trajectory, times: Array) -> Array:
    """Return the reduced states at times (T,), (T, k), NaN after an event has ended a motion."""
    known = times[times <= traj.scene.end]
    y = traj.motion.reduced(known)
    return np.concatenate([y, np.full((len(times) - len(known), y.shape[1]), np.nan)])
