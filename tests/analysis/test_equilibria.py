"""Relative equilibria: closed forms, published counts, and zero acceleration by ABA."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import make_case, multipliers
from point_pendulum import GRAVITY, urdf
from spinning_robots import equilibria_of_cat, gyrostat, rods
from trees import random_model

import pinred
from pinred.analysis.equilibria.amended_potential import AmendedEnergy, _quarters
from pinred.analysis.equilibria.equilibrium_problem import Points, problem_of
from pinred.analysis.equilibria.find_equilibria import equilibrium_at
from pinred.common.arrays import Array
from pinred.forces import Damper, PotentialEnergy
from pinred.reduction.potential import falling

ROOT = Path(__file__).parent.parent.parent


def assert_steady(found: pinred.Equilibria, forces: dict[int, float] | None = None) -> None:
    """Assert that ABA gives zero body acceleration, except free fall and driven wheels."""
    for each in found:
        system, problem = each.system, each.problem
        scene = each.scene()
        model, data = system.model, system.model.createData()
        start = scene.start
        q, v = system.q(start.pose, start.x), system.v(start.xi, start.xdot)
        tau = np.zeros(system.n)
        for k, torque in (forces or {}).items():
            tau[system.r + k] = torque
        free = pin.aba(model, data, q, v, tau)
        if problem.driven:  # The drives keep these rates constant.
            rows = system.r + np.array(problem.driven)
            H = np.triu(pin.crba(model, data, q))
            inverse = np.linalg.inv(H + np.triu(H, 1).T)
            free = free - inverse[:, rows] @ np.linalg.solve(
                inverse[np.ix_(rows, rows)], free[rows]
            )
        if system.group.linear and system.gravity.any():
            fall = falling(system)
            free[: len(fall)] -= system.group.turned_back(start.pose[system.group.linear :], fall)
        size = max(1.0, float(np.abs(v).max()) ** 2, float(np.abs(each.energy)))
        assert np.abs(free).max() <= 1e-9 * size, str(each)
        assert each.residual < 1e-12
        np.testing.assert_allclose(start.x, each.x, atol=1e-15)


def test_rigid_body_has_three_axes() -> None:
    """The energy is ½ J²/I; the middle axis grows by λ = √((I₂−I₁)(I₃−I₂)/(I₁I₃)) Ω."""
    body = pinred.load("rigid_body")
    I = np.array([2.5, 2.0, 1.0])  # descending, so that energies ascend
    J = 1.7
    equilibria = pinred.relative_equilibria(body, momentum=J)
    assert len(equilibria) == 3
    np.testing.assert_allclose(
        [e.amended_potential for e in equilibria], 0.5 * J**2 / I, rtol=1e-14
    )
    assert [e.verdict for e in equilibria] == ["stable", "unstable", "stable"]
    for k, each in enumerate(equilibria):
        np.testing.assert_allclose(np.abs(each.direction), np.eye(3)[2 - k], atol=1e-12)
        np.testing.assert_allclose(each.mu, J * each.direction, atol=1e-14)
        np.testing.assert_allclose(each.xi, J / I[k] * each.direction, atol=1e-13)
        a, b = np.delete(I, k)
        rate = J / I[k] * np.sqrt(abs((I[k] - a) * (I[k] - b)) / (a * b))
        expected = each.growth if k == 1 else each.frequencies[0]
        assert expected == pytest.approx(rate, rel=1e-12)
    assert_steady(equilibria)


def test_growing_mode_grows_in_simulation() -> None:
    """A perturbation along the growing mode grows by e^{λt}."""
    body = pinred.load("rigid_body")
    middle = pinred.relative_equilibria(body, momentum=2.0)[1]
    growth = np.sqrt(1.0 * 0.5 / 2.5) * 1.0
    assert middle.growth == pytest.approx(growth, rel=1e-12)
    scene = middle.scene(0, amplitude=1e-7, duration=20.0)
    traj = pinred.simulate(scene)
    difference = np.linalg.norm(traj.body_momentum - middle.mu, axis=1)
    rate = np.polyfit(traj.t[20:180], np.log(difference[20:180]), 1)[0]
    assert rate == pytest.approx(growth, rel=1e-4)


def test_double_pendulum_matches_published_counts() -> None:
    """At J = 2: 14 shapes, one stable, one undecided, 12 unstable; published frequencies."""
    equilibria = pinred.relative_equilibria(pinred.load("double_spherical_pendulum"), momentum=2.0)
    assert len(equilibria) == 14
    verdicts = [e.verdict for e in equilibria]
    assert [verdicts.count(v) for v in ("stable", "unstable", "undecided")] == [1, 12, 1]
    lowest = equilibria[0]
    np.testing.assert_allclose(np.abs(lowest.x), [0.444672, 0.0, 0.155910], atol=5e-7)
    assert lowest.x[0] * lowest.x[2] > 0.0
    assert lowest.xi[0] == pytest.approx(2.913119, abs=5e-7)
    np.testing.assert_allclose(lowest.frequencies, [4.16816, 5.13036, 8.30001], atol=5e-6)
    (one,) = (e for e in equilibria if e.verdict == "undecided")
    np.testing.assert_allclose(one.frequencies, [0.23173, 7.08424, 10.72249], atol=5e-6)
    np.testing.assert_allclose(np.abs(one.x), [0.355, np.pi / 2, np.pi / 2], atol=1e-3)
    signs = {True: "grows", False: "decays"}
    damped = [
        f"at {name} it {signs[growth > 0.0]} by {abs(growth):.5g}"
        for name, growth in one.damped_growth.items()
    ]
    assert f"{verdicts.index('undecided')}, by a damper: {', '.join(damped)}" in str(equilibria)
    assert_steady(equilibria)


def point_mass_pendulum(path: Path) -> pinred.System:
    """Equal masses on equal rods: m = (m₁ + m₂)/m₂ = 2, r = l₂/l₁ = 1."""
    path.write_text(urdf((1.0, 1.0), (1.0, 1.0)), encoding="utf-8")
    with pytest.warns(pinred.ModelWarning):
        return pinred.load(path, group="SO2")


@pytest.mark.by_hand
def test_point_mass_pendulum_matches_closed_form(tmp_path: Path) -> None:
    """λ² = (L² − r²)/(L² − α²), L = α(m + α)/(m(1 + α)): both hanging branches, J = 0.2 … 30."""
    system = point_mass_pendulum(tmp_path / "pendulum.urdf")
    m, r = 2.0, 1.0
    for J in (0.2, 1.0, 3.0, 8.0, 15.0, 30.0):
        alphas = []
        for each in pinred.relative_equilibria(system, momentum=J, starts=400):
            q = system.q([0.0], each.x)
            data = system.model.createData()
            pin.forwardKinematics(system.model, data, q)
            ends = [data.oMi[k].act(np.array([0.0, 0.0, -1.0])) for k in (2, 4)]
            first, second = ends[0], ends[1] - ends[0]
            direction = first[:2] / np.linalg.norm(first[:2])
            assert (
                abs(direction[0] * second[1] - direction[1] * second[0]) < 1e-9
            )  # The pendulum is in one vertical plane.
            radius = float(np.linalg.norm(first[:2]))
            alpha = float(second[:2] @ direction) / radius
            L = alpha * (m + alpha) / (m * (1.0 + alpha))
            assert radius**2 == pytest.approx((L**2 - r**2) / (L**2 - alpha**2), abs=1e-9)
            omega = np.sqrt(GRAVITY * m / (-first[2] * (m + alpha)))
            spin = omega * radius**2 * (1.0 + (1.0 + alpha) ** 2)
            assert spin == pytest.approx(J, rel=1e-9)
            assert each.xi[0] == pytest.approx(omega, rel=1e-9)
            if first[2] < 0.0:
                alphas.append(alpha)
        assert any(alpha > 0.0 for alpha in alphas)
        assert any(-m < alpha < -1.0 for alpha in alphas)


def test_three_rods_have_four_equilibrium_shapes() -> None:
    """I = 2.25 (maximum: stable), twice 0.916667 (saddles), and 0.25."""
    equilibria = pinred.relative_equilibria(rods(), momentum=1.0)
    inertias = [0.5 / e.amended_potential for e in equilibria]
    np.testing.assert_allclose(inertias, [2.25, 11.0 / 12.0, 11.0 / 12.0, 0.25], rtol=1e-13)
    assert [e.stability.index for e in equilibria] == [0, 1, 1, 2]
    assert [e.verdict for e in equilibria][:3] == ["stable", "unstable", "unstable"]
    assert_steady(equilibria)


# Gyrostats and the dual-spin satellite have closed forms, too.
@pytest.mark.by_hand
def test_reaction_wheels_have_eight_equilibria() -> None:
    """J = 0.5, π = (0.3, −0.2, 0.4): no two of the eight are opposite directions."""
    system = pinred.load("reaction_wheel_satellite")
    equilibria = pinred.relative_equilibria(
        system, momentum=0.5, cyclic={"wheel_x": 0.3, "wheel_y": -0.2, "wheel_z": 0.4}
    )
    assert len(equilibria) == 8
    for equilibrium in equilibria:
        J = system.group.about(pinred.Reduction(system).split(equilibrium.x).com, equilibrium.mu)
        assert np.linalg.norm(J) == pytest.approx(0.5, rel=1e-12)
        pi = (
            pinred.Reduction(system).mass_matrix(equilibrium.x)[6:]
            @ np.r_[equilibrium.xi, equilibrium.xdot]
        )
        np.testing.assert_allclose(pi[1:], [0.3, -0.2, 0.4], atol=1e-13)
    assert_steady(equilibria)


@pytest.mark.parametrize("rate", [-4.0, -0.5, 0.7, 6.0])
@pytest.mark.sampled
def test_gyrostat_matches_closed_form(rate: float) -> None:
    """s² = −Ω²(λ − I₁)(λ − I₃)/(I₁I₃), λ = I₂ + h/Ω, for a rotor driven about axis 2."""
    I, J, spin = (0.9, 1.3, 1.1), 1.5, 0.03
    equilibria = pinred.relative_equilibria(
        gyrostat(I), momentum=J, prescribed={"wheel": f"{rate}*t"}, starts=30
    )
    h = spin * rate
    about = [e for e in equilibria if abs(abs(e.direction[1]) - 1.0) < 1e-9]
    assert len(about) == 2
    for each in about:
        omega = (J * each.direction[1] - h) / I[1]
        assert each.xi[1] == pytest.approx(omega, rel=1e-12)
        size = I[1] + h / omega
        square = -(omega**2) * (size - I[0]) * (size - I[2]) / (I[0] * I[2])
        if square > 0.0:
            assert each.growth == pytest.approx(np.sqrt(square), rel=1e-11)
            assert each.verdict == "unstable"
        else:
            assert each.frequencies[0] == pytest.approx(np.sqrt(-square), rel=1e-11)
            assert each.verdict == "stable"
    assert_steady(equilibria)


def test_gyrostat_verdict_changes_at_closed_form_thresholds() -> None:
    """Thresholds are λ = I₁ or I₃: h = Ω (I_k − I₂), Ω = J/I_k, to a fraction of 1e-10."""
    I, J, spin = (0.9, 1.0, 1.3), 1.5, 0.03
    second = Points(np.zeros((1, 0)), np.array([[0.0, 1.0, 0.0]]))
    problem = problem_of(
        gyrostat(I), cyclic=None, springs=None, forces=(), prescribed=None, passive=False
    )
    for k in (0, 2):
        omega = J / I[k]
        rate = omega * (I[k] - I[1]) / spin
        momentum = spin * (omega + rate)
        for side in (-1.0, 1.0):
            beside = momentum + side * 1e-10 * abs(rate) * spin
            equilibrium = equilibrium_at(
                replace(problem, cyclic_momenta=np.array([beside])), second, J
            )
            # The unstable range is between the two thresholds.
            assert (equilibrium.verdict == "unstable") == (side == 1.0 - k)
            assert equilibrium.xdot[0] == pytest.approx(rate, rel=2e-10)
            assert equilibrium.xi[1] == pytest.approx(omega, rel=2e-10)


def test_dual_spin_satellite_matches_closed_form() -> None:
    """A free rotor on the least axis has the gyrostat's s² with h = π − I_w Ω."""
    I, spin = (1.1, 0.8, 1.3), 0.03
    system = gyrostat(I, group="SE3")
    for J, pi in ((1.0, 0.5), (1.0, -0.6), (0.4, 0.9)):
        equilibria = pinred.relative_equilibria(system, momentum=J, cyclic={"wheel": pi}, starts=30)
        both = [e for e in equilibria if abs(abs(e.direction[1]) - 1.0) < 1e-9]
        for each in both:
            omega = (J * each.direction[1] - pi) / (I[1] - spin)
            assert each.xi[4] == pytest.approx(omega, rel=1e-12)
            h = pi - spin * omega
            size = I[1] + h / omega
            square = -(omega**2) * (size - I[0]) * (size - I[2]) / (I[0] * I[2])
            rate = each.growth if square > 0.0 else each.frequencies[0]
            assert rate == pytest.approx(np.sqrt(abs(square)), rel=1e-10)
        assert len(both) == 2
        assert_steady(equilibria)


