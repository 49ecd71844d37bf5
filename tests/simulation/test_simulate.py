"""Simulations against closed forms, and the interface of a trajectory."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import quad
from scipy.special import ellipj, ellipkinc
from textbook import DELTA, I1, I2, J1, J2, M1, M2, D, M
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.lie import GROUPS


def test_beanie_with_spring_is_harmonic() -> None:
    """θ2 oscillates at √(k (I1+I2)/(I1 I2)); Ω = θ̇1 + A θ̇2 is constant, so θ1 follows."""
    k, x0, v0, xi0 = 3.0, 0.5, -0.4, 0.8
    system = pinred.load("elroys_beanie")
    springs = {system.shape_names[0]: (k, 0.0)}
    traj = pinred.simulate(system, x0=[x0], xdot0=[v0], xi0=[xi0], duration=10.0, springs=springs)
    w = np.sqrt(k * (I1 + I2) / (I1 * I2))
    theta2 = x0 * np.cos(w * traj.t) + v0 / w * np.sin(w * traj.t)
    A = I2 / (I1 + I2)
    theta1 = (xi0 + A * v0) * traj.t - A * (theta2 - x0)
    np.testing.assert_allclose(traj.x[:, 0], theta2, atol=1e-9)
    np.testing.assert_allclose(traj.pose[:, 0], theta1, atol=1e-9)
    np.testing.assert_allclose(traj.body_momentum, (I1 + I2) * xi0 + I2 * v0, rtol=1e-13)


def test_momentum_of_one_dimensional_group_is_a_number() -> None:
    """A number is the momentum (I1 + I2) θ̇1 + I2 θ̇2 of the beanie; other groups need a vector."""
    system = pinred.load("elroys_beanie")
    traj = pinred.simulate(system, xdot0=[0.9], momentum=0.6, duration=1.0)
    np.testing.assert_allclose(traj.xi[:, 0], (0.6 - I2 * 0.9) / (I1 + I2), rtol=1e-13)
    assert pinred.compare(traj).passed
    for odd in (np.nan, True, "0.6"):
        with pytest.raises(pinred.ShapeError, match="momentum"):
            pinred.Scene(system=system, xdot0=[0.9], momentum=odd)
    with pytest.raises(pinred.ShapeError, match=r"momentum: expected 3 numbers: px, py, L"):
        pinred.Scene(system=pinred.load("three_rods"), xdot0=[0.9, 0.0], momentum=0.6)


def test_coupled_planar_bodies_agree_with_closed_form() -> None:
    """Joint and base rotate at constant rates, and the centre of mass moves on a line."""
    x0, xdot0, xi0 = 0.3, 1.2, np.array([0.4, -0.7, 0.9])
    pose0 = np.array([1.0, 2.0, 0.5])
    traj = pinred.simulate(
        pinred.load("coupled_planar"),
        x0=[x0], xdot0=[xdot0], xi0=xi0, pose0=pose0, duration=10.0,
    )  # fmt: skip
    np.testing.assert_allclose(traj.xdot[:, 0], xdot0, rtol=1e-11)
    np.testing.assert_allclose(traj.x[:, 0], x0 + xdot0 * traj.t, atol=1e-9)
    spin = (J1 + J2 + M1 * M2 / M * D**2) * xi0[2] + J2 * xdot0  # about the centre of mass
    rate = (spin - J2 * xdot0) * M / DELTA
    theta = pose0[2] + rate * traj.t
    np.testing.assert_allclose(traj.pose[:, 2], theta, atol=1e-9)

    def arm(angle: Array) -> Array:
        return M2 * D / M * np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    v = turn @ (xi0[:2] + xi0[2] * np.array([0.0, M2 * D / M]))
    path = pose0[:2] + arm(pose0[2]) + v * traj.t[:, None] - arm(theta)
    np.testing.assert_allclose(traj.pose[:, :2], path, atol=1e-9)


def test_euler_top_agrees_with_elliptic_functions() -> None:
    """Body rates follow Jacobi's functions, the attitude a quadrature of the precession."""
    system = pinred.load("rigid_body")
    moments = np.diag(pinred.Reduction(system).locked_inertia([]))
    order = np.argsort(moments)  # the formulas want I1 < I2 < I3, a cyclic order of axes
    assert list(order) in ([0, 1, 2], [1, 2, 0], [2, 0, 1])
    a, b, c = moments[order]
    xi0 = np.empty(3)
    xi0[order] = 0.5, 0.7, 1.6
    u, v, w = xi0[order]
    T2, L2 = a * u**2 + b * v**2 + c * w**2, (a * u) ** 2 + (b * v) ** 2 + (c * w) ** 2
    assert T2 * b < L2  # the axis of largest moment circulates about J
    rate = np.sqrt((c - b) * (L2 - T2 * a) / (a * b * c))
    k2 = (b - a) * (T2 * c - L2) / ((c - b) * (L2 - T2 * a))
    most = np.sqrt(
        [
            (T2 * c - L2) / (a * (c - a)),
            (T2 * c - L2) / (b * (c - b)),
            (L2 - T2 * a) / (c * (c - a)),
        ]
    )
    phase = ellipkinc(np.arctan2(v / most[1], u / most[0]), k2)

    def rates(t: Array | float) -> Array:
        sn, cn, dn, _ = ellipj(rate * np.asarray(t) + phase, k2)
        return np.stack([most[0] * cn, most[1] * sn, most[2] * dn], axis=-1)

    traj = pinred.simulate(system, xi0=xi0, duration=10.0, times=np.linspace(0.0, 10.0, 21))
    np.testing.assert_allclose(traj.xi[:, order], rates(traj.t), atol=1e-9)

    # The largest axis turns about J by ∫ L (aΩ1² + bΩ2²)/(a²Ω1² + b²Ω2²) dt.
    J = traj.spatial_momentum[0]
    L, z = np.sqrt(L2), J / np.linalg.norm(J)
    x_axis = np.cross(z, [1.0, 0.0, 0.0])
    x_axis /= np.linalg.norm(x_axis)
    y_axis = np.cross(z, x_axis)
    axis = np.eye(3)[order[2]]
    seen = np.array([pin.Quaternion(g).matrix() @ axis for g in traj.pose])
    azimuth = np.unwrap(np.arctan2(seen @ y_axis, seen @ x_axis))

    def precession(t: float) -> float:
        p, q, _ = rates(t)
        return float(L * (a * p**2 + b * q**2) / ((a * p) ** 2 + (b * q) ** 2))

    for k in (1, 10, 20):
        turned = quad(precession, 0.0, traj.t[k], epsabs=1e-12, epsrel=1e-12, limit=500)[0]
        whole = 2 * np.pi * np.rint((turned - (azimuth[k] - azimuth[0])) / (2 * np.pi))
        assert azimuth[k] - azimuth[0] + whole == pytest.approx(turned, abs=1e-9)
    np.testing.assert_allclose(seen @ z, (c * rates(traj.t)[:, 2]) / L, atol=1e-9)


