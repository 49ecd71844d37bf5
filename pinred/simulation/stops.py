"""Stops: times at which a force is not smooth or a controller acts."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from ..scene.scene import Scene


def stops_of(scene: Scene) -> Array:
    """Return the times at which integration stops, (S,) [s]; the last one ends the scene."""
    forces, end = scene.force_model, scene.end
    if forces is None:
        return np.array([end])
    times = [forces.breaks(end), np.array([end])]
    for controller, _ in forces.held:
        times.append(controller.period * np.arange(1, int(end / controller.period) + 1))
    stops = np.unique(np.concatenate(times))
    stops = stops[stops <= end]
    # Times that differ by round-off are one stop, and the end has to remain.
    distinct = np.append(np.diff(stops) > 1e-12 * end, True)
    return np.asarray(stops[distinct])
