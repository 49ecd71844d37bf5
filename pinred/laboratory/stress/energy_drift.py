"""Energy over up to a million periods: bounded for symplectic methods, a slope for the others.

Energies are Pinocchio's, of the states reported at random times, so that no phase is preferred;
the slope is that of a straight line through them, with its standard deviation.
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
_SIGMAS = 4.0
_DRIFTING = 10_000  # periods
_STEPS = 59.3  # in a period; no whole number, lest steps and motion resonate
_ROUNDING = 10.0  # of eps times the root of the number of steps


Make: TypeAlias = Callable[[float], Method]


@dataclass(frozen=True)
class Swing:
    """A periodic motion.  period: s, in closed form."""

    name: str
    system: System
    x0: Array
    xi0: Array
    period: float


def swings() -> list[Swing]:
    """Return a pole swinging from a free cart, and a tumbling body."""
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
            kind = _bounded if make(h).symplectic else _drifting
            yield from kind(trial, swing, make, periods)
        line = _line(trial, swing, dop853(_RTOL, 1e-2 * _RTOL), periods)
        change = (abs(line.change) + _SIGMAS * line.uncertainty) / periods
        yield Case(f"{swing.name}, DOP853, change in a period", change, 10.0 * _RTOL)


def _bounded(trial: Trial, swing: Swing, make: Make, periods: int) -> Cases:
    """A symplectic method: no slope that can be measured, and no change above the early ones."""
    method = make(swing.period / _STEPS)
    line = _line(trial, swing, method, periods)
    who = f"{swing.name}, {method.name}, {periods:.0e} periods"
    rounding = _ROUNDING * EPS * math.sqrt(periods * _STEPS)
    yield Case(f"{who}, slope", abs(line.change), _SIGMAS * line.uncertainty + rounding)
    yield Case(f"{who}, largest change", line.most, 2.0 * line.early + rounding)


def _drifting(trial: Trial, swing: Swing, make: Make, periods: int) -> Cases:
    """A method of order p that loses energy: with the step to the power p, at least."""
    count = min(periods // 10, _DRIFTING)  # for longer, too much would be lost for a straight line
    coarse, fine = (
        _line(trial, swing, make(swing.period / (parts * _STEPS)), count) for parts in (1, 2)
    )
    method = make(swing.period)
    who = f"{swing.name}, {method.name}"
    yield Case(f"{who}, uncertainty of its slope", fine.uncertainty / abs(fine.change), 0.1)
    ratio = abs(fine.change / coarse.change)
    yield Case(f"{who}, slope at half the step", ratio, 2.0 ** (0.5 - method.order))


@dataclass(frozen=True)
class Line:
    """Changes of energy over time, relative to the kinetic energy at its most.

    change: of the fitted line from start to end.  uncertainty: its standard deviation.
    most: the largest of all changes.  early: of those in the first hundredth of the time.
    """

    change: float
    uncertainty: float
    most: float
    early: float


def _line(trial: Trial, swing: Swing, method: Method, periods: int) -> Line:
    end = swing.period * periods
    rng = np.random.default_rng(3)
    early, late = rng.uniform(0.0, 0.01 * end, _SAMPLES), rng.uniform(0.0, end, _SAMPLES)
    times = np.union1d(np.concatenate([early, late]), [0.0, end])
    found = trial.simulate_many(
        swing.system, x0=swing.x0[None], xi0=swing.xi0[None], times=times, method=method
    )[0]
    energy, kinetic = _energies(swing.system, found.q, found.v)
    change = (energy - energy[0]) / kinetic.max()
    part = times / end
    coefficients, covariance = np.polyfit(part, change, 1, cov=True)
    return Line(
        change=float(coefficients[0]),
        uncertainty=math.sqrt(covariance[0, 0]),
        most=float(np.abs(change).max()),
        early=float(np.abs(change[part <= 0.01]).max()),
    )


def _energies(system: System, q: Array, v: Array) -> tuple[Array, Array]:
    """Return total and kinetic energies (T,), by Pinocchio."""
    model, data = system.model, system.model.createData()
    kinetic = np.array([pin.computeKineticEnergy(model, data, *s) for s in zip(q, v, strict=True)])
    height = np.array([pin.computePotentialEnergy(model, data, row) for row in q])
    return kinetic + height, kinetic


CHECK = Check("energy", "change of energy, relative", _cases)