@pytest.mark.by_hand("RxSE2", "R")
@pytest.mark.parametrize("group", [name for name in GROUPS if GROUPS[name].linear])
def test_free_fall_is_exact(group: str) -> None:
    """The centre of mass is on its parabola to round-off, and the shape is unaffected."""
    model = random_model(group, 3, 2)
    root = model.jointPlacements[1].rotation
    flat = np.array([2.0, -3.0, 0.0 if group == "SE2" else 4.0])
    if group == "R":  # along the root's axis only, or the shape would feel the rest
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        flat = 5.0 * np.array(data.joints[1].S).reshape(-1)[:3]
    floating, system = pinred.load(model), pinred.load(model, gravity=root @ flat)
    pose0 = system.group.exp(np.full(system.r, 0.4))
    still = pinred.simulate(floating, seed=3, duration=3.0, pose0=pose0)
    traj = pinred.simulate(system, seed=3, duration=3.0, pose0=pose0)
    np.testing.assert_allclose(traj.x, still.x, atol=1e-14)
    data = model.createData()

    # Along the directions in which the group translates; the others the joints may move.
    pin.computeJointJacobians(model, data, pin.neutral(model))
    S = root @ np.array(data.joints[1].S).reshape(6, -1)[:3, : system.group.linear]

    def com(k: int) -> Array:
        pin.centerOfMass(model, data, traj.q[k], traj.v[k])
        return np.array(S.T @ data.com[0])

    start, v0 = com(0), S.T @ np.array(data.vcom[0])
    for k in range(0, len(traj), 20):
        t = traj.t[k]
        expected = start + v0 * t + 0.5 * S.T @ root @ flat * t**2
        np.testing.assert_allclose(com(k), expected, rtol=0.0, atol=1e-14 * (1 + 30 * t**2))
    assert np.abs(traj.energy - traj.energy[0]).max() < 1e-8 * np.abs(traj.energy).max()


