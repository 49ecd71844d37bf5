"""simulate_chain(): all phases of a scene file, with the impacts between them, as one motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError
from ...common.waiting import Progress
from ...scene.scene import Engine
from ...scene.toml.file_place import naming
from ...scene.toml.reader import LaterPhase, SceneFile, read_scene_file
from ...system.derived_systems import Instant, place_of, placements, pose_of
from ...system.system import System
from ..simulate import simulate
from ..trajectory import Trajectory
from .capture import capture, moment_of, options_of, release
from .chain import Chain, Impact, chain
from .landing import Landing, land


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
        impact, states = _after(phase, moving)
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


def _after(
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
