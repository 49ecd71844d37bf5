"""Faults of 1e-9 in a mass, a length or an axis fail the comparison of every bundled robot."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.system.find_robot_files import bundled_robots

BY = 1e-9


def with_fault(system: pinred.System, kind: str, joint: int, axis: int) -> pinred.System:
    """Return the robot with one constant wrong by 1e-9 (relative, or rad for an axis)."""
    model, entry = system.model.copy(), np.eye(3)[axis]
    body, place = model.inertias[joint].copy(), model.jointPlacements[joint].copy()
    if kind == "mass":
        model.inertias[joint].mass = body.mass * (1.0 + BY)
    elif kind == "lever":
        model.inertias[joint].lever = body.lever * (1.0 + BY * entry)
    elif kind == "moment":
        model.inertias[joint].inertia = body.inertia + BY * np.diag(entry * np.diag(body.inertia))
    elif kind == "length":
        longer = place.translation * (1.0 + BY * entry)
        model.jointPlacements[joint] = pin.SE3(place.rotation, longer)
    else:
        turn = pin.exp3(BY * entry)
        model.jointPlacements[joint] = pin.SE3(place.rotation @ turn, place.translation)
    return pinred.load(model, loops=system.loops)  # type: ignore[arg-type]


@cache
def motion(name: str) -> pinred.Trajectory:
    """Simulate a short motion of a bundled robot, with a spring if nothing moves otherwise."""
    springs = {"elroys_beanie": {"beanie": (3.0, 0.0)}, "snakeboard": {"rotor": (3.0, 0.0)}}
    return pinred.simulate(pinred.load(name), duration=0.5, springs=springs.get(name, {}))


def compare_with(traj: pinred.Trajectory, other: pinred.System) -> pinred.Report:
    """Compare a motion with the equations of another robot."""
    start: dict[str, Any] = {"x0": traj.x[0], "xdot0": traj.xdot[0], "xi0": traj.xi[0]}
    scene = replace(traj.scene, system=other, **start)
    return pinred.compare(pinred.Trajectory(scene, traj.motion, traj.run))


# Of a free body only its moments show; a hinge's axis in the plane, or along that of symmetry of
# all it carries, shows only where it is turned about itself, or not at all; of the beanie, no axis.
FAULTS = {
    "elroys_beanie": [("moment", 1, 2), ("moment", 2, 2)],
    "coupled_planar": [("mass", 1, 0), ("mass", 2, 0), ("length", 2, 0)],
    "planar_chain5": [
        ("mass", 1, 0), ("mass", 6, 0), ("lever", 6, 0), ("length", 2, 0), ("length", 6, 0),
        ("axis", 2, 2), ("axis", 6, 2),
    ],
    "rigid_body": [("moment", 1, 0), ("moment", 1, 1), ("moment", 1, 2)],
    "coupled_spatial": [
        ("mass", 1, 0), ("mass", 4, 0), ("lever", 4, 0), ("length", 2, 0), ("axis", 2, 0),
        ("axis", 4, 2),
    ],
    "satellite_two_arms": [
        ("mass", 1, 0), ("mass", 4, 0), ("lever", 7, 0), ("length", 2, 1), ("length", 7, 0),
        ("axis", 2, 0), ("axis", 7, 1),
    ],
    "falling_cat": [
        ("mass", 1, 0), ("mass", 4, 0), ("lever", 1, 0), ("axis", 2, 0), ("axis", 4, 2),
    ],
    "cartpole": [("mass", 1, 0), ("mass", 2, 0), ("lever", 2, 2), ("axis", 2, 1)],
    "double_spherical_pendulum": [
        ("mass", 2, 0), ("mass", 4, 0), ("lever", 4, 2), ("length", 3, 2), ("axis", 2, 0),
        ("axis", 4, 1),
    ],
    "reaction_wheel_satellite": [
        ("mass", 1, 0), ("lever", 2, 0), ("length", 2, 0), ("axis", 2, 0), ("axis", 3, 1),
        ("moment", 3, 0), ("mass", 4, 0),
    ],
    "upright_drone": [
        ("mass", 1, 0), ("mass", 3, 0), ("lever", 3, 0), ("axis", 2, 2), ("axis", 3, 1),
    ],
    "purcell_swimmer": [("mass", 1, 0), ("mass", 3, 0), ("length", 3, 0), ("moment", 2, 2)],
    "three_rods": [("mass", 1, 0), ("mass", 3, 0), ("lever", 3, 0), ("length", 3, 0)],
    "snakeboard": [("mass", 2, 0), ("length", 3, 0), ("moment", 1, 2), ("moment", 4, 2)],
    "falling_cat_ball": [("mass", 1, 0), ("mass", 2, 0), ("lever", 2, 0), ("moment", 1, 1)],
    "diver": [("mass", 1, 0), ("mass", 2, 0), ("lever", 3, 2), ("length", 3, 1), ("axis", 2, 1)],
    "astronaut": [
        ("mass", 1, 0), ("mass", 3, 0), ("lever", 4, 2), ("length", 2, 2), ("axis", 3, 1),
    ],
    "floating_arm": [("mass", 1, 0), ("mass", 3, 0), ("lever", 3, 0), ("length", 2, 0)],
    "four_bar": [("mass", 1, 0), ("mass", 3, 0), ("lever", 4, 0)],
    "gripper": [("mass", 1, 0), ("mass", 3, 0), ("lever", 4, 0)],
    "parallel_biped": [("mass", 1, 0), ("mass", 3, 0), ("lever", 5, 2)],
}  # fmt: skip


def test_all_bundled_robots_have_faults() -> None:
    """No bundled robot is left out."""
    assert set(FAULTS) == set(bundled_robots())


# Robots whose comparisons take more than 4 s.
LONG = {
    "coupled_spatial",
    "elroys_beanie",
    "four_bar",
    "gripper",
    "parallel_biped",
    "astronaut",
    "diver",
    "snakeboard",
    "upright_drone",
    "satellite_two_arms",
    "double_spherical_pendulum",
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.by_hand) if name in LONG else name
        for name in sorted(FAULTS)
    ],
)
@pytest.mark.sampled(4)
def test_fault_of_1e_9_fails_equations(name: str) -> None:
    """The equations detect it at the default tolerance; without the fault all checks pass."""
    traj = motion(name)
    unit = compare_with(traj, traj.system)
    assert unit.passed, str(unit)
    for fault, joint, axis in FAULTS[name]:
        report = compare_with(traj, with_fault(traj.system, fault, joint, axis))
        assert report.verdict == "FAILED", (fault, joint, axis, str(report))
        assert report.equations > report.equations_bound, (fault, joint, axis)
