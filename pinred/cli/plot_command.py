"""`pinred plot`: draw figures of a motion and write them to files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.files import FIGURES
from ..views.plots import KINDS, options_of
from ..views.plots.by_kind import DEFAULT_KIND, draw
from .command_options import (
    add_options,
    add_parameters,
    option_adder,
    parameters_in,
    refuse_of_robots,
    scene_with,
)
from .motion_files import check_robot, motion_in
from .output_files import describe_file, save_figure

if TYPE_CHECKING:
    from ..scene.toml.schema import Key
    from ..simulation.trajectory import Trajectory

# Options of the kinds of figures.
_OPTIONS = (
    "joints", "component", "attitude", "value", "direction", "against", "output", "numbers",
)  # fmt: skip
SAMPLES = 501  # number of report times of a robot that this command simulates
_OF_SWEEPS = {"histogram", "scatter", "heatmap", "quantiles"}
_OTHER_COMMANDS = {"field": "pinred field", "cycles": "pinred phase"}


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    text = (
        "motion traj.npz, scene.toml, robot (see `pinred robots`, or a URDF or MJCF file), "
        "results.zarr of `pinred sweep`, or accuracy.csv of `pinred bench accuracy`"
    )
    sub.add_argument("source", metavar="SOURCE", help=text)
    add = option_adder(sub)
    kinds = ", ".join(kind for kind in KINDS if kind not in _OTHER_COMMANDS)
    add("--kind K[,K]", f"kinds of figures: {kinds}", str, DEFAULT_KIND)
    text = f"FILE{' or '.join(FIGURES)}; FILE_KIND.png if there are several kinds"
    add("--out FILE", text, required=True)
    add("--robot R", "robot of a .npz file that names none")
    add("--joints J1,J2,…", "names of the joints to draw")
    add("--component C", "component of the curvature: v1 … w3, x, y, z or turn")
    add("--attitude A", "attitude of the base: quaternion, vector or rpy (in degrees)")
    add("--value X", "joint value of a Poincaré section [rad | m]", float)
    add("--direction D", "direction of a Poincaré section: 1, -1 or 0", int)
    add("--against W", "axis of work_precision: wall or evaluations")
    add("--output O", "output of a sweep")
    add("--numbers N1,N2,…", "varied numbers of a sweep")
    add_options(sub, _keys_of_robots())
    add_parameters(sub)


def _keys_of_robots() -> dict[str, Key]:
    """Return the options that apply to the simulation of a robot."""
    from ..scene.load_options import LOAD
    from ..scene.scene_options import SCENE_OPTIONS

    keys: dict[str, Key] = {name: SCENE_OPTIONS[name] for name in ("duration", "seed")}
    return keys | {name: LOAD.keys[name] for name in ("group", "root")}


def run(arguments: argparse.Namespace) -> int:
    """Draw the figures and write them.  Returns 0."""
    kinds = arguments.kind.split(",")
    for kind, command in _OTHER_COMMANDS.items():
        if kind in kinds:
            raise InputError(f"{kind} is not a figure of a motion; draw it with `{command}`")
    stated = {
        name: getattr(arguments, name) for name in _OPTIONS if getattr(arguments, name) is not None
    }
    for name in ("joints", "numbers"):
        if name in stated:
            stated[name] = stated[name].split(",")
    paths = _paths(arguments.out, kinds)
    options: dict[str, dict[str, Any]] = {}
    for kind in kinds:
        valid = options_of(kind)
        options[kind] = {name: value for name, value in stated.items() if name in valid}
    for name in stated:
        if not any(name in values for values in options.values()):
            raise InputError(f"--{name} has no effect on {', '.join(kinds)}")
    source = _source(arguments, kinds)
    figures = {kind: draw(source, kind, options[kind]) for kind in paths}
    for kind, path in paths.items():
        save_figure(figures[kind], path)
        print(describe_file(path))
    return 0


def _paths(out: str, kinds: list[str]) -> dict[str, Path]:
    from ..common.files import check_path

    path = Path(out)
    if len(kinds) == 1:
        return {kinds[0]: check_path(path, FIGURES)}
    return {
        kind: check_path(path.with_name(f"{path.stem}_{kind}{path.suffix}"), FIGURES)
        for kind in kinds
    }


def _source(arguments: argparse.Namespace, kinds: list[str]) -> Any:
    """Return the object to draw: a motion, or the results of a measurement."""
    source, suffix = arguments.source, Path(arguments.source).suffix
    is_measurement = "work_precision" in kinds
    if "branches" in kinds:
        raise InputError(
            "branches are drawn by `pinred equilibria ROBOT --momentum LOW,HIGH --out FILE`"
        )
    if is_measurement and (suffix != ".csv" or len(kinds) > 1):
        raise InputError(
            "work_precision must be the only figure, and its source accuracy.csv, which "
            "`pinred bench accuracy --out FOLDER` writes"
        )
    if suffix == ".csv" and not is_measurement:
        raise InputError(f"'{source}' can only be drawn as work_precision; motions are .npz files")
    if suffix == ".zarr" or {*kinds} & _OF_SWEEPS:
        return _results_of_sweep(arguments, kinds)
    check_robot(source, arguments.robot)
    if suffix not in (".npz", ".toml", ".csv"):
        return _motion_of_robot(arguments)
    refuse_of_robots(arguments, source, "duration", "seed", "group", "root", "parameters")
    if suffix == ".csv":
        from ..laboratory.bench.work_precision import read_record

        return read_record(Path(source))
    return motion_in(source, arguments.robot)


def _results_of_sweep(arguments: argparse.Namespace, kinds: list[str]) -> Any:
    from ..sweeps.sweep import open_sweep

    source = arguments.source
    if Path(source).suffix != ".zarr" or not {*kinds} <= _OF_SWEEPS:
        raise InputError(
            f"{', '.join(sorted(_OF_SWEEPS))} are drawn of a store of `pinred sweep`, such as "
            "results.zarr, which has no other figures"
        )
    refuse_of_robots(arguments, source, "robot", "duration", "seed", "group", "root", "parameters")
    return open_sweep(source)


def _motion_of_robot(arguments: argparse.Namespace) -> Trajectory:
    from dataclasses import replace

    import numpy as np

    from ..simulation.simulate import simulate
    from ..system.load import load

    parameters = parameters_in(arguments.parameters)
    system = load(
        arguments.source, group=arguments.group, root=arguments.root, parameters=parameters
    )
    scene = scene_with(system, arguments.seed, duration=arguments.duration)
    scene = replace(scene, times=np.linspace(0.0, scene.end, SAMPLES))
    return simulate(scene, progress=True)
