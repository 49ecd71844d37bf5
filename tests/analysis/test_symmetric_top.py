"""Heavy symmetric tops, with and without rotors: stability thresholds and ABA's spectrum."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from spinning_robots import heavy_gyrostat

import pinred
from pinred.analysis.equilibria.equilibrium_problem import Points, problem_of
from pinred.analysis.equilibria.find_equilibria import equilibrium_at
from pinred.analysis.equilibria.relative_equilibrium import RelativeEquilibrium
from pinred.analysis.stability.stability_verdict import HeavyTop
from pinred.common.arrays import Array

TOP = Path(__file__).parent.parent.parent / "examples/heavy_top.urdf"
NOTHING: dict[str, Any] = dict.fromkeys(("cyclic", "springs", "prescribed"), None)
NOTHING |= {"forces": (), "passive": False}
UP = Points(np.zeros((1, 0)), np.array([[0.0, 0.0, 1.0]]))
# Of the gyrostat: moments about its pivot with the rotor's, and m g l of both.
I1, I3, WHEEL = 0.1 + 0.25 + 0.01 + 0.4 * 0.49, 0.05 + 0.02, 0.02
PULL = 9.81 * (1.0 * 0.5 + 0.4 * 0.7)
THRESHOLD = float(np.sqrt(4.0 * PULL * I1))  # threshold of the momentum about the axis


def upright_equilibrium(system: pinred.System, J: float, **given: object) -> RelativeEquilibrium:
    """Return the equilibrium upright on its pivot, with a momentum about the vertical."""
    return equilibrium_at(problem_of(system, **(NOTHING | given)), UP, J)


def full_spectrum(each: RelativeEquilibrium) -> Array:
    """Return the eigenvalues of ABA, linearised about the steady motion in body coordinates."""
    model, n = each.system.model, each.system.n
    start = each.scene().start
    q = each.system.q(start.pose, start.x)
    v = each.system.v(start.xi, start.xdot)
    data = model.createData()
    by_q, by_v, _ = pin.computeABADerivatives(model, data, q, v, np.zeros(n))
    J = np.block([[np.zeros((n, n)), np.eye(n)], [by_q, by_v]])
    J[:3, :3] = -pin.skew(each.xi)  # δg = g η̂:  η̇ = δξ − ξ × η
    return np.asarray(np.linalg.eigvals(J))


def test_sleeping_top_is_stable_above_threshold() -> None:
    """The threshold ω² = 4 m g l I₁/I₃² is met to 1e-10."""
    top, I1, I3, pull = pinred.load(TOP, group="SO3"), 0.35, 0.05, 9.81 * 0.5
    threshold = np.sqrt(4.0 * pull * I1) / I3

    def sleeping(spin: float) -> RelativeEquilibrium:
        return upright_equilibrium(top, I3 * spin)

    assert sleeping((1.0 - 1e-10) * threshold).growth > 0.0
    assert sleeping((1.0 + 1e-10) * threshold).growth == 0.0
    slow, fast = sleeping(0.9 * threshold), sleeping(1.1 * threshold)
    assert (slow.verdict, fast.verdict) == ("unstable", "stable")
    assert fast.stability.index == 2  # The amended potential alone does not show stability.
    # The horizontal component δ of Γ obeys δ̈ I₁ − i I₃ ω δ̇ − m g l δ = 0.
    half, rest = 0.5 * I3 * 0.9 * threshold / I1, pull / I1
    assert slow.growth == pytest.approx(np.sqrt(rest - half**2), rel=1e-11)
    half = 0.5 * I3 * 1.1 * threshold / I1
    # Body coordinates rotate at ω.
    spins = half + np.array([-1.0, 1.0]) * np.sqrt(half**2 - rest)
    expected = np.sort(np.abs(1.1 * threshold - spins))
    np.testing.assert_allclose(fast.frequencies, expected, rtol=1e-10)


@pytest.mark.parametrize("momentum", [-2.0, 0.0, 0.6, 5.0])
@pytest.mark.sampled(4)
def test_sleeping_gyrostat_is_stable_above_threshold(momentum: float) -> None:
    """The threshold is (I₃ ω + h)² = 4 m g l I₁ for any rotor momentum h."""
    system = heavy_gyrostat()
    cyclic = {"wheel": momentum}
    for factor, stable in ((1.0 - 1e-8, False), (1.0 + 1e-8, True)):
        beside = upright_equilibrium(system, factor * THRESHOLD, cyclic=cyclic)
        assert (beside.verdict == "stable") == stable
    for factor, verdict in ((0.95, "unstable"), (1.05, "stable"), (-1.05, "stable")):
        equilibrium = upright_equilibrium(system, factor * THRESHOLD, cyclic=cyclic)
        assert equilibrium.verdict == verdict
        omega, rate = equilibrium.xi[2], equilibrium.xdot[0]
        h = WHEEL * rate  # relative to the body
        assert I3 * omega + h == pytest.approx(factor * THRESHOLD, rel=1e-12)
        assert WHEEL * (omega + rate) == pytest.approx(momentum, abs=1e-13)
        half = 0.5 * (I3 * omega + h) / I1
        left = half**2 - PULL / I1
        if left < 0.0:
            assert equilibrium.growth == pytest.approx(np.sqrt(-left), rel=1e-11)
        else:
            spins = half + np.array([-1.0, 1.0]) * np.sqrt(left)
            expected = np.sort(np.abs(omega - spins))  # Body coordinates rotate at ω.
            np.testing.assert_allclose(equilibrium.frequencies, expected, rtol=1e-9)
            assert equilibrium.stability.index == 2
        spectrum = full_spectrum(equilibrium)
        assert spectrum.real.max() == pytest.approx(
            equilibrium.growth, abs=1e-5
        )  # double zeros have errors of √ε
        for expected in equilibrium.frequencies:
            assert np.abs(spectrum - 1j * expected).min() < 1e-5


def test_driven_rotor_stabilises_top_at_rest() -> None:
    """For ω = 0 the momentum of the rotor alone must exceed the threshold: h² > 4 m g l I₁."""
    system = heavy_gyrostat()
    for factor, verdict in ((0.99, "unstable"), (1.01, "stable"), (-1.01, "stable")):
        h = factor * THRESHOLD
        each = upright_equilibrium(system, h, prescribed={"wheel": f"{h / WHEEL!r}*t"})
        assert each.xi[2] == pytest.approx(0.0, abs=1e-12)
        assert each.verdict == verdict
    equilibrium = upright_equilibrium(system, 1.01 * THRESHOLD, prescribed={"wheel": 0.3})
    assert equilibrium.verdict == "stable"
    assert equilibrium.xi[2] == pytest.approx(1.01 * THRESHOLD / I3, rel=1e-12)


def test_simulated_top_stays_upright_above_threshold() -> None:
    """After a perturbation it stays upright above the threshold and falls below it."""
    system = heavy_gyrostat()
    for factor, stays in ((1.05, True), (0.95, False)):
        equilibrium = upright_equilibrium(system, factor * THRESHOLD, cyclic={"wheel": 2.0})
        traj = pinred.simulate(equilibrium.scene(0, amplitude=1e-4, duration=20.0))
        tops = [pin.Quaternion(pose).matrix()[2, 2] for pose in traj.pose]
        assert (min(tops) > 0.99999) == stays


@pytest.mark.parametrize("changes", [{"tilt": 1e-5}, {"skew": 1e-4}])
@pytest.mark.sampled
def test_asymmetric_top_is_undecided(changes: dict[str, float]) -> None:
    """With a tilted rotor or unequal moments, only the momentum about the vertical remains."""
    system = heavy_gyrostat(**changes)
    equilibria = pinred.relative_equilibria(system, momentum=1.2 * THRESHOLD, cyclic={"wheel": 2.0})
    top = max(equilibria, key=lambda each: each.direction[2])
    assert top.direction[2] > 0.99
    assert top.verdict == "undecided"
    assert len(top.frequencies) == 2


@pytest.mark.by_hand("1.0")
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_threshold_is_independent_of_units(unit: float) -> None:
    """Very light and very heavy tops have the same threshold in scaled units."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "root")
    body = pin.Inertia(unit, np.array([0.0, 0.0, 0.5]), unit * np.diag([0.1, 0.1, 0.05]))
    model.appendBodyToJoint(root, body, pin.SE3.Identity())
    system = pinred.load(model)
    threshold = unit * np.sqrt(4.0 * 9.81 * 0.5 * 0.35)
    for factor, verdict in ((0.999, "unstable"), (1.001, "stable"), (100.0, "stable")):
        assert upright_equilibrium(system, factor * threshold).verdict == verdict


def test_top_axis_needs_symmetry_to_1e_12() -> None:
    """Inertia, centre of mass and rotors must share the axis to twelve digits."""
    lever = np.array([0.0, 0.0, 0.5])

    def axis(moments: list[float], offset: list[float], com: Array = lever) -> Array | None:
        scales = np.repeat([1.0, 1.0], 3)
        return HeavyTop(np.diag(moments), np.array(offset), com, 9.81, scales, 1.0).axis

    assert axis([0.1, 0.1, 0.05], [0.0, 0.0, 0.3]) is not None
    assert axis([0.1, 0.1 + 5e-13, 0.05], [0.0, 0.0, 0.3]) is None
    assert axis([0.1, 0.1, 0.05], [5e-12, 0.0, 0.3]) is None
    assert axis([0.1, 0.1, 0.05], [0.0, 0.0, 0.3], np.array([0.1, 0.0, 0.5])) is None
