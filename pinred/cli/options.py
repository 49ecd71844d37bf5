"""Options that several commands share: a robot, and the state and run of a scene.

Nothing heavy is imported before they are asked for.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.plain_names import quoted

if TYPE_CHECKING:
    from ..scene.event import Event
    from ..scene.scene import Scene
    from ..system.system import System

_JOINTS = "V1,V2,… or J1=V1,…"
STATE = {  # the initial state, by the names that Scene has for it: the form, and what it is
    "x0": (_JOINTS, "initial shape, in order, or by joint with zero for the others [rad | m]"),
    "xdot0": (_JOINTS, "initial shape rate"),
    "xi0": ("V1,V2,…", "initial body twist of the base [linear; angular]"),
    "momentum": ("V1,V2,…", "initial body momentum instead, or 0"),
    "pose0": ("V1,V2,…", "initial pose of the base"),
    "q0": ("V1,V2,…", "Pinocchio's configuration instead of x0 and pose0"),
    "v0": ("V1,V2,…", "Pinocchio's velocity instead of xdot0, xi0 and momentum"),
}
# Options of numbers with commas.
VECTORS = ("--at", "--gravity", "--axis", "--target", "--limits", *(f"--{name}" for name in STATE))


def one_of(names: Iterable[str], default: Any) -> str:
    """Return names as help shows them, with the default marked."""
    return ", ".join(f"{name} (default)" if name == default else name for name in names)


def add_robot(
    sub: argparse.ArgumentParser, what: str = "a name (`pinred robots`), or a URDF or MJCF file"
) -> None:
    """Add a robot and how to load it.  what: may stand for it."""
    from ..lie import GROUPS

    sub.add_argument("robot", metavar="ROBOT", help=what)
    sub.add_argument("--group", metavar="G", help=f"{', '.join(GROUPS)}; the robot's own root")
    sub.add_argument("--lock", metavar="J1,J2,…", help="joints to freeze, as NAME or NAME=VALUE")
    sub.add_argument("--gravity", metavar="GX,GY,GZ", help="in the world frame [m/s²]")
    sub.add_argument("--root", metavar="BODY", help="of MJCF, which of several bodies that move")
    sub.add_argument(
        "--strict", action="store_true", help="refuse what there is a warning about otherwise"
    )
    add_parameters(sub, "a number of the robot")


def add_parameters(sub: argparse.ArgumentParser, what: str) -> None:
    """Add parameters by name.  what: they are."""
    sub.add_argument(
        "--parameter", metavar="NAME=VALUE", action="append", default=[],
        help=f"{what}, such as hand.mass=1.3 or elbow.placement=X,Y,Z,ROLL,PITCH,YAW",
    )  # fmt: skip


def parameters_in(entries: Sequence[str]) -> dict[str, Any]:
    """Return the parameters that options of the form NAME=VALUE name."""
    out: dict[str, Any] = {}
    for entry in entries:
        name, _, text = entry.partition("=")
        if not (name and text):
            raise InputError(f"--parameter takes NAME=NUMBER, or NAME=V1,V2,…, got {quoted(entry)}")
        if name in out:
            raise InputError(f"--parameter has {quoted(name)} twice")
        values = numbers_in(text, "parameter") or []
        out[name] = values[0] if len(values) == 1 else values
    return out


def refuse_of_robots(options: argparse.Namespace, source: str, *names: str) -> None:
    """Refuse options that are for robots beside a file that says itself.  Raises InputError."""
    for name in names:
        if getattr(options, name) not in (None, []):
            raise InputError(f"--{name} is for robots; {quoted(source)} says itself")


def system_of(options: argparse.Namespace) -> System:
    """Return the system that the options of `add_robot` name."""
    from ..system.load import load

    lock: dict[str, float] = {}
    for entry in options.lock.split(",") if options.lock else ():
        name, _, value = entry.partition("=")
        lock[name] = (numbers_in(value, "lock") or [0.0])[0]
    gravity = numbers_in(options.gravity, "gravity")
    return load(
        options.robot,
        group=options.group,
        lock=lock,
        gravity=gravity,
        root=options.root,
        strict=options.strict,
        parameters=parameters_in(options.parameter),
    )


def add_scene(sub: argparse.ArgumentParser) -> None:
    """Add the initial state of a scene, for how long to follow it, and how."""
    from ..integrators.methods import METHODS, Gauss
    from ..scene.scene import ENGINES, OUTPUTS, Scene

    sub.add_argument("--time", metavar="T", type=float, help="duration [s]")
    sub.add_argument("--seed", metavar="S", type=int, help="a random initial state")
    sub.add_argument("--keyframe", metavar="K", help="an initial state that the MJCF file names")
    sub.add_argument("--engine", metavar="E", default=ENGINES[0], help=one_of(ENGINES, ENGINES[0]))
    sub.add_argument(
        "--outputs", metavar="O", default=Scene.outputs, help=one_of(OUTPUTS, Scene.outputs)
    )
    methods = one_of(["auto", *METHODS], Scene.method)
    sub.add_argument("--method", metavar="M", help=f"{methods}; with options, 'Gauss(0.01, 8)'")
    sub.add_argument("--step", metavar="H", type=float, help="of methods with fixed steps [s]")
    sub.add_argument("--order", metavar="P", type=int, help=f"of Gauss ({Gauss.order})")
    for name in ("rtol", "atol"):
        default = getattr(Scene, name)
        sub.add_argument(f"--{name}", metavar="TOL", type=float, help=f"({default:g})")
    for name, (form, text) in STATE.items():
        sub.add_argument(f"--{name}", metavar=form, help=text)
    sub.add_argument(
        "--spring", metavar="J=K,REST", action="append", default=[], help="a spring at joint J"
    )
    sub.add_argument(
        "--passive", action="store_true", help="springs and dampers in the robot's file act"
    )
    sub.add_argument(
        "--friction", metavar="WIDTH", type=float,
        help="dry friction in the file acts: -most*tanh(rate/WIDTH) [rad/s | m/s]",
    )  # fmt: skip
    sub.add_argument(
        "--prescribed", metavar="J=PLAN", action="append", default=[],
        help="joint J follows a number or a formula in t, such as '0.4*sin(t)' [rad | m]",
    )  # fmt: skip
    for name, text in (("event", "tell when"), ("until", "end where")):
        sub.add_argument(
            f"--{name}", metavar="[NAME=]FORMULA", action="append", default=[],
            help=f"{text} a formula of the state crosses zero, such as 'x[0] - 0.5'",
        )  # fmt: skip


def scene_of(options: argparse.Namespace) -> Scene:
    """Return the scene that the options of `add_robot` and `add_scene` describe."""
    system = system_of(options)
    given: dict[str, Any] = {}
    for name, (form, _) in STATE.items():
        text = getattr(options, name)
        if text is not None:
            given[name] = by_joint_in(text, name) if form == _JOINTS else numbers_in(text, name)
    if given.get("momentum") == [0.0]:
        given["momentum"] = 0
    for name in ("rtol", "atol"):
        if getattr(options, name) is not None:
            given[name] = getattr(options, name)
    return scene_with(
        system,
        options.seed,
        duration=options.time,
        springs=springs_in(options.spring),
        prescribed=prescribed_in(options.prescribed),
        passive=options.passive,
        friction=options.friction,
        outputs=options.outputs,
        method=_method(options),
        events=[*_events(options.event, ends=False), *_events(options.until, ends=True)],
        keyframe=options.keyframe,
        **given,
    )


def scene_with(system: System, seed: int | None, **given: Any) -> Scene:
    """Return the scene of a system and options of Scene.

    Where no state is given and the robot comes with none, it is random; the seed is printed, so
    that anyone can repeat the run.
    """
    from ..scene.angles import large_angles
    from ..scene.scene import Scene

    states = (*STATE, "keyframe")
    known = system.initial is not None or any(given.get(name) is not None for name in states)
    seed = 0 if seed is None and not known else seed
    scene = Scene(system=system, seed=seed, **given)
    if given.get("x0") is not None and (note := large_angles(scene.given.x[0], system)):
        print(f"note: {note}")
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
        raise InputError(
            f"--{option} takes numbers separated by commas, got {quoted(text)}"
        ) from None


def by_joint_in(text: str, option: str) -> list[float] | dict[str, float]:
    """Return numbers in order, or {joint: number}."""
    if "=" not in text:
        return numbers_in(text, option) or []
    out: dict[str, float] = {}
    for entry in text.split(","):
        name, _, value = entry.rpartition("=")
        if name in out:
            raise InputError(f"--{option} has joint {quoted(name)} twice")
        try:
            out[name] = float(value if name else "")
        except ValueError:
            raise InputError(
                f"--{option} takes numbers, or JOINT=NUMBER for each, got {quoted(entry)}"
            ) from None
    return out


def springs_in(entries: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return the springs that options of the form JOINT=STIFFNESS,REST name."""
    springs = {}
    for entry in entries:
        name, _, text = entry.partition("=")
        values = numbers_in(text, "spring") or []
        if len(values) not in (1, 2):
            raise InputError(
                f"--spring takes JOINT=STIFFNESS or JOINT=STIFFNESS,REST, got {quoted(entry)}"
            )
        springs[name] = (values[0], values[1] if len(values) == 2 else 0.0)
    return springs


