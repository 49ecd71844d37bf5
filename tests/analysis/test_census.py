"""The count of relative equilibria: Morse sums, coverings, and equilibria close to thresholds."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pinocchio as pin
import pytest
from point_pendulum import urdf
from spinning_robots import equilibria_of_cat, rods
from test_branches import HUB, LENGTH, MASS, SLIM, WIDE, G, governor, squared_momentum_at

import pinred
from pinred.analysis.equilibria.amended_potential import AmendedEnergy
from pinred.analysis.equilibria.distinct_points import DistinctPoints, Orbit, symmetries_of
from pinred.analysis.equilibria.equilibrium_problem import Points, Problem, problem_of
from pinred.analysis.equilibria.find_equilibria import _degree, euler_characteristic
from pinred.common.arrays import Array

NOTHING = {"cyclic": None, "springs": None, "forces": (), "prescribed": None, "passive": False}


def problem(system: pinred.System, **options: Any) -> Problem:
    """Return the problem of a system."""
    return problem_of(system, **(NOTHING | options))


def random_chain(bodies: int, seed: int) -> pinred.System:
    """Return a planar chain of rods with random lengths and masses."""
    rng, model = np.random.default_rng(seed), pin.Model()
    model.gravity.setZero()
    parent, joint, place = 0, pin.JointModelPlanar(), pin.SE3.Identity()
    for k in range(bodies):
        parent = model.addJoint(parent, joint, place, f"joint{k}")
        length, mass = rng.uniform(0.5, 1.5, 2)
        centre = np.array([length * rng.uniform(0.3, 0.7), 0.0, 0.0])
        moment = mass * length**2 / 12.0
        body = pin.Inertia(mass, centre, np.diag([1e-3, moment, moment]))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        joint, place = pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    return pinred.load(model)


def assert_all_folded_shapes(equilibria: pinred.Equilibria, m: int) -> None:
    """Assert that every shape with all angles 0 or π, an equilibrium by symmetry, is found."""
    for folds in product((0.0, np.pi), repeat=m):
        difference = [np.abs(np.exp(1j * e.x) - np.exp(1j * np.array(folds))) for e in equilibria]
        assert min(float(d.max()) for d in difference) < 1e-9, folds


# Families, sliding joints and the limit of a search are counted by default.
@pytest.mark.by_hand
@pytest.mark.parametrize(
    ("seed", "count"), [(0, 68), pytest.param(2, 66, marks=pytest.mark.by_hand)]
)
def test_six_body_chain_has_morse_sum_zero(seed: int, count: int) -> None:
    """Random chains of six bodies: all folded shapes, closed under reflection, sum 0."""
    equilibria = pinred.relative_equilibria(random_chain(6, seed), momentum=1.0)
    census = equilibria.census
    assert len(equilibria) == census.count == count
    assert (census.morse_sum, census.expected, census.agrees) == (0, 0, True)
    assert sum((-1) ** e.stability.index for e in equilibria) == 0
    assert_all_folded_shapes(equilibria, 5)
    for each in equilibria:
        mirrored = [
            np.abs(np.exp(1j * other.x) - np.exp(-1j * each.x)).max() for other in equilibria
        ]
        assert min(mirrored) < 1e-7


@pytest.mark.by_hand
def test_equal_links_have_two_degenerate_equilibria() -> None:
    """Six equal links: 64 shapes; (0, π, π, π, π) and its reverse are flat in one direction."""
    equilibria = pinred.relative_equilibria(pinred.load("planar_chain5"), momentum=1.0)
    assert len(equilibria) == 64
    assert equilibria.census.morse_sum == equilibria.census.expected == 0
    assert_all_folded_shapes(equilibria, 5)
    flat = []
    for each in equilibria:
        hessian = AmendedEnergy(each.problem)(Points(each.x[None], np.zeros((1, 0))), 1.0).hessian
        curvatures = np.abs(np.linalg.eigvalsh(hessian[0]))
        if curvatures.min() < 1e-7 * curvatures.max():
            flat.append(np.round(np.abs(each.x) / np.pi, 9).tolist())
    assert sorted(flat) == [[0, 1, 1, 1, 1], [1, 1, 1, 1, 0]]


@pytest.mark.by_hand
def test_spatial_chain_has_morse_sum_zero() -> None:
    """coupled_spatial has 60 equilibria; a search with another seed finds as many."""
    system = pinred.load("coupled_spatial")
    counts = [pinred.relative_equilibria(system, momentum=1.0, seed=k).census for k in (0, 3)]
    assert [(c.count, c.morse_sum, c.expected) for c in counts] == [(60, 0, 0), (60, 0, 0)]


def test_limit_stops_search_and_is_stated() -> None:
    """A search of six bodies states what it leaves out."""
    system = random_chain(6, 0)
    equilibria = pinred.relative_equilibria(system, momentum=1.0, starts=20, limit=60)
    census = equilibria.census
    assert census.starts <= 60
    assert census.pending > 0
    assert "stopped at its limit" in str(equilibria)
    assert f"Morse sum {census.morse_sum} differs from the Euler characteristic 0" in str(census)
    with pytest.raises(pinred.InputError, match="limit must be a whole number"):
        pinred.relative_equilibria(system, momentum=1.0, limit=0)


@pytest.mark.by_hand("0.01")
@pytest.mark.parametrize("beyond", [1e-2, 1e-6])
def test_pitchfork_keeps_unstable_equilibrium(beyond: float) -> None:
    """Just above its threshold, the governor's arm lifts (stable) or hangs (unstable)."""
    wide = MASS * LENGTH**2 + WIDE - SLIM
    critical = (HUB + SLIM) * np.sqrt(MASS * G * LENGTH / wide)
    J = critical * (1.0 + beyond)
    equilibria = pinred.relative_equilibria(governor(0.0), momentum=J)
    assert [e.stability.index for e in equilibria] == [0, 1, 1]
    lifted, hanging, upright = (float(e.x[0]) for e in equilibria)
    assert hanging == 0.0
    assert abs(upright) == pytest.approx(np.pi, abs=1e-12)
    assert pytest.approx(squared_momentum_at(lifted, 0.0), rel=1e-8) == J**2
    assert 0.5 * np.sqrt(beyond) < abs(lifted) < 3.0 * np.sqrt(beyond)
    # The lifted arm is one motion, but two shapes: the hub turns by a half turn.
    assert equilibria.census.morse_sum == equilibria.census.expected == 0


