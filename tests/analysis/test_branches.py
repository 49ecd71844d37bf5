"""Branches over the momentum, on a pendulum whose folds and pitchforks have closed forms."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize_scalar

import pinred
from pinred.analysis.equilibria import branches as found_by
from pinred.analysis.equilibria.amended_potential import AmendedEnergy
from pinred.analysis.equilibria.branches import Curve, CurvePoint
from pinred.analysis.equilibria.equilibrium_problem import Points, problem_of
from pinred.common.arrays import Array

HUB, MASS, LENGTH, G = 0.3, 1.2, 0.7, 9.81
SLIM, WIDE = 0.01, 0.06  # moments of inertia about the arm and transverse to it [kg m²]
NOTHING = {"cyclic": None, "springs": None, "forces": (), "prescribed": None, "passive": False}


def governor(offset: float) -> pinred.System:
    """An arm on a hub that rotates about the vertical, hinged at an offset from the axis."""
    model = pin.Model()
    model.name = "governor"
    hub = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hub")
    model.appendBodyToJoint(hub, pin.Inertia(1.0, np.zeros(3), HUB * np.eye(3)), pin.SE3.Identity())
    place = pin.SE3(np.eye(3), np.array([offset, 0.0, 0.0]))
    arm = model.addJoint(hub, pin.JointModelRY(), place, "tilt")
    body = pin.Inertia(MASS, np.array([0.0, 0.0, -LENGTH]), np.diag([WIDE, WIDE, SLIM]))
    model.appendBodyToJoint(arm, body, pin.SE3.Identity())
    return pinred.load(model)


def inertia(x: float | Array, offset: float) -> float | Array:
    """Inertia about the vertical; the arm hangs at x = 0 and its tip moves towards −x."""
    s, c = np.sin(x), np.cos(x)
    return HUB + MASS * (offset - LENGTH * s) ** 2 + WIDE * s**2 + SLIM * c**2


def squared_momentum_at(x: float, offset: float) -> float:
    """J² = 2 I² V′/I′, for which the arm is in equilibrium at x."""
    s, c = np.sin(x), np.cos(x)
    slope = -2.0 * MASS * LENGTH * c * (offset - LENGTH * s) + 2.0 * (WIDE - SLIM) * s * c
    return float(2.0 * inertia(x, offset) ** 2 * MASS * G * LENGTH * s / slope)


def test_pitchfork_of_centred_governor() -> None:
    """With the hinge on the axis, J_c = I₀ √(m g l/ΔI). Above it two mirror images lift."""
    wide = MASS * LENGTH**2 + WIDE - SLIM
    critical = (HUB + SLIM) * np.sqrt(MASS * G * LENGTH / wide)
    branches = pinred.branches(governor(0.0), momentum=(0.6 * critical, 1.4 * critical), starts=15)
    hanging = [p for p in branches.pitchforks if abs(p.x[0]) < 1.0]
    assert len(hanging) == 1
    assert hanging[0].momentum == pytest.approx(critical, rel=1e-10)
    assert branches.folds == ()
    (lifted,) = (
        k for k in range(branches.count) if any(0.1 < abs(p.x[0]) < 1.4 for p in branches.branch(k))
    )
    for p in branches.branch(lifted):
        if abs(p.x[0]) > 0.02:
            assert p.momentum**2 == pytest.approx(squared_momentum_at(p.x[0], 0.0), rel=1e-9)
            assert p.index == 0
            assert p.residual < 1e-12
    assert min(p.momentum for p in branches.branch(lifted)) == pytest.approx(critical, rel=2e-3)
    (down,) = (
        k for k in range(branches.count) if all(abs(p.x[0]) < 1e-6 for p in branches.branch(k))
    )
    for p in branches.branch(down):
        assert p.index == int(p.momentum > critical)


def test_fold_of_offset_governor() -> None:
    """An offset of the hinge breaks the pitchfork into a fold at the minimum of J²(x)."""
    offset = 0.05
    best = minimize_scalar(
        lambda x: squared_momentum_at(x, offset), bounds=(0.1, 1.2), method="bounded",
        options={"xatol": 1e-12},
    )  # fmt: skip
    critical = np.sqrt(best.fun)
    branches = pinred.branches(
        governor(offset), momentum=(0.8 * critical, 1.4 * critical), starts=15
    )
    assert len(branches.folds) == 1
    (fold,) = branches.folds
    assert fold.momentum == pytest.approx(critical, rel=1e-10)
    assert fold.x[0] == pytest.approx(best.x, abs=1e-5)
    assert fold.residual < 1e-9
    assert branches.pitchforks == ()
    through = branches.branch(fold.branch)
    assert {p.index for p in through} == {0, 1}
    for p in through:
        assert p.momentum**2 == pytest.approx(squared_momentum_at(p.x[0], offset), rel=1e-8)
    each = through[0].equilibrium()
    assert each.momentum == through[0].momentum
    assert each.residual < 1e-12
    assert "fold at momentum" in str(branches)


def test_fold_needs_extended_system_and_half_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fold is rejected if half steps move it or the extended system does not confirm it."""
    offset = 0.05
    problem = problem_of(governor(offset), **NOTHING)  # type: ignore[arg-type]
    curve = Curve(AmendedEnergy(problem), 1.0)
    point = Points(np.array([[0.3]]), np.zeros((1, 0)))
    here = curve.start(point, np.sqrt(squared_momentum_at(0.3, offset)), np.array([-1.0, 0.0]))
    there: CurvePoint | None = here
    while there is not None and there.index == here.index:
        here, there = there, curve.step(there, 0.02)
    assert there is not None
    (fold,) = found_by.bifurcations_between(curve, here, there, 0.02)
    assert fold.kind == "fold"
    assert found_by.extended_residual(curve, fold.at) < 1e-9
    whole = found_by.locate_zero
    for factor, folds in ((4.0, []), (0.4, [fold])):
        with monkeypatch.context() as patch:
            patch.setattr(found_by, "extended_residual", lambda *_, f=factor: f * 1e-9)
            again = found_by.bifurcations_between(curve, here, there, 0.02)
            assert [each.at.J for each in again] == [each.at.J for each in folds]
        off = factor * 1e-7 * max(1.0, fold.at.J)

        def elsewhere(
            curve: Curve, a: CurvePoint, h: float, k: int, off: float = off
        ) -> CurvePoint | None:
            found = whole(curve, a, h, k)
            return found if found is None or h >= 0.02 else replace(found, J=found.J + off)

        with monkeypatch.context() as patch:
            patch.setattr(found_by, "locate_zero", elsewhere)
            patch.setattr(found_by, "extended_residual", lambda *_: 0.0)
            patch.setattr(found_by, "classify", lambda *_: fold)
            assert len(found_by.bifurcations_between(curve, here, there, 0.02)) == len(folds)
        v, e = curve.null_vector(fold.at), curve.energy(fold.at.points, fold.at.J)
        size = max(float(np.abs(e.hessian).max()), float(e.scale[0]))
        with monkeypatch.context() as patch:  # with a small component of ∂F/∂J along v
            patch.setattr(
                Curve, "slope_by_momentum", lambda *_, s=factor * 1e-6 * size * v / curve.unit: s
            )
            kind = found_by.classify(curve, fold.at)
            assert kind is not None
            assert (kind.kind == "fold") == (factor > 1.0)