def prescribed_in(entries: Sequence[str]) -> dict[str, float | str]:
    """Return the plans that options of the form JOINT=PLAN name."""
    plans: dict[str, float | str] = {}
    for entry in entries:
        name, _, text = entry.partition("=")
        if not text:
            raise InputError(
                f"--prescribed takes JOINT=NUMBER or JOINT=FORMULA, got {quoted(entry)}"
            )
        if name in plans:
            raise InputError(f"--prescribed has joint {quoted(name)} twice")
        try:
            plans[name] = float(text)
        except ValueError:
            plans[name] = text
    return plans


def _events(entries: Sequence[str], *, ends: bool) -> list[Event]:
    """Return the events of --event, or of --until, whose names are these if none are given."""
    from ..scene.event import Event

    found = []
    for entry in entries:
        named = re.fullmatch(r"\s*([A-Za-z]\w*)\s*=(?!=)(.*)", entry, re.DOTALL)
        name, text = named.groups() if named else ("until" if ends else "event", entry)
        found.append(Event(text, name, terminal=ends))
    return found


def _method(options: argparse.Namespace) -> str:
    """Return the integrator asked for, as the text that Scene takes."""
    from ..integrators.methods import METHODS, options_of

    name: str = options.method or "auto"
    given = {key: getattr(options, key) for key in ("step", "order")}
    given = {key: value for key, value in given.items() if value is not None}
    if not given:
        return name
    if name in ("auto", *METHODS):
        having = {
            key: [m for m, kind in METHODS.items() if key in [o.name for o in options_of(kind)]]
            for key in given
        }
        if name not in having.get("step", [name]):
            raise InputError(f"--step H and --method {' or '.join(having['step'])} go together")
        if name not in having.get("order", [name]):
            raise InputError(f"--order P goes with --method {' or '.join(having['order'])}")
    return f"{name}({', '.join(f'{key}={value!r}' for key, value in given.items())})"
