"""Functions of connections take systems, and functions of systems take mechanical connections."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pinred
from pinred import Connection, Gait, InputError

CAT = pinred.load("three_rods")
GAIT = Gait.fourier([0.0, 0.0], [[0.4, 0.0]], [[0.0, 0.4]])
LIMITS = [(-0.5, 0.5)] * 2
CALLS: dict[str, Callable[[Any], Any]] = {
    "phase": lambda source: pinred.phase(source, GAIT).pose,
    "phase_slopes": lambda source: pinred.phase_slopes(source, GAIT).pose,
    "flatness": lambda source: pinred.flatness(source, LIMITS).worst,
    "corrected_integral": lambda source: pinred.corrected_integral(source, GAIT).integral,
    "optimal_frame": lambda source: pinred.optimal_frame(source, LIMITS, degree=3).angular,
    "optimise_gait": lambda source: pinred.optimise_gait(source, harmonics=1, starts=1).merit,
    "field": lambda source: pinred.plot(source, "field", limits=LIMITS).axes[0].get_title(),
}


@pytest.mark.parametrize("name", CALLS)
def test_system_stands_for_its_mechanical_connection(name: str) -> None:
    """Both arguments give the same result, and the message names what is accepted."""
    call = CALLS[name]
    np.testing.assert_array_equal(call(CAT), call(Connection.mechanical(CAT)))
    with pytest.raises(InputError, match="Connection"):
        call("three_rods")


def test_reorient_takes_mechanical_connection() -> None:
    """It simulates the robot of the connection, and refuses other connections."""
    by_system, by_connection = (pinred.reorient(s, 0.3) for s in (CAT, Connection.mechanical(CAT)))
    np.testing.assert_array_equal(by_system.trajectory.x, by_connection.trajectory.x)
    swimmer = Connection.viscous(CAT, {"base": np.eye(6)})
    with pytest.raises(InputError, match="mechanical connection"):
        pinred.reorient(swimmer, 0.3)


def test_curvature_of_connection_is_its_field() -> None:
    """The plot of a connection has the values of `field`."""
    connection = Connection.mechanical(CAT)
    both = [
        pinred.plot(connection, kind, limits=LIMITS).axes[1].get_ylim()
        for kind in ("curvature", "field")
    ]
    assert both[0] == both[1]
    with pytest.raises(InputError, match="draws gaits"):
        pinred.plot(connection, "curvature", path=np.zeros((3, 2)))
