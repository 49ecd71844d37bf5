"""Closure of gaits that turn joints: a complete turn must restore the robot."""

from __future__ import annotations

import numpy as np

from ...common.errors import InputError
from ..connections.connection import Connection
from ..connections.gaits_of_all_joints import AllJointsCode
from ..connections.loop_connection import LoopConnectionCode
from ..gaits.arcs import TAU
from ..gaits.gait import Gait

_REPEATS = 1e-9  # largest change of body twists over a complete turn, relative to the twists
_SAMPLES = 16  # number of shapes at which the turned robot is compared


def refuse_open(connection: Connection, gait: Gait) -> None:
    """Reject a gait that turns a joint whose complete turn does not restore the robot.

    Args:
        connection: Connection, in rotation vectors if there are ball joints.
        gait: Path in shape space that may turn joints.
    Raises:
        InputError: The path is open; the message names the joint.
    """
    if len(gait.turns) == connection.m and (joint := _open_joint(connection, gait)):
        raise InputError(
            "gait: only a joint whose complete turn restores the robot may turn, "
            f"got turns {gait.turns}, with a turn of '{joint}'"
        )


def is_closed(connection: Connection, gait: Gait) -> bool:
    """Return whether a connection repeats itself after the turns of a gait.

    Args:
        connection: Connection with as many joints as the gait.
        gait: Path in shape space that may turn joints.
    Returns:
        Whether all joints that turn are revolute, and a complete turn of each restores the
        connection; or are balls whose attitudes at both ends are equal.
    """
    return not _open_joint(connection.in_chart(), gait)


def turns_ball(connection: Connection, gait: Gait) -> bool:
    """Return whether a gait turns a ball, so that its rotation vector does not return."""
    chart = connection.chart
    return chart is not None and bool(gait.rise[chart.space.ball_v].any())


def _open_joint(connection: Connection, gait: Gait) -> str:
    """Return a joint whose complete turn does not restore the connection, or ""."""
    rise, chart = gait.rise, connection.chart
    if chart is not None:
        start, _ = gait.at(0.0)
        if ball := chart.open_ball(start, start + rise):
            return ball
        rise[chart.space.ball_v] = 0.0
    x, xdot = gait.samples(_SAMPLES)
    xi = connection.code.velocities(x, xdot).xi
    size = float(np.abs(xi).max(initial=0.0))
    is_closed_loop = isinstance(connection.code, AllJointsCode | LoopConnectionCode)
    for k in np.flatnonzero(rise).tolist():
        # Joints of a closed loop may turn together although none of them can turn alone.
        alone = TAU * np.eye(connection.m)[k]
        turned = x + (rise if is_closed_loop else alone)
        change = float(np.abs(connection.code.velocities(turned, xdot).xi - xi).max(initial=0.0))
        if connection.form.units[k] != "rad" or not change <= _REPEATS * size:
            return connection.joints[k]
    return ""
