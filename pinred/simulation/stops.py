"""Stops: where a force is not smooth or a controller is due."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from ..scene.scene import Scene


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
