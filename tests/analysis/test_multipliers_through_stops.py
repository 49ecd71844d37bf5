"""Floquet multipliers of periodic motions with impacts, against closed forms."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from slides import bouncing_slide, pair_of_slides

import pinred
from pinred.forces import Torque

MASS = 0.75  # reduced mass of the slide [kg]


def test_ball_between_two_stops_has_the_closed_form() -> None:
    """A slide at speed v between stops at 0 and 1 shears: δx grows by T δv. It is cyclic."""
    traj = pinred.simulate(
        bouncing_slide(), x0=[0.4], xdot0=[1.0], xi0=[0.1], duration=2.5,
        stops={"slide": (0.0, 1.0, 1.0)},
    )  # fmt: skip
    floquet = pinred.floquet(traj, period=2.0)
    np.testing.assert_allclose(floquet.monodromy, [[1.0, 2.0 / MASS], [0.0, 1.0]], atol=1e-12)
    np.testing.assert_allclose(floquet.multipliers, 1.0, atol=1e-6)  # a double root
    assert floquet.closure < 1e-14


def test_one_cyclic_joint_with_a_stop_beside_one_without() -> None:
    """The cyclic joint without a stop has a constant momentum, and is left out."""
    traj = pinred.simulate(
        pair_of_slides(), x0=[0.4, 0.3], xdot0=[1.0, 0.0], xi0=[-0.25], duration=2.0,
        stops={"left": (0.0, 1.0, 1.0)},
    )  # fmt: skip
    # Reduced masses: the inverse mass of the left slide is 1/1 + 1/2.
    monodromy = pinred.floquet(traj).monodromy
    np.testing.assert_allclose(monodromy, [[1.0, 2.0 * 1.5], [0.0, 1.0]], atol=1e-12)


@pytest.mark.by_hand("0.6")
@pytest.mark.parametrize("restitution", [0.6, 0.9])
def test_driven_impact_oscillator_has_the_closed_form(restitution: float) -> None:
    """A spring, a force of frequency Ω, and one impact in each period T = 2π/Ω.

    Between the impacts at ±T/2, x = X cos ωt + P cos(Ωt + ψ). The impact law gives X, and x = b at
    the impact gives b. The monodromy matrix is the rotation by ωT times the saltation matrix
    ((−e, 0), ((1 + e) a/v, −e)), where a is the acceleration at the stop and v the speed before it.
    """
    e, w, Omega, P, psi = restitution, 2.3, 3.1, 0.3, np.pi / 12.0
    T = 2.0 * np.pi / Omega
    c, s, Q = np.cos(w * T / 2.0), np.sin(w * T / 2.0), P * Omega * np.sin(psi)
    X = -Q * (1.0 + e) / (w * s * (1.0 - e))
    b, v = X * c - P * np.cos(psi), Q - w * X * s
    a = -(w**2 - Omega**2) * P * np.cos(psi) - w**2 * b
    force = MASS * P * (w**2 - Omega**2)
    run: dict[str, Any] = {
        "x0": [X + P * np.cos(psi)], "xdot0": [-P * Omega * np.sin(psi)], "xi0": [0.0],
        "duration": T, "stops": {"slide": (-9.0, b, e)}, "springs": {"slide": (MASS * w**2, 0.0)},
        "forces": [Torque(lambda t, *_: [force * ca.cos(Omega * t + psi)])],
    }  # fmt: skip
    traj = pinred.simulate(bouncing_slide(), **run)
    np.testing.assert_allclose(traj.impacts.t, [T / 2.0], rtol=1e-9)
    np.testing.assert_allclose(traj.impacts.rate_before, [v], rtol=1e-8)
    floquet = pinred.floquet(traj)
    C, S = np.cos(w * T), np.sin(w * T)
    saltation = np.array([[-e, 0.0], [(1.0 + e) * a / v, -e]])
    trace = float(np.trace(np.array([[C, S / w], [-w * S, C]]) @ saltation))
    root = np.sqrt(complex(trace**2 / 4.0 - e**2))
    expected = np.sort_complex([trace / 2.0 + root, trace / 2.0 - root])
    np.testing.assert_allclose(np.sort_complex(floquet.multipliers), expected, atol=1e-9)
    np.testing.assert_allclose(np.prod(floquet.multipliers), e**2, atol=1e-9)


def test_period_that_ends_or_starts_at_a_stop_is_refused() -> None:
    """A period starts where no joint is at its stop."""
    run: dict[str, Any] = {"xi0": [0.1], "stops": {"slide": (0.0, 1.0)}, "duration": 1.0}
    resting = pinred.simulate(bouncing_slide(), x0=[0.4], xdot0=[-1.0], **run)
    with pytest.raises(pinred.InputError, match="period: slide of 'slide' rests at its stop"):
        pinred.floquet(resting)
    starting = pinred.simulate(bouncing_slide(), x0=[0.0], xdot0=[-1.0], **run)
    with pytest.raises(pinred.InputError, match="'slide' starts at its lower stop"):
        pinred.floquet(starting)
