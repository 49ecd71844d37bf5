"""Arguments that are a connection, or a system that stands for its mechanical connection."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ...system.system import System
from .connection import Connection
from .loop_connection import LoopConnectionCode

ConnectionSource: TypeAlias = Connection | System


def connection_of(source: ConnectionSource, what: str) -> Connection:
    """Return a connection, or the mechanical connection of a system.

    Args:
        source: The connection or the system.
        what: Name of the function in messages.
    Raises:
        InputError: The source is neither.
    """
    if isinstance(source, System):
        return Connection.mechanical(source)
    if not isinstance(source, Connection):
        raise InputError(
            f"{what} takes a Connection, or a System for its mechanical connection; got "
            f"{type(source).__name__}"
        )
    return source


def robot_of(connection: Connection) -> System | None:
    """Return the robot of a connection, with its loops; None if it was built without one."""
    code = connection.code
    return code.chart_system if isinstance(code, LoopConnectionCode) else connection.system


def rest_of(connection: Connection) -> Array:
    """Return the shape (m,) at rest: zero, or that at which the loops of a robot were assembled."""
    if not isinstance(connection.code, LoopConnectionCode):
        return np.zeros(connection.m)
    chart = connection.code.chart
    closure = chart.system.closure
    assert closure is not None
    return closure.x[chart.system.space.coordinates_of(chart.independent.tolist())]


def system_of(source: ConnectionSource, what: str) -> System:
    """Return a system, or the system of a mechanical connection.

    Args:
        source: The system or the connection.
        what: Name of the function in messages.
    Raises:
        InputError: The source is neither, or the connection is not mechanical.
    """
    if not isinstance(source, Connection):
        return source
    system = robot_of(source)
    if system is None or not source.is_mechanical:
        raise InputError(
            f"{what} simulates a robot by its mechanical connection, got {source.title()}; pass "
            "the System"
        )
    return system
