"""Initial shapes of members, with the planned values of prescribed joints."""

from __future__ import annotations

from ...common.arrays import Array
from ...scene.scene import Scene


def with_prescribed_joints(
    scene: Scene, x: Array, xdot: Array, numbers: Array | None
) -> tuple[Array, Array]:
    """Return initial shapes and rates, in which prescribed joints have their planned values.

    Args:
        scene: The scene of all members.
        x: Initial shapes, (N, nx) [rad | m | 1].
        xdot: Initial shape rates, (N, m) [rad/s | m/s].
        numbers: Force parameters of each member, (N, p), or None if all members share them.
    Returns:
        The shapes and rates.
    """
    model = scene.force_model
    if model is None or not model.joints or numbers is None:
        return scene.with_prescribed(x, xdot)
    x, xdot, joints = x.copy(), xdot.copy(), list(model.joints)
    coordinates = scene.system.space.coordinates_of_joints(joints)
    for k, row in enumerate(numbers):
        planned = model.prescribed(0.0, row)
        x[k, coordinates], xdot[k, joints] = planned.x, planned.xdot
    return x, xdot
