"""Cameras of players: balls about a robot's shapes, and whether a camera sees them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import pinred
from pinred.common.arrays import Array
from pinred.views.playback.drawn_bodies import drawn_bodies, extents


def shape_balls(traj: pinred.Trajectory, times: Array) -> tuple[Array, Array, Array]:
    """Return balls about all shapes from Pinocchio's kinematics.

    Args:
        traj: The motion.
        times: Times, (F,) [s].
    Returns:
        Centres (F, N, 3), radii (N,) and centres of mass (F, 3) [m].
    """
    system = traj.system
    model, data = system.model, system.model.createData()
    balls = extents(drawn_bodies(system))
    centres, com = np.empty((len(times), len(balls), 3)), np.empty((len(times), 3))
    for k, q in enumerate(traj(times).q):
        com[k] = pin.centerOfMass(model, data, q)
        centres[k] = [data.oMi[joint].act(centre) for joint, centre, _ in balls]
    return centres, np.array([radius for *_, radius in balls]), com


def sees(
    position: Array, target: Array, fov: float, aspect: float, centres: Array, radii: Array
) -> bool:
    """Return whether balls are inside of the four side planes of a camera with z upwards.

    Args:
        position: Position of the camera, (3,) [m].
        target: Point in the middle of the picture, (3,) [m].
        fov: Vertical field of view [rad].
        aspect: Width of the picture divided by its height.
        centres: Centres of the balls, (…, 3) [m].
        radii: Their radii, (…,) [m].
    Returns:
        True if all of them are inside.
    """
    ahead = (target - position) / np.linalg.norm(target - position)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    above = np.cross(right, ahead)
    arm = centres - position
    for axis, slope in ((above, np.tan(0.5 * fov)), (right, aspect * np.tan(0.5 * fov))):
        half = np.arctan(slope)
        inside = arm @ ahead * np.sin(half) - np.abs(arm @ axis) * np.cos(half) - radii
        if (inside < 0.0).any():
            return False
    return True
