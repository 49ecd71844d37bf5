"""`pinred run`: simulate the scene in a file, and print a summary."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from ..common.errors import InputError
from .compare import judged
from .options import add_parameters, parameters_in
from .written import written

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from ..simulation.trajectory import Trajectory

_TIMES = 8  # of an event, in a summary


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.scene import ENGINES

    sub.add_argument("scene", metavar="SCENE", nargs="?", help="a TOML file (docs/scenes.md)")
    sub.add_argument("--check", action="store_true", help="say whether it can run; do not run it")
    sub.add_argument("--explain", action="store_true", help="print what is skipped")
    sub.add_argument("--compare", action="store_true", help="judge by full ABA; exit 1 if it fails")
    sub.add_argument("--out", metavar="FILE", help="write the motion: traj.npz or traj.csv")
    engines = " or ".join(ENGINES)
    sub.add_argument("--engine", metavar="E", help=f"{engines}, whatever the file says")
    add_parameters(sub, "a parameter of the file or a number of its robot, whatever the file says")
    sub.add_argument("--schema", action="store_true", help="print the JSON Schema of scenes")


def run(options: argparse.Namespace) -> int:
    """Run the command.  Returns 0, or 1 if a comparison does not pass."""
    if options.schema:
        from ..scene.toml.keys import scene_schema

        print(json.dumps(scene_schema(), indent=2, ensure_ascii=False))
        return 0
    if options.scene is None:
        raise InputError("run needs a scene: the name of a TOML file; see `pinred run --help`")
    from ..common.files import check_path
    from ..scene.angles import large_angles
    from ..scene.toml.reader import read_scene_file
    from ..simulation.explain import explain
    from ..simulation.plan import plan_of
    from ..simulation.simulate import as_scene, simulate

    file = read_scene_file(options.scene)
    scene = file.scene
    if parameters := parameters_in(options.parameter):
        scene = as_scene(scene, {"parameters": parameters}, "run")
    explanation = explain(plan_of(scene))  # finds out whether the scene can run, too
    if options.explain:
        print(explanation)
    elif note := large_angles(scene.given.x[0], scene.system):
        print(f"note: {note}")
    if options.check:
        print(f"ok: {_title(scene)}")
        return 0
    path = None if options.out is None else check_path(options.out)
    traj = simulate(scene, engine=options.engine or file.engine, progress=True)
    print(summary(traj))
    if path is not None:
        traj.save(path)
        print(f"  {written(path)}")
    return judged(traj) if options.compare else 0


def summary(traj: Trajectory) -> str:
    """Return a short table of a simulation's results."""
    from ..simulation.explain import integrated

    scene, run = traj.scene, traj.run
    rows = [
        ("integrated", integrated(traj.plan)),
        ("steps", f"{run.steps} of {run.method} ({run.engine}), {run.evaluations} evaluations"),
        ("wall time [s]", f"{run.wall:.5f}"),
    ]
    rows += [(f"event {name}", text) for name, text in told_events(traj)]
    if scene.left_out:
        rows.append(("left out", scene.left_out))
    if scene.outputs == "all":
        rows += _balances(traj)
    else:
        rows.append(("energy, momentum", "no balance: outputs = 'shape' leaves out the base"))
    width = max(len(name) for name, _ in rows)
    return "\n".join([_title(scene), *(f"  {name:<{width}}  {text}" for name, text in rows)])


def told_events(traj: Trajectory) -> list[tuple[str, str]]:
    """Return the names of the events, each with its times in words."""
    out = []
    for name, found in traj.events.items():
        times = ", ".join(f"{t:.9g}" for t in found.t[:_TIMES])
        more = f", … ({len(found)} in all)" if len(found) > _TIMES else ""
        ends = "; the motion ends there" if name == traj.ended_by else ""
        out.append((name, f"t = {times}{more} s{ends}" if times else "does not happen"))
    return out


def _title(scene: Scene) -> str:
    system = scene.system
    return f"{system.name}: {system.group.name} × {system.m} joints, {scene.end:g} s"


def _balances(traj: Trajectory) -> list[tuple[str, str]]:
    from ..judge.audit import audit_states
    from ..judge.reference_solution import FullState

    energy, momentum = traj.energy_balance, traj.momentum_balance
    work = energy.work.sum(axis=1)
    audit = audit_states(FullState(traj.scene), traj.states, work, momentum.impulse)
    rows = [("energy [J]", f"{energy.energy[0]:.6g} → {energy.energy[-1]:.6g}")]
    rows += [
        (f"work of {label} [J]", f"{work:.6g}")
        for label, work in zip(energy.labels, energy.work[-1], strict=True)
    ]
    rows.append(("energy balance", f"{audit.energy:.1e} of the kinetic energy"))
    rows.append(("momentum balance", f"{audit.momentum:.1e}, relative"))
    return rows
