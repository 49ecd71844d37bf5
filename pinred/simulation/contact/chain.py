"""Chain: phases of motion with captures, releases and landings between them, as one motion.

`simulate_chain` simulates all phases of a scene file.

All phases have the same links.  The states of a chain are those of one system that has all their
joints: both robots of a capture with free joints between them, or the robot that floats before it
lands.  A phase with fewer freedoms is a motion of this system, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, entries_of
from ...common.errors import InputError
from ...common.names import brief, listed
from ...common.waiting import Progress
from ...scene.scene import Engine
from ...system.assembly import take_apart
from ...system.derived_systems import (
    Instant,
    Moving,
    Transfer,
    free_prefix,
    link_motions,
    pair,
    place_of,
    placements,
    pose_of,
)
from ...system.state_fields import State, arrays_of
from ...system.system import System
from ..impacts import ImpactTable, joined_tables
from ..read_recording import Recording
from ..simulate import simulate
from ..trajectory import Trajectory
from .capture import (
    Capture,
    Landing,
    Release,
    capture,
    land,
    mass_matrix,
    moment_of,
    options_of,
    release,
)

if TYPE_CHECKING:
    from ...scene.toml.reader import LaterPhase, SceneFile

Impact: TypeAlias = Capture | Release | Landing
_FITTING = 1e-9  # largest accepted jump between parts of a chain, relative to size and speed
_SAME_END = 1e-12  # largest relative difference of the ends of motions of one phase


@dataclass(frozen=True, eq=False)
class Phase:
    """Motions at the same time, between two impacts.

    Attributes:
        motions: One motion for each system.
        prefixes: Text before the names of each system in the system of the chain.
        start: Time of the chain at which they start [s].
        end: Time of the chain at which they end [s].
    """

    motions: tuple[Trajectory, ...]
    prefixes: tuple[str, ...]
    start: float
    end: float

    def parts(self, time: float) -> list[Moving]:
        """Return the states of all systems at a time of the chain [s]."""
        return [
            Moving(traj.system, _instant(traj, time - self.start), prefix)
            for traj, prefix in zip(self.motions, self.prefixes, strict=True)
        ]


@checks_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Chain(Recording):
    """Several phases as one motion, with the states of one system that contains all robots.

    It plots, plays and saves like a recording.  At an impact it has two states: the one after the
    impact is stored at the next larger number.

    Attributes:
        path: Empty.
        robot: Name of the system.
        group: Name of its symmetry group.
        joints: Labels of its shape rates.
        content: States at the report times of all phases.
        origin: Arrays of a recording; empty.
        confirmed: Whether the user named the robot; it is known.
        phases: The phases.
        between: What happens after each phase: a Capture, Release or Landing, or None.  After the
            last one nothing need happen.
        impacts: The impacts at joint stops in all phases.
        whole: The system that contains the robots of all phases; `system` is the same.
    """

    phases: tuple[Phase, ...] = ()
    between: tuple[Impact | None, ...] = ()
    whole: System | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        names = [f"{phase.end - phase.start:g} s" for phase in self.phases]
        for k, impact in enumerate(self.between):
            names[k] += f", {type(impact).__name__.lower()}" if impact else ""
        return f"<Chain of {self.robot!r}: {', '.join(names)}>"

    @property
    def _name(self) -> str:
        return self.robot

    @cached_property
    def system(self) -> System:
        """The system that contains the robots of all phases."""
        assert self.whole is not None
        return self.whole

    @property
    def end(self) -> float:
        """End of the last phase [s]; the first starts at 0."""
        return self.phases[-1].end


def chain(*parts: Any) -> Chain:
    """Connect motions, and the impacts between them, to one motion.

    Args:
        parts: Trajectories in the order of time, with the Capture, Release or Landing between
            them.  Systems that move at the same time are a list of motions:
            chain([chaser, target], capture, together).  An impact at the end is the last state.
    Returns:
        The chain.
    Raises:
        InputError: A part does not start where the one before it ends, motions of one phase differ
            in duration, or they contain other links than the first.
    """
    motions, impacts = _ordered(parts)
    whole = _whole(motions, impacts)
    phases, time, columns = list[Phase](), 0.0, list[dict[str, Array]]()
    for k, moving in enumerate(motions):
        prefixes = _prefixes(whole, [traj.system for traj in moving])
        ends = [traj.scene.end for traj in moving]
        if np.ptp(ends) > _SAME_END * max(ends):
            raise InputError(
                f"chain: motions of one phase must end together, got {listed(list(map(str, ends)))}"
                " s. Simulate each to the same time"
            )
        phase = Phase(tuple(moving), prefixes, time, time + ends[0])
        if phases:
            _check_fit(whole, phases[-1], impacts[k - 1], phase)
        phases.append(phase)
        columns.append(_states(whole, phase, columns[-1] if columns else None))
        time = phase.end
    if len(impacts) == len(phases):
        columns.append(_end_state(whole, phases[-1], impacts[-1], columns[-1]))
    content = {
        name: np.concatenate([block[name] for block in columns])
        for name in State.__dataclass_fields__
    }
    return Chain(
        Path(), whole.name, whole.group.name, whole.shape_names, State(**content), {},
        impacts=_stop_impacts(whole, phases), confirmed=True,
        phases=tuple(phases), between=impacts, whole=whole,
    )  # fmt: skip


def _stop_impacts(whole: System, phases: Sequence[Phase]) -> ImpactTable:
    """Return the impacts at joint stops in all phases, at times of the chain."""
    tables = list[ImpactTable]()
    for phase in phases:
        for traj, prefix in zip(phase.motions, phase.prefixes, strict=True):
            table = traj.impacts
            names = tuple(prefix + joint for joint in table.joint)
            table = replace(table, t=table.t + phase.start, joint=names)
            if traj.system.group is not whole.group:  # as in the stance of a landing
                unknown = np.full((len(table), whole.r), np.nan)
                table = replace(table, momentum_before=unknown, momentum_after=unknown)
            tables.append(table)
    return joined_tables(tables)


def _ordered(
    parts: Sequence[Any],
) -> tuple[list[tuple[Trajectory, ...]], tuple[Impact | None, ...]]:
    """Return the motions of each phase, and what happens between phases."""
    motions, impacts = list[tuple[Trajectory, ...]](), list[Impact | None]()
    pending: Impact | None = None
    for part in parts:
        if isinstance(part, Capture | Release | Landing):
            if pending is not None or not motions:
                raise InputError("chain: expected a motion before each Capture, Release or Landing")
            pending = part
            continue
        moving = (part,) if isinstance(part, Trajectory) else tuple(entries_of(part) or ())
        if not moving or not all(isinstance(traj, Trajectory) for traj in moving):
            raise InputError(
                "chain: expected a Trajectory, a list of them, a Capture, Release or Landing, got "
                f"{brief(part)}"
            )
        if motions:
            impacts.append(pending)
        motions.append(moving)
        pending = None
    if not motions:
        raise InputError("chain: expected a motion, got nothing. Pass the trajectories of simulate")
    return motions, (*impacts, *([] if pending is None else [pending]))


def _whole(motions: Sequence[Sequence[Trajectory]], impacts: Sequence[Impact | None]) -> System:
    """Return a system that has the freedoms of all phases."""
    first, *later_systems = (traj.system for traj in motions[0])
    captures = [impact for impact in impacts if isinstance(impact, Capture)]
    releases = [impact for impact in impacts if isinstance(impact, Release)]
    whole = first
    for system in later_systems:
        stated = [c.prefix for c in captures if c.b is system]
        whole = pair(whole, system, prefix=stated[0] if stated else free_prefix(whole, system))
    if not later_systems and releases:
        whole = pair(releases[0].carrier.system, releases[0].released.system, prefix="")
    return whole


def _prefixes(whole: System, systems: Sequence[System]) -> tuple[str, ...]:
    """Return the text before the names of each system in the whole.  Raises InputError."""
    links = take_apart(whole).links
    covered, prefixes = set[str](), list[str]()
    for system in systems:
        names = _heavy(system)
        shifts = sorted((n.removesuffix(names[0]) for n in links if n.endswith(names[0])), key=len)
        fitting = (p for p in shifts if {p + n for n in names} <= links.keys() - covered)
        prefix = next(fitting, None)
        if prefix is None:
            raise InputError(
                f"chain: '{whole.name}' does not contain all links of '{system.name}'. All phases "
                "have the same links; name all robots in the first phase"
            )
        covered |= {prefix + n for n in names}
        prefixes.append(prefix)
    if missing := {*_heavy(whole)} - covered:
        raise InputError(
            f"chain: a phase lacks {listed(sorted(missing), 6)} of '{whole.name}'. State the "
            "motions of all robots in each phase"
        )
    return tuple(prefixes)


def _heavy(system: System) -> list[str]:
    """Return the names of the links with mass."""
    return [n for n, link in take_apart(system).links.items() if link.inertia.mass > 0.0]


def _instant(traj: Trajectory, time: float) -> Instant:
    state = traj(min(max(time, 0.0), traj.scene.end))
    return Instant(state.pose, state.x, state.xdot, state.xi)


def parts_of(whole: System, impact: Impact) -> tuple[list[Moving], list[Moving]]:
    """Return the systems with their states before and after an impact, with prefixes in `whole`."""
    if isinstance(impact, Capture):
        before = [(impact.a, impact.before_a), (impact.b, impact.before_b)]
        after = [(impact.system, impact.instant)]
    elif isinstance(impact, Release):
        before = [(impact.whole, impact.before)]
        after = [(p.system, p.instant) for p in (impact.carrier, impact.released)]
    else:
        before, after = [(impact.system, impact.before)], [(impact.system, impact.instant)]
    return _named(whole, before), _named(whole, after)


def _named(whole: System, parts: Sequence[tuple[System, Instant]]) -> list[Moving]:
    prefixes = _prefixes(whole, [system for system, _ in parts])
    return [Moving(*moment, prefix) for moment, prefix in zip(parts, prefixes, strict=True)]


def gap(a: Sequence[Moving], b: Sequence[Moving]) -> float:
    """Return the largest difference of the motions of common links, relative to size and speed."""
    first, second = ({n: m for p in parts for n, m in link_motions(p).items()} for parts in (a, b))
    common = first.keys() & second.keys()
    places, twists = (
        np.array([[np.ravel(m[n][k].homogeneous) if k == 0 else m[n][k].vector for n in common]
                  for m in (first, second)])
        for k in (0, 1)
    )  # fmt: skip
    return max(
        float(
            np.abs(values[1] - values[0]).max(initial=0.0)
            / max(np.abs(values).max(initial=0.0), 1.0)
        )
        for values in (places, twists)
    )


def _after(whole: System, before: Phase, impact: Impact) -> list[Moving]:
    """Return the systems with their states after an impact at the end of a phase.

    Args:
        whole: System of the chain.
        before: The phase.
        impact: The impact.
    Raises:
        InputError: The phase does not end in the state before the impact.
    """
    ends, starts = parts_of(whole, impact)
    if gap(before.parts(before.end), ends) > _FITTING:
        raise InputError(
            f"chain: the {type(impact).__name__} at t = {before.end:g} s does not have the state "
            "at which the motion before it ends. Pass this motion to it"
        )
    return starts


def _end_state(
    whole: System, phase: Phase, impact: Impact | None, before: dict[str, Array]
) -> dict[str, Array]:
    """Return the state after an impact with which a chain ends, by field, (1, …)."""
    assert impact is not None
    robots = _after(whole, phase, impact)
    transfer = Transfer(
        [robot.system for robot in robots], [robot.prefix for robot in robots], whole
    )
    state = _continued(whole, transfer(robots), (before["pose"][-1], before["x"][-1]))
    lost = 0.0 if isinstance(impact, Release) else impact.energy_lost
    values = _fields(whole, state, before["energy"][-1] - lost)
    t = np.nextafter(before["t"][-1], np.inf)
    return {name: np.array([value]) for name, value in (values | {"t": t}).items()}


def _check_fit(whole: System, before: Phase, impact: Impact | None, after: Phase) -> None:
    """Reject phases that do not fit to the impact between them."""
    # An impact at a stop may follow at once, so the states count from which the motions start.
    end = before.parts(before.end)
    start = [
        Moving(traj.system, moment_of(traj.scene, "chain")[1], prefix)
        for traj, prefix in zip(after.motions, after.prefixes, strict=True)
    ]
    what = "the motion before" if impact is None else f"the {type(impact).__name__}"
    starts = end if impact is None else _after(whole, before, impact)
    if gap(starts, start) > _FITTING:
        raise InputError(
            f"chain: the motion at t = {after.start:g} s does not start where {what} ends. "
            "Simulate it with **start of the impact, and without prescribed joints that jump"
        )


def _states(whole: System, phase: Phase, before: dict[str, Array] | None) -> dict[str, Array]:
    """Return the states of a phase by field; quaternions and angles go on from those before."""
    times = np.unique(np.concatenate([traj.t for traj in phase.motions]))
    times = np.clip(times, 0.0, min(traj.scene.end for traj in phase.motions))
    t = phase.start + times
    if before is not None and t[0] <= before["t"][-1]:
        t[0] = np.nextafter(before["t"][-1], np.inf)
    (first, *later_motions) = phase.motions
    if not later_motions and first.system is whole:
        return {**arrays_of(first(times)), "t": t}
    states = [traj(times) for traj in phase.motions]
    columns: dict[str, list[Array]] = {name: [] for name in State.__dataclass_fields__}
    transfer = Transfer([traj.system for traj in phase.motions], phase.prefixes, whole)
    last = None if before is None else (before["pose"][-1], before["x"][-1])
    for k in range(len(times)):
        robots = [
            Moving(traj.system, Instant(s.pose[k], s.x[k], s.xdot[k], s.xi[k]), prefix)
            for traj, s, prefix in zip(phase.motions, states, phase.prefixes, strict=True)
        ]
        state = _continued(whole, transfer(robots), last)
        last = state.pose, state.x
        energy = float(np.sum([s.energy[k] for s in states]))
        for name, value in _fields(whole, state, energy).items():
            columns[name].append(value)
    return {**{name: np.array(values) for name, values in columns.items() if name != "t"}, "t": t}


def _fields(whole: System, state: Instant, energy: float) -> dict[str, Any]:
    """Return the fields of a State except its time, with the energy [J]."""
    mu = (mass_matrix(whole, state) @ np.concatenate([state.xi, state.xdot]))[: whole.r]
    return {
        "x": state.x, "xdot": state.xdot, "xi": state.xi, "pose": state.pose,
        "q": whole.q(state.pose, state.x), "v": whole.v(state.xi, state.xdot),
        "body_momentum": mu, "spatial_momentum": whole.group.spatial_momentum(state.pose, mu),
        "energy": energy,
    }  # fmt: skip


def _continued(whole: System, state: Instant, last: tuple[Array, Array] | None) -> Instant:
    """Return the same state, with quaternions and angles nearest to the last ones."""
    if last is None:
        return state
    pose, x = state.pose.copy(), state.x.copy()
    group, turn = whole.group, 2.0 * np.pi
    attitudes = [(x, last[1], joint.x) for joint in whole.space.joints if joint.kind.is_ball]
    if group.turns == 3:
        attitudes.append((pose, last[0], slice(group.linear, group.size)))
    for values, previous, entries in attitudes:
        if values[entries] @ previous[entries] < 0.0:
            values[entries] *= -1.0
    angles = [
        (x, last[1], j.x)
        for j in whole.space.joints
        if not j.kind.is_ball and j.kind.units == ("rad",)
    ]
    if group.turns == 1:
        angles.append((pose, last[0], slice(group.linear, group.size)))
    for values, previous, entries in angles:
        values[entries] += turn * np.round((previous[entries] - values[entries]) / turn)
    return Instant(pose, x, state.xdot, state.xi)


@checks_arguments
def simulate_chain(
    path: str | Path,
    *,
    engine: Engine | None = None,
    check: bool = False,
    progress: Progress | bool | None = None,
) -> Chain:
    """Simulate a scene file with several phases: motions, captures, releases and landings.

    Args:
        path: Path of the file; docs/capture.md shows one, and docs/scenes.md lists its keys.
        engine: Engine of all motions, instead of those in the file.
        check: Whether to find forces that steps skip in all motions, and not only where the file
            says so.
        progress: True for a progress bar for each motion; see `simulate`.
    Returns:
        The chain of all phases.
    Raises:
        InputError: A key or value is not valid, the file has one phase, or an impact is not
            possible; the message names file, line and key.
        LoadError: The file, or a file that it names, cannot be read.
    """
    from ...scene.toml.reader import read_scene_file

    file = read_scene_file(path)
    if not file.phases:
        raise InputError(
            f"simulate_chain: '{path}' has no tables [[phases]]; simulate(load_scene(path)) "
            "simulates its motion"
        )
    return run_phases(file, engine=engine, check=check, progress=progress)


def run_phases(
    file: SceneFile,
    *,
    engine: Engine | None = None,
    check: bool = False,
    progress: Progress | bool | None = None,
) -> Chain:
    """Simulate all phases of a file that was read; see simulate_chain."""

    def play(*files: SceneFile) -> list[Trajectory]:
        """Simulate robots that move at the same time: until the first one ends."""
        motions = list[Trajectory]()
        for one in files:
            scene = one.scene
            if motions:  # an event may end the motion of the first early
                scene = replace(scene, duration=motions[0].scene.end)
            run = {"engine": engine or one.engine, "check": check or one.check}
            motions.append(simulate(scene, progress=progress, **run))  # type: ignore[arg-type]
        return motions

    def approach(second: SceneFile | None) -> list[Trajectory]:
        return play(file, *([] if second is None else [second]))

    moving = approach(file.second)
    parts: list[Any] = [moving]
    for number, phase in enumerate(file.phases):
        if phase.impact is not None and phase.impact[1].get("align"):
            if number or file.second is None:
                phase.place.fail(
                    "align: expected the two robots of the file in the phase before the capture"
                )
            parts = [moving := approach(_aligned(file.second, phase, moving))]
        impact, states = _impact_before(phase, moving)
        parts += [] if impact is None else [impact]
        if isinstance(impact, Landing) and not states:
            if number + 1 < len(file.phases) or "run" in phase.document:
                (phase.place / "land").fail(impact.why_no_stance)
            break
        moving = play(*(
            phase.scene_file(system, start, second=k > 0)
            for k, (system, start) in enumerate(states)
        ))  # fmt: skip
        parts.append(moving)
    return chain(*parts)


def _impact_before(
    phase: LaterPhase, moving: Sequence[Trajectory]
) -> tuple[Impact | None, list[tuple[System, dict[str, Any]]]]:
    """Return the impact before a phase, and the robots after it with the options that start them.

    Args:
        phase: The phase.
        moving: Motions of the phase before it.
    Returns:
        The impact, or None; and the robots, none after a landing that leaves no symmetry.
    Raises:
        InputError: The impact is not possible.
    """
    if phase.impact is None:
        ends = [moment_of(traj, "phases") for traj in moving]
        return None, [(system, options_of(state)) for system, state in ends]
    from ...scene.toml.schema import naming

    name, options = phase.impact
    place = phase.place / name
    if (name == "capture") != (len(moving) == 2):
        place.fail(
            f"a {name} needs {'two robots' if name == 'capture' else 'one robot'}, and "
            f"{len(moving)} move. State the other robot as [second], or capture it before"
        )
    with naming(place, f"{name}: "):
        if name == "capture":
            options.pop("align", None)
            caught = capture(moving[0], moving[1], **options)
            return caught, [(caught.system, caught.start)]
        if name == "release":
            parts = release(moving[0], **options)
            return parts, [(p.system, p.start) for p in (parts.carrier, parts.released)]
        landing = land(moving[0], **options)
        stance = landing.stance
        return landing, [] if stance is None else [(stance.system, stance.start)]


def _aligned(second: SceneFile, phase: LaterPhase, moving: Sequence[Trajectory]) -> SceneFile:
    """Return the file of the second robot with the pose at which its frame meets that of the first.

    A robot moves alike from every pose, so its start moves by the difference of the frames at the
    end.
    """
    from ...scene.toml.schema import naming

    assert phase.impact is not None
    with naming(phase.place / "capture"):
        at, onto = (
            _placement(*moment_of(traj, name), phase.impact[1][name], name)
            for traj, name in zip(moving, ("at", "onto"), strict=True)
        )
        system, start = second.scene.system, second.scene.start
        fixed = system.sorted_model.jointPlacements[1]
        base = placements(system, start.pose, start.x).oMi[1]
        pose = pose_of(system, fixed.actInv(at * onto.inverse() * base))
        return replace(second, scene=replace(second.scene, pose0=pose))


def _placement(system: System, state: Instant, name: str, what: str) -> pin.SE3:
    place = place_of(system, name, what)
    return placements(system, state.pose, state.x).oMi[place.joint] * place.on_joint