@pytest.mark.sampled
@pytest.mark.parametrize("group", sorted(GROUPS))
@pytest.mark.parametrize("joints", [pytest.param(0, marks=pytest.mark.by_hand), 3])
def test_zero_momentum_motion_is_horizontal(group: str, joints: int) -> None:
    """With momentum=0 the base moves by ξ = −A ẋ, and the momentum remains zero."""
    system = pinred.load(random_model(group, joints, 8))
    xdot0 = np.linspace(0.5, -0.8, joints)
    traj = pinred.simulate(system, xdot0=xdot0, momentum=0, duration=2.0)
    red = pinred.Reduction(system)
    for state in (traj(0.0), traj(1.3), traj(2.0)):
        horizontal = -red.local_connection(state.x) @ state.xdot
        np.testing.assert_allclose(state.xi, horizontal, atol=1e-13)
        np.testing.assert_allclose(state.body_momentum, np.zeros(system.r), atol=1e-13)


def test_zero_momentum_evaluates_no_momentum_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    """The vector field omits the terms with μ instead of multiplying them by zero."""

    def forbidden(*_: Array) -> Array:
        raise AssertionError("momentum was turned into the body frame")

    monkeypatch.setattr("pinred.simulation.pinocchio_engine._into_body", forbidden)
    system = pinred.load("falling_cat")
    xdot0 = np.full(system.m, 0.3)
    pinred.simulate(system, xdot0=xdot0, momentum=0, duration=0.1, engine="pinocchio")
    off = [0, 0, 0, 0, 0, 1e-300]
    with pytest.raises(AssertionError, match="turned"):
        pinred.simulate(system, xdot0=xdot0, momentum=off, duration=0.1, engine="pinocchio")


def test_initial_momentum_and_twist_are_equivalent() -> None:
    """A momentum and the twist that has it give the same motion."""
    system = pinred.load("coupled_spatial")
    initial = system.initial
    assert initial is not None
    a = pinred.simulate(system, duration=1.0)
    mu = pinred.Reduction(system).body_momentum(initial.x, initial.xdot, initial.xi)
    b = pinred.simulate(system, x0=initial.x, xdot0=initial.xdot, momentum=mu, duration=1.0)
    np.testing.assert_allclose(a.pose, b.pose, atol=1e-10)
    np.testing.assert_allclose(a.xi, b.xi, atol=1e-10)


