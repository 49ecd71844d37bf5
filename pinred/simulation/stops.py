"""Stops: where a force is not smooth or a controller is due, and what is set anew there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..common.arrays import Array
from ..scene.scene import Scene
from .state import Sample


def stops_of(scene: Scene) -> Array:
    """Return the times at which integration stops, the end of the scene last, (S,) [s]."""
    forces, end = scene.force_model, scene.end
    if forces is None:
        return np.array([end])
    times = [forces.breaks(end), np.array([end])]
    for controller, _ in forces.held:
        times.append(controller.period * np.arange(1, int(end / controller.period) + 1))
    inside = np.unique(np.concatenate(times))
    inside = inside[inside <= end]
    # What round-off holds apart is one stop; the end stays.
    apart = np.append(np.diff(inside) > 1e-12 * end, True)
    return np.asarray(inside[apart])


def begin_stretch(
    scene: Scene, numbers: Array, t: float, stop: float, see: Callable[[], Sample]
) -> None:
    """Set the numbers in the forces of a scene for the stretch from t to its stop.

    see: gives what forces see at t, and is called only if a controller is due.
    """
    forces = scene.force_model
    if forces is None:
        return
    numbers[forces.within] = 0.5 * (t + stop)
    # The first sample is at the start; the others at multiples of the period.
    due = [
        (controller, where)
        for controller, where in forces.held
        if abs(t / controller.period - round(t / controller.period)) < 1e-9
    ]
    if due:
        seen, names = see(), scene.system.shape_names
        for controller, where in due:
            numbers[where] = controller.sample(names, t, seen.x, seen.xdot, seen.mu)
