"""Compilation ahead of use: the machine code that common calls on a robot need."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from ..analysis.full_reduction import Reduction
from ..common.errors import InputError
from ..integrators.methods import METHODS
from ..scene.scene import Scene
from ..simulation.flow_map.flow import flow
from ..simulation.simulate import simulate
from ..simulation.simulate_many import simulate_many
from ..system.system import System

_DURATION = 1e-3  # [s]


def warm_caches(system: System) -> Iterator[tuple[str, float]]:
    """Compile and cache the code of simulations, batches, flows and fields of a robot.

    Scenes with forces, prescribed joints or variable parameters have code of their own.

    Args:
        system: The robot.
    Yields:
        A call that is prepared, and the time that it took [s].
    """
    for name, call in _calls(system):
        began = time.perf_counter()
        with suppress(InputError):  # a method or a derivative that this robot does not have
            call()
            yield name, time.perf_counter() - began


def _calls(system: System) -> Iterator[tuple[str, Callable[[], Any]]]:
    scenes = {
        "": Scene(system=system, seed=0, duration=_DURATION),
        " at zero momentum": Scene(system=system, momentum=0, duration=_DURATION),
    }
    methods: dict[str, Any] = dict(METHODS)
    for kind, method in methods.items():
        integrator = kind if method.adaptive else method(_DURATION)
        yield f"simulate(method={kind})", partial(simulate, scenes[""], method=integrator)
    yield "simulate_many", partial(simulate_many, system, seeds=[0, 1], duration=_DURATION)
    still = partial(simulate_many, system, x0=_shapes(system), momentum=0, duration=_DURATION)
    yield "simulate_many at zero momentum", still
    for words, scene in scenes.items():
        yield f"simulate{words}", partial(simulate, scene)
        yield f"flow{words}", partial(_flow_end, scene)
        yield f"flow.jacobian{words}", partial(_jacobian, scene)
        yield f"flow.vjp{words}", partial(_pull_back, scene)
    yield "Reduction.grid", partial(Reduction(system).grid, _shapes(system))


def _shapes(system: System) -> Any:
    """Return two shapes, (2, nx)."""
    return np.tile(system.space.neutral, (2, 1))


def _flow_end(scene: Scene) -> Any:
    return flow(scene)()


def _jacobian(scene: Scene) -> Any:
    return flow(scene).jacobian()


def _pull_back(scene: Scene) -> Any:
    return flow(scene).vjp({"pose": np.ones(scene.system.group.dim)})