def test_cart_pole_hangs_or_stands_at_any_momentum() -> None:
    """On ℝ, ω² is g k/(M at 0) for the hanging pole and its negative for the upright one."""
    cart = pinred.load("cartpole")
    for momentum in (0.0, -3.0):
        equilibria = pinred.relative_equilibria(cart, momentum=momentum)
        assert [round(e.x[0], 12) for e in equilibria] == [0.0, round(np.pi, 12)]
        M = 0.34 - 1.0 / 12.0
        rate = np.sqrt(9.81 * 0.5 / M)
        assert equilibria[0].frequencies[0] == pytest.approx(rate, rel=1e-12)
        assert equilibria[1].growth == pytest.approx(rate, rel=1e-12)
        assert equilibria[0].xi[0] == pytest.approx(momentum / 3.0, abs=1e-14)


@pytest.mark.by_hand
def test_spring_equals_custom_potential() -> None:
    """A spring changes the equilibria of the cat exactly as the same custom potential does."""
    cat = pinred.load("falling_cat")
    spring = {"bend": (5.0, 0.6), "sway": (5.0, -0.2), "twist": (5.0, 0.3)}
    equilibria = pinred.relative_equilibria(cat, momentum=1.0, springs=spring, starts=150)
    own = pinred.relative_equilibria(
        cat,
        momentum=1.0,
        starts=150,
        forces=PotentialEnergy(
            lambda x: 2.5 * ((x[0] - 0.6) ** 2 + (x[1] + 0.2) ** 2 + (x[2] - 0.3) ** 2)
        ),
    )
    assert own[0].energy == pytest.approx(equilibria[0].energy, rel=1e-12)
    np.testing.assert_allclose(own[0].x, equilibria[0].x, atol=1e-10)
    least = equilibria[0]
    tau = {k: -5.0 * (least.x[k] - rest) for k, rest in enumerate((0.6, -0.2, 0.3))}
    assert_steady(replace(equilibria, entries=(least,)), tau)