def test_below_pitchfork_only_hanging_and_upright() -> None:
    """Below the threshold there are two equilibria."""
    wide = MASS * LENGTH**2 + WIDE - SLIM
    critical = (HUB + SLIM) * np.sqrt(MASS * G * LENGTH / wide)
    equilibria = pinred.relative_equilibria(governor(0.0), momentum=critical * (1.0 - 1e-6))
    assert [e.stability.index for e in equilibria] == [0, 1]


def masses_of(system: pinred.System, x: Array) -> list[tuple[Array, Array]]:
    """Return centre (3,) and inertia (3, 3) of every body about it, in the frame of the base."""
    model, data = system.model, system.model.createData()
    pin.forwardKinematics(model, data, system.q(system.group.identity(), x))
    placed = [
        data.oMi[1].actInv(place).act(b) for place, b in zip(data.oMi, model.inertias, strict=True)
    ]
    return [(np.array(b.lever), np.array(b.inertia)) for b in placed[1:]]


@pytest.mark.parametrize(
    ("name", "coverings", "others"),
    [("double_spherical_pendulum", 3, 4), ("coupled_spatial", 3, 0), ("planar_chain5", 0, 1)],
)
def test_coverings_keep_masses_up_to_turn_of_base(name: str, coverings: int, others: int) -> None:
    """Pinocchio's forward kinematics gives the same masses after a rotation of the base.

    A chain in the plane has one symmetry, its reflection, which two of the candidates are.
    """
    system = pinred.load(name)
    symmetries = symmetries_of(AmendedEnergy(problem(system)), 1.0)
    assert len(symmetries) == coverings + others
    assert sum(s.is_covering for s in symmetries) == coverings
    x = np.random.default_rng(3).uniform(-3.0, 3.0, (1, system.m))
    n = np.array([[0.6, 0.0, 0.8]])[:, : 3 * (name == "coupled_spatial")]
    before = masses_of(system, x[0])
    for symmetry in symmetries:
        image = symmetry(Points(x, n))
        after = masses_of(system, image.x[0])
        turns = [np.diag(s) for s in product((1.0, -1.0), repeat=3)]
        kept = [
            P for P in turns if all(
                np.abs(P @ c - d).max() < 1e-9 and np.abs(P @ T @ P - S).max() < 1e-9
                for (c, T), (d, S) in zip(before, after, strict=True)
            )
        ]  # fmt: skip
        proper = [P for P in kept if np.linalg.det(P) > 0.0 and (n.size or P[2, 2] > 0.0)]
        assert bool(proper) == symmetry.is_covering
        assert kept


