"""Problems of the accuracy benchmark by name; SCENES contains one entry for each problem."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError
from ...scene.random_state import random_state
from ...system.catalogue import INSTALL_ROBOTS, bundled_robots, has_example_robots
from ...system.coordinates import InitialState
from ...system.load import load
from .chains import chain
from .problems import Problem

BARS = ("planar1", "planar5", "satellite", "solo12", "talos")
CHAINS = {"planar": (2, 3, 5, 10, 20, 50), "spatial": (2, 3, 5, 10, 20, 50)}
CHAIN_TIME = 2.0  # duration [s]; long chains become chaotic a few seconds later
_EXAMPLES = {"solo12": (4.0, 1.0), "talos": (2.0, 2.0)}  # duration [s], factor of initial rates
# Scene name → bundled robot, and the factor by which its initial rates are multiplied.
_FASTER = {"planar5": ("planar_chain5", 2.0), "satellite": ("satellite_two_arms", 3.0)}
_NO_GRAVITY = (0.0, 0.0, 0.0)


def planar_joint() -> Problem:
    """Return two coupled planar bodies whose locked inertia depends on the joint angle."""
    system = load("planar_chain5", lock=("joint2", "joint3", "joint4", "joint5"))
    start = InitialState(
        x=np.array([0.3]), xdot=np.array([1.2]), xi=np.array([0.1, 0.2, -0.3]), duration=10.0
    )
    return Problem("planar1", "planar_chain5 with all joints but the first locked", system, start)


def bundled(name: str) -> Problem:
    """Return a bundled robot with its default initial state."""
    system = load(name)
    if system.initial is None:
        raise InputError(f"'{name}' has no default initial state")
    return Problem(
        name, f"{bundled_robots()[name].description}, default initial state", system, system.initial
    )


def faster(name: str) -> Problem:
    """Return a bundled robot with its default initial state and its rates scaled by a factor."""
    robot, factor = _FASTER[name]
    slow = bundled(robot)
    about = f"{robot} from its default state with rates times {factor:g}"
    return Problem(name, about, slow.system, _scaled(slow.start, factor, slow.start.duration))


def example(name: str) -> Problem:
    """Return a robot of example-robot-data without gravity, from a random initial state."""
    system = load(name, gravity=_NO_GRAVITY)
    duration, factor = _EXAMPLES[name]
    about = f"{name} tumbling without torque or gravity, seed 0"
    about += f", rates times {factor:g}" if factor != 1.0 else ""
    return Problem(name, about, system, _scaled(random_state(system, 0), factor, duration))


def _scaled(state: InitialState, factor: float, duration: float) -> InitialState:
    return InitialState(state.x, factor * state.xdot, factor * state.xi, duration)


def chained(family: str, joints: int) -> Problem:
    """Return a chain of equal links, from a random initial state."""
    system = chain(family, joints)
    start = _scaled(random_state(system, 0), 1.0, CHAIN_TIME)
    name = f"{family}-{joints}"
    return Problem(name, f"a {family} chain of {joints} joints, seed 0", system, start)


def _factories() -> dict[str, Callable[[], Problem]]:
    factories: dict[str, Callable[[], Problem]] = {"planar1": planar_joint}
    # The peers of the benchmark have no ball joints in pinred's coordinates, and no closed loops.
    robots = [name for name, robot in bundled_robots().items() if not (robot.balls or robot.loops)]
    factories |= {name: partial(bundled, name) for name in robots}
    factories |= {name: partial(faster, name) for name in _FASTER}
    factories |= {name: partial(example, name) for name in _EXAMPLES}
    for family, sizes in CHAINS.items():
        factories |= {f"{family}-{n}": partial(chained, family, n) for n in sizes}
    return factories


SCENES = _factories()


@checks_arguments
def problems_named(names: Sequence[str] | None = None) -> tuple[list[Problem], list[str]]:
    """Build the problems with the given names.

    Args:
        names: Names in SCENES; BARS if None.
    Returns:
        The problems, and one message for each problem that needs a missing package.
    Raises:
        InputError: Unknown name.
    """
    requested = list(dict.fromkeys(BARS if names is None else names))
    for name in requested:
        if name not in SCENES:
            raise InputError(f"no scene '{name}'; the scenes are {', '.join(SCENES)}")
    unavailable = [n for n in requested if n in _EXAMPLES and not has_example_robots()]
    missing = [f"{name} is left out: {INSTALL_ROBOTS}" for name in unavailable]
    return [SCENES[name]() for name in requested if name not in unavailable], missing