def test_prescribed_joint_keeps_its_value() -> None:
    """A prescribed joint keeps its value; the other joints are in equilibrium."""
    chain = rods(4)
    equilibria = pinred.relative_equilibria(chain, momentum=1.0, prescribed={"joint2": 0.5})
    assert all(e.x[1] == 0.5 for e in equilibria)
    lowest = equilibria[0]
    energy = AmendedEnergy(lowest.problem)
    assert energy.problem.driven == (1,)
    red = pinred.Reduction(chain)

    def inertia(x: Array) -> float:
        I = red.locked_inertia(x)
        return float(1.0 / np.linalg.inv(I)[2, 2])

    for step in (1e-3, -1e-3):
        for k in (0, 2):
            assert inertia(lowest.x + step * np.eye(3)[k]) < inertia(lowest.x)


def test_heavy_pivoted_tree_is_steady() -> None:
    """For a random heavy tree ABA has no acceleration, and the base rotates about the vertical."""
    model = random_model("SO3", 1, 7)
    model.gravity.linear = np.array([0.0, 3.0, -9.0])
    system = pinred.load(model)
    equilibria = pinred.relative_equilibria(system, momentum=0.7, starts=60)
    assert len(equilibria) >= 4
    for equilibrium in equilibria:
        np.testing.assert_allclose(np.cross(equilibrium.xi, equilibrium.direction), 0.0, atol=1e-12)
        assert equilibrium.mu @ equilibrium.direction == pytest.approx(0.7, rel=1e-12)
    assert_steady(equilibria)


