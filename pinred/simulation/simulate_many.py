"""simulate_many(): many motions of one system, as many at once as there are lanes, over threads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Unpack

from ..common.arrays import entries_of
from ..common.errors import InputError, IntegrationError
from ..common.names import brief
from ..common.progress import Progress, shown
from ..common.signatures import shows_fields
from ..scene.option_checks import check_seed
from ..scene.scene import Scene
from ..scene.scene_options import SceneOptions
from ..system.system import System, checked_system
from .members.member_groups import Members, of_scenes
from .members.member_options import MemberOptions
from .members.trajectories import Batch, Failure, Trajectories
from .simulate import trajectory_of
from .trajectory import Trajectory


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
        found = MemberOptions(system, options, members, _checked(seeds)).members()
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
    from .members.integrate_members import lanes_of

    lines = []
    for group in found.groups:
        plan = group.plan
        if why := group.one_by_one:
            lines.append(f"{len(group.members)} members one by one, {plan.method.name}: {why}")
            continue
        for members, flow in flows_of(plan, group.given, group.own):
            lanes = lanes_of(plan.method, flow.kernel)
            how = f"{lanes} at once in lanes" if lanes else "one after another"
            lines.append(
                f"{len(members)} members {how}, {plan.method.name}, "
                f"{flow.kernel.layout.size} numbers each"
            )
    return "\n".join(lines)


def _run(
    members: Members, threads: int | None, progress: Callable[[float], None] | None
) -> Trajectories:
    from .compiled.compiled_flow import flows_of
    from .members.integrate_members import integrate_members

    batches: list[Batch] = []
    single: dict[int, Trajectory] = {}
    failures: list[Failure] = []
    done = 0

    def report(part: float, share: int) -> None:
        if progress is not None:
            progress((done + share * part) / members.count)

    for group in members.groups:
        if group.one_by_one:
            for member in group.members.tolist():
                try:
                    single[member] = trajectory_of(members.scene_of(member))
                except IntegrationError as error:
                    time = getattr(error, "time", float("nan"))
                    failures.append(Failure(member, time, str(error)))
                done += 1
                report(0.0, 0)
            continue
        for some, flow in flows_of(group.plan, group.given, group.own):
            told = partial(report, share=len(some)) if progress is not None else None
            batch = integrate_members(flow, group.plan, group.members[some], threads, told)
            batches.append(batch)
            failures += batch.failures
            done += len(some)
    failures.sort(key=lambda failure: failure.member)
    return Trajectories((members.count, members.scene_of), batches, single, failures)
