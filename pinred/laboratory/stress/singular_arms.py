"""Check of motions through singular shapes of an arm: gimbal lock, and a stretched arm."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...judge.step_defects import largest_defect
from ...system.system import System
from ..bench.chains import chain
from .check import DEFECT, EPS, Case, Cases, Check, Trial, tolerance
from .generated_robots import body, serial

_RTOL = 1e-10
_ROUNDING = 10.0  # bound on round-off in units of eps times the mass ratio of body and ring


def _cases(trial: Trial) -> Cases:
    for light in trial.pick((1e-4,), (1e-1, 1e-2, 1e-3, 1e-4)):
        system = _gimbal(light)
        for miss in trial.pick((1e-3,), (0.0, 1e-3, 1e-1)):
            traj = trial.simulate(
                system,
                x0=[miss, 0.5 * np.pi - 0.4, -miss],
                xdot0=[0.3 * miss, 0.8, 0.2 * miss],
                xi0=[0.1, 0.0, 0.1, 0.2, -0.1, 0.3],
                duration=1.0,
                **tolerance(_RTOL),
            )
            bound = DEFECT + _ROUNDING * EPS / light / _RTOL
            defect = largest_defect(traj, system) / _RTOL
            yield Case(f"gimbal with rings of {light:.0e}, missed by {miss:.0e}", defect, bound)
    for joints in trial.pick((2,), (2, 3, 6)):
        bends = 0.3 * (-1.0) ** np.arange(joints)
        system = chain("spatial", joints)
        traj = trial.simulate(system, x0=bends, xdot0=-bends, duration=2.0, **tolerance(_RTOL))
        yield Case(
            f"arm of {joints} joints stretching out", largest_defect(traj, system) / _RTOL, DEFECT
        )


def _gimbal(light: float) -> System:
    """Build two bodies on a gimbal; two of its axes align if the middle joint is at 90°."""
    heavy = body(1.0, [0.1, -0.2, 0.1], [0.1, 0.15, 0.2])
    ring = body(light, [0.0, 0.0, 0.0], [0.1 * light] * 3)
    joints = (pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ())
    positions = [[0.3, 0.1, 0.0], [0.0] * 3, [0.0] * 3]
    links = list(zip(joints, positions, (ring, ring, heavy), strict=True))
    return serial("gimbal", [(pin.JointModelFreeFlyer(), [0.0] * 3, heavy), *links])


CHECK = Check("singular_shapes", "defect of a step, per tolerance", _cases)
