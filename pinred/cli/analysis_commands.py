"""Commands that analyse robots: inspect, robots, equilibria, phase, gait and reorient."""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError, PinredError
from ..common.files import DATA, FIGURES
from .command_options import (
    ROBOT,
    add_options,
    add_parameters,
    add_robot,
    add_source,
    by_joint_in,
    connection_keys,
    describe_file,
    numbers_in,
    option_adder,
    options_in,
    out_path,
    refuse_of_robots,
    save_figure,
    show_motion,
    source_of,
    system_of,
    write_plan,
    write_series,
)

if TYPE_CHECKING:
    from ..analysis.equilibria.relative_equilibrium import Equilibria
    from ..analysis.phases.gait import Gait
    from ..analysis.phases.phase import Phase
    from ..scene.toml.schema import Key
    from ..system.system import System


def add_inspect_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    sub.add_argument("--at", metavar="X1,X2,…", help="shape [rad | m] (default: zero)")


def run_inspect(arguments: argparse.Namespace) -> int:
    """Print the inspection.  Returns 0."""
    from ..analysis.inspection import inspect

    print(inspect(system_of(arguments), numbers_in(arguments.at, "at")))
    return 0


def add_robots_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("--check", action="store_true", help="load each robot and print errors")


def run_robots(arguments: argparse.Namespace) -> int:
    """Print the names of the robots.  Returns 0."""
    from ..system.find_robot_files import INSTALL_ROBOTS, bundled_robots, example_robots

    bundled = bundled_robots()
    width = max(map(len, bundled))
    print("bundled:")
    for name, robot in bundled.items():
        print(f"  {name:<{width}}  {robot.group:<3}  {robot.description}")
    examples = example_robots()
    if not examples:
        print(f"more (solo12, talos, ur5, …): {INSTALL_ROBOTS}")
        return 0
    print("from example-robot-data:")
    if not arguments.check:
        print("  " + ", ".join(examples))
        return 0
    from ..system.load import load

    width = max(map(len, examples))
    for name in examples:
        try:
            with warnings.catch_warnings(record=True) as caught:
                system = load(name)
            print(
                f"  {name:<{width}}  {system.group.name:<3}  {system.m} joints, {system.mass:g} kg"
            )
            for warning in caught:
                print(f"  {'':<{width}}  warning: {warning.message}")
        except PinredError as error:
            print(f"  {name:<{width}}  refused: {error}")
    return 0


_PLAYED = (".html", ".rrd", ".mp4", ".gif", ".png")  # suffixes of files with --play
_SCENE = ("springs", "passive", "prescribed")  # options of a scene that this command accepts


def add_equilibria_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.scene_options import SCENE_OPTIONS

    add_robot(sub)
    add_options(sub, {name: SCENE_OPTIONS[name] for name in _SCENE})
    add = option_adder(sub)
    text = "momentum of the relative equilibria, or a range for branches [N·m·s | N·s]"
    add("--momentum J or LOW,HIGH", text, required=True)
    add("--cyclic J1=V1,…", "momenta of cyclic joints, such as wheels [N·m·s | N·s] (default: 0)")
    add("--starts N", "number of random starting points of each round", int)
    add("--limit N", "largest number of starting points in all, at one momentum", int)
    add("--seed S", "seed of the starting points", int, 0)
    add("--joint J", "vertical axis of the diagram (default: amended potential)")
    add("--play K", "play equilibrium K, counted from 0", int)
    add("--mode M", "perturb it along mode M, counted from 0", int)
    add("--amplitude A", "amplitude of the mode [rad | m]", float, 0.05)
    text = "ten periods of the mode, or of the rotation"
    add_options(sub, {"duration": replace(SCENE_OPTIONS["duration"], default=text)})
    text = (
        "diagram of a range (.png, .pdf, .svg), or motion of --play (.html, .rrd, .mp4, .gif, .png)"
    )
    add("--out FILE", text)


