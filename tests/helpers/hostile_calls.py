"""Calls of all public callables with one argument of a right kind and an impossible value.

The checks of kinds in `test_argument_kinds` never run the callables.  Here each callable runs with
valid arguments, of which one is replaced by an empty, ragged, huge, unprintable or unknown value.
"""

from __future__ import annotations

import inspect
import re
import signal
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import api_index
import numpy as np

import pinred
from pinred.common.names import plain as plain_text
from pinred.forces import Damper, Torque

SECONDS = 5.0  # Longest time of a call [s].
HUGE = 2**63 - 1
VALUES: list[Any] = [
    (), [], range(3), (1.0,), [[]], [[1.0], [1.0, 2.0]], 0, -1, 1, HUGE, 2**63, 1e300, 1e-300, -1.0,
    0.5, float("nan"), float("inf"), np.zeros(0), np.zeros((3, 0)), np.zeros((0, 3)), np.eye(3),
    np.zeros((2, 2, 2)), np.array(1.0), np.full(3, np.nan), np.full(3, 1e300), np.zeros(1000), "",
    "a", "/x", "x.y", "\0", "\ud800", "a" * 10_000, (), ("a",), ["a"] * 1000, ("a", "a"), {},
    {"a": 1.0}, {"": {}}, {1: 2}, int, max, lambda *_: None, lambda *_: "a", Path("/dev/zero"),
    Path("\0"), True, b"a",
]  # fmt: skip


# Calls that take long, read or write files, or open windows.
_LEFT_OUT = re.compile(
    r"bench|corpus|play|film|feel|save|published|stress|plots\.|plot$|reorient|optimise|optimal_|"
    r"lyapunov|floquet|read_|open_|workspace|trace|extremal|branches|linearise|pinred\.sweep$|"
    r"Flow\.(jacobian|jax|torch)|to_xarray|to_pandas|relative_equilibria|follow_mixed"
)
_VARIADIC = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
# A long duration is a long run, and exceptions of a user's progress function are the user's own.
EXEMPT = {
    (f"pinred.{name}", key)
    for name in ("simulate", "simulate_many", "compare", "flow")
    for key in ("duration", "progress")
}


class TooLongError(Exception):
    """A call that did not end in time."""


def _stop(_: int, __: FrameType | None) -> None:
    raise TooLongError


@cache
def objects() -> list[Any]:
    """Return an object of each class whose methods are called."""
    cat = pinred.load("falling_cat")
    gain = pinred.Parameter("gain", 0.1)
    options: dict[str, Any] = {"duration": 0.05, "times": [0.0, 0.05], "xdot0": [0.1, 0.2, 0.3]}
    options["forces"] = [Damper("bend", gain)]
    scene = pinred.Scene(system=cat, **options)
    traj = pinred.simulate(scene)
    gait = pinred.Gait.fourier([0.0] * 3, [[0.3, 0.0, 0.0]], [[0.0, 0.3, 0.1]])
    reduction = pinred.Reduction(cat)
    connection = pinred.Connection.mechanical(cat)
    folder = Path(tempfile.mkdtemp(prefix="pinred-hostile-"))
    traj.save(folder / "m.npz")
    many = pinred.simulate_many(scene, members={"x0": np.zeros((2, 3))})
    flow = pinred.flow(scene, wrt=["x0", "gain"])
    t, x = [0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 0.0, 1.0]
    sweep = pinred.sweep(scene, {"gain": [0.1, 0.2]}, outputs=["x"], store=folder / "s.zarr")
    return [
        cat, scene, traj, gait, reduction, reduction.at([0.0] * 3), connection, many, flow, sweep,
        flow.step(0.01), pinred.phase(connection, gait), pinred.read_recording(folder / "m.npz"),
        connection.grid(np.zeros((2, 3))), pinred.lie.SE2, pinred.lie.SO2, pinred.lie.R,
        pinred.lie.SO3, pinred.lie.RxSE2, pinred.lie.SE3,
        pinred.signals.Spline(t, x), pinred.signals.Linear(t, x), pinred.signals.Hold(t, x),
        pinred.signals.Expression("sin(t)"), pinred.signals.Constant(1.0),
        pinred.signals.Attitude((0.0, 0.1, 0.2)), pinred.signals.Fourier(0.0, [1.0], [1.0], 1.0),
        pinred.Grid(0, 1, 3), pinred.Normal(0, 1), pinred.Uniform(0, 1), pinred.LogUniform(1, 2),
        pinred.Values([1.0]), pinred.Model("m"), pinred.LoopReduction(pinred.load("four_bar")),
        pinred.flatness(connection), pinred.poisson.casimirs(cat)[0], gain,
    ]  # fmt: skip