def test_dense_output_agrees_with_aba() -> None:
    """Between steps, v̇ by differences agrees with ABA, and q̇ with v."""
    system = pinred.load("satellite_two_arms")
    traj = pinred.simulate(system, duration=2.0, rtol=1e-12, atol=1e-14)
    model, data, step = system.model, system.model.createData(), 2e-3
    for t in np.linspace(0.1, 1.9, 23):
        s = traj(t)
        near = {n: traj(t + n * step) for n in (-3, -2, -1, 1, 2, 3)}
        weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
        slope = sum(w * (near[n].v - near[-n].v) for n, w in weights.items()) / step
        a = pin.aba(model, data, s.q, s.v, np.zeros(model.nv))
        np.testing.assert_allclose(slope, a, atol=1e-7 * max(1.0, np.abs(a).max()))
        moved = sum(
            w * (pin.difference(model, s.q, near[n].q) - pin.difference(model, s.q, near[-n].q))
            for n, w in weights.items()
        )
        np.testing.assert_allclose(moved / step, s.v, atol=1e-8)


def test_trajectory_fields_have_time_first() -> None:
    """One time gives no time axis, and arrays are read-only."""
    system = pinred.load("cartpole")
    traj = pinred.simulate(system, duration=1.0, times=[0.25, 0.5, 1.0])
    sizes = {"x": 1, "xdot": 1, "xi": 1, "pose": 1, "q": system.model.nq, "v": 2}
    for name, size in sizes.items():
        assert getattr(traj, name).shape == (3, size)
        assert getattr(traj(0.5), name).shape == (size,)
        assert getattr(traj([0.1, 0.2]), name).shape == (2, size)
    assert traj.energy.shape == (3,)
    assert traj(0.5).energy.shape == ()
    np.testing.assert_array_equal(traj(traj.t).q, traj.q)
    with pytest.raises(ValueError, match="read-only"):
        traj.x[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        traj(0.5).x[0] = 1.0
    for bad in (-0.1, 1.1, np.nan, [0.5, 2.0]):
        with pytest.raises(pinred.InputError, match="between 0 and 1 s"):
            traj(bad)


def test_motion_is_invariant_under_the_group() -> None:
    """Another initial pose gives the same motion, transformed."""
    system = pinred.load("falling_cat")
    g = system.group.exp(np.array([1.0, -2.0, 0.5, 0.7, 1.1, -0.4]))
    a = pinred.simulate(system, duration=3.0)
    b = pinred.simulate(system, duration=3.0, pose0=g)
    np.testing.assert_allclose(a.x, b.x, atol=5e-9)
    error = system.group.error(system.group.compose(g, a.pose), b.pose)
    assert max(error.rotation.max(), error.translation.max()) < 5e-9


def test_same_scene_gives_same_bits() -> None:
    """A scene gives the same trajectory to the bit, and progress reaches one."""
    system = pinred.load("double_spherical_pendulum")
    parts: list[float] = []
    a = pinred.simulate(system, duration=1.0, progress=parts.append)
    b = pinred.simulate(pinred.Scene(system=system, duration=1.0))
    np.testing.assert_array_equal(a.q, b.q)
    assert parts == sorted(parts)
    assert parts[-1] == 1.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"duration": 0.0}, "duration must be finite and above zero, got 0"),
        ({"duration": -1.0}, "duration"),
        ({"duration": np.nan}, "duration"),
        ({"duration": "long"}, "duration must be a number"),
        ({"rtol": 0.0}, "rtol"),
        ({"rtol": 1e-15}, "rtol must be at least"),
        ({"atol": -1.0}, "atol"),
        ({"x0": [0.0, 0.0]}, r"x0: expected 1 number: "),
        ({"xdot0": [np.inf]}, "xdot0 must be finite"),
        ({"xi0": [0.0]}, r"xi0: expected 3 numbers: v1, v2, ω, got 1"),
        ({"xi0": [0, 0, 0], "momentum": [0, 0, 0]}, "not both"),
        ({"momentum": 1.0}, "momentum: expected"),
        ({"seed": 1, "x0": [0.0]}, "do not combine it with x0"),
        ({"pose0": [0.0]}, "a pose of SE2"),
        ({"times": []}, "times"),
        ({"times": [0.0, 0.0]}, "must increase"),
        ({"times": [0.0, 2.0], "duration": 1.0}, "to the duration"),
        ({"times": [0.0, np.nan]}, "finite"),
        ({"springs": {"nope": (1.0, 0.0)}}, "no shape joint 'nope'; the joints are hinge"),
        ({"springs": {"hinge": (1.0, np.nan)}}, "finite"),
        ({"springs": {"hinge": 1.0}}, "stiffness, rest"),
        ({"speed": 3}, "no option 'speed'"),
        ({"engine": "magic"}, "engine: expected one of compiled, pinocchio"),
    ],
)
def test_invalid_scenes_are_rejected(options: dict[str, object], words: str) -> None:
    """The error states the reason before any integration."""
    with pytest.raises(pinred.InputError, match=words):
        pinred.simulate(pinred.load("coupled_planar"), **options)  # type: ignore[arg-type]


