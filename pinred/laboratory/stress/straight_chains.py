"""Check of nearly straight chains of thin rods, whose locked inertia is almost singular."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...judge.step_defects import largest_defect
from ...reduction.inertia_split import symmetric
from ...system.system import System
from .check import DEFECT, EPS, Case, Cases, Check, Trial, tolerance
from .generated_robots import body, serial

_RTOL = 1e-10
_ROUNDING = 10.0  # bound on round-off in units of eps times the locked inertia's condition number


def _cases(trial: Trial) -> Cases:
    for thin in trial.pick((1e-2, 1e-8), (1e-2, 1e-4, 1e-6, 1e-8)):
        system = _chain(thin)
        for bend in trial.pick((1e-1, 1e-4), (1e-1, 1e-2, 1e-4)):
            # The spin axis is normal to the chain, so only the bends cause spin along the chain.
            traj = trial.simulate(
                system,
                x0=bend * np.array([1.0, -0.7, 0.4]),
                xdot0=bend * np.array([0.5, 0.8, -0.6]),
                xi0=[0.0, 0.5, -0.7],
                duration=2.0,
                **tolerance(_RTOL),
            )
            condition = max(_condition(system, q) for q in traj.q[::20])
            bound = DEFECT + _ROUNDING * EPS * condition / _RTOL
            yield Case(
                f"thin to {thin:.0e}, bent by {bend:.0e}",
                largest_defect(traj, system) / _RTOL,
                bound,
            )


def _condition(system: System, q: Array) -> float:
    """Compute the condition number of the locked inertia with Pinocchio's CRBA."""
    upper = pin.crba(system.model, system.model.createData(), q)[:3, :3]
    return float(np.linalg.cond(symmetric(upper)))


def _chain(thin: float) -> System:
    link = body(1.0, [0.25, 0.0, 0.0], 0.02 * np.array([thin, 1.0, 1.0]))
    joints = (pin.JointModelSpherical(), pin.JointModelRY(), pin.JointModelRZ(), pin.JointModelRY())
    return serial("straight", [(j, [0.5 * (k > 0), 0.0, 0.0], link) for k, j in enumerate(joints)])


CHECK = Check("straight_chains", "defect of a step, per tolerance", _cases)