@pytest.mark.parametrize(
    ("third", "kind"), [(0.0, "pitchfork"), (3e-5, "pitchfork"), (3e-4, "crossing")]
)
def test_crossing_is_pitchfork_below_third_derivative_limit(third: float, kind: str) -> None:
    """For U = ⅙ c z³ of size 1, a crossing with |c| below 1e-4 is a pitchfork."""

    def energy(points: Points, _: float) -> SimpleNamespace:
        z = points.x[0, 0]
        return SimpleNamespace(hessian=np.array([[[third * z]]]), scale=np.ones(1))

    bent: Any = SimpleNamespace(
        unit=1.0,
        energy=energy,
        null_vector=lambda _: np.ones(1),
        slope_by_momentum=lambda _: np.zeros(1),
        ambient=lambda _, direction: direction,
        local=lambda _, along: along,
    )
    flat = np.zeros(1)
    at = CurvePoint(x=flat, n=np.zeros(0), J=1.0, tangent=flat, values=flat, residual=0.0)
    bifurcation = found_by.classify(bent, at)
    assert bifurcation is not None
    assert bifurcation.kind == kind


def test_rigid_body_has_three_branches_without_bifurcation() -> None:
    """The amended potential is ½ J²/I along three branches, each with one index."""
    branches = pinred.branches(pinred.load("rigid_body"), momentum=(0.5, 1.5), starts=20, step=0.2)
    assert branches.count == 3
    assert len(branches.folds) + len(branches.pitchforks) + len(branches.crossings) == 0
    for k, I in enumerate((2.5, 2.0, 1.0)):
        for p in branches.branch(k):
            assert p.amended_potential == pytest.approx(0.5 * p.momentum**2 / I, rel=1e-12)
            assert p.index == k
        ends = [branches.branch(k)[0].momentum, branches.branch(k)[-1].momentum]
        np.testing.assert_allclose(sorted(ends), [0.5, 1.5], rtol=1e-12)


@pytest.mark.by_hand
def test_double_pendulum_has_fold_at_published_momentum() -> None:
    """The fold is at J = 0.908178; two more equilibria exist above it."""
    pendulum = pinred.load("double_spherical_pendulum")
    branches = pinred.branches(pendulum, momentum=(0.9, 0.915), starts=40, step=0.2)
    (fold,) = branches.folds
    assert fold.momentum == pytest.approx(0.9081782824, rel=1e-9)
    before, after = (len(pinred.relative_equilibria(pendulum, momentum=J)) for J in (0.9, 0.915))
    assert after == before + 2


def test_invalid_ranges_and_branches_are_refused() -> None:
    """Invalid ranges, missing branches and robots without unknowns are refused."""
    cat = pinred.load("falling_cat")
    for momentum in ((1.0, 0.5), (1.0,), (0.0, 1.0), (-1.0, 1.0), (np.nan, 1.0)):
        with pytest.raises(pinred.InputError, match="momentum"):
            pinred.branches(cat, momentum=momentum)
    with pytest.raises(pinred.InputError, match="step must be"):
        pinred.branches(cat, momentum=(0.5, 1.0), step=0.0)
    with pytest.raises(pinred.InputError, match="no branches of relative"):
        pinred.branches(pinred.load("coupled_planar"), momentum=(0.5, 1.0))
    few = pinred.branches(pinred.load("cartpole"), momentum=(0.5, 1.0), starts=8, step=0.5)
    with pytest.raises(pinred.InputError, match="a branch below 2, got 2"):
        few.branch(2)