def run_equilibria(arguments: argparse.Namespace) -> int:
    """Print equilibria or branches, and draw or play them.  Returns 0."""
    momenta = numbers_in(arguments.momentum, "momentum") or []
    if len(momenta) not in (1, 2):
        raise InputError(f"--momentum takes J, or LOW,HIGH, got {len(momenta)} numbers")
    _check(arguments, is_range=len(momenta) == 2)
    system = system_of(arguments)
    from ..scene.scene_options import SCENE_OPTIONS

    options = options_in(arguments, {name: SCENE_OPTIONS[name] for name in _SCENE})
    options |= {"cyclic": _parse_cyclic(arguments.cyclic), "seed": arguments.seed}
    if arguments.starts is not None:
        options["starts"] = arguments.starts
    if arguments.limit is not None:
        options["limit"] = arguments.limit
    if len(momenta) == 2:
        return _branches(arguments, system, (momenta[0], momenta[1]), options)
    from ..analysis.equilibria.find_equilibria import relative_equilibria

    equilibria = relative_equilibria(system, momentum=momenta[0], **options)
    for note in {equilibrium.problem.scene.left_out for equilibrium in equilibria} - {""}:
        print(note)
    print(equilibria)
    return 0 if arguments.play is None else _play(arguments, equilibria)


def _branches(
    arguments: argparse.Namespace,
    system: System,
    ends: tuple[float, float],
    options: dict[str, Any],
) -> int:
    """Follow branches between two momenta, print them, and draw a diagram.  Returns 0."""
    from ..analysis.equilibria.branches import branches

    path = out_path(arguments, FIGURES)
    if path is not None:
        from ..views.plots import branches as draw  # Fail early if matplotlib is missing.
    result = branches(system, momentum=ends, **options)
    print(result)
    if path is not None:
        save_figure(draw(result, joint=arguments.joint), path)
        print(describe_file(path))
    return 0


def _play(arguments: argparse.Namespace, equilibria: Equilibria) -> int:
    """Simulate one equilibrium, perturbed along a mode, and play or write it.  Returns 0."""
    from ..simulation.simulate import simulate
    from ..views.playback.colours_and_view_options import View, default_fps

    index, count = arguments.play, len(equilibria)
    if not 0 <= index < count:
        raise InputError(f"--play: expected an index below {count}, got {index}")
    equilibrium = equilibria[index]
    scene = equilibrium.scene(
        arguments.mode, amplitude=arguments.amplitude, duration=arguments.duration
    )
    traj = simulate(scene, progress=True)
    print(f"playing {index}, {equilibrium}")
    path = None if arguments.out is None else Path(arguments.out)
    show_motion(traj, path, View(fps=default_fps(path)))
    return 0


def _check(arguments: argparse.Namespace, *, is_range: bool) -> None:
    """Raise InputError for options without effect; `is_range`: the command follows branches."""
    if is_range and arguments.limit is not None:
        raise InputError("--limit is for one momentum, not for a range")
    if is_range and arguments.play is not None:
        raise InputError("--play requires a single momentum, not a range")
    if arguments.play is None:
        for name in ("mode", "duration"):
            if getattr(arguments, name) is not None:
                raise InputError(f"--{name} requires --play K")
        if arguments.out is not None and not is_range:
            raise InputError("--out requires a range, --momentum LOW,HIGH, or --play K")
    else:
        out_path(arguments, _PLAYED)
    if arguments.joint is not None and not (is_range and arguments.out is not None):
        raise InputError("--joint requires the diagram that --momentum LOW,HIGH --out FILE draws")


def _parse_cyclic(text: str | None) -> dict[str, float] | None:
    if text is None:
        return None
    momenta = by_joint_in(text, "cyclic")
    if not isinstance(momenta, dict):
        raise InputError(f"--cyclic takes JOINT=MOMENTUM for each joint, got '{text}'")
    return momenta


def add_phase_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..planning.gait_file import GAIT_FILE

    add_source(sub)
    add_options(sub, {"momentum": GAIT_FILE.keys["momentum"]})
    add = option_adder(sub)
    add("--tolerance TOL", "tolerance of the pose", float, 1e-10)
    add("--cycles N", "number of cycles", int, 1)
    add("--out FILE", "figure of the cycles, or .npz or .csv file of the poses")


def run_phase(arguments: argparse.Namespace) -> int:
    """Print the phase.  Returns 0."""
    from ..analysis.phases.phase import phase
    from ..planning.gait_file import GAIT_FILE

    path = out_path(arguments, (*FIGURES, *DATA))
    source = source_of(arguments, gait=True)
    stated = options_in(arguments, {"momentum": GAIT_FILE.keys["momentum"]})
    momentum = stated.get("momentum", source.momentum)
    result = phase(source.connection, source.path, momentum, tolerance=arguments.tolerance)
    print(f"{source.connection.title()}: {result}")
    if (n := arguments.cycles) != 1:
        print(f"  {f'after {n} cycles':<18} {result.in_words(result.cycles(n))}")
    if path is not None:
        _write_cycles(result, path, arguments.cycles)
        print(describe_file(path))
    return 0


