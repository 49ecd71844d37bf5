"""simulate_many(): many motions of one system, in SIMD lanes and on several threads."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal, Unpack

from ..common.argument_kinds import checks_arguments, shows_fields
from ..common.arrays import entries_of, whole
from ..common.errors import InputError, IntegrationError, SceneWarning
from ..common.names import brief, one_of
from ..common.waiting import Progress, shown
from ..integrators.methods import Explicit
from ..scene.scene import Scene
from ..scene.scene_options import SceneOptions
from ..system.system import System, checked_system
from .compiled.code_ahead import expect_members
from .members.member_options import (
    INVALID,
    Invalid,
    MemberOptions,
    separate_rejected,
    warn_of_rejected,
)
from .members.trajectories import Batch, Failure, Trajectories
from .plan import Group, Members, of_scenes, refuse_with_stops
from .simulate import free_joints_notice, trajectory_of
from .trajectory import Trajectory


@checks_arguments
@shows_fields(Scene)
def simulate_many(
    system: System | Scene | Sequence[Scene],
    *,
    members: Mapping[str, Any] | None = None,
    seeds: Sequence[int] | None = None,
    threads: int | None = None,
    device: Literal["cuda"] | None = None,
    progress: Progress | bool | None = None,
    explain: bool = False,
    invalid: Invalid = "record",
    **options: Unpack[SceneOptions],
) -> Trajectories:
    """Simulate many motions of one system with one kernel, in SIMD lanes and on threads.

    With DOP853 and Tsit5, eight members are integrated at once (sixteen for small robots), each
    with individual step lengths.  The results of a member are bit-for-bit independent of the other
    members, of their order, and of the number of threads.  The results agree with `simulate` within
    round-off times the growth along the motion; with other methods they are equal bit for bit.
    Where functions of time in forces change within less than a step, both place stops, at different
    times, and agree within the tolerance.

    Where `simulate` would choose AdaptiveGauss, DOP853 is used, which costs less for many members.
    Members with controllers, events, or prescribed joints whose plans have breaks are simulated
    one by one, as by `simulate`.  A member that fails is listed in `failures` and does not affect
    the others.  So is a member whose values are rejected, such as a negative mass, and a
    RejectedWarning counts these members.

    Values of x0, xdot0, xi0, momentum, pose0, q0, v0 and parameters that have a leading axis (N, …)
    differ between members.

    Args:
        system: A System; or a Scene whose options apply unless `options` replaces them; or a list
            of Scenes of one System with equal report times, one for each member.
        members: Values by name, (N, …): initial states, Parameters, parameters of the robot,
            numbers of joint stops, such as "elbow.stop.restitution", and gravity, (N, 3), in the
            world frame [m/s²].
        seeds: Seeds of random initial states, (N,), one for each member.
        threads: Number of threads; as many as processors if None.
        device: "cuda" to integrate each member in a thread of the CUDA devices, with DOP853 or
            Tsit5; None for the CPU.
        progress: As in `simulate`, but called with the completed fraction of the members.
        explain: Whether to print how the members are integrated.
        invalid: "record" to list members with rejected values in `failures`, "raise" to raise the
            error of the first one.
        options: Fields of Scene.
    Returns:
        The trajectories of all members.
    Raises:
        InputError: The scenes or options are invalid, or differ in system or report times.
        ShapeError: Arrays have different numbers of members.
        DeviceError: There is no device that can run the code, or it reports an error.
        MissingPackageError: `device` needs a package that is not installed.
        UnsupportedOperationError: Forces need a function that devices do not have.
    """
    rejected: list[Failure] = []
    if not one_of(invalid, INVALID):
        raise InputError(f"invalid: expected one of {', '.join(INVALID)}, got {brief(invalid)}")
    if isinstance(system, (System, Scene)):
        member_options = MemberOptions(system, options, members, _checked(seeds))
        resolved, rejected = separate_rejected(member_options, invalid)
        warn_of_rejected(rejected, resolved.count)
    else:
        scenes = entries_of(system)
        if scenes is None:
            checked_system(system, "simulate_many")
        excluded = {**options, "members": members, "seeds": seeds}
        for name, value in excluded.items():
            if value is not None:
                raise InputError(f"a list of Scenes already contains all options. Omit {name}.")
        if not scenes:
            raise InputError("simulate_many needs at least one member")
        resolved = of_scenes(scenes)
    if notice := free_joints_notice(resolved.groups[0].plan.scene):
        warnings.warn(notice, SceneWarning, stacklevel=3)
    if device is not None:
        check_device(device, threads, resolved.groups)
    if explain:
        print(_explained(resolved, device))
    name = resolved.groups[0].plan.system.name
    what = f"simulates {resolved.count} members of '{name}'"
    modes = Counter[str]()
    with shown(progress, f"simulating {resolved.count} of {name}", what=what) as done:
        trajectories = run_members(resolved, threads, done, rejected, device, modes)
    if explain:
        for label, count in sorted(modes.items(), key=lambda mode: (-mode[1], mode[0])):
            print(f"mode: {label}, in {count} members")
    return trajectories


def _checked(seeds: Sequence[int] | None) -> list[int] | None:
    if seeds is None:
        return None
    entries = entries_of(seeds)
    if entries is None:
        raise InputError(f"seeds must be a list of whole numbers, got {brief(seeds)}")
    return [whole(seed, "seed", 0) for seed in entries]


def check_device(device: str, threads: int | None, groups: Sequence[Group]) -> None:
    """Check that a device integrates members.

    Args:
        device: The device, "cuda".
        threads: Number of threads of the CPU; None is expected.
        groups: Groups of the members.
    Raises:
        InputError: There is no such device, or no device integrates these members.
    """
    if device != "cuda":
        raise InputError(f"device: expected None or 'cuda', got {brief(device)}")
    if threads is not None:
        raise InputError(f"threads: expected None with a device, got {brief(threads)}. Omit it.")
    for group in groups:
        if group.one_by_one:
            raise InputError(
                f"device: expected members that share a kernel, got {len(group.members)} that are "
                f"simulated one by one: {group.one_by_one}. Omit device."
            )
        if not isinstance(group.plan.method, Explicit):
            raise InputError(
                f"method: expected DOP853 or Tsit5 on a device, got {group.plan.method.name}. "
                "Choose one of them"
            )


def _explained(resolved: Members, device: str | None) -> str:
    """Describe how members are integrated, in one line for each group."""
    from .compiled.compiled_flow import flows_of
    from .members.integrate_members import lanes_of

    if device is not None:
        from ..kernels.device.equal_limbs import group_of
    lines = []
    for group in resolved.groups:
        plan = group.plan
        if why := group.one_by_one:
            lines.append(f"{len(group.members)} members one by one, {plan.method.name}: {why}")
            continue
        for members, flow in flows_of(plan, group.given, group.own):
            lanes = lanes_of(plan.method, flow.kernel)
            how = f"{lanes} at once in lanes" if lanes else "one after another"
            if device is not None:
                limbs = group_of(flow.kernel)
                threads = "thread" if limbs is None else f"{len(limbs.places)} threads"
                how = f"one per {threads} of a device ({device})"
            lines.append(
                f"{len(members)} members {how}, {plan.method.name}, "
                f"{flow.kernel.layout.size} numbers each"
            )
    return "\n".join(lines)


def run_members(
    members: Members,
    threads: int | None,
    progress: Callable[[float], None] | None,
    rejected: Sequence[Failure] = (),
    device: str | None = None,
    modes: Counter[str] | None = None,
) -> Trajectories:
    """Integrate members.

    Args:
        members: The members, in groups.
        threads: Number of threads; as many as processors if None.
        progress: Called with the completed fraction of the members.
        rejected: Failures of the members that belong to no group.
        device: "cuda" to integrate on a CUDA device, None for the CPU.
        modes: The number of members is added for each mode of motions with joint stops.
    Returns:
        The trajectories of all members.
    """
    for group in members.groups:
        if not group.one_by_one:
            expect_members(group.plan.method)
        else:
            refuse_with_stops(group.plan, checkpoint=False)
    from .compiled.compiled_flow import flows_of
    from .members.integrate_members import integrate_members
    from .members.member_options import reject_singular

    batches: list[Batch] = []
    single: dict[int, Trajectory] = {}
    failures = list(rejected)
    done = len(failures)

    def report(report_part: float, share: int) -> None:
        if progress is not None:
            progress((done + share * report_part) / members.count)

    for group in members.groups:
        if group.one_by_one:
            has_stops = bool(group.plan.scene.bounds)
            # Prescribed joints of a member may run into stops of the file.
            failing = (IntegrationError, InputError) if has_stops else IntegrationError
            for member in group.members.tolist():
                try:
                    traj = trajectory_of(members.scene_of(member))
                    if modes is not None and has_stops:
                        modes.update({label for _, label in traj.motion.modes})
                    # The segments of a motion with stops take more memory than its states.
                    single[member] = traj.without_motion() if has_stops else traj
                except failing as error:
                    time = getattr(error, "time", float("nan"))
                    failures.append(Failure(member, time, str(error)))
                done += 1
                report(0.0, 0)
            continue
        for members_of_flow, flow in flows_of(group.plan, group.given, group.own, threads):
            report_part = None if progress is None else partial(report, share=len(members_of_flow))
            batch = integrate_members(
                flow, group.plan, group.members[members_of_flow], threads, report_part, device
            )
            batches.append(batch)
            failures += batch.failures
            failures += reject_singular(batch, group.plan.scene.report_times, members.scene_of)
            done += len(members_of_flow)
    failures.sort(key=lambda failure: failure.member)
    return Trajectories((members.count, members.scene_of), batches, single, failures)
