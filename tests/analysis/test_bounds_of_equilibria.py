"""Tolerances of equilibria and stability: cases just inside and just outside each."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from spinning_robots import gyrostat, heavy_gyrostat

import pinred
from pinred.analysis.equilibria import amended_potential
from pinred.analysis.equilibria.amended_potential import AmendedEnergy
from pinred.analysis.equilibria.equilibrium_problem import Points, problem_of
from pinred.analysis.equilibria.find_equilibria import equilibrium_at
from pinred.analysis.stability import stability_verdict as verdict
from pinred.analysis.stability.linearised_flow import _casimir_gradients
from pinred.analysis.stability.stability_verdict import (
    _is_definite,
    heavy_top,
    is_definite_with_axis_momentum,
)
from pinred.reduction.base_parts import BaseParts

NOTHING = {"cyclic": None, "springs": None, "forces": (), "prescribed": None, "passive": False}
BEYOND, WITHIN = 4.0, 0.4  # factors of a tolerance


def body(*moments: float) -> pinred.System:
    """A free body with given principal moments of inertia."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "root")
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag(moments))
    model.appendBodyToJoint(root, inertia, pin.SE3.Identity())
    return pinred.load(model, gravity=np.zeros(3))


@pytest.mark.parametrize(("factor", "found"), [(BEYOND, 0), (WITHIN, 1)])
def test_residual_limit_is_1e_9_of_energy(
    monkeypatch: pytest.MonkeyPatch, factor: float, found: int
) -> None:
    """A gradient counts as zero up to 1e-9 of the size of the energies."""
    monkeypatch.setattr(amended_potential, "NEWTON", 0)
    energy = AmendedEnergy(problem_of(body(2.0, 3.0, 4.0), **NOTHING))  # type: ignore[arg-type]
    middle = Points(np.zeros((1, 0)), np.array([[0.0, 1.0, 0.0]]))
    slope = (
        amended_potential.residuals(energy(middle.moved(np.array([[1e-4, 0.0]])), 1.0))[0] / 1e-4
    )
    beside = middle.moved(np.array([[factor * 1e-9 / slope, 0.0]]))
    assert len(amended_potential.critical_points(energy, beside, 1.0)[0]) == found


def test_prescribed_rate_is_steady_within_1e_12() -> None:
    """A prescribed rate may change by 1e-12, the round-off of a formula."""
    wheel = gyrostat((0.9, 1.3, 1.1))
    for factor in (WITHIN, BEYOND):
        plan = {"wheel": f"{0.5 * factor * 1e-12!r}*t**2 + 0.7*t"}
        if factor == WITHIN:
            assert pinred.relative_equilibria(wheel, momentum=1.0, prescribed=plan, starts=20)
            continue
        with pytest.raises(pinred.InputError, match="constant rate"):
            pinred.relative_equilibria(wheel, momentum=1.0, prescribed=plan)


@pytest.mark.parametrize(("parts", "name"), [(5.0, "stable"), (20.0, "unstable")])
def test_growth_beyond_ten_errors_is_unstable(
    monkeypatch: pytest.MonkeyPatch, parts: float, name: str
) -> None:
    """The error is 1e-14 of the matrix norm times the condition of the eigenvalue."""
    I, J = (2.0, 3.0, 4.0), 1.0
    problem = problem_of(body(*I), **NOTHING)  # type: ignore[arg-type]
    middle = Points(np.zeros((1, 0)), np.array([[0.0, 1.0, 0.0]]))
    a, b = J * (1.0 / I[1] - 1.0 / I[2]), J * (1.0 / I[0] - 1.0 / I[1])
    error = 1e-14 * max(a, b) * (a + b) / (2.0 * np.sqrt(a * b))
    equilibrium = equilibrium_at(problem, middle, J)
    assert equilibrium.growth == pytest.approx(np.sqrt(a * b), rel=1e-12)
    assert equilibrium.stability.growth_error == pytest.approx(error, rel=1e-6, abs=0.0)
    monkeypatch.setattr(verdict, "_ROUND_OFF", 1e-14 * equilibrium.growth / (parts * error))
    again = equilibrium_at(problem, middle, J)
    assert (again.verdict == "unstable") == (name == "unstable")


