"""MuJoCo's humanoid turns over in flight: a plan of pinred, judged by ABA (needs dm_control)."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinred

MOVED = ("abdomen_y", "hip_x", "hip_y", "knee", "shoulder1", "shoulder2")


def humanoid() -> Path:
    """Return the file of the humanoid in dm_control, which is not imported."""
    spec = find_spec("dm_control")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("dm_control is not installed")
    return Path(spec.submodule_search_locations[0], "suite", "humanoid.xml")


@pytest.mark.by_hand
@pytest.mark.filterwarnings("ignore::pinred.LeftOutWarning")
def test_humanoid_turns_over_at_zero_momentum() -> None:
    """Eleven joints within 1.2 rad pitch the pelvis by half a turn, from rest to rest."""
    path = humanoid()
    names = pinred.load(path).shape_names
    system = pinred.load(path, lock=[n for n in names if not n.endswith(MOVED)])
    plan = pinred.reorient(system, [0.0, np.pi, 0.0], limits=1.2)
    traj = plan.trajectory
    assert plan.remaining <= 1e-12
    assert np.abs(traj.x).max() <= 1.2 + 1e-9
    turned = pin.Quaternion(traj.pose[0, 3:]).inverse() * pin.Quaternion(traj.pose[-1, 3:])
    np.testing.assert_allclose(np.abs(turned.coeffs()), [0.0, 1.0, 0.0, 0.0], atol=1e-8)
    data = system.model.createData()
    for q, v in zip(traj.q, traj.v, strict=True):
        spin = pin.computeCentroidalMomentum(system.model, data, q, v).angular
        assert np.abs(spin).max() <= 1e-9
    report = pinred.compare(traj)
    print(report)
    assert report.passed
