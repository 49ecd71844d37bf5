"""Commands that simulate: simulate, run, compare, sweep, and capture, release and land.

scene/scene_options.py describes their options; cli/command_options.py makes arguments of them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.files import DATA, check_path
from ..common.names import listed
from .command_options import (
    add_options,
    add_parameters,
    add_repeated,
    add_robot,
    add_scene,
    assigned_in,
    check_robot,
    describe_file,
    motion_in,
    option_adder,
    options_in,
    out_path,
    parameters_in,
    print_report,
    scene_of,
)

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from ..scene.toml.reader import SceneFile
    from ..scene.toml.schema import Key
    from ..simulation.contact.capture import Capture, Landing, Release
    from ..simulation.contact.chain import Chain
    from ..simulation.plan import Plan
    from ..simulation.trajectory import Trajectory
    from ..sweeps.sweep_result import SweepResult
    from ..system.system import System
    from ..views.motion_source import MotionSource


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
        from ..scene.toml.reader import scene_schema

        print(json.dumps(scene_schema(), indent=2, ensure_ascii=False))
        return 0
    if arguments.scene is None:
        raise InputError("run needs a scene: the name of a TOML file; see `pinred run --help`")
    from ..scene.initial_state import large_angles
    from ..scene.toml.reader import read_scene_file
    from ..simulation.plan import plan_of, refuse_with_stops
    from ..simulation.saved_states import FOLDERS, SUFFIXES
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
    path = out_path(arguments, SUFFIXES, FOLDERS)
    traj = simulate(scene, engine=engine, check=check, checkpoint=checkpoint, progress=True)
    print(summary_of_run(traj))
    if path is not None:
        traj.save(path)
        print(f"  {describe_file(path)}")
    return print_comparison(traj) if arguments.compare else 0


def _run_phases(arguments: argparse.Namespace, file: SceneFile) -> int:
    """Run a file with several phases.  Returns 0, or 1 or 3 if a comparison does not pass."""
    from ..simulation.contact.chain import run_phases
    from ..simulation.plan import plan_of
    from ..simulation.saved_states import FOLDERS, SUFFIXES
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
    path = out_path(arguments, SUFFIXES, FOLDERS)
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
    from ..scene.parse_options import EVEN_TIMES
    from ..scene.scene_options import RUN_OPTIONS

    add_robot(sub)
    add_scene(sub)
    add_options(sub, {name: RUN_OPTIONS[name] for name in ("samples", "checkpoint")})
    sub.set_defaults(samples=EVEN_TIMES)
    sub.add_argument("--out", metavar="FILE", required=True, help="traj.npz, csv, h5, zarr or xml")


def run_simulate(arguments: argparse.Namespace) -> int:
    """Simulate and write.  Returns 0."""
    import numpy as np

    from ..simulation.saved_states import FOLDERS, SUFFIXES
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
        stated["vary"] = {**file.sweep.get("vary", {}), **_laws(arguments.vary)}
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


def _laws(entries: Sequence[str]) -> dict[str, str]:
    """Parse texts NAME=LAW.  Raises InputError."""

    def read(text: str) -> str:
        if not text.strip():
            raise ValueError
        return text.strip()

    usage = "NAME=LAW, such as 'front.mass=Uniform(0.5, 2)'"
    laws = assigned_in(entries, "vary", read, usage, noun="")
    return {name.strip(): law for name, law in laws.items()}


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


_MOTION = "scene file (.toml), whose end counts, or motion traj.npz, whose last state counts"
_AFTER = (
    "duration", "prescribed", "hold", "springs", "passive", "friction", "rtol", "atol", "method",
)  # fmt: skip


def add_capture_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("first", metavar="FIRST", help=f"the robot that captures: {_MOTION}")
    sub.add_argument("second", metavar="SECOND", help="the other robot, at the same time")
    add = option_adder(sub)
    add("--at FRAME", "link or frame of the first", required=True)
    add("--onto FRAME", "link or frame of the second", required=True)
    add("--tolerance T", "largest distance [m] and angle [rad] of the frames", float, 1e-6)
    add("--prefix P", "text before the names of the second")
    _add_after(sub)


def run_capture(arguments: argparse.Namespace) -> int:
    """Print the capture.  Returns 0, or the verdict of --compare."""
    from ..simulation.contact.capture import capture

    _check_after(arguments)
    motions = [_motion_before(path) for path in (arguments.first, arguments.second)]
    result = capture(
        motions[0], motions[1], at=arguments.at, onto=arguments.onto,
        tolerance=arguments.tolerance, prefix=arguments.prefix,
    )  # fmt: skip
    return _follow(arguments, motions, result, [(result.system, result.start)])


def add_release_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("motion", metavar="MOTION", help=f"the robot: {_MOTION}")
    add = option_adder(sub)
    add("--link LINK", "link behind the joint that opens, or the joint", required=True)
    add("--root LINK", "link of the released part that its pose describes", default="")
    _add_after(sub)


def run_release(arguments: argparse.Namespace) -> int:
    """Print the release.  Returns 0, or the verdict of --compare."""
    from ..simulation.contact.capture import release

    _check_after(arguments)
    motion = _motion_before(arguments.motion)
    result = release(motion, arguments.link, root=arguments.root)
    systems = (result.carrier, result.released)
    return _follow(arguments, [motion], result, [(state.system, state.start) for state in systems])


def add_land_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("motion", metavar="MOTION", help=f"the robot in flight: {_MOTION}")
    add = option_adder(sub)
    add("--frame F[,F2]", "link or frame that stops, or several at once", required=True)
    add("--contact C", "point: its origin stops; flat: it stops turning, too", str, "point")
    _add_after(sub)


def run_land(arguments: argparse.Namespace) -> int:
    """Print the landing.  Returns 0, or the verdict of --compare."""
    from ..simulation.contact.capture import land

    _check_after(arguments)
    motion = _motion_before(arguments.motion)
    landing = land(motion, arguments.frame.split(","), contact=arguments.contact)
    stance = landing.stance
    if stance is None and arguments.duration is not None:
        raise InputError(f"--duration: {landing.why_no_stance}")
    states = [] if stance is None else [(stance.system, stance.start)]
    return _follow(arguments, [motion], landing, states)


def _add_after(sub: argparse.ArgumentParser) -> None:
    """Add the options of the motion after the impact."""
    add_options(sub, _keys())
    add = option_adder(sub)
    add("--compare", "compare all motions with full ABA, and the impact with full mass matrices")
    add("--out FILE", "write the motions and the impact as one motion (.npz, .csv)")


def _keys() -> dict[str, Key]:
    from ..scene.scene_options import SCENE_OPTIONS

    return {name: SCENE_OPTIONS[name] for name in _AFTER}


def _check_after(arguments: argparse.Namespace) -> None:
    """Check the options before a long simulation.  Raises InputError."""
    options = options_in(arguments, _keys())
    out_path(arguments, DATA)
    if "duration" not in options and options:
        raise InputError("pass --duration T to simulate the motion after the impact")


def _motion_before(path: str) -> MotionSource:
    """Return the motion in a scene file or recording."""
    check_robot(path, None)
    if Path(path).suffix not in (".toml", ".npz"):
        raise InputError(f"expected a scene file (.toml) or a motion (.npz), got '{path}'")
    return motion_in(path, None)


def _follow(
    arguments: argparse.Namespace,
    before: Sequence[MotionSource],
    impact: Capture | Release | Landing,
    states: Sequence[tuple[System, dict[str, Any]]],
) -> int:
    """Print an impact, simulate what follows, if requested, and write and compare all of it.

    Args:
        arguments: Parsed arguments of the command.
        before: Motions that end at the impact.
        impact: The impact.
        states: Systems after it, with the options that start them.
    Returns:
        0, or the exit code of the comparison.
    Raises:
        InputError: The motions before it are recordings, but more than the impact is requested.
    """
    from ..simulation.contact.chain import chain
    from ..simulation.simulate import simulate
    from ..simulation.trajectory import Trajectory

    print(impact)
    options = options_in(arguments, _keys())
    if "duration" not in options and arguments.out is None and not arguments.compare:
        return 0
    earlier = [motion for motion in before if isinstance(motion, Trajectory)]
    if len(earlier) < len(before):
        raise InputError(
            "--duration, --out and --compare need scene files (.toml) of one motion, not "
            "recordings; state further phases in the file, as tables [[phases]] (docs/scenes.md)"
        )
    after = [
        simulate(system, **start, **options, progress=True)
        for system, start in (states if "duration" in options else ())
    ]
    mission = chain(earlier, impact, *([after] if after else []))
    if arguments.out is not None:
        path = Path(arguments.out)
        mission.save(path)
        print(describe_file(path))
    if not arguments.compare:
        return 0
    from ..judge.compare import compare

    return print_report(compare(mission, progress=True))
