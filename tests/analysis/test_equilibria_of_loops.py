"""Relative equilibria of robots with loops, against closed forms and Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from constraint_dynamics import constraint_dynamics
from finite_hessian import hessian
from loop_robots import crank_angles, five_bar, four_bar, random_loops
from scipy.optimize import brentq

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import SingularInertiaError


def test_equilibria_of_a_four_bar_are_the_critical_points_of_its_closed_form() -> None:
    """All roots of ∂U/∂crank on both branches, with U = J²/2I by CRBA; ω² is U''/M."""
    model, loops = four_bar()
    system, J, h = pinred.load(model, loops=loops), 3.0, 1e-3
    data = model.createData()

    def energy(crank: float, branch: float) -> float:
        coupler, rocker = crank_angles(crank, branch)
        q = np.array([0.0, 0.0, 1.0, 0.0, crank, coupler, rocker])
        pin.ccrba(model, data, q, np.zeros(model.nv))
        return 0.5 * J**2 / float(data.Ig.inertia[2, 2])

    def slope(crank: float, branch: float) -> float:
        U = [energy(crank + k * h, branch) for k in (-2, -1, 1, 2)]
        return (U[0] - 8.0 * U[1] + 8.0 * U[2] - U[3]) / (12.0 * h)

    grid = np.linspace(-np.pi, np.pi, 101) + 0.01
    roots = []
    for branch in (-1.0, 1.0):
        slopes = [slope(u, branch) for u in grid]
        changes = np.flatnonzero(np.diff(np.sign(slopes))).tolist()
        ends = [(grid[k], grid[k + 1]) for k in changes]
        roots += [(brentq(slope, a, b, (branch,), xtol=1e-13), branch) for a, b in ends]
    expected = np.sort([energy(*root) for root in roots])
    equilibria = pinred.relative_equilibria(system, momentum=J, starts=20)
    assert len(equilibria) == len(roots) == 4
    np.testing.assert_allclose([e.amended_potential for e in equilibria], expected, rtol=1e-11)
    red = pinred.LoopReduction(system, independent=("crank",))
    for entry in equilibria:
        crank, branch = min(roots, key=lambda r: abs(np.exp(1j * r[0]) - np.exp(1j * entry.x[0])))
        coupler, rocker = crank_angles(crank, branch)
        np.testing.assert_allclose(
            np.exp(1j * entry.x), np.exp(1j * np.array([crank, coupler, rocker])), atol=1e-9
        )
        U = [energy(crank + k * h, branch) for k in (-2, -1, 0, 1, 2)]
        second = float(np.dot(U, [-1.0, 16.0, -30.0, 16.0, -1.0])) / (12.0 * h**2)
        square = second / float(red.at(entry.x).reduced_metric[0, 0])
        found = entry.growth if square < 0.0 else entry.frequencies[0]
        np.testing.assert_allclose(found, np.sqrt(abs(square)), rtol=1e-6)
        assert entry.verdict == ("stable" if square > 0.0 else "unstable")


@pytest.mark.by_hand
def test_frequencies_of_a_rotating_five_bar_have_the_gyroscopic_term() -> None:
    """The reduced equations M ü = J GᵀBG u̇ − U'' u, with U'' by differences, have the modes."""
    model, loops = five_bar()
    system, J = pinred.load(model, loops=loops), 2.0
    springs = {"left_crank": (30.0, 2.0), "right_crank": (30.0, 1.0), "left_coupler": (5.0, -1.0)}
    equilibria = pinred.relative_equilibria(system, momentum=J, springs=springs, starts=40)
    red = pinred.LoopReduction(system, independent=("left_crank", "right_crank"), springs=springs)
    rows, checked = [system.shape_names.index(name) for name in red.independent], 0

    def amended(u: Array) -> float:
        at = red.at(red.shape(u))
        I = at.locked_inertia
        about_com = I[2, 2] - I[2, :2] @ np.linalg.solve(I[:2, :2], I[:2, 2])
        return float(at.potential + 0.5 * J**2 / about_com)

    for entry in equilibria:
        try:
            u = entry.x[rows]
            here, K = red.at(red.shape(u)), hessian(amended, u, 5e-4)
        except SingularInertiaError:
            continue
        turns = (here.x - entry.x)[1::2] / (2.0 * np.pi)  # no spring acts on the right coupler
        if abs(turns[0]) > 1e-6 or abs(turns[1] - np.round(turns[1])) > 1e-6:
            continue  # on another branch of the couplers
        checked, M = checked + 1, here.reduced_metric
        gyro = np.einsum("i,iab->ab", entry.mu, here.curvature)
        matrix = np.block(
            [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), np.linalg.solve(M, gyro)]]
        )
        expected = np.linalg.eigvals(matrix)
        traj = pinred.simulate(entry.scene(duration=0.1))
        found = pinred.linearise(traj).eigenvalues
        np.testing.assert_allclose(
            np.sort_complex(np.round(found, 6)), np.sort_complex(np.round(expected, 6)), rtol=1e-5
        )
    assert checked >= 1


@pytest.mark.by_hand
def test_equilibria_in_space_are_steady_for_constraint_dynamics_of_pinocchio() -> None:
    """With multipliers, joints do not accelerate and the body twist is constant."""
    model, loops = random_loops(5, ("3d",), 3)
    system = pinred.load(model, loops=loops)
    springs = dict.fromkeys(system.shape_names, (4.0, 0.1))
    equilibria = pinred.relative_equilibria(system, momentum=0.5, springs=springs, starts=30)
    assert len(equilibria) > 2
    solve = constraint_dynamics(system.model, *system.loops)
    for entry in equilibria:
        traj = pinred.simulate(entry.scene(duration=0.1))
        q, v, tau = traj.q[0], traj.v[0], np.zeros(system.model.nv)
        tau[6:] = -4.0 * (entry.x - 0.1)
        assert np.linalg.norm(v[3:6]) > 1e-3
        acceleration, _ = solve(q, v, tau)
        # Body coordinates: a steady twist has the acceleration zero.
        size = float(np.abs(tau).max() + np.linalg.norm(v) ** 2)
        np.testing.assert_allclose(acceleration, 0.0, atol=1e-8 * size * 1e2)


def test_motion_along_a_mode_keeps_the_loops_closed_and_its_frequency() -> None:
    """A scene on a mode starts closed, and compare passes."""
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    entry = pinred.relative_equilibria(system, momentum=3.0, starts=10)[0]
    period = 2.0 * np.pi / entry.frequencies[0]
    scene = entry.scene(0, amplitude=1e-3, times=np.linspace(0, period, 5))
    traj = pinred.simulate(scene, method="AdaptiveGauss")
    around = (traj.x - entry.x)[:, 0]
    expected = around[0] * np.cos(np.linspace(0.0, 2.0 * np.pi, 5))
    np.testing.assert_allclose(around, expected, atol=1e-2 * abs(around[0]))
    assert abs(around[0]) > 5e-4
    assert pinred.compare(traj).passed
