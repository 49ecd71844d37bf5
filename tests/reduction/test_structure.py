"""What a scene decides: which joints are cyclic, whether time counts, what is left of the base."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.forces import PD, Damper, PotentialEnergy, Spring, Torque, Wrench
from pinred.forces.force import Force
from pinred.judge.reference_solution import FullState
from pinred.reduction.cyclic_joints import cyclic_of
from pinred.signals import Expression, Fourier
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.pinocchio_engine import PinocchioFlow
from pinred.simulation.plan import plan_of


def sizes(scene: pinred.Scene) -> tuple[int, int]:
    """Numbers that the compiled engine and the Pinocchio route integrate."""
    return len(CompiledFlow.of_plan(plan_of(scene)).y0), len(PinocchioFlow(plan_of(scene)).y0)


def by_aba(scene: pinred.Scene) -> Array:
    """The shape at the report times, (T, m), by ABA on the full state."""
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    return full.run(y0, scene.report_times, 1e-12, 1e-14).x


def test_pivoted_base_under_gravity_has_six_variables() -> None:
    """Without the base, μ and the direction of gravity replace the attitude: 6 instead of 4 + 3."""
    model = random_model("SO3", 2, 3)
    model.gravity.linear = np.array([1.0, -2.0, 9.0])
    system = pinred.load(model)
    scene = pinred.Scene(system=system, seed=1, duration=1.0, outputs="shape")
    assert sizes(scene) == (10, 10)
    assert sizes(pinred.Scene(system=system, seed=1)) == (11, 11)
    for engine in ("compiled", "pinocchio"):
        traj = pinred.simulate(scene, engine=engine)
        np.testing.assert_allclose(traj.x, by_aba(scene), rtol=0, atol=1e-8)


def test_saved_shape_motion_has_requested_arrays(tmp_path: Path) -> None:
    """The file has only the requested outputs."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=0.5, outputs="shape")
    for suffix in ("npz", "csv"):
        traj.save(tmp_path / f"traj.{suffix}")
    found = np.load(tmp_path / "traj.npz")
    np.testing.assert_array_equal(found["x"], traj.x)
    assert "pose" not in found
    table = np.genfromtxt(tmp_path / "traj.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(table["energy"], traj.energy)


@pytest.mark.slow
def test_time_is_integrated_only_if_forces_depend_on_it() -> None:
    """A constant torque needs no clock, one that depends on time does."""
    system = pinred.load("falling_cat")
    joint = system.shape_names[0]
    for force, clock in (
        (Torque({joint: 0.2}), 0),
        (Torque({joint: Expression("0.2 + t - t")}), 0),
        (Torque({joint: Fourier(0.1, [0.2], [0.0], 1.0)}), 1),
        (Torque(lambda t, *_: [0.1 * ca.sin(t), 0.0, 0.0]), 1),
        (Torque(lambda _, x, *__: [0.1 * x[1], 0.0, 0.0]), 0),
    ):
        flow = CompiledFlow.of_plan(plan_of(pinred.Scene(system=system, seed=1, forces=[force])))
        assert flow.kernel.layout.clock == clock


WHEELS = ("wheel_x", "wheel_y", "wheel_z")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("force", "cyclic"),
    [
        (Damper("wheel_x", 0.1), ("wheel_y", "wheel_z")),
        pytest.param(Torque({"wheel_y": 0.01}), ("wheel_x", "wheel_z"), marks=pytest.mark.by_hand),
        pytest.param(
            PD({"wheel_z": 0.3}, 1.0, 0.1), ("wheel_x", "wheel_y"), marks=pytest.mark.by_hand
        ),
        (Spring("wheel_x", 0.1), ("wheel_y", "wheel_z")),
        (PotentialEnergy(lambda x: ca.cos(x[1] - x[2])), ("wheel_z",)),
        # What depends on the rate of a wheel, not on its angle, leaves it cyclic.
        (Torque(lambda _, __, xdot, ___: {"panel_hinge": -0.1 * xdot[1]}), WHEELS),
        pytest.param(Damper("panel_hinge", 0.3), WHEELS, marks=pytest.mark.by_hand),
        (Wrench([0.1, 0.0, 0.0, 0.0, 0.0, 0.02]), WHEELS),
    ],
)
@pytest.mark.sampled(4)
def test_force_on_wheel_makes_it_acyclic(force: Force, cyclic: tuple[str, ...]) -> None:
    """A force that acts on a wheel, or depends on its angle, makes it acyclic; others do not."""
    system = pinred.load("reaction_wheel_satellite")
    scene = pinred.Scene(system=system, duration=1.0, forces=[force])
    layout = CompiledFlow.of_plan(plan_of(scene)).kernel.layout
    assert tuple(system.shape_names[k] for k in layout.cyclic) == cyclic
    report = pinred.compare(pinred.simulate(scene))
    assert report.passed, str(report)


@pytest.mark.parametrize("kind", [pin.JointModelFreeFlyer, pin.JointModelSpherical])
@pytest.mark.parametrize("size", [1.0, 1e-4, 1e-7, 1e-8])
def test_small_gimbals_are_not_cyclic(kind: Any, size: float) -> None:
    """Their inertias are small only beside the base's, and are not round-off."""
    rng = np.random.default_rng(3)
    model = pin.Model()

    def body(size: float) -> pin.Inertia:
        return pin.Inertia(1.0, np.zeros(3), np.diag(rng.uniform(0.5, 1.0, 3)) * 0.4 * size**2)

    at = model.addJoint(0, kind(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(at, body(1.0), pin.SE3.Identity())
    for k in range(3):
        axis = rng.normal(size=3)
        hinge = pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis))
        turned = pin.SE3(pin.exp3(rng.normal(size=3)), np.zeros(3))
        at = model.addJoint(at, hinge, turned, f"gimbal_{k}")
        model.appendBodyToJoint(at, body(size), pin.SE3.Identity())
    model.gravity.setZero()
    assert cyclic_of(pinred.load(model), frozenset(), pushed=False) == ()