# Gyrostats without gravity, and heavy trees without rotors, are judged by default.
@pytest.mark.by_hand
def test_heavy_gyrostat_with_free_and_driven_rotor() -> None:
    """A rotor and an arm on a pivot under gravity; the rotor is free, then driven."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "root")
    for kind, name, place, lever, moments in (
        (None, "", (0.0, 0.0, 0.0), (0.0, 0.1, 0.5), (0.1, 0.2, 0.15)),
        (pin.JointModelRZ(), "wheel", (0.0, 0.1, 0.5), (0.0, 0.0, 0.0), (0.02, 0.02, 0.03)),
        (pin.JointModelRX(), "arm", (0.0, 0.3, 0.2), (0.0, 0.0, -0.3), (0.02, 0.03, 0.01)),
    ):
        body = pin.Inertia(0.5, np.array(lever), np.diag(moments))
        where = pin.SE3(np.eye(3), np.array(place))
        at = root if kind is None else model.addJoint(root, kind, where, name)
        model.appendBodyToJoint(at, body, pin.SE3.Identity())
    system = pinred.load(model)
    free = pinred.relative_equilibria(system, momentum=1.3, cyclic={"wheel": 0.8}, starts=60)
    driven = pinred.relative_equilibria(
        system, momentum=1.3, prescribed={"wheel": "20*t"}, starts=60
    )
    for found in (free, driven):
        assert len(found) >= 4
        assert_steady(found)
    red = pinred.Reduction(system)
    for each in free:
        pi = red.mass_matrix(each.x) @ np.r_[each.xi, each.xdot]
        assert pi[3] == pytest.approx(0.8, rel=1e-12)
    assert all(each.xdot[0] == 20.0 for each in driven)


@pytest.mark.by_hand
def test_coupled_joints_are_steady() -> None:
    """A tree with coupled joints has no acceleration by ABA with multipliers."""
    case = make_case("SE2", 3, 4)
    system, model = case.system, case.system.model
    assert system.couplings
    equilibria = pinred.relative_equilibria(system, momentum=1.0, starts=40)
    assert len(equilibria) >= 1
    tau = multipliers(system)
    for equilibrium in equilibria:
        q, v = (
            system.q(np.zeros(3), equilibrium.x),
            system.v(equilibrium.xi, equilibrium.xdot),
        )
        a = pin.aba(model, model.createData(), q, v, tau(0.0, q, v))
        assert np.abs(a).max() <= 1e-9 * max(1.0, float(v @ v)), str(equilibrium)


def test_family_of_equilibria_counts_once() -> None:
    """The cat's symmetric front half creates circles of equilibria, judged transverse to them."""
    equilibria = equilibria_of_cat()
    dimensions = {e.dimension for e in equilibria}
    assert dimensions == {0, 1}
    (least,) = (e for e in equilibria if e.verdict == "stable")
    assert least.dimension == 1
    assert least.growth == 0.0
    assert_steady(equilibria)
    disc = pin.Model()
    root = disc.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    disc.appendBodyToJoint(
        root, pin.Inertia(1.0, np.zeros(3), np.diag([0.2, 0.2, 0.3])), pin.SE3.Identity()
    )
    disc.gravity.setZero()
    spins = pinred.relative_equilibria(pinred.load(disc), momentum=1.0)
    assert [(e.dimension, e.verdict) for e in spins] == [(0, "stable"), (1, "stable")]


