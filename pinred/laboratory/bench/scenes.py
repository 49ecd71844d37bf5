"""The problems on which accuracy is measured, by name.  A further one is one more entry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from ...common.errors import InputError
from ...scene.random_state import random_state
from ...system.catalogue import INSTALL_ROBOTS, bundled_robots, has_example_robots
from ...system.coordinates import InitialState
from ...system.load import load
from .chains import chain
from .problems import Problem

BARS = ("planar1", "planar5", "satellite", "solo12", "talos")
CHAINS = {"planar": (2, 3, 5, 10, 20, 50), "spatial": (2, 3, 5, 10, 20, 50)}
CHAIN_TIME = 2.0  # s; long chains are chaotic within some seconds more
_EXAMPLES = {"solo12": (4.0, 1.0), "talos": (2.0, 2.0)}  # s, and by how much rates are larger
# Bundled robots that move faster than the state they come with has it.
_FASTER = {"planar5": ("planar_chain5", 2.0), "satellite": ("satellite_two_arms", 3.0)}
_AFLOAT = (0.0, 0.0, 0.0)


def planar_joint() -> Problem:
    """Return two coupled bodies in the plane, where the joint's angle matters."""
    system = load("planar_chain5", lock=("joint2", "joint3", "joint4", "joint5"))
    start = InitialState(
        x=np.array([0.3]), xdot=np.array([1.2]), xi=np.array([0.1, 0.2, -0.3]), duration=10.0
    )
    return Problem("planar1", "planar_chain5 with all joints but the first locked", system, start)


def bundled(name: str) -> Problem:
    """Return a bundled robot from the state it comes with."""
    system = load(name)
    if system.initial is None:
        raise InputError(f"'{name}' comes with no initial state")
    return Problem(
        name, f"{bundled_robots()[name].description}, its own state", system, system.initial
    )


def faster(name: str) -> Problem:
    """Return a bundled robot from the state it comes with, all rates multiplied."""
    robot, factor = _FASTER[name]
    slow = bundled(robot)
    about = f"{robot} from its own state with rates times {factor:g}"
    return Problem(name, about, slow.system, _scaled(slow.start, factor, slow.start.duration))


def example(name: str) -> Problem:
    """Return a robot of example-robot-data tumbling without gravity, from a generic state."""
    system = load(name, gravity=_AFLOAT)
    duration, factor = _EXAMPLES[name]
    about = f"{name} tumbling without torque or gravity, seed 0"
    about += f", rates times {factor:g}" if factor != 1.0 else ""
    return Problem(name, about, system, _scaled(random_state(system, 0), factor, duration))


def _scaled(state: InitialState, factor: float, duration: float) -> InitialState:
    return InitialState(state.x, factor * state.xdot, factor * state.xi, duration)


def chained(family: str, joints: int) -> Problem:
    """Return a chain of equal links, from a generic state."""
    system = chain(family, joints)
    start = _scaled(random_state(system, 0), 1.0, CHAIN_TIME)
    name = f"{family}-{joints}"
    return Problem(name, f"a {family} chain of {joints} joints, seed 0", system, start)


def _makers() -> dict[str, Callable[[], Problem]]:
    makers: dict[str, Callable[[], Problem]] = {"planar1": planar_joint}
    makers |= {name: partial(bundled, name) for name in bundled_robots()}
    makers |= {name: partial(faster, name) for name in _FASTER}
    makers |= {name: partial(example, name) for name in _EXAMPLES}
    for family, sizes in CHAINS.items():
        makers |= {f"{family}-{n}": partial(chained, family, n) for n in sizes}
    return makers


SCENES = _makers()


def problems_named(names: Sequence[str] | None = None) -> tuple[list[Problem], list[str]]:
    """Return the problems of these names, those of BARS if None, and a line on each left out.

    Raises InputError for a name that is none, listing them.
    """
    wanted = list(dict.fromkeys(BARS if names is None else names))
    for name in wanted:
        if name not in SCENES:
            raise InputError(f"no scene '{name}'; they are {', '.join(SCENES)}")
    there = has_example_robots()
    left = [name for name in wanted if name in _EXAMPLES and not there]
    missing = [f"{name} is left out: {INSTALL_ROBOTS}" for name in left]
    return [SCENES[name]() for name in wanted if name not in left], missing
