"""Robots in other units: the same motion with other numbers for lengths, masses and times."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from ball_trees import ball_tree
from loop_robots import five_bar, sliding_bars
from trees import random_model

import pinred
from pinred import forces
from pinred.analysis.connections.drag_fluid_and_wheels import centres_of_mass, mechanical_code
from pinred.common.arrays import Array
from pinred.system.loops.loop import Loop
from pinred.system.system import System

GRAVITY = 4.0 * np.array([0.3, -0.8, 0.5])  # [m/s²]
STIFFNESS, DAMPING = 3.0, 0.4  # of the first hinge or slide, in the robot's first units


@dataclass(frozen=True)
class Units:
    """Sizes of the units, each relative to the SI unit.

    Attributes:
        length: Unit of length [m].
        mass: Unit of mass [kg].
        time: Unit of time [s].
    """

    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0


ROBOTS: dict[str, Callable[[], tuple[pin.Model, Sequence[Loop]]]] = {
    "tree": lambda: (random_model("SE3", 4, 3), ()),
    "balls": lambda: (ball_tree(1, 3, balls=0.3).model, ()),
    "loop": five_bar,
    "weld": sliding_bars,
}


def scaled(robot: str, units: Units) -> tuple[System, dict[str, Any]]:
    """Return a robot in other units, with options of a scene that scale with it.

    Args:
        robot: A key of ROBOTS.
        units: The units.
    Returns:
        The robot under gravity, and its forces, initial twist and duration.
    """
    original, loops = ROBOTS[robot]()
    model, L, M, T = original.copy(), units.length, units.mass, units.time
    for i in range(1, model.njoints):
        place, body = model.jointPlacements[i], model.inertias[i]
        model.jointPlacements[i] = pin.SE3(place.rotation, L * place.translation)
        model.inertias[i] = pin.Inertia(M * body.mass, L * body.lever, M * L**2 * body.inertia)
    for frame in model.frames:
        frame.placement = pin.SE3(frame.placement.rotation, L * frame.placement.translation)
    model.gravity.linear = L / T**2 * GRAVITY
    system = pinred.load(model, loops=loops)
    sizes = np.array([L if unit == "m" else 1.0 for unit in system.units])
    armature = np.array(model.armature)
    rates = [L if unit == "m" else 1.0 for unit in system.units]
    armature[-system.m :] *= M * L**2 / np.square(rates)
    model.armature = armature
    system = pinred.load(model, loops=loops)
    first = next(k for k, name in enumerate(system.shape_names) if k not in system.space.ball_v)
    moment = M * L**2 / sizes[first] ** 2
    name = system.shape_names[first]
    pulls = [
        forces.Spring(name, STIFFNESS * moment / T**2),
        forces.Damper(name, DAMPING * moment / T),
    ]
    linear = np.arange(system.r) < system.group.linear
    twist = np.where(linear, L, 1.0) / T * np.linspace(0.4, 1.0, system.r)
    return system, {"forces": pulls, "xi0": twist, "duration": 0.2 * T}


def corners(sizes: Sequence[float]) -> Iterator[Units]:
    """Yield all combinations of sizes of the three units."""
    for length in sizes:
        for mass in sizes:
            for time in sizes:
                yield Units(length, mass, time)


def refusals(system: System, options: dict[str, Any]) -> dict[str, str]:
    """Return the messages of the calls that refuse a robot, by name of the call.

    Args:
        system: The robot.
        options: Options of a scene.
    Returns:
        The messages; empty if no call refuses the robot.
    """
    twist, step = np.asarray(options["xi0"]), options["duration"] / 4.0

    def flow() -> pinred.Flow:
        return pinred.flow(system, wrt=["xi0"], **options)

    calls: dict[str, Callable[[], object]] = {
        "simulate": lambda: pinred.simulate(system, **options),
        "simulate_many": lambda: pinred.simulate_many(
            system, members={"xi0": twist * np.linspace(0.5, 1.0, 9)[:, None]},
            **{key: value for key, value in options.items() if key != "xi0"},
        ),
        "jacobian": lambda: flow().jacobian(),
        "jvp": lambda: flow().jvp({"xi0": twist}),
        "vjp": lambda: flow().vjp(np.ones_like(flow().jvp({"xi0": twist}))),
        "Radau": lambda: pinred.simulate(system, method="Radau", **options),
        "Gauss": lambda: pinred.simulate(system, method=pinred.Gauss(step), **options),
        "connection": lambda: evaluate_connection(system),
    }  # fmt: skip
    messages = {}
    for name, call in calls.items():
        try:
            call()
        except (pinred.PinredError, TypeError) as error:
            messages[name] = f"{type(error).__name__}: {error}"
    return messages


def evaluate_connection(system: System) -> None:
    """Evaluate the mechanical connection, its curvature and its slope, at the neutral shape."""
    if system.loops:
        return
    code = mechanical_code(system)
    x, rates = system.space.neutral[None], np.ones((1, system.m))
    code.velocities(x, rates)
    code.locals(x)
    code.curvatures(x)
    code.velocity_slopes(x, rates)
    code.covariant_forces(x, rates, rates, rates)
    code.locked_derivatives(x, np.ones((1, system.r)))
    centres_of_mass(system, x)


def weld(seed: int) -> str:
    """Return the MJCF of two arms of four hinges on a floating base, with ends welded together."""
    rng = np.random.default_rng(seed)

    def numbers(values: Array) -> str:
        return " ".join(repr(float(value)) for value in values)

    def unit(size: int) -> str:
        direction = rng.normal(size=size)
        return numbers(direction / np.linalg.norm(direction))

    def inertial() -> str:
        A, mass = 0.1 * rng.normal(size=(3, 3)), rng.uniform(1.0, 2.2)
        spread = mass * A @ A.T + 1e-2 * np.eye(3)
        full = np.trace(spread) * np.eye(3) - spread
        entries = numbers(full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        position = numbers(0.08 * rng.normal(size=3))
        return f'<inertial pos="{position}" mass="{mass}" fullinertia="{entries}"/>'

    def arm(name: str) -> str:
        text = ""
        for k in range(4):
            axis = unit(3)
            turn = unit(4) if k < 3 else "1 0 0 0"
            position = numbers(0.6 * rng.normal(size=3))
            text += f'<body name="{name}{k}" pos="{position}" quat="{turn}">'
            text += f'<joint name="j{name}{k}" type="hinge" axis="{axis}"/>{inertial()}'
        position = numbers(0.4 * rng.normal(size=3))
        return text + f'<site name="s{name}" pos="{position}" quat="{unit(4)}"/>' + "</body>" * 4

    gravity = numbers(4.0 * rng.normal(size=3))
    return (
        f'<mujoco><compiler angle="radian"/><option gravity="{gravity}"/><worldbody>'
        f'<body name="base"><freejoint name="root"/>{inertial()}{arm("a")}{arm("b")}</body>'
        '</worldbody><equality><weld body1="a3" body2="b3"/></equality></mujoco>'
    )