@pytest.mark.parametrize(
    ("slope", "degree"),
    [
        (lambda z: z[0] ** 3, -1), (lambda z: -(z[0] ** 3), 1), (lambda z: z[0] ** 2, 0),
        (lambda z: -0.05 * z[0] ** 3 + 50.0 * z[0] ** 5, 1),
    ],
)  # fmt: skip
def test_degenerate_equilibrium_counts_by_degree(slope: Any, degree: int) -> None:
    """U = ±x⁴/4 − y² + x² y has the degree of its minimum or maximum along the flat curve.

    The last slope is round-off at x = 0.001, and has the opposite sign at x = 0.1.
    """

    def energy(points: Points, _: float) -> SimpleNamespace:
        x, y = points.x[0]
        gradient = np.array([[slope((x, y)) + 0.2 * x * y, -2.0 * y + 0.1 * x**2]])
        hessian = np.array([[[0.0, 0.0], [0.0, -2.0]]])
        return SimpleNamespace(gradient=gradient, hessian=hessian, scale=np.ones(1))

    point = Points(np.zeros((1, 2)), np.zeros((1, 0)))
    orbit = Orbit(point, np.zeros(1, dtype=np.intp), 1, True, 0, 0.0, 1)
    assert _degree(cast(AmendedEnergy, energy), orbit, 1.0) == degree


def test_equilibria_of_different_index_are_distinct() -> None:
    """Two points within 1e-6 are one equilibrium, unless their indices differ."""
    energy = AmendedEnergy(problem(rods()))
    known = DistinctPoints(energy, 1.0)
    points = Points(np.array([[1.0, 0.5], [1.0, 0.5 + 5e-7], [1.0, 0.5 + 5e-6]]), np.zeros((3, 0)))
    e = energy(points, 1.0)
    hessians = np.array([np.diag([1.0, 1.0]), np.diag([1.0, -1.0]), np.diag([1.0, 1.0])])
    e = replace(e, gradient=np.zeros((3, 2)), hessian=hessians)
    assert known.add(points, e, is_random=True) == [0, 1, 2]
    assert known.add(points, e, is_random=True) == []
    same = Points(points.x[:1] + np.array([2.0 * np.pi, 5e-7]), points.n[:1])
    alike = replace(e, **{name: getattr(e, name)[:1] for name in e.__dataclass_fields__})
    assert known.add(same, alike, is_random=True) == []
    assert [orbit.hits for orbit in known.orbits] == [3, 2, 2]


@pytest.mark.parametrize(("apart", "count"), [(4e-4, 1), (4e-3, 2)])
def test_degenerate_points_within_1e_3_are_one(apart: float, count: int) -> None:
    """Newton's method ends up to 1e-3 from a degenerate equilibrium."""
    energy = AmendedEnergy(problem(rods()))
    points = Points(np.array([[1.0, 0.5], [1.0, 0.5 + apart]]), np.zeros((2, 0)))
    flat = np.repeat(np.diag([1.0, 0.0])[None], 2, axis=0)
    e = replace(energy(points, 1.0), gradient=np.zeros((2, 2)), hessian=flat)
    assert len(DistinctPoints(energy, 1.0).add(points, e, is_random=True)) == count


