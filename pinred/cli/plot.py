"""`pinred plot`: figures of a motion as files.  Nothing heavy is imported before it runs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.files import FIGURES
from ..views.plots import KINDS, options_of
from ..views.plots.by_kind import draw
from .motion_files import check_robot, motion_in
from .options import add_parameters, parameters_in, refuse_of_robots, scene_with
from .written import written

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..simulation.trajectory import Trajectory

SAMPLES = 501  # report times of a robot that is simulated here
_OF_CONNECTIONS = {"field": "pinred field", "cycles": "pinred phase"}
_NO_DATE: dict[str, dict[str, Any]] = {  # so that the same figure is the same file
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument(
        "source",
        metavar="SOURCE",
        help="traj.npz, a scene.toml, a robot (`pinred robots`, or a URDF or MJCF file), "
        "or accuracy.csv of `pinred bench accuracy` for work_precision",
    )
    sub.add_argument(
        "--kind",
        metavar="K[,K]",
        required=True,
        help=", ".join(kind for kind in KINDS if kind not in _OF_CONNECTIONS),
    )
    sub.add_argument(
        "--out", metavar="FILE", required=True,
        help=f"FILE{' or '.join(FIGURES)}; of several kinds, FILE_KIND.png",
    )  # fmt: skip
    sub.add_argument("--robot", metavar="R", help="the robot of an npz that does not name its own")
    sub.add_argument("--joints", metavar="J1,J2,…", help="joints to draw, by name")
    sub.add_argument("--component", metavar="C", help="of the curvature: v1 … w3")
    sub.add_argument("--value", metavar="X", type=float, help="of a Poincaré section [rad | m]")
    sub.add_argument("--direction", metavar="D", type=int, help="1, -1 or 0, of a Poincaré section")
    sub.add_argument("--against", metavar="W", help="wall or evaluations, of work_precision")
    sub.add_argument("--time", metavar="T", type=float, help="duration of a robot's motion [s]")
    sub.add_argument("--seed", metavar="S", type=int, help="a random initial state of a robot")
    sub.add_argument("--group", metavar="G", help="the symmetry of a robot")
    sub.add_argument("--root", metavar="BODY", help="of MJCF, which of several bodies that move")
    add_parameters(sub, "a number of a robot")


def run(options: argparse.Namespace) -> int:
    """Draw the figures and write them.  Returns 0."""
    kinds = options.kind.split(",")
    for kind, command in _OF_CONNECTIONS.items():
        if kind in kinds:
            raise InputError(f"{kind} is no figure of a motion; `{command}` draws it")
    given = {
        name: getattr(options, name)
        for name in ("joints", "component", "value", "direction", "against")
        if getattr(options, name) is not None
    }
    if "joints" in given:
        given["joints"] = given["joints"].split(",")
    paths = _paths(options.out, kinds)
    own: dict[str, dict[str, Any]] = {}
    for kind in kinds:
        known = options_of(kind)
        own[kind] = {name: value for name, value in given.items() if name in known}
    for name in given:
        if not any(name in of_kind for of_kind in own.values()):
            raise InputError(f"--{name} means nothing to {', '.join(kinds)}")
    source = _source(options, kinds)
    figures = {kind: draw(source, kind, own[kind]) for kind in paths}
    for kind, path in paths.items():
        save(figures[kind], path)
        print(written(path))
    return 0


def save(figure: Figure, path: Path) -> None:
    """Write a figure to a .png, .pdf or .svg file, the whole of it or nothing.

    Raises OutputError if writing fails.
    """
    from ..common.files import write_atomic

    kind = path.suffix
    write_atomic(path, lambda file: figure.savefig(file, format=kind[1:], metadata=_NO_DATE[kind]))


def _paths(out: str, kinds: list[str]) -> dict[str, Path]:
    from ..common.files import check_path

    path = Path(out)
    if len(kinds) == 1:
        return {kinds[0]: check_path(path, FIGURES)}
    return {
        kind: check_path(path.with_name(f"{path.stem}_{kind}{path.suffix}"), FIGURES)
        for kind in kinds
    }


def _source(options: argparse.Namespace, kinds: list[str]) -> Any:
    """Return the source of a plot: that of a file, a scene or a robot."""
    source, suffix = options.source, Path(options.source).suffix
    measured = "work_precision" in kinds
    if "branches" in kinds:
        raise InputError(
            "branches are followed by `pinred equilibria ROBOT --momentum LOW,HIGH`, "
            "which draws them with --out"
        )
    if measured and (suffix != ".csv" or len(kinds) > 1):
        raise InputError(
            "work_precision is drawn alone, of accuracy.csv; "
            "`pinred bench accuracy --out FOLDER` writes it"
        )
    if suffix == ".csv" and not measured:
        raise InputError(f"'{source}' can be drawn as work_precision only; motions are npz")
    check_robot(source, options.robot)
    if suffix not in (".npz", ".toml", ".csv"):
        return _motion_of_robot(options)
    refuse_of_robots(options, source, "time", "seed", "group", "root", "parameter")
    if suffix == ".csv":
        from ..laboratory.bench.record import read_record

        return read_record(Path(source))
    return motion_in(source, options.robot)


def _motion_of_robot(options: argparse.Namespace) -> Trajectory:
    from dataclasses import replace

    import numpy as np

    from ..simulation.simulate import simulate
    from ..system.load import load

    parameters = parameters_in(options.parameter)
    system = load(options.source, group=options.group, root=options.root, parameters=parameters)
    scene = scene_with(system, options.seed, duration=options.time)
    scene = replace(scene, times=np.linspace(0.0, scene.end, SAMPLES))
    return simulate(scene, progress=True)
