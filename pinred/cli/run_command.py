"""`pinred run`: simulate the scene in a TOML file and print a summary."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from typing import TYPE_CHECKING

from ..common.errors import InputError
from ..common.names import listed
from .command_options import add_options, add_parameters, option_adder, parameters_in
from .compare_command import print_comparison
from .output_files import describe_file

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from ..simulation.trajectory import Trajectory

_TIMES = 8  # largest number of times of an event in a summary


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.scene_options import RUN_OPTIONS

    sub.add_argument("scene", metavar="SCENE", nargs="?", help="scene file (docs/scenes.md)")
    add = option_adder(sub)
    add("--validate", "validate the scene without running it")
    add("--explain", "print what the simulation skips")
    add("--compare", "compare with full ABA; exit 1 on failure")
    add("--out FILE", "write the motion to traj.npz or traj.csv")
    engine = replace(RUN_OPTIONS["engine"], default="the engine in the file")
    others = {name: RUN_OPTIONS[name] for name in ("check", "checkpoint")}
    add_options(sub, {"engine": engine, **others})
    add_parameters(sub, "value of a parameter of the file or of its robot, instead of the file's")
    add("--schema", "print the JSON Schema of scene files")


def run(arguments: argparse.Namespace) -> int:
    """Run the command.  Returns 0, or 1 if a comparison does not pass."""
    if arguments.schema:
        from ..scene.toml.keys import scene_schema

        print(json.dumps(scene_schema(), indent=2, ensure_ascii=False))
        return 0
    if arguments.scene is None:
        raise InputError("run needs a scene: the name of a TOML file; see `pinred run --help`")
    from ..common.files import check_path
    from ..scene.initial_state import large_angles
    from ..scene.toml.reader import read_scene_file
    from ..simulation.explain import explain
    from ..simulation.plan import plan_of
    from ..simulation.simulate import as_scene, simulate

    file = read_scene_file(arguments.scene)
    scene = file.scene
    if parameters := parameters_in(arguments.parameters):
        scene = as_scene(scene, {"parameters": parameters}, "run")
    explanation = explain(plan_of(scene))  # This also verifies that the scene can be simulated.
    if arguments.explain:
        print(explanation)
    elif note := large_angles(scene.given.x[0], scene.system):
        print(f"note: {note}")
    if arguments.validate:
        print(f"ok: {_title(scene)}")
        return 0
    path = None if arguments.out is None else check_path(arguments.out)
    engine, check = arguments.engine or file.engine, bool(arguments.check or file.check)
    checkpoint = arguments.checkpoint or file.checkpoint
    traj = simulate(scene, engine=engine, check=check, checkpoint=checkpoint, progress=True)
    print(summary(traj))
    if path is not None:
        traj.save(path)
        print(f"  {describe_file(path)}")
    return print_comparison(traj) if arguments.compare else 0


def summary(traj: Trajectory) -> str:
    """Return a short table of the results of a simulation."""
    from ..simulation.explain import integrated

    scene, run = traj.scene, traj.run
    lines = [
        ("integrated", integrated(traj.plan)),
        ("steps", f"{run.steps} of {run.method} ({run.engine}), {run.evaluations} evaluations"),
        ("wall time [s]", f"{run.wall:.5f}"),
    ]
    if scene.bounds:
        lines.append(("impacts", describe_impacts(traj)))
    lines += [(f"event {name}", text) for name, text in describe_events(traj)]
    if scene.left_out:
        lines.append(("left out", scene.left_out))
    if scene.outputs == "all":
        lines += _balances(traj)
    else:
        lines.append(("energy, momentum", "no balance: outputs = 'shape' leaves out the base"))
    width = max(len(name) for name, _ in lines)
    return "\n".join([_title(scene), *(f"  {name:<{width}}  {text}" for name, text in lines)])


def describe_impacts(traj: Trajectory) -> str:
    """Return the number of impacts, their joints, and the energy that they remove, in words."""
    table = traj.impacts
    if not len(table):
        return "none"
    joints = listed(sorted(set(table.joint)), _TIMES)
    return f"{len(table.times)} at stops of {joints}; {table.energy_lost.sum():.6g} J lost"


def describe_events(traj: Trajectory) -> list[tuple[str, str]]:
    """Return (name, times in words) of each event."""
    descriptions = []
    for name, crossings in traj.events.items():
        times = ", ".join(f"{t:.9g}" for t in crossings.t[:_TIMES])
        more = f", … ({len(crossings)} in all)" if len(crossings) > _TIMES else ""
        ends = "; the motion ends there" if name == traj.ended_by else ""
        text = f"t = {times}{more} s{ends}" if times else "does not happen"
        descriptions.append((name, text))
    return descriptions


def _title(scene: Scene) -> str:
    system = scene.system
    return f"{system.name}: {system.group.name} × {system.m} joints, {scene.end:g} s"


def _balances(traj: Trajectory) -> list[tuple[str, str]]:
    from ..judge.audit import audit_states
    from ..judge.reference_solution import FullState

    energy, momentum = traj.energy_balance, traj.momentum_balance
    work = energy.work.sum(axis=1)
    audit = audit_states(FullState(traj.scene), traj.states, work, momentum.impulse)
    lines = [("energy [J]", f"{energy.energy[0]:.6g} → {energy.energy[-1]:.6g}")]
    lines += [
        (f"work of {label} [J]", f"{work:.6g}")
        for label, work in zip(energy.labels, energy.work[-1], strict=True)
    ]
    lines.append(("energy balance", f"{audit.energy:.1e} of the kinetic energy"))
    lines.append(("momentum balance", f"{audit.momentum:.1e}, relative"))
    return lines
