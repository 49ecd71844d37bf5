"""Options that several commands share: a robot, and the state and run of a scene.

Nothing heavy is imported before they are asked for.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal

from ..common.errors import InputError

if TYPE_CHECKING:
    from ..integrators.methods import Method
    from ..scene.scene import Scene
    from ..system.system import System

STATE = {  # the initial state, by the names that Scene has for it
    "x0": "initial shape [rad | m]",
    "xdot0": "initial shape rate",
    "xi0": "initial body twist of the base [linear; angular]",
    "momentum": "initial body momentum instead, or 0",
    "pose0": "initial pose of the base",
}
VECTORS = ("--at", "--gravity", *(f"--{name}" for name in STATE))  # of numbers with commas


def one_of(names: Iterable[str], default: Any) -> str:
    """Return names as help shows them, with the default marked."""
    return ", ".join(f"{name} (default)" if name == default else name for name in names)


def add_robot(sub: argparse.ArgumentParser) -> None:
    """Add a robot and how to load it."""
    from ..lie import GROUPS

    sub.add_argument(
        "robot", metavar="ROBOT", help="a name (`pinred robots`), or a URDF or MJCF file"
    )
    sub.add_argument("--group", metavar="G", help=f"{', '.join(GROUPS)}; the robot's own root")
    sub.add_argument("--lock", metavar="J1,J2,…", help="joints to freeze, as NAME or NAME=VALUE")
    sub.add_argument("--gravity", metavar="GX,GY,GZ", help="in the world frame [m/s²]")
    sub.add_argument(
        "--strict", action="store_true", help="refuse what there is a warning about otherwise"
    )


def system_of(options: argparse.Namespace) -> System:
    """Return the system that the options of `add_robot` name."""
    from ..system.load import load

    lock: dict[str, float] = {}
    for entry in options.lock.split(",") if options.lock else ():
        name, _, value = entry.partition("=")
        lock[name] = (numbers_in(value, "lock") or [0.0])[0]
    gravity = numbers_in(options.gravity, "gravity")
    return load(
        options.robot, group=options.group, lock=lock, gravity=gravity, strict=options.strict
    )


def add_scene(sub: argparse.ArgumentParser) -> None:
    """Add the initial state of a scene, for how long to follow it, and how."""
    from ..integrators.methods import METHODS, Gauss
    from ..scene.scene import ENGINES, OUTPUTS, Scene

    sub.add_argument("--time", metavar="T", type=float, help="duration [s]")
    sub.add_argument("--seed", metavar="S", type=int, help="a random initial state")
    sub.add_argument("--engine", metavar="E", default=ENGINES[0], help=one_of(ENGINES, ENGINES[0]))
    sub.add_argument(
        "--outputs", metavar="O", default=Scene.outputs, help=one_of(OUTPUTS, Scene.outputs)
    )
    methods = one_of(["auto", *METHODS], Scene.method)
    sub.add_argument("--method", metavar="M", help=methods)
    sub.add_argument("--step", metavar="H", type=float, help="of methods with fixed steps [s]")
    sub.add_argument("--order", metavar="P", type=int, help=f"of Gauss ({Gauss.order})")
    for name in ("rtol", "atol"):
        default = getattr(Scene, name)
        sub.add_argument(
            f"--{name}", metavar="TOL", type=float, default=default, help=f"({default:g})"
        )
    for name, text in STATE.items():
        sub.add_argument(f"--{name}", metavar="V1,V2,…", help=text)
    sub.add_argument(
        "--spring", metavar="J=K,REST", action="append", default=[], help="a spring at joint J"
    )


def scene_of(options: argparse.Namespace) -> Scene:
    """Return the scene that the options of `add_robot` and `add_scene` describe."""
    system = system_of(options)
    state = {name: numbers_in(getattr(options, name), name) for name in STATE}
    if state["momentum"] == [0.0]:
        state["momentum"] = [0.0] * system.r
    springs: dict[str, tuple[float, float]] = {}
    for entry in options.spring:
        name, _, text = entry.partition("=")
        values = numbers_in(text, "spring") or []
        if len(values) not in (1, 2):
            raise InputError(
                f"--spring takes JOINT=STIFFNESS or JOINT=STIFFNESS,REST, got '{entry}'"
            )
        springs[name] = (values[0], values[1] if len(values) == 2 else 0.0)
    return scene_with(
        system,
        options.seed,
        duration=options.time,
        rtol=options.rtol,
        atol=options.atol,
        springs=springs,
        outputs=options.outputs,
        method=_method(options),
        **state,
    )


def scene_with(system: System, seed: int | None, **given: Any) -> Scene:
    """Return the scene of a system and options of Scene.

    Where no state is given and the robot comes with none, it is random; the seed is printed, so
    that anyone can repeat the run.
    """
    from ..scene.scene import Scene

    known = system.initial is not None or any(given.get(name) is not None for name in STATE)
    seed = 0 if seed is None and not known else seed
    scene = Scene(system=system, seed=seed, **given)
    if seed is not None:
        print(f"initial state: random, seed {seed}")
    return scene


def numbers_in(text: str | None, option: str) -> list[float] | None:
    """Return the numbers of an option, None if it is not given.  Raises InputError."""
    if text is None:
        return None
    try:
        return [float(word) for word in text.split(",")] if text else []
    except ValueError:
        raise InputError(f"--{option} takes numbers separated by commas, got '{text}'") from None


def _method(options: argparse.Namespace) -> Method | Literal["auto"]:
    """Return the integrator asked for."""
    from ..integrators.methods import method_named

    name, step, order = options.method, options.step, options.order
    if name in (None, "auto") and step is None and order is None:
        return "auto"
    return method_named(name or "DOP853", step, order, options.rtol, options.atol)
