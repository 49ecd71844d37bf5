"""Check of chains of up to 200 joints, planar and spatial."""

from __future__ import annotations

import numpy as np

from ...judge.step_defects import largest_defect
from ..bench.chains import chain
from .check import DEFECT, Case, Cases, Check, Trial, tolerance

_RTOL = 1e-10


def _cases(trial: Trial) -> Cases:
    sizes = (("planar", 50), ("planar", 200), ("spatial", 50), ("spatial", 200))
    for family, joints in trial.pick((("planar", 50),), sizes):
        rng = np.random.default_rng(joints)
        system = chain(family, joints)
        traj = trial.simulate(
            system,
            x0=rng.uniform(-0.3, 0.3, joints),
            xdot0=rng.uniform(-0.3, 0.3, joints),
            duration=0.5,
            **tolerance(_RTOL),
        )
        defect = largest_defect(traj, system, max_steps=trial.pick(5, 20)) / _RTOL
        yield Case(f"{family}, {joints} joints", defect, DEFECT)


CHECK = Check("long_chains", "defect of a step, per tolerance", _cases)
