"""Check of the energy over up to a million periods: bounded with symplectic methods, else drifting.

Pinocchio computes the energies of states at random times, so that no phase is preferred. The drift
is the slope of a fitted line, with its standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...integrators.methods import Method
from ...system.load import load
from ...system.system import System
from .check import EPS, Case, Cases, Check, Trial, dop853
from .closed_forms import cartpole_period, euler_top

_RTOL = 1e-11
_SAMPLES = 500
_SIGMAS = 4.0  # significance of a slope, in standard deviations
_DRIFTING = 10_000  # largest number of periods for methods with an energy drift
_STEPS = 59.3  # steps per period; not an integer, so that steps and motion do not resonate
_ROUNDING = 10.0  # bound in units of eps times the square root of the number of steps


Make: TypeAlias = Callable[[float], Method]


@dataclass(frozen=True)
class Swing:
    """A periodic motion.

    Attributes:
        name: Name of the motion.
        system: The system.
        x0: Initial shape, (m,).
        xi0: Initial body twist, (r,).
        period: Period in closed form [s].
    """

    name: str
    system: System
    x0: Array
    xi0: Array
    period: float


def swings() -> list[Swing]:
    """Return a pole that swings on a free cart, and a tumbling rigid body."""
    pole = load("cartpole")
    omega, moments = np.array([0.5, 0.7, 1.6]), np.array([1.0, 2.0, 2.5])
    _, period = euler_top(moments, omega, np.zeros(1))
    swing = cartpole_period(mass=3.0, lever=0.5, moment=0.34, gravity=9.81, most=1.0)
    return [
        Swing("cartpole", pole, np.ones(1), np.zeros(1), swing),
        Swing("rigid_body", load("rigid_body"), np.empty(0), omega, period),
    ]


def _cases(trial: Trial) -> Cases:
    periods = trial.pick(1000, 100_000, 1_000_000)
    for swing in swings():
        h = swing.period / _STEPS
        for make in trial.fixed:
            check = _check_bounded if make(h).symplectic else _check_drifting
            yield from check(trial, swing, make, periods)
        line = _fit_line(trial, swing, dop853(_RTOL, 1e-2 * _RTOL), periods)
        change = (abs(line.change) + _SIGMAS * line.uncertainty) / periods
        yield Case(f"{swing.name}, DOP853, change in a period", change, 10.0 * _RTOL)


def _check_bounded(trial: Trial, swing: Swing, make: Make, periods: int) -> Cases:
    """Check that the energy of a symplectic method has no measurable slope or growing changes."""
    method = make(swing.period / _STEPS)
    line = _fit_line(trial, swing, method, periods)
    case = f"{swing.name}, {method.name}, {periods:.0e} periods"
    rounding = _ROUNDING * EPS * math.sqrt(periods * _STEPS)
    yield Case(f"{case}, slope", abs(line.change), _SIGMAS * line.uncertainty + rounding)
    yield Case(f"{case}, largest change", line.most, 2.0 * line.early + rounding)


def _check_drifting(trial: Trial, swing: Swing, make: Make, periods: int) -> Cases:
    """Check that the energy loss of a method of order p decreases at least with step^p."""
    count = min(periods // 10, _DRIFTING)  # longer runs lose too much energy for a linear fit
    coarse, fine = (
        _fit_line(trial, swing, make(swing.period / (n * _STEPS)), count) for n in (1, 2)
    )
    method = make(swing.period)
    case = f"{swing.name}, {method.name}"
    yield Case(f"{case}, uncertainty of its slope", fine.uncertainty / abs(fine.change), 0.1)
    ratio = abs(fine.change / coarse.change)
    yield Case(f"{case}, slope at half the step", ratio, 2.0 ** (0.5 - method.order))


@dataclass(frozen=True)
class Line:
    """Changes of energy over time, relative to the largest kinetic energy.

    Attributes:
        change: Change of the fitted line from start to end.
        uncertainty: Standard deviation of `change`.
        most: Largest change.
        early: Largest change in the first hundredth of the time.
    """

    change: float
    uncertainty: float
    most: float
    early: float


def _fit_line(trial: Trial, swing: Swing, method: Method, periods: int) -> Line:
    end = swing.period * periods
    rng = np.random.default_rng(3)
    early, late = rng.uniform(0.0, 0.01 * end, _SAMPLES), rng.uniform(0.0, end, _SAMPLES)
    times = np.union1d(np.concatenate([early, late]), [0.0, end])
    traj = trial.simulate_many(
        swing.system, x0=swing.x0[None], xi0=swing.xi0[None], times=times, method=method
    )[0]
    energy, kinetic = _energies(swing.system, traj.q, traj.v)
    change = (energy - energy[0]) / kinetic.max()
    fraction = times / end
    coefficients, covariance = np.polyfit(fraction, change, 1, cov=True)
    return Line(
        change=float(coefficients[0]),
        uncertainty=math.sqrt(covariance[0, 0]),
        most=float(np.abs(change).max()),
        early=float(np.abs(change[fraction <= 0.01]).max()),
    )


def _energies(system: System, q: Array, v: Array) -> tuple[Array, Array]:
    """Compute total and kinetic energies, (T,) each, with Pinocchio."""
    model, data = system.model, system.model.createData()
    kinetic = np.array([pin.computeKineticEnergy(model, data, *s) for s in zip(q, v, strict=True)])
    height = np.array([pin.computePotentialEnergy(model, data, row) for row in q])
    return kinetic + height, kinetic


CHECK = Check("energy", "change of energy, relative", _cases)