def _write_cycles(result: Phase, path: Path, cycles: int) -> None:

    if path.suffix in FIGURES:
        from ..views.plots.by_kind import plot

        save_figure(plot(result, "cycles", count=max(1, cycles)), path)
        return
    arrays = {"t": result.times, "pose": result.path, "end": result.pose}
    write_series(path, ("t", *result.group.pose_names), arrays)


_SAMPLES = 400  # number of samples of a cycle in a file


def add_gait_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..planning.gait_file import OPTIMISE

    text = "gait file (.toml) with connection and objective, or robot: a name or a file"
    sub.add_argument("source", metavar="SOURCE", help=text)
    add_options(sub, {**connection_keys(), **OPTIMISE.keys})
    add_parameters(sub)
    add = option_adder(sub)
    add("--any-winding", "let the winding number vary")
    add("--distance", "print the distance from the extremal, or from twice the harmonics")
    add("--compare", "compare a cycle with full ABA")
    add("--out FILE", "gait as joint data (.npz, .csv), or figure of it on the curvature")


def run_gait(arguments: argparse.Namespace) -> int:
    """Print the best loop and its certificate.  Returns 0, or the verdict of --compare."""
    from ..planning.optimisation.optimise import optimise_gait

    path = out_path(arguments, (*DATA, *FIGURES))
    arguments.gait = arguments.circle = None
    source = source_of(arguments, gait=False)
    best = optimise_gait(
        source.connection, **{**source.optimise, **_stated_of_gait(arguments)}, progress=True
    )
    print(best)
    if arguments.distance:
        print(f"  distance from optimum: {best.distance()}")
    return write_plan(
        best,
        path,
        lambda file: _write(best.gait, source.connection.joints, file),
        compare=arguments.compare,
    )


def _stated_of_gait(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return {Python name: value} of the options that the user passed."""
    from ..planning.gait_file import OPTIMISE

    options = options_in(arguments, OPTIMISE.keys)
    if options.get("cost") == "none":
        options["cost"] = None
    if arguments.any_winding:
        options["winding"] = None
    return options


def _write(gait: Gait, joints: tuple[str, ...], path: Path) -> None:
    """Write a cycle as joint data in the format of `Gait.read`."""
    import numpy as np

    if not np.isfinite(gait.period):
        raise InputError("a gait without a period cannot be written")
    t = np.linspace(0.0, gait.period, _SAMPLES + 1)
    x = gait.at(np.append(t[:-1], 0.0))[0]
    write_series(path, ("t", *joints), {"t": t, "x": x})


def add_reorient_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub, f"{ROBOT}, or a gait file with [reorient]")
    add_options(sub, _keys())
    add = option_adder(sub)
    add("--compare", "compare the motion with full ABA")
    add("--out FILE", "write the motion (.npz, .csv) or a figure")


def run_reorient(arguments: argparse.Namespace) -> int:
    """Print the plan.  Returns 0, or the verdict of --compare."""
    from ..planning.reorientation.reorient import reorient

    path = out_path(arguments, (*DATA, *FIGURES))
    system, options = _stated(arguments)
    if "target" not in options:
        raise InputError("pass --target with comma-separated numbers, or a gait file with a target")
    plan = reorient(system, **options)
    print(plan)
    print(f"  missed by the motion    {plan.missed:.1e} rad")
    return write_plan(plan, path, plan.trajectory.save, compare=arguments.compare)


def _stated(arguments: argparse.Namespace) -> tuple[System, dict[str, Any]]:
    """Return the robot, and the options of `reorient` from the file and the arguments."""
    options: dict[str, Any] = {}
    if Path(arguments.robot).suffix == ".toml":
        from ..planning.gait_file import load_gait

        refuse_of_robots(
            arguments, arguments.robot, "group", "lock", "gravity", "root", "parameters"
        )
        file = load_gait(arguments.robot)
        system = file.system
        options |= file.reorient
    else:
        system = system_of(arguments)
    stated = options_in(arguments, _keys())
    if stated.get("target") == []:
        raise InputError("--target takes numbers separated by commas, got nothing")
    return system, options | stated


def _keys() -> dict[str, Key]:
    """Return the gait-file keys that this command accepts as options."""
    from ..planning.gait_file import GAIT_FILE, REORIENT

    return {**REORIENT.keys, "momentum": GAIT_FILE.keys["momentum"]}