@pytest.mark.parametrize("moment", [0.2, 0.3, 1e-9, 7e5])
def test_ball_has_one_family_of_dimension_2(moment: float) -> None:
    """A ball spins about any axis; its growth rates are round-off."""
    ball = pin.Model()
    root = ball.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    body = pin.Inertia(moment, np.array([0.1, 0.2, 0.0]), moment * np.eye(3))
    ball.appendBodyToJoint(root, body, pin.SE3.Identity())
    ball.gravity.setZero()
    (only,) = pinred.relative_equilibria(pinred.load(ball), momentum=moment, starts=20)
    assert (only.dimension, only.verdict, only.growth) == (2, "stable", 0.0)
    assert only.amended_potential == pytest.approx(0.5 * moment, rel=1e-14)


@pytest.mark.by_hand
def test_minimum_of_many_joints_is_independent_of_seed() -> None:
    """Searches with different seeds find the same minimum, with residuals of round-off."""
    system = pinred.load("satellite_two_arms")
    least = []
    for seed in range(2):
        equilibria = pinred.relative_equilibria(system, momentum=1.0, starts=30, seed=seed)
        assert max(e.residual for e in equilibria) < 1e-12
        (one,) = (e for e in equilibria if e.verdict == "stable")
        assert one is equilibria[0]
        least.append(one.amended_potential)
    assert least[0] == pytest.approx(least[1], rel=1e-12)


def test_starting_points_of_humanoid_are_limited() -> None:
    """Only the requested number of the 4³² shapes with quarter turns is generated."""
    rng = np.random.default_rng(0)
    assert _quarters(32, 0, 25, rng).shape == (25, 32)
    assert _quarters(64, 0, 25, rng).shape == (25, 64)
    assert len(np.unique(_quarters(2, 0, 16, rng), axis=0)) == 16
    assert _quarters(0, 0, 5, rng).shape == (1, 0)


