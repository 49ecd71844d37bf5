"""Commands that show: plot, play, feel and field."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.files import FIGURES, check_path, write_atomic
from ..views.plots import KINDS, options_of
from ..views.plots.by_kind import DEFAULT_KIND, draw
from .command_options import (
    add_options,
    add_parameters,
    add_robot,
    add_source,
    check_robot,
    describe_file,
    motion_in,
    numbers_in,
    option_adder,
    parameters_in,
    refuse_of_robots,
    save_figure,
    scene_with,
    show_motion,
    source_of,
    system_of,
)

if TYPE_CHECKING:
    from ..scene.toml.schema import Key
    from ..simulation.trajectory import Trajectory
    from ..views.motion_source import MotionSource


# Options of the kinds of figures.
_OPTIONS = (
    "joints", "component", "attitude", "value", "direction", "against", "output", "numbers",
)  # fmt: skip
SAMPLES = 501  # number of report times of a robot that this command simulates
_OF_SWEEPS = {"histogram", "scatter", "heatmap", "quantiles"}
_OTHER_COMMANDS = {"field": "pinred field", "cycles": "pinred phase"}


def add_plot_arguments(sub: argparse.ArgumentParser) -> None:
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
    from ..scene.scene_options import LOAD, SCENE_OPTIONS

    keys: dict[str, Key] = {name: SCENE_OPTIONS[name] for name in ("duration", "seed")}
    return keys | {name: LOAD.keys[name] for name in ("group", "root")}


def run_plot(arguments: argparse.Namespace) -> int:
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
        from ..laboratory.bench.accuracy_record import read_record

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


def add_play_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..views.playback.colours_and_view_options import VIEWER, VIEWERS

    text = "motion traj.npz, scene file (.toml), or a robot, which is shown at rest"
    sub.add_argument("motion", metavar="MOTION", help=text)
    add = option_adder(sub)
    add("--robot R", "robot of a .npz file that names none")
    add("--ghost", "show full ABA too (scene files only)")
    add("--speed S", "initial playback speed", float, 1.0)
    add("--pair J1,J2", "two joints for the axes of the shape panel")
    add("--sphere JOINT", "draw the momentum sphere of a joint's body, or of 'base'")
    add("--meshes FOLDER", "folder with the meshes of a URDF; repeatable", action="append")
    add("--no-meshes", "draw bodies from their inertias instead of meshes")
    viewers = "; ".join(f"{name}: {text}" for name, text in VIEWERS.items())
    add("--viewer V", f"{viewers} (default: {VIEWER})", choices=[*VIEWERS])
    add("--port P", "port of the web server (default: a free one)", int)
    add("--no-open", "do not open the browser")
    add("--out FILE", "write FILE.html, .rrd (for rerun), .mp4, .gif or .png instead of playing")
    add("--fps F", "frames per second (default: 60; films 25)", float)


def run_play(arguments: argparse.Namespace) -> int:
    """Play or write the motion.  Returns 0."""
    from ..views.playback.colours_and_view_options import PAGES, View, default_fps

    _check(arguments)
    pair = None if arguments.pair is None else tuple(arguments.pair.split(","))
    path = None if arguments.out is None else Path(arguments.out)
    fps = default_fps(path) if arguments.fps is None else arguments.fps
    meshes = arguments.meshes or not arguments.no_meshes
    view = View(
        ghost=arguments.ghost, speed=arguments.speed, fps=fps, pair=pair,
        sphere=arguments.sphere, meshes=meshes,
    )  # fmt: skip
    if path is not None:
        from ..views.playback.film import SUFFIXES

        check_path(path, (*PAGES, *SUFFIXES))  # Check the path before a long simulation.
    else:
        from ..views.playback.page import check_port

        check_port(arguments.port)
    is_motion = Path(arguments.motion).suffix in (".npz", ".toml")
    motion = (
        motion_in(arguments.motion, arguments.robot)
        if is_motion
        else _at_rest(arguments.motion, arguments.meshes)
    )
    show_motion(
        motion, path, view, viewer=arguments.viewer, port=arguments.port, show=not arguments.no_open
    )
    return 0


def _at_rest(robot: str, meshes: list[str] | None) -> MotionSource:
    """Return a motion in which a robot, given by name or file, stays in its neutral shape."""
    from ..simulation.simulate import simulate
    from ..system.load import load

    system = load(robot, gravity=(0.0, 0.0, 0.0), meshes=meshes or ())
    return simulate(
        system, xdot0=[0.0] * system.m, momentum=0, passive=False, duration=1.0, times=[0.0, 1.0]
    )


def _check(arguments: argparse.Namespace) -> None:
    """Raise InputError for an unsupported kind of motion, or for an option without effect."""
    from ..views.playback.colours_and_view_options import PAGES

    check_robot(arguments.motion, arguments.robot)
    if arguments.out is not None and arguments.port is not None:
        raise InputError("--port applies to playback in a browser, not to --out")
    if arguments.out is not None and arguments.viewer is not None:
        raise InputError("--viewer applies to playback in a browser, not to --out")
    if arguments.meshes and arguments.no_meshes:
        raise InputError("--meshes and --no-meshes exclude each other; pass only one of them")
    page = arguments.out is None or Path(arguments.out).suffix in PAGES
    if arguments.fps is not None and page and Path(arguments.motion).suffix == ".npz":
        raise InputError(
            "--fps applies to films and scenes; a page shows a .npz file at its stored times "
            "(`pinred simulate --samples` stores more of them)"
        )


def add_feel_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    add = option_adder(sub)
    add("--pair J1,J2", "two joints for the axes of the shape plane")
    add("--no-meshes", "draw bodies from their inertias instead of meshes")
    add("--port P", "port of the web server (default: a free one)", int)
    add("--no-open", "do not open the browser")
    add("--out FILE", "write the page FILE.html instead of opening it")


def run_feel(arguments: argparse.Namespace) -> int:
    """Open or write the page.  Returns 0."""
    from ..views.motions import feel, save_html
    from ..views.playback.page import check_port

    if arguments.out is not None and arguments.port is not None:
        raise InputError("--port applies to the page in a browser, not to --out")
    if arguments.out is not None:
        check_path(arguments.out, (".html",))  # Check the path before the robot is loaded.
    check_port(arguments.port)
    pair = None if arguments.pair is None else arguments.pair.split(",")
    system, meshes = system_of(arguments), not arguments.no_meshes
    if arguments.out is None:
        show = not arguments.no_open
        feel(system, pair=pair, meshes=meshes, port=arguments.port, show=show, wait=True)
    else:
        size = save_html(system, arguments.out, feel=True, pair=pair, meshes=meshes)
        print(f"written to {arguments.out} ({size / 1e6:.2f} MB)")
    return 0


_SAMPLES = 200  # default number of grid points along each joint


def add_field_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_source(sub)
    add = option_adder(sub)
    add("--joints J1,J2", "names of the joints to vary (default: the first two)")
    add("--component C", "component of the body twist: v1 … w3, x, y, z or turn")
    add("--part P", "quantity: curvature, exterior, bracket or connection", str, "curvature")
    add("--limits LOW,HIGH", "range of both joints [rad | m]")
    add("--at X1,X2,…", "shape of the other joints [rad | m]")
    add("--samples N", "number of grid points along each joint in a .npz file", int, _SAMPLES)
    add("--out FILE", "figure file, or .npz file of numbers", required=True)


def run_field(arguments: argparse.Namespace) -> int:
    """Draw or write the field.  Returns 0."""
    import numpy as np

    path = check_path(arguments.out, (*FIGURES, ".npz"))
    source = source_of(arguments, gait=False)
    joints = None if arguments.joints is None else arguments.joints.split(",")
    limits = None
    if (ends := numbers_in(arguments.limits, "limits")) is not None:
        if len(ends) != 2 or not ends[0] < ends[1]:
            raise InputError(f"--limits takes LOW,HIGH, got {arguments.limits}")
        limits = [(ends[0], ends[1])] * 2
    at = numbers_in(arguments.at, "at")
    if path.suffix == ".npz":
        arrays = _compute_grid(source.connection, joints, limits, at, arguments.samples)
        write_atomic(path, lambda file: np.savez(file, **arrays))
    else:
        from ..views.plots.by_kind import plot

        figure = plot(
            source.connection, "field", joints=joints, component=arguments.component,
            part=arguments.part, limits=limits, at=at, gait=source.gait,
        )  # fmt: skip
        save_figure(figure, path)
    print(describe_file(path))
    return 0


def _compute_grid(
    connection: Any, joints: list[str] | None, limits: Any, at: Any, samples: int
) -> dict[str, Any]:
    """Compute A and the curvature with its two terms on a grid of shapes.

    Args:
        connection: Connection to evaluate.
        joints: Names of the two joints on the axes; by default the first two.
        limits: (low, high) of each axis.
        at: Values of the other joints.
        samples: Number of samples along each axis.
    Returns:
        Arrays by name, with leading axes (samples, samples).
    Raises:
        InputError: An option is invalid.
    """
    import numpy as np

    from ..analysis.connections.connection import rest_of
    from ..common.arrays import vector
    from ..views.motion_source import labels_of_connection

    if samples < 2:
        raise InputError(f"--samples must be at least 2, got {samples}")
    connection = connection.in_chart()
    names = list(connection.joints)
    pair = labels_of_connection(connection).pair(joints, "a field")
    fixed = rest_of(connection) if at is None else vector(at, connection.m, "--at", names)
    (low, high), _ = limits or [(-np.pi, np.pi)] * 2
    axis = np.linspace(low, high, samples)
    x = np.broadcast_to(fixed, (samples, samples, connection.m)).copy()
    x[..., pair[0]], x[..., pair[1]] = np.meshgrid(axis, axis, indexing="ij")
    grid = connection.grid(x)
    return {
        "x": x, "joints": np.array(names), "local": grid.local, "curvature": grid.curvature,
        "exterior": grid.exterior, "bracket": grid.bracket,
    }  # fmt: skip