@pytest.mark.by_hand("0.001")
@pytest.mark.parametrize("part", [1e-7, 4e-6, 1e-3])
def test_curvatures_above_1e_7_are_not_flat(part: float) -> None:
    """A curvature above 1e-7 of the largest does not count as a family direction."""
    equilibria = pinred.relative_equilibria(body(1.0, 1.0 + part, 2.0), momentum=1.0)
    assert [equilibrium.verdict for equilibrium in equilibria] == ["stable", "unstable", "stable"]
    assert [equilibrium.dimension for equilibrium in equilibria] == [0, 0, 0]
    growth = np.sqrt(part * (1.0 - part) / 2.0) / (1.0 + part)
    assert equilibria[1].growth == pytest.approx(growth, rel=1e-7)


@pytest.mark.parametrize(("factor", "steady"), [(BEYOND, False), (WITHIN, True)])
def test_top_off_equilibrium_by_1e_8_is_undecided(factor: float, steady: bool) -> None:
    """No verdict is given if the critical-point equations have a residual above 1e-8."""
    system = heavy_gyrostat()
    problem = problem_of(system, **(NOTHING | {"cyclic": {"wheel": 2.0}}))  # type: ignore[arg-type]
    J = 6.0
    top = heavy_top(problem, J)
    pull = top.weight * np.linalg.norm(top.com)
    omega = (J - top.offset[2]) / top.inertia[2, 2]
    size = np.hypot(pull, top.scales[3] * omega)
    # At a tilt ε, no multipliers balance the torque of gravity.
    tilts = np.geomspace(1e-12, 1e-4, 161)
    left = np.array([_residual_at_tilt(top, tilt, J) for tilt in tilts])
    tilt = float(np.exp(np.interp(np.log(factor * 1e-8), np.log(left), np.log(tilts))))
    up = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    assert size > 0.0
    assert is_definite_with_axis_momentum(top, up, J) == steady


def _residual_at_tilt(top: object, tilt: float, J: float) -> float:
    """Return the residual of the multiplier equations at a tilt, by separate least squares."""
    from pinred.analysis.stability.stability_verdict import HeavyTop

    assert isinstance(top, HeavyTop)
    up, D = np.array([np.sin(tilt), 0.0, np.cos(tilt)]), top.scales
    omega = (J - up @ top.offset) / (up @ top.inertia @ up) * up
    mu = top.inertia @ omega + top.offset
    slope = D * np.r_[-top.weight * top.com, omega]
    columns = (
        D[:, None]
        * np.array([np.r_[mu, -up], np.r_[-up, np.zeros(3)], np.r_[np.zeros(3), [0.0, 0.0, 1.0]]]).T
    )
    orthonormal = np.linalg.qr(columns)[0]
    rest = slope - orthonormal @ (orthonormal.T @ slope)
    return float(np.linalg.norm(rest) / np.linalg.norm(slope))


def test_definiteness_limit_is_1e_14_of_largest_entry() -> None:
    """A form is definite if a multiplier makes its least eigenvalue exceed 1e-14 of its size."""
    assert _is_definite(lambda _: np.diag([1.0, BEYOND * 1e-14]), 0.0)
    assert not _is_definite(lambda _: np.diag([1.0, WITHIN * 1e-14]), 0.0)
    assert _is_definite(lambda _: np.diag([-1.0, -2.0]), 0.0)
    assert not _is_definite(lambda _: np.diag([-1.0, 2.0]), 0.0)
    assert _is_definite(lambda k: np.diag([k - 3.0, 4.0 - k]), 10.0)
    assert not _is_definite(lambda k: np.diag([k - 4.0, 3.0 - k, 1.0]), 10.0)


@pytest.mark.parametrize(("factor", "rows"), [(BEYOND, 1), (WITHIN, 3)])
def test_leaf_is_point_below_momentum_limit(factor: float, rows: int) -> None:
    """The leaf is a point below 1e-12 of the typical momentum, and a sphere above."""
    z = factor * 1e-12 * np.array([0.6, 0.0, 0.8])
    gradients = _casimir_gradients(z, 0, BaseParts(momentum=3))
    assert gradients.shape == (rows, 3)
    if rows == 1:
        assert gradients[0] == pytest.approx([0.6, 0.0, 0.8])
