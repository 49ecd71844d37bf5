"""Commands that simulate: simulate, run, compare and sweep.

Their options are described in scene/scene_options.py and scene/scene_options.py;
cli/command_options.py makes arguments of them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.names import listed, quoted
from .command_files import describe_file, print_report
from .command_options import (
    add_options,
    add_parameters,
    add_repeated,
    add_robot,
    add_scene,
    option_adder,
    options_in,
    parameters_in,
    scene_of,
)

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from ..scene.toml.reader import SceneFile
    from ..simulation.contact.chain import Chain
    from ..simulation.plan import Plan
    from ..simulation.trajectory import Trajectory
    from ..sweeps.sweep_result import SweepResult


def add_compare_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    add_scene(sub)
    sub.add_argument(
        "--budget", type=float, metavar="S",
        help="processor time after which ABA stops [s] (default: 30, or 500 times the run's)",
    )  # fmt: skip


def run_compare(arguments: argparse.Namespace) -> int:
    """Simulate and compare.  Returns 0 for PASSED, 1 for FAILED, 3 for CANNOT TELL."""
    from ..simulation.simulate import simulate

    scene, engine = scene_of(arguments), arguments.engine
    traj = simulate(scene, engine=engine, check=arguments.check, progress=True)
    return print_comparison(traj, arguments.budget)


def print_comparison(traj: Trajectory | Chain, budget: float | None = None) -> int:
    """Print the comparison of a motion with full ABA.  Returns 0, 1 or 3, as `run` does."""
    from ..judge.compare import compare

    return print_report(compare(traj, progress=True, budget=budget))


_TIMES = 8  # largest number of times of an event in a summary


def add_run_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.scene_options import RUN_OPTIONS

    sub.add_argument("scene", metavar="SCENE", nargs="?", help="scene file (docs/scenes.md)")
    add = option_adder(sub)
    add("--validate", "validate the scene without running it")
    add("--explain", "print what the simulation skips")
    add("--compare", "compare with full ABA; exit 1 on failure")
    add("--out FILE", "write the motion to traj.npz, .csv, .h5, .zarr or .xml")
    engine = replace(RUN_OPTIONS["engine"], default="the engine in the file")
    further = {name: RUN_OPTIONS[name] for name in ("check", "checkpoint")}
    add_options(sub, {"engine": engine, **further})
    add_parameters(sub, "value of a parameter of the file or of its robot, instead of the file's")
    add("--schema", "print the JSON Schema of scene files")


def run_run(arguments: argparse.Namespace) -> int:
    """Run the command.  Returns 0, or 1 if a comparison does not pass."""
    if arguments.schema:
        from ..scene.toml.documents import scene_schema

        print(json.dumps(scene_schema(), indent=2, ensure_ascii=False))
        return 0
    if arguments.scene is None:
        raise InputError("run needs a scene: the name of a TOML file; see `pinred run --help`")
    from ..common.files import check_path
    from ..scene.initial_state import large_angles
    from ..scene.toml.reader import read_scene_file
    from ..simulation.over_time import FOLDERS, SUFFIXES
    from ..simulation.plan import plan_of, refuse_with_stops
    from ..simulation.simulate import as_scene, explain_plan, simulate

    file = read_scene_file(arguments.scene)
    if file.phases:
        return _run_phases(arguments, file)
    scene = file.scene
    if parameters := parameters_in(arguments.parameters):
        scene = as_scene(scene, {"parameters": parameters}, "run")
    engine, check = arguments.engine or file.engine, bool(arguments.check or file.check)
    checkpoint = arguments.checkpoint or file.checkpoint
    plan = plan_of(scene)
    explanation = explain_plan(plan)  # This also verifies that the scene can be simulated.
    refuse_with_stops(plan, checkpoint=checkpoint is not None)
    if arguments.explain:
        print(explanation)
    elif note := large_angles(scene.given.x[0], scene.system):
        print(f"note: {note}")
    if arguments.validate:
        print(f"ok: {_title(scene)}")
        return 0
    path = None if arguments.out is None else check_path(arguments.out, SUFFIXES, folders=FOLDERS)
    traj = simulate(scene, engine=engine, check=check, checkpoint=checkpoint, progress=True)
    print(summary_of_run(traj))
    if path is not None:
        traj.save(path)
        print(f"  {describe_file(path)}")
    return print_comparison(traj) if arguments.compare else 0


def _run_phases(arguments: argparse.Namespace, file: SceneFile) -> int:
    """Run a file with several phases.  Returns 0, or 1 or 3 if a comparison does not pass."""
    from ..common.files import check_path
    from ..simulation.contact.chain import run_phases
    from ..simulation.over_time import FOLDERS, SUFFIXES
    from ..simulation.plan import plan_of
    from ..simulation.simulate import explain_plan

    for name in ("parameters", "checkpoint"):
        if getattr(arguments, name):
            raise InputError(f"--{name}: a file with several phases does not support it")
    scenes = [one.scene for one in (file, file.second) if one is not None]
    for scene in scenes:
        plan_of(scene)  # This verifies that they can be simulated.
    if arguments.validate:
        robots = " and ".join(scene.system.name for scene in scenes)
        print(f"ok: {robots}, {len(file.phases) + 1} phases; later robots are known when they run")
        return 0
    path = None if arguments.out is None else check_path(arguments.out, SUFFIXES, folders=FOLDERS)
    chain = run_phases(file, engine=arguments.engine, check=bool(arguments.check), progress=True)
    print(summary_of_chain(chain, explain_plan if arguments.explain else None))
    if path is not None:
        chain.save(path)
        print(describe_file(path))
    return print_comparison(chain) if arguments.compare else 0


def summary_of_chain(chain: Chain, explain: Callable[[Plan], object] | None = None) -> str:
    """Return the results of all motions of a chain, and its impacts.

    Args:
        chain: The chain.
        explain: Function that explains the plan of a motion; None to leave it out.
    """
    lines = list[str]()
    for number, phase in enumerate(chain.phases):
        for traj in phase.motions:
            lines += [] if explain is None else [str(explain(traj.plan))]
            lines.append(summary_of_run(traj))
        if number < len(chain.between) and (impact := chain.between[number]) is not None:
            lines.append(f"at t = {phase.end:g} s: {impact}")
    return "\n".join(lines)


def summary_of_run(traj: Trajectory) -> str:
    """Return a short table of the results of a simulation."""
    from ..simulation.simulate import integrated

    scene, run = traj.scene, traj.run
    lines = [
        ("integrated", integrated(traj.plan)),
        (
            "steps",
            f"{run.steps} of {run.method} ({run.engine}), {run.evaluations} evaluations",
        ),
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


def add_simulate_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.input_formats import EVEN_TIMES
    from ..scene.scene_options import RUN_OPTIONS

    add_robot(sub)
    add_scene(sub)
    add_options(sub, {name: RUN_OPTIONS[name] for name in ("samples", "checkpoint")})
    sub.set_defaults(samples=EVEN_TIMES)
    sub.add_argument("--out", metavar="FILE", required=True, help="traj.npz, csv, h5, zarr or xml")


def run_simulate(arguments: argparse.Namespace) -> int:
    """Simulate and write.  Returns 0."""
    import numpy as np

    from ..common.files import check_path
    from ..simulation.over_time import FOLDERS, SUFFIXES
    from ..simulation.simulate import simulate

    path = check_path(arguments.out, SUFFIXES, folders=FOLDERS)
    scene = scene_of(arguments)
    if arguments.samples < 2:
        raise InputError(f"--samples must be at least 2, got {arguments.samples}")
    scene = replace(scene, times=np.linspace(0.0, scene.end, arguments.samples))
    traj = simulate(
        scene,
        engine=arguments.engine,
        check=arguments.check,
        checkpoint=arguments.checkpoint,
        progress=True,
    )
    traj.save(path)
    if scene.left_out:
        print(scene.left_out)
    for name, text in describe_events(traj):
        print(f"event {name}: {text}")
    print(f"{traj}\n{describe_file(path)}")
    return 0


_QUANTILES = (0.05, 0.5, 0.95)


def add_sweep_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.scene_options import SWEEP_OPTIONS

    text = "scene file (docs/scenes.md); the options replace those of its table `sweep`"
    sub.add_argument("scene", metavar="SCENE", help=text)
    repeated = {name: SWEEP_OPTIONS[name] for name in ("vary", "outputs")}
    for option in repeated.values():
        add_repeated(sub, option.command, f"{option.description}; repeatable")
    single = {name: key for name, key in SWEEP_OPTIONS.items() if name not in repeated}
    add_options(sub, single)
    sub.add_argument("--threads", metavar="N", type=int, help="number of local threads")
    sub.add_argument("--device", choices=["cuda"], help="integrate on CUDA devices")
    add_parameters(sub, "value of a parameter of the file or of its robot, instead of the file's")


def run_sweep(arguments: argparse.Namespace) -> int:
    """Run the command.  Returns 0."""
    from ..scene.scene_options import SWEEP_OPTIONS
    from ..scene.toml.reader import read_scene_file, refuse_phases
    from ..scene.toml.schema import naming
    from ..simulation.simulate import as_scene
    from ..sweeps.sweep import sweep
    from ..system.body_parameters import refuse_vague
    from ..system.system import nominal

    file = read_scene_file(arguments.scene)
    refuse_phases(file)
    scene = file.scene
    if parameters := parameters_in(arguments.parameters):
        scene = as_scene(scene, {"parameters": parameters}, "sweep")
    with naming(file.place):
        for name in file.sweep.get("vary", {}):
            refuse_vague(nominal(scene.system), name)
    single = {name: key for name, key in SWEEP_OPTIONS.items() if name not in ("vary", "outputs")}
    stated = options_in(arguments, single)
    if arguments.vary:
        stated["vary"] = {**file.sweep.get("vary", {}), **_assigned(arguments.vary)}
    if arguments.outputs:
        stated["outputs"] = _outputs(arguments.outputs)
    options: dict[str, Any] = {**file.sweep, **stated}
    for name, example in (("vary", "front.mass=Uniform(0.5, 2)"), ("store", "results.zarr")):
        if name not in options:
            raise InputError(
                f"{name}: expected a table [sweep] with the key '{name}', or --{name} '{example}'"
            )
    with nullcontext() if stated else naming(file.place):
        result = sweep(
            scene, options.pop("vary"), threads=arguments.threads, device=arguments.device,
            progress=True, **options,
        )  # fmt: skip
    print(summary_of_sweep(result))
    print(f"  written to {options['store']}")
    return 0


def _assigned(entries: Sequence[str]) -> dict[str, str]:
    """Parse texts NAME=LAW.  Raises InputError."""
    values = {}
    for entry in entries:
        name, sign, text = entry.partition("=")
        if not (sign and name.strip() and text.strip()):
            raise InputError(
                f"--vary takes NAME=LAW, such as 'front.mass=Uniform(0.5, 2)', got {quoted(entry)}"
            )
        values[name.strip()] = text.strip()
    return values


def _outputs(entries: Sequence[str]) -> dict[str, str]:
    """Parse texts FIELD or NAME=FIELD."""
    values = {}
    for entry in entries:
        name, sign, field = entry.partition("=")
        values[name if sign else entry.removesuffix("(t)")] = field if sign else entry
    return values


def summary_of_sweep(result: SweepResult) -> str:
    """Return the number of points by status, and the quantiles of all scalar outputs."""
    import numpy as np

    status = result["status"].values
    lines = [
        f"{result.attrs['robot']}: {len(status)} points, {int((status == 2).sum())} failed, "
        f"{int((status == 3).sum())} rejected"
    ]
    for name, values in result.data_vars.items():
        if values.dims != ("point",) or name == "status":
            continue
        quantiles = np.nanquantile(values.values, _QUANTILES)
        unit = values.attrs.get("units", "")
        shown = ", ".join(f"{value:.6g}" for value in quantiles)
        percents = ", ".join(f"{100 * quantile:.0f}" for quantile in _QUANTILES)
        lines.append(f"  {name}{f' [{unit}]' if unit else ''}: {shown} at {percents} %")
    return "\n".join(lines)
