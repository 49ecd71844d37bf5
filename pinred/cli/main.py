"""The command line: the same things as the Python API, by the same names.

Nothing heavy is imported before a command runs, so that help is instant.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NoReturn

from ..common.errors import InputError, IntegrationError, PinredError
from ..common.version import __version__
from ..scene.toml.keys import GROUPS
from . import play as play_command
from . import plot as plot_command
from . import run as run_command
from . import stress as stress_command
from .bench import add_measurements

if TYPE_CHECKING:
    from ..integrators.methods import Method
    from ..scene.scene import Scene
    from ..system.system import System

_LISTED = 20  # kernels
VECTORS = ("--at", "--x0", "--xdot0", "--xi0", "--momentum", "--pose0", "--gravity")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.  Returns 0, or 1 if a comparison does not pass, or 2 on bad input."""
    parser = _parser()
    options = parser.parse_args(_joined(sys.argv[1:] if arguments is None else arguments))
    # What overflows or is not finite is refused or stopped by name; numpy need not say so too.
    warnings.simplefilter("ignore", RuntimeWarning)
    try:
        code: int = options.run(options)
        print(end="", flush=True)
    except PinredError as error:
        return _failed(str(error), 1 if isinstance(error, IntegrationError) else 2)
    except MemoryError:
        return _failed("not enough memory for this many numbers", 2)
    except KeyboardInterrupt:
        print("pinred: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has gone, as in `pinred robots | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _failed(f"cannot write the output: {error.strerror}", 2)
    return code


def _failed(message: str, code: int) -> int:
    """Print a message as one line on standard error and return the exit code."""
    print(f"pinred: error: {' '.join(message.split())}", file=sys.stderr)
    return code


class _Parser(argparse.ArgumentParser):
    """An argument parser that says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"pinred: error: {message}; see `{self.prog} --help`\n")


def _joined(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with vectors tied to their option, for those that begin with a minus."""
    out: list[str] = []
    for argument in arguments:
        if out and out[-1] in VECTORS:
            out[-1] += f"={argument}"
        else:
            out.append(argument)
    return out


def _parser() -> _Parser:
    parser = _Parser(
        prog="pinred",
        description="Reduce multibody systems with symmetry and compare with the full simulation.",
    )
    parser.add_argument("--version", action="version", version=f"pinred {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def command(name: str, run: Any, text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        sub.set_defaults(run=run)
        return sub

    sub = command("inspect", _inspect, "show group, joints, I, A, M and what will be skipped")
    _add_robot(sub)
    sub.add_argument("--at", metavar="X1,X2,…", help="the shape [rad | m]; zero if not given")

    sub = command("compare", _compare, "simulate the reduced equations and judge them by full ABA")
    _add_robot(sub)
    _add_scene(sub)

    sub = command("simulate", _simulate, "simulate the reduced equations and write the motion")
    _add_robot(sub)
    _add_scene(sub)
    sub.add_argument("--out", metavar="FILE", required=True, help="traj.npz or traj.csv")
    sub.add_argument("--samples", metavar="N", type=int, default=201, help="report times (201)")

    sub = command("run", run_command.run, "simulate what a scene file says")
    run_command.add_arguments(sub)

    sub = command("plot", plot_command.run, "draw a motion, or what bench accuracy measured")
    plot_command.add_arguments(sub)

    sub = command("play", play_command.run, "play a motion in a browser, or write it as a film")
    play_command.add_arguments(sub)

    sub = command("robots", _robots, "list the robots that can be loaded by name")
    sub.add_argument("--check", action="store_true", help="load each and say what is refused")

    sub = command("cache", _cache, "show the compiled kernels kept on disk")
    sub.add_argument("--clear", action="store_true", help="remove them")

    sub = command("stress", stress_command.run, "check the numbers where they are hard")
    stress_command.add_arguments(sub)

    bench = commands.add_parser(
        "bench", help="measure speed and accuracy", description="Measure speed and accuracy."
    )
    add_measurements(bench)
    return parser


def _add_robot(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "robot", metavar="ROBOT", help="a name (`pinred robots`), or a URDF or MJCF file"
    )
    sub.add_argument("--group", metavar="G", help=f"{', '.join(GROUPS)}; the robot's own root")
    sub.add_argument("--lock", metavar="J1,J2,…", help="joints to freeze, as NAME or NAME=VALUE")
    sub.add_argument("--gravity", metavar="GX,GY,GZ", help="in the world frame [m/s²]")


def _add_scene(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--time", metavar="T", type=float, help="duration [s]")
    sub.add_argument("--seed", metavar="S", type=int, help="a random initial state")
    sub.add_argument(
        "--engine", metavar="E", default="compiled", help="compiled (default), pinocchio"
    )
    sub.add_argument("--outputs", metavar="O", default="all", help="all (default), shape")
    methods = "auto (default), DOP853, AdaptiveGauss, Gauss, Radau, RKMK4 or Variational"
    sub.add_argument("--method", metavar="M", help=methods)
    sub.add_argument("--step", metavar="H", type=float, help="of methods with fixed steps [s]")
    sub.add_argument("--order", metavar="P", type=int, help="of Gauss (6)")
    sub.add_argument("--rtol", metavar="TOL", type=float, default=1e-10, help="(1e-10)")
    sub.add_argument("--atol", metavar="TOL", type=float, default=1e-12, help="(1e-12)")
    for name, text in (
        ("x0", "initial shape [rad | m]"),
        ("xdot0", "initial shape rate"),
        ("xi0", "initial body twist of the base [linear; angular]"),
        ("momentum", "initial body momentum instead, or 0"),
        ("pose0", "initial pose of the base"),
    ):
        sub.add_argument(f"--{name}", metavar="V1,V2,…", help=text)
    sub.add_argument(
        "--spring", metavar="J=K,REST", action="append", default=[], help="a spring at joint J"
    )


def _vector(text: str | None, option: str) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(word) for word in text.split(",")] if text else []
    except ValueError:
        raise InputError(f"--{option} takes numbers separated by commas, got '{text}'") from None


def _load(options: argparse.Namespace) -> System:
    from ..system.load import load

    lock: dict[str, float] = {}
    for entry in options.lock.split(",") if options.lock else ():
        name, _, value = entry.partition("=")
        lock[name] = (_vector(value, "lock") or [0.0])[0]
    gravity = _vector(options.gravity, "gravity")
    return load(options.robot, group=options.group, lock=lock, gravity=gravity)


def _scene(options: argparse.Namespace, system: System) -> Scene:
    from ..scene.scene import Scene

    given: dict[str, Any] = {
        name: _vector(getattr(options, name), name)
        for name in ("x0", "xdot0", "xi0", "momentum", "pose0")
    }
    if given["momentum"] == [0.0]:
        given["momentum"] = [0.0] * system.r
    springs: dict[str, tuple[float, float]] = {}
    for entry in options.spring:
        name, _, text = entry.partition("=")
        values = _vector(text, "spring") or []
        if len(values) not in (1, 2):
            raise InputError(
                f"--spring takes JOINT=STIFFNESS or JOINT=STIFFNESS,REST, got '{entry}'"
            )
        springs[name] = (values[0], values[1] if len(values) == 2 else 0.0)
    seed = options.seed
    if seed is None and system.initial is None and not any(v is not None for v in given.values()):
        seed = 0
    scene = Scene(
        system=system,
        seed=seed,
        duration=options.time,
        rtol=options.rtol,
        atol=options.atol,
        springs=springs,
        outputs=options.outputs,
        method=_method(options),
        **given,
    )
    if seed is not None:
        print(f"initial state: random, seed {seed}")
    return scene


def _method(options: argparse.Namespace) -> Method | Literal["auto"]:
    """Return the integrator asked for."""
    from ..integrators.methods import method_named

    name, step, order = options.method, options.step, options.order
    if name in (None, "auto") and step is None and order is None:
        return "auto"
    return method_named(name or "DOP853", step, order, options.rtol, options.atol)


def _inspect(options: argparse.Namespace) -> int:
    from ..analysis.inspection import inspect

    print(inspect(_load(options), _vector(options.at, "at")))
    return 0


def _compare(options: argparse.Namespace) -> int:
    from ..common.progress import ProgressBar
    from ..simulation.simulate import simulate
    from ..verification.compare import compare

    scene = _scene(options, _load(options))
    with ProgressBar("reduced") as bar:
        traj = simulate(scene, engine=options.engine, progress=bar)
    with ProgressBar("full   ") as bar:
        report = compare(traj, progress=bar)
    print(report)
    return 0 if report.passed else 1


def _simulate(options: argparse.Namespace) -> int:
    from dataclasses import replace
    from pathlib import Path

    import numpy as np

    from ..common.files import check_path
    from ..common.progress import ProgressBar
    from ..simulation.simulate import simulate

    path = check_path(options.out)
    scene = _scene(options, _load(options))
    if options.samples < 2:
        raise InputError(f"--samples must be at least 2, got {options.samples}")
    scene = replace(scene, times=np.linspace(0.0, scene.end, options.samples))
    with ProgressBar("reduced") as bar:
        traj = simulate(scene, engine=options.engine, progress=bar)
    traj.save(path)
    print(f"{traj}\nwritten to {Path(path)} ({path.stat().st_size / 1e3:.0f} kB)")
    return 0


def _robots(options: argparse.Namespace) -> int:
    from ..system import catalogue

    bundled = catalogue.bundled_robots()
    width = max(map(len, bundled))
    print("bundled:")
    for name, robot in bundled.items():
        print(f"  {name:<{width}}  {robot.group:<3}  {robot.description}")
    examples = catalogue.example_robots()
    if not examples:
        print(f"more (solo12, talos, ur5, …): {catalogue.INSTALL_ROBOTS}")
        return 0
    print("from example-robot-data:")
    if not options.check:
        print("  " + ", ".join(examples))
        return 0
    from ..system.load import load

    width = max(map(len, examples))
    for name in examples:
        try:
            system = load(name)
            print(
                f"  {name:<{width}}  {system.group.name:<3}  {system.m} joints, {system.mass:g} kg"
            )
        except PinredError as error:
            print(f"  {name:<{width}}  refused: {error}")
    return 0


def _cache(options: argparse.Namespace) -> int:
    from ..kernels.store import ObjectCache

    cache = ObjectCache()
    if options.clear:
        print(f"{cache.clear()} kernels removed from {cache.folder}")
        return 0
    entries = cache.entries()
    size = sum(entry.size for entry in entries)
    print(
        f"{len(entries)} kernels, {size / 1e6:.2f} MB of {cache.limit / 1e6:.0f}, in {cache.folder}"
    )
    for entry in entries[: -_LISTED - 1 : -1]:  # the last used first
        print(f"  {entry.key[:16]}  {entry.size / 1e3:8.1f} kB")
    if len(entries) > _LISTED:
        print(f"  … and {len(entries) - _LISTED} more")
    return 0


if __name__ == "__main__":
    sys.exit(main())