def test_missing_initial_state_is_rejected() -> None:
    """No initial state is invented."""
    system = pinred.load(random_model("SE3", 2, 1))
    with pytest.raises(pinred.InputError, match="pass x0, xdot0, xi0 or momentum, or seed="):
        pinred.simulate(system, duration=1.0)


def test_diverging_joint_is_named() -> None:
    """The error names the joint and the time."""
    system = pinred.load("coupled_planar")
    with pytest.raises(pinred.IntegrationError, match=r"coupled_planar.*t = "):
        pinred.simulate(system, x0=[1.0], duration=100.0, springs={"hinge": (-1e6, 0.0)})


@pytest.mark.parametrize("name", ["rigid_body", "double_spherical_pendulum"])
def test_asymmetric_gravity_names_broken_directions(name: str) -> None:
    """The error names the directions that gravity breaks."""
    broken = {"rigid_body": (0.0, 0.0, -9.81), "double_spherical_pendulum": (0.0, 9.81, 0.0)}[name]
    system = pinred.load(name, gravity=broken)
    if name == "rigid_body":  # its pivot is its centre of mass: gravity does nothing
        traj = pinred.simulate(system, duration=0.1)
        np.testing.assert_allclose(traj.energy, traj.energy[0], rtol=1e-10)
        return
    with pytest.raises(pinred.SymmetryError, match=r"axis \(0, 0, .?1\).*not along gravity"):
        pinred.simulate(system, duration=0.1)
    red = pinred.Reduction(system)
    with pytest.raises(pinred.SymmetryError):
        red.potential(np.zeros(system.m))
    at = red.at(np.zeros(system.m))  # the split itself does not need gravity
    with pytest.raises(pinred.SymmetryError):
        _ = at.potential


def test_pivot_under_gravity_names_broken_directions() -> None:
    """Gravity breaks x and y, but not z, for a body on a pivot away from its centre of mass."""
    model = random_model("SO3", 1, 4)
    model.jointPlacements[1].rotation = np.eye(3)
    system = pinred.load(model, gravity=(0.0, 0.0, -9.81))
    with pytest.raises(pinred.SymmetryError, match=r"SO3.*about the world's x, y axes"):
        pinred.Reduction(system).potential([0.1])
    sideways = pinred.load(model, gravity=(3.0, 0.0, 0.0))
    with pytest.raises(pinred.SymmetryError, match="about the world's y, z axes"):
        pinred.Reduction(sideways).potential([0.1])


def test_csv_headers_quote_any_joint_name(tmp_path: Path) -> None:
    """Python's csv reader finds the same columns for any joint name."""
    model = random_model("SE2", 2, 3)
    model.names[2], model.names[3] = 'a,"b"', "c d"
    system = pinred.load(model)
    assert system.shape_names == ('a,"b"', "c d")
    traj = pinred.simulate(system, seed=0, duration=0.1, times=[0.0, 0.1])
    traj.save(tmp_path / "traj.csv")
    with (tmp_path / "traj.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row['x.a,"b"']) for row in rows] == traj.x[:, 0].tolist()
    assert [float(row["xdot.c d"]) for row in rows] == traj.xdot[:, 1].tolist()