def test_point_beyond_newton_step_of_1e_6_is_no_equilibrium() -> None:
    """A small gradient is no equilibrium if Newton's next step is longer than 1e-6."""
    energy = AmendedEnergy(problem(rods()))
    points = Points(np.array([[1.0, 0.5]]), np.zeros((1, 0)))
    e = replace(energy(points, 1.0), hessian=np.eye(2)[None])
    for step, count in ((4e-7, 1), (4e-6, 0)):
        known = DistinctPoints(energy, 1.0)
        assert (
            len(known.add(points, replace(e, gradient=np.array([[step, 0.0]])), is_random=True))
            == count
        )


def test_euler_characteristic_needs_torus_springs_or_sphere() -> None:
    """Angles give 0, springs on every joint give 1, and a rigid body has a sphere."""
    springs = {"joint1": (2.0, 0.3), "joint2": (1.0, 0.0)}
    assert euler_characteristic(problem(rods())) == (0, "")
    assert euler_characteristic(problem(rods(), springs=springs)) == (1, "")
    assert euler_characteristic(problem(rods(), springs={"joint1": (2.0, 0.3)})) == (0, "")
    assert euler_characteristic(problem(pinred.load("rigid_body"))) == (2, "")
    push, reason = euler_characteristic(problem(rods(), springs={"joint1": (-2.0, 0.3)}))
    assert push is None
    assert "joint1" in reason
    sprung = pinred.relative_equilibria(rods(), momentum=1.0, springs=springs)
    assert sprung.census.agrees
    assert sprung.census.morse_sum == sum((-1) ** e.stability.index for e in sprung) == 1


def test_singular_mass_matrix_has_no_sum(tmp_path: Path) -> None:
    """Where point masses are on the vertical axis, the amended potential is infinite."""
    path = tmp_path / "pendulum.urdf"
    path.write_text(urdf((1.0, 1.0), (1.0, 1.0)), encoding="utf-8")
    with pytest.warns(pinred.ModelWarning):
        system = pinred.load(path, group="SO2")
    reason = "the mass matrix is singular at some shapes"
    assert euler_characteristic(problem(system)) == (None, reason)


def test_census_of_sliding_joint_has_no_sum() -> None:
    """A joint that slides without a spring makes the shape space no torus."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hub")
    model.appendBodyToJoint(root, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    bead = model.addJoint(root, pin.JointModelPX(), pin.SE3.Identity(), "bead")
    model.appendBodyToJoint(
        bead, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity()
    )
    model.gravity.setZero()
    equilibria = pinred.relative_equilibria(pinred.load(model), momentum=1.0, starts=20)
    census = equilibria.census
    assert (census.morse_sum, census.expected, census.agrees) == (None, None, None)
    assert "does not apply: bead is not periodic" in str(equilibria)


def test_families_are_stated() -> None:
    """The cat's circles of equilibria add nothing to its Morse sum, and the text says so."""
    census = equilibria_of_cat().census
    assert census.families > 0
    assert census.agrees
    assert "does not show whether one is missing" in str(census)


@pytest.mark.parametrize(
    ("once", "twice", "walked", "unseen"),
    [(0, 0, 0, 0), (10, 4, 0, 9), (10, 4, 7, 2), (3, 9, 5, 0)],
)
def test_unseen_is_chaos_estimate(once: int, twice: int, walked: int, unseen: int) -> None:
    """f₁(f₁ − 1)/(2(f₂ + 1)), rounded up, less those that only walks reached."""
    census = pinred.Census(
        count=20, families=0, starts=10, converged=9, seen_once=once, seen_twice=twice,
        not_seen=walked, pending=0, morse_sum=0, expected=0, reason="",
    )  # fmt: skip
    assert census.unseen == unseen
    assert f"estimated unseen {unseen} (Chao's estimator, a weak lower bound)" in str(census)
    assert "missing" in replace(census, morse_sum=1).caveat
