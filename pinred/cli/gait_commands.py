"""Commands for gaits: phase, gait and reorient."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.files import DATA, FIGURES
from .command_files import describe_file, out_path, save_figure, write_plan, write_series
from .command_options import (
    ROBOT,
    add_options,
    add_parameters,
    add_robot,
    add_source,
    connection_keys,
    option_adder,
    options_in,
    refuse_of_robots,
    source_of,
    system_of,
)

if TYPE_CHECKING:
    from ..analysis.phases.gait import Gait
    from ..analysis.phases.phase import Phase
    from ..scene.toml.schema import Key
    from ..system.system import System


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
