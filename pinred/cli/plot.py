"""`pinred plot`: figures of a motion as files.  Nothing heavy is imported before it runs."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..views.plots import KINDS, options_of, plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..scene.scene import Scene

SUFFIXES = (".png", ".pdf", ".svg")
SAMPLES = 501  # report times of a robot that is simulated here
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
    sub.add_argument("--kind", metavar="K[,K]", required=True, help=", ".join(KINDS))
    sub.add_argument(
        "--out", metavar="FILE", required=True,
        help="FILE.png, .pdf or .svg; of several kinds, FILE_KIND.png",
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


def run(options: argparse.Namespace) -> int:
    """Draw the figures and write them.  Returns 0."""
    kinds = options.kind.split(",")
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
    figures = {kind: plot(source, kind, **own[kind]) for kind in paths}
    for kind, path in paths.items():
        save(figures[kind], path)
        print(f"written to {path} ({path.stat().st_size / 1e3:.0f} kB)")
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
        return {kinds[0]: check_path(path, SUFFIXES)}
    return {
        kind: check_path(path.with_name(f"{path.stem}_{kind}{path.suffix}"), SUFFIXES)
        for kind in kinds
    }


def _source(options: argparse.Namespace, kinds: list[str]) -> Any:
    """Return what a plot takes: of a file, a scene or a robot."""
    read: dict[str, Callable[[], Any]] = {
        ".npz": lambda: _recording(options.source, options.robot),
        ".csv": lambda: _measurements(options.source),
        ".toml": lambda: _simulated_file(options.source),
    }
    suffix = Path(options.source).suffix
    measured = "work_precision" in kinds
    if measured and (suffix != ".csv" or len(kinds) > 1):
        raise InputError(
            "work_precision is drawn alone, of accuracy.csv; "
            "`pinred bench accuracy --out FOLDER` writes it"
        )
    if suffix == ".csv" and not measured:
        raise InputError(f"'{options.source}' can be drawn as work_precision only; motions are npz")
    if options.robot is not None and suffix != ".npz":
        raise InputError(f"--robot is for .npz files; '{options.source}' names its robot itself")
    if suffix not in read:
        return _simulated(_robot_scene(options))
    for name in ("time", "seed", "group"):
        if getattr(options, name) is not None:
            raise InputError(f"--{name} is for robots; '{options.source}' says itself")
    return read[suffix]()


def _recording(path: str, robot: str | None) -> Any:
    from ..simulation.recording import read_recording

    return read_recording(path, robot)


def _measurements(path: str) -> Any:
    from ..verification.bench.record import read_record

    return read_record(Path(path))


def _simulated_file(path: str) -> Any:
    from ..scene.toml.reader import read_scene_file

    file = read_scene_file(path)
    return _simulated(file.scene, engine=file.engine)


def _robot_scene(options: argparse.Namespace) -> Scene:
    from dataclasses import replace

    import numpy as np

    from ..scene.scene import Scene
    from ..system.load import load

    system = load(options.source, group=options.group)
    seed = options.seed
    if seed is None and system.initial is None:
        seed = 0
    if seed is not None:
        print(f"initial state: random, seed {seed}")
    scene = Scene(system=system, seed=seed, duration=options.time)
    return replace(scene, times=np.linspace(0.0, scene.end, SAMPLES))


def _simulated(scene: Scene, **options: Any) -> Any:
    from ..common.progress import ProgressBar
    from ..simulation.simulate import simulate

    with ProgressBar("reduced") as bar:
        return simulate(scene, progress=bar, **options)