@cache
def valid() -> dict[str, Any]:
    """Return a valid value of each required parameter, by name."""
    cat, scene, traj, gait, reduction, _, connection, *_ = objects()
    x = np.zeros(3)
    r = cat.group.dim
    return {
        "system": cat, "scene": scene, "source": cat, "motion": traj, "traj": traj, "gait": gait,
        "connection": connection, "red": reduction, "other": gait, "group": cat.group,
        "x": x, "xdot": x + 0.1, "xddot": x, "u": x, "v": np.zeros(r + 3), "q": traj.q[0],
        "shapes": np.zeros((2, 3)), "pose": cat.group.identity(), "g": cat.group.identity(),
        "h": cat.group.identity(), "xi": np.zeros(r), "eta": np.zeros(r), "mu": np.zeros(r),
        "zeta": np.zeros(r), "omega": np.zeros(r), "etadot": np.zeros(r), "dx": x, "dxdot": x,
        "p": x, "attitude": cat.group.identity()[cat.group.linear:], "c": np.zeros(3),
        "t": 0.02, "name": "x0", "joint": "bend", "index": 0, "along": {"x0": x}, "inputs": {},
        "covector": np.ones(3), "mean": x, "cos": [x], "sin": [x + 0.1], "period": 1.0, "count": 3,
        "points": [[0.0] * 3, [1.0] * 3, [1.0, 0.0, 0.0]], "factor": 1.0, "phase": 0.1, "n": 2,
        "joints": ["a", "b", "c"], "start": [0.0] * 3, "moves": [{"a": 1.0}, {"a": -1.0}],
        "times": [0.0, 1.0, 2.0, 3.0], "values": [0.0, 1.0, 0.0, 1.0], "attitudes": np.eye(3),
        "vector": (0.0, 0.1, 0.2), "low": 1.0, "high": 2.0, "deviation": 1.0, "step": 0.1,
        "a": 1.0, "b": 2.0, "length": 1.0, "across": 1.0, "semi_axes": (1.0, 1.0, 1.0),
        "forces": np.zeros(3), "sizes": np.ones(3), "matrix": np.eye(3), "names": ["x"],
        "vary": {"gain": [0.1]}, "value": 0.1, "frame": "front", "text": "a", "mass": 1.0,
        "axis": "x", "parent": "a", "kind": "shape", "expression": "x['bend']", "wrt": ["x0"],
        "momentum": np.zeros(r), "drag": {"front": pinred.Rod(1, 1, 1)}, "density": 1.0,
        "bodies": {"front": pinred.Ellipsoid((1, 1, 1))}, "link": "front", "key": "k",
        "gains": 1.0, "stiffness": 1.0, "coefficient": 1.0, "kp": 1.0, "kd": 1.0,
        "function": Torque, "follower": "bend", "leader": "sway", "frame_a": "a", "frame_b": "b",
        "arcs": gait.arcs, "wheels": (), "path": "falling_cat", "level": 1.0, "cosines": [1.0],
        "sines": [1.0], "reference": {"bend": 0.1}, "most": 1.0, "lagrangian": lambda xi: xi @ xi,
        "members": {"x0": np.zeros((2, 3))}, "store": Path("none.zarr"), "f": None,
        "rotation": np.zeros(1), "translation": np.zeros(1), "samples": 3,
        "coefficients": (0.0, 1.0), "radius": 1.0, "end": [1.0] * 3, "what": "a",
    }  # fmt: skip


def callables() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield all public functions, constructors, and methods of the objects, by name."""
    seen = set()
    for name, value in api_index.public_names().items():
        is_class = inspect.isclass(value) and not issubclass(value, Exception)
        if inspect.isfunction(value) or (is_class and not inspect.isabstract(value)):
            yield name, value
        if inspect.isclass(value):
            for attribute, member in inspect.getmembers_static(value):
                if isinstance(member, classmethod) and not attribute.startswith("_"):
                    yield f"{name}.{attribute}", getattr(value, attribute)
    for thing in objects():
        kind = type(thing)
        for attribute, member in inspect.getmembers_static(kind):
            is_ours = inspect.isfunction(member) and member.__module__.startswith("pinred")
            is_public = not attribute.startswith("_") or attribute == "__call__"
            if is_ours and is_public and (kind, attribute) not in seen:
                seen.add((kind, attribute))
                yield f"{kind.__name__}.{attribute}", getattr(thing, attribute)


def parameters_of(call: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the parameters of a callable; for a class, those of its constructor."""
    if not inspect.isclass(call):
        return dict(inspect.signature(call).parameters)
    first, *others = inspect.signature(call.__init__).parameters.items()
    assert first[0] == "self"
    return dict(others)


def attempt(call: Callable[..., Any], arguments: dict[str, Any]) -> str:
    """Call; return "" for a result or an error of pinred, else the foreign exception."""
    parameters = parameters_of(call)
    plain = [
        arguments[name]
        for name, parameter in parameters.items()
        if parameter.kind is parameter.POSITIONAL_ONLY and name in arguments
    ]
    named = {
        name: value
        for name, value in arguments.items()
        if parameters[name].kind is not inspect.Parameter.POSITIONAL_ONLY
    }
    before = signal.signal(signal.SIGALRM, _stop)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call(*plain, **named)
    except pinred.PinredError:
        return ""
    except Exception as error:
        return plain_text(f"{type(error).__name__}: {error}", 200)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    return ""


def faults(every: int, first: int) -> tuple[list[str], int]:
    """Try values at each parameter of each callable.

    Args:
        every: Step between the tried values; 1 for all values.
        first: Index of the first value.
    Returns:
        The foreign exceptions with their calls, and the number of calls.
    """
    found, count, values = [], 0, valid()
    for name, call in callables():
        if _LEFT_OUT.search(name):
            continue
        parameters = parameters_of(call)
        keys = [key for key, entry in parameters.items() if entry.kind not in _VARIADIC]
        needed = [key for key in keys if parameters[key].default is inspect.Parameter.empty]
        if not {*needed} <= values.keys():
            continue
        arguments = {key: values[key] for key in needed}
        for key in keys:
            if (name, key) in EXEMPT:
                continue
            for value in VALUES[(first + len(key)) % every :: every]:
                count += 1
                if error := attempt(call, {**arguments, key: value}):
                    found.append(f"{name}({key}={plain_text(repr(value), 60)}): {error}")
    return found, count
