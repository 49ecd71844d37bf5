"""Torques that are functions of time: random ones, fast for a short time, and ordinary ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import pinred
from pinred import Parameter
from pinred.common.arrays import Array
from pinred.forces import Torque

ROBOTS = ("falling_cat", "solo12", "satellite_two_arms", "planar_chain5")
END = 2.0  # duration of scenes with fast torques [s]
ORDINARY_END = 4.0  # duration of scenes with ordinary torques [s]
ORDINARY_RATES = (1.0, 5.0, 20.0, 100.0)  # [rad/s]
_SIZES = {"falling_cat": 1.0, "solo12": 0.3, "satellite_two_arms": 20.0, "planar_chain5": 1.0}
_SIZE, _CENTRE = Parameter("size", 1.0), Parameter("centre", 1.0)
_WIDTH, _RATE, _SWEEP = Parameter("width", 0.1), Parameter("rate", 100.0), Parameter("sweep", 0.0)


Function = Callable[[Any, Any], Any]  # of expressions


def _bump(t: Any) -> Any:
    return ca.exp(-(((t - _CENTRE) / _WIDTH) ** 2))


def _packet(t: Any, _: Any) -> Any:
    return ca.sin(_RATE * t) * _bump(t)


def _chirp(t: Any, _: Any) -> Any:
    return ca.sin((_RATE + _SWEEP * (t - _CENTRE)) * t) * _bump(t)


def _gaussian(t: Any, _: Any) -> Any:
    return _bump(t)


def _lorentzian(t: Any, _: Any) -> Any:
    return 1.0 / (1.0 + ((t - _CENTRE) / _WIDTH) ** 2)


def _product(t: Any, x: Any) -> Any:
    return ca.sin(_RATE * t) * _bump(t) * (1.0 + 0.5 * ca.cos(2.0 * x)) - 0.1 * x


def _wave(t: Any, x: Any) -> Any:
    return ca.sin(_RATE * t - 3.0 * x) * _bump(t)


KINDS: dict[str, Function] = {
    "packet": _packet,
    "chirp": _chirp,
    "gaussian": _gaussian,
    "lorentzian": _lorentzian,
    "product": _product,
    "wave": _wave,
}
# The first four have a frequency.
ORDINARY: dict[str, Function] = {
    "sine": lambda t, _: 0.05 * ca.sin(_RATE * t),
    "long packet": lambda t, _: 0.05 * ca.sin(_RATE * t) * ca.exp(-(((t - 2.0) / 0.5) ** 2)),
    "two rates": lambda t, _: 0.05 * ca.sin(_RATE * t) + 0.0005 * ca.sin(3.0 * _RATE * t),
    "tracking": lambda t, x: 0.015 * ca.sin(_RATE * t) - 0.05 * x,
    "wide bump": lambda t, _: 0.05 * ca.exp(-(((t - 2.0) / 0.5) ** 2)),
    "ramp": lambda t, x: 0.05 * ca.tanh(t - 2.0) * ca.cos(x),
}


@dataclass(frozen=True)
class Case:
    """One random torque on one robot.

    Attributes:
        robot: Name of the robot.
        kind: Name of the function in KINDS or ORDINARY.
        parameters: Values of its parameters.
        scene: The scene, without method and tolerances.
        rate: Largest angular frequency of the torque [rad/s].
    """

    robot: str
    kind: str
    parameters: dict[str, float]
    scene: pinred.Scene
    rate: float


_scenes: dict[tuple[str, str], pinred.Scene] = {}


def scene_of(robot: str, kind: str) -> pinred.Scene:
    """Return the scene of a robot with a torque of a kind on its first joint."""
    if (robot, kind) not in _scenes:
        system = pinred.load(robot)
        joint = next(k for k, unit in enumerate(system.units) if unit == "rad")
        name = system.shape_names[joint]

        def torque(s: Any) -> dict[str, Any]:
            size = _SIZE if kind in KINDS else _SIZES[robot]
            return {name: size * (KINDS | ORDINARY)[kind](s.t, s.x[joint])}

        start = pinred.simulate(system, seed=2, times=[0.0, 0.01])
        _scenes[robot, kind] = pinred.Scene(
            system=system, forces=[Torque(torque)], times=[END if kind in KINDS else ORDINARY_END],
            x0=start.x[0], xdot0=start.xdot[0], xi0=start.xi[0],
        )  # fmt: skip
    return _scenes[robot, kind]


def cases(count: int, seed: int = 0) -> Iterator[Case]:
    """Yield random torques, with frequencies of 30 to 1000 rad/s."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        robot = ROBOTS[k % len(ROBOTS)]
        kind = list(KINDS)[k // len(ROBOTS) % len(KINDS)]
        rate, width = np.exp(rng.uniform(np.log([30.0, 3e-3]), np.log([1000.0, 0.3]))).tolist()
        centre = float(rng.uniform(0.05, END))
        size = _SIZES[robot] * float(np.exp(rng.uniform(np.log(0.1), np.log(3.0))))
        if kind in ("gaussian", "lorentzian"):  # limit the impulse
            size *= min(1.0, 0.03 / width)
        sweep = float(rng.uniform(-1.0, 1.0)) * rate / END
        parameters = {
            "size": size, "centre": centre, "width": width, "rate": rate, "sweep": sweep,
        }  # fmt: skip
        scene = scene_of(robot, kind)
        assert scene.force_model is not None
        used = {p.name: parameters[p.name] for p in scene.force_model.parameters}
        yield Case(robot, kind, used, scene, 4.0 * rate + 10.0 / width)


def ordinary_cases(*robots: str) -> Iterator[Case]:
    """Yield ordinary torques on robots, on all robots by default."""
    for robot in robots or ROBOTS:
        for k, kind in enumerate(ORDINARY):
            scene = scene_of(robot, kind)
            for rate in ORDINARY_RATES if k < 4 else (1.0,):
                parameters = {"rate": rate} if k < 4 else {}
                yield Case(robot, kind, parameters, scene, 5.0 * rate + 5.0)


def reference(case: Case) -> tuple[Array, float]:
    """Return the final shape by short steps, and the growth of changes of the initial shape."""
    method = pinred.DOP853(max_step=1.0 / case.rate, rtol=1e-13, atol=1e-15)
    options: dict[str, Any] = {"parameters": case.parameters, "method": method}
    end = pinred.simulate(case.scene, **options).x[-1]
    x0 = np.asarray(case.scene.x0)
    kick = 1e-6 * np.random.default_rng(1).standard_normal(len(x0))
    other = pinred.simulate(case.scene, x0=x0 + kick, **options).x[-1]
    return np.asarray(end), float(np.abs(other - end).max() / np.abs(kick).max())