def test_zero_momentum_with_rotor_has_no_modes() -> None:
    """Without momentum the base cannot change: a rotor spins, and there is no mode."""
    system = gyrostat((0.9, 1.3, 1.1))
    (only,) = pinred.relative_equilibria(system, momentum=0.0, cyclic={"wheel": 0.4})
    assert (only.verdict, only.modes, only.momentum) == ("stable", (), 0.0)
    assert only.xdot[0] == pytest.approx(0.4 / (0.03 - 0.03**2 / 1.3), rel=1e-12)


# A ball at very small and large momenta is judged by default.
@pytest.mark.by_hand
@pytest.mark.parametrize(
    "J", [1e-9, 1e12, *(pytest.param(J, marks=pytest.mark.by_hand) for J in (1e-3, 1.0, 1e6))]
)
@pytest.mark.sampled
def test_verdicts_are_independent_of_time_unit(J: float) -> None:
    """A free robot at another momentum moves equally at another speed."""
    equilibria = pinred.relative_equilibria(pinred.load("falling_cat"), momentum=J, starts=60)
    usual = equilibria_of_cat()
    assert [e.verdict for e in equilibria] == [e.verdict for e in usual]
    for one, other in zip(equilibria, usual, strict=True):
        assert one.growth == pytest.approx(J * other.growth, rel=1e-6)
        np.testing.assert_allclose(one.frequencies, J * other.frequencies, rtol=1e-6)


def test_scene_of_equilibrium_keeps_shape() -> None:
    """The simulation keeps the shape, and oscillates on a mode at its frequency."""
    pendulum = pinred.load("double_spherical_pendulum")
    least = pinred.relative_equilibria(pendulum, momentum=2.0, starts=200)[0]
    traj = pinred.simulate(least.scene(duration=5.0))
    assert np.abs(traj.x - least.x).max() < 1e-8
    mode = least.modes[0]
    traj = pinred.simulate(least.scene(0, amplitude=1e-5, duration=6.0))
    swing = (traj.x - least.x) / 1e-5
    expected = np.real(mode.shape * np.exp(1j * mode.frequency * traj.t)[:, None])
    assert np.abs(swing - expected).max() < 1e-3
    with pytest.raises(pinred.InputError, match="expected an index below 3, got 3"):
        least.scene(3)


def test_invalid_problems_are_refused() -> None:
    """Invalid arguments are refused by name."""
    cat, wheels = pinred.load("falling_cat"), pinred.load("reaction_wheel_satellite")
    for words, options in (
        ("of at least 0", {"momentum": -1.0}),
        ("momentum must be a finite number", {"momentum": np.nan}),
        ("every shape is an equilibrium", {"momentum": 0.0}),
        ("starts must be a whole number of at least 1", {"momentum": 1.0, "starts": 0}),
        ("seed must be a whole number of at least 0", {"momentum": 1.0, "seed": -1}),
        ("The cyclic joints are none", {"momentum": 1.0, "cyclic": {"bend": 1.0}}),
        ("does work", {"momentum": 1.0, "forces": Damper("bend", 0.1)}),
        ("constant rate", {"momentum": 1.0, "prescribed": {"bend": "sin(t)"}}),
        ("no motion is steady", {"momentum": 1.0, "prescribed": {"bend": "t"}}),
    ):
        with pytest.raises(pinred.InputError, match=words):
            pinred.relative_equilibria(cat, **options)
    with pytest.raises(pinred.InputError, match="wheel_x, wheel_y, wheel_z"):
        pinred.relative_equilibria(wheels, momentum=1.0, cyclic={"panel_hinge": 1.0})
    tilted = pinred.load("double_spherical_pendulum", gravity=(1.0, 0.0, -9.0))
    with pytest.raises(pinred.SymmetryError):
        pinred.relative_equilibria(tilted, momentum=1.0)


def test_equilibria_print_as_text_and_html() -> None:
    """The table has a text form and an HTML form."""
    equilibria = pinred.relative_equilibria(pinred.load("rigid_body"), momentum=1.0, starts=10)
    text = str(equilibria)
    assert "3 relative equilibria found at momentum 1" in text
    assert "unstable" in text
    assert "grows by 0.223607" in str(equilibria[1])
    assert "0.223607 ± " in text
    assert "relative equilibria" in equilibria._repr_html_()
    assert len(equilibria[:2]) == 2
