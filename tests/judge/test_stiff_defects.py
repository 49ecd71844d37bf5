"""Filtered defects of steps in scenes whose dampers stop the reference solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import pinred
from pinred.forces import Damper
from pinred.judge.compare import DENSE_BOUND
from pinred.judge.reference_solution import FullState
from pinred.judge.step_defects import compute_defects, filter_defect


def stiff_cat() -> pinred.Trajectory:
    """Return a motion whose dampers stop the joints within microseconds."""
    system = pinred.load("falling_cat")
    dampers = [Damper(name, 1e6) for name in system.shape_names]
    return pinred.simulate(system, forces=dampers, duration=20.0)


def test_stiff_dampers_are_not_failed() -> None:
    """SciPy's Radau over ABA confirms such a motion to 1e-8; residuals alone exceed the bound."""
    traj = stiff_cat()
    report = pinred.compare(traj, budget=0.05)
    assert report.verdict == "CANNOT TELL"
    assert report.defect < 0.5 * report.defect_bound
    plain = compute_defects(traj, FullState(traj.scene), max_steps=40, propagate=False)
    assert plain.worst > 100.0 * report.defect_bound


def test_moderate_dampers_are_not_failed() -> None:
    """Joints that come to rest within milliseconds: ABA needs 1e5 evaluations for a second."""
    system = pinred.load("falling_cat")
    dampers = [Damper(name, 10.0) for name in system.shape_names]
    traj = pinred.simulate(system, forces=dampers, rtol=1e-8, seed=1, duration=1.0)
    report = pinred.compare(traj, budget=0.05)
    assert report.verdict == "CANNOT TELL"
    assert report.defect < 0.1 * report.defect_bound


def test_filter_keeps_defects_of_faults() -> None:
    """Those of the right system pass; 1e-5 more mass in one body gives defects far above."""
    traj = stiff_cat()
    system = traj.system
    model = system.model.copy()
    model.inertias[1].mass *= 1.0 + 1e-5
    full = FullState(replace(traj.scene, system=pinred.System(model, system.name), seed=0))
    wrong, right = (
        compute_defects(traj, each, max_steps=40, propagate=False, stiff=True).worst
        for each in (full, FullState(traj.scene))
    )
    tolerance = traj.scene.rtol + traj.scene.atol
    assert wrong > 30.0 * 3.0 * tolerance
    assert right < 0.5 * DENSE_BOUND * tolerance


def test_filter_leaves_growing_defects() -> None:
    """Decaying parts are divided by 1 + h c / 2; growing parts are kept."""
    defect = np.array([1.0, 2.0])
    decaying = filter_defect(np.diag([-1e6, -1e-3]), 2.0, defect)
    np.testing.assert_allclose(decaying, [1.0 / (1.0 + 1e6), 2.0 / 1.001], rtol=1e-12)
    np.testing.assert_array_equal(filter_defect(np.diag([1e6, -1e6]), 2.0, defect), defect)
