"""Springs, dampers, torques, wrenches: closed forms, and ABA under the same forces."""

from __future__ import annotations

from typing import Any

import aba
import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from forced_trees import against_aba, tree
from hypothesis import given, settings
from strategies import groups, seeds
from trees import climbing_joint, random_model

import pinred
from pinred.common.arrays import Array
from pinred.forces import PD, Controller, Damper, PotentialEnergy, Spring, Torque, Wrench
from pinred.forces.force import Force
from pinred.lie import GROUPS
from pinred.scene.scene import ENGINES, Engine
from pinred.signals import Constant, Hold, Linear, Spline
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.plan import plan_of

SATELLITE = pinred.load("reaction_wheel_satellite")
I1, I2 = 2.0, 1.0  # of elroys_beanie


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("c", [0.3, pytest.param(1.5, marks=pytest.mark.by_hand)])
@pytest.mark.sampled
def test_damped_spring_equals_closed_form(c: float, engine: Engine) -> None:
    """M ẍ + c ẋ + k x = 0 with M = I1 I2/(I1+I2): decay c/2M, frequency √(k/M − (c/2M)²)."""
    k, x0, v0 = 3.0, 0.7, -0.4
    forces = [Spring("beanie", k, 0.1), Damper("beanie", c)]
    traj = pinred.simulate(
        pinred.load("elroys_beanie"),
        x0=[x0 + 0.1], xdot0=[v0], xi0=[0.8], duration=5.0, forces=forces, engine=engine,
    )  # fmt: skip
    M = I1 * I2 / (I1 + I2)
    decay, t = c / (2 * M), traj.t
    w = np.sqrt(k / M - decay**2)
    swing = x0 * np.cos(w * t) + (v0 + decay * x0) / w * np.sin(w * t)
    x = np.exp(-decay * t) * swing
    np.testing.assert_allclose(traj.x[:, 0], 0.1 + x, atol=1e-9)
    angle = (0.8 + I2 / (I1 + I2) * v0) * t - I2 / (I1 + I2) * (x - x0)
    np.testing.assert_allclose(traj.pose[:, 0], angle, atol=1e-9)
    np.testing.assert_allclose(traj.spatial_momentum[:, 0], I1 * 0.8 + I2 * (0.8 + v0), rtol=1e-12)
    balance = traj.energy_balance
    assert balance.labels == ("damper beanie",)
    # ½ M ẋ² + ½ k x² from the closed form; what it lost the damper took.
    rate = np.exp(-decay * t) * (
        -decay * swing - w * x0 * np.sin(w * t) + (v0 + decay * x0) * np.cos(w * t)
    )
    inner = 0.5 * M * rate**2 + 0.5 * k * x**2
    np.testing.assert_allclose(balance.work[:, 0], inner - inner[0], atol=1e-9)
    np.testing.assert_allclose(balance.residual, 0.0, atol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_internal_forces_conserve_momentum(engine: Engine) -> None:
    """With dampers, springs and joint torques, momentum about the CoM stays within 1e-12."""
    system = pinred.load("falling_cat")
    a, b, c = system.shape_names
    forces = [
        Damper(a, 0.1),
        Damper(b, 0.2, to=c),
        Spring(b, 2.0, 0.3, to=a),
        PotentialEnergy(lambda x: ca.cos(x[0] - x[2]) + 0.1 * x[1] ** 4),
        Torque(lambda t, _x, xdot, mu: {c: 0.3 * ca.sin(3 * t) + 0.1 * mu[4] * xdot[0]}),
    ]
    traj = pinred.simulate(system, duration=2.0, forces=forces, engine=engine)
    about = aba.momentum_about_com(system.model, traj.q, traj.v)
    scale, data = np.abs(about[0]).max(), system.model.createData()
    np.testing.assert_allclose(about, np.broadcast_to(about[0], (201, 3)), atol=1e-12 * scale)

    def tau(t: float, q: Array, v: Array) -> Array:
        x, xdot = q[7:], v[6:]
        mu = aba.body_momentum(system.model, data, q, v)
        full_torque = np.zeros(9)
        stretch = x[1] - x[0] - 0.3
        full_torque[6:] += 2.0 * stretch * np.array([1.0, -1.0, 0.0])
        full_torque[6:] -= np.array(
            [0.1 * xdot[0], 0.2 * (xdot[1] - xdot[2]), 0.2 * (xdot[2] - xdot[1])]
        )
        full_torque[6:] += np.sin(x[0] - x[2]) * np.array([1.0, 0.0, -1.0])
        full_torque[7] -= 0.4 * x[1] ** 3
        full_torque[8] += 0.3 * np.sin(3 * t) + 0.1 * mu[4] * xdot[0]
        return full_torque

    assert against_aba(traj, tau) < 1e-7
    np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-8)
    assert traj.energy_balance.labels == (f"damper {a}", f"damper {b}–{c}", "torque")


def thrust(r: int) -> tuple[Wrench, Any]:
    """A wrench that depends on time and shape, for CasADi and for NumPy."""
    size, phase = np.linspace(1.5, -1.0, r), np.arange(r)

    def wrench(sin: Any, t: Any, x: Any) -> list[Any]:
        return [size[i] * sin(2 * t + phase[i]) + 0.3 * x[0] * size[-1 - i] for i in range(r)]

    return Wrench(lambda t, x, *_: wrench(ca.sin, t, x)), lambda t, x: wrench(np.sin, t, x)


# Wrenches from tables, and those on links, are compared with ABA by default.
@pytest.mark.by_hand
@pytest.mark.slow
@settings(max_examples=3)
@given(groups, seeds)
def test_wrench_on_random_trees_equals_aba(group: str, seed: int) -> None:
    """In time and shape, under gravity: ABA, momentum and energy, on both engines."""
    system = tree(group, 2, seed)
    wrench, by_numbers = thrust(system.r)
    scene = pinred.Scene(system=system, seed=seed % 100, duration=0.6, forces=[wrench])

    def tau(t: float, q: Array, _v: Array) -> Array:
        x = system.configuration(q).x
        return np.append(by_numbers(t, x), np.zeros(2))

    for engine in ENGINES:
        traj = pinred.simulate(scene, engine=engine)
        assert against_aba(traj, tau) < 1e-6
        scale = max(1.0, float(np.abs(traj.spatial_momentum).max()))
        np.testing.assert_allclose(traj.momentum_balance.residual, 0.0, atol=1e-8 * scale)
        kinetic = [
            pin.computeKineticEnergy(system.model, system.model.createData(), q, v)
            for q, v in zip(traj.q, traj.v, strict=True)
        ]
        scale = max(1.0, max(kinetic), float(np.abs(traj.energy).max()))
        np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-8 * scale)
        shape = pinred.simulate(scene, engine=engine, outputs="shape")
        np.testing.assert_allclose(shape.x, traj.x, atol=1e-6)


# RxSE2 has the same factor.
@pytest.mark.by_hand("SE2")
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.sampled(4)
def test_wrench_from_tables_equals_aba(group: str) -> None:
    """Signals with jumps and kinks, on a pushed and falling tree of every group."""
    system = tree(group, 2, 11)
    burns: list[Any] = [
        Hold([0.0, 0.31, 0.77], [1.0, -2.0, 0.5]),
        Linear([0.0, 0.5, 1.0], [0.0, 1.0, -1.0]),
        Spline([0.0, 0.4, 0.8, 1.0], [0.0, 1.0, -0.5, 0.0]),
        Constant(0.3),
        -0.2,
        0.0,
    ]
    wrench = Wrench(burns[: system.r])
    values = [s if isinstance(s, pinred.signals.Signal) else Constant(s) for s in burns]

    def tau(t: float, _q: Array, _v: Array) -> Array:
        return np.append([float(s.value(t)) for s in values[: system.r]], np.zeros(2))

    breaks = (0.31, 0.4, 0.5, 0.77, 0.8)
    for engine in ENGINES:
        traj = pinred.simulate(system, seed=1, duration=1.0, forces=[wrench], engine=engine)
        assert set(traj.motion.knots) >= set(wrench_breaks(wrench))
        assert against_aba(traj, tau, breaks) < 1e-7
        np.testing.assert_allclose(traj.momentum_balance.residual, 0.0, atol=1e-9)


def wrench_breaks(wrench: Wrench) -> list[float]:
    """Return the times at which the signals of a wrench are not smooth."""
    return [float(b) for signal in wrench.signals for b in signal.breaks if b < 1.0]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_detumbling_equals_closed_form(engine: Engine) -> None:
    """A pure moment −c μ on the base: |J| = |J0| e^(−ct), with a constant direction."""
    system, c = pinred.load("reaction_wheel_satellite"), 0.7
    brake = Wrench(lambda *seen: ca.vertcat(0, 0, 0, -c * seen[3][3:]), name="brake")
    traj = pinred.simulate(system, duration=3.0, forces=[brake], engine=engine)
    about = aba.momentum_about_com(system.model, traj.q, traj.v)
    expected = np.exp(-c * traj.t)[:, None] * about[0]
    np.testing.assert_allclose(about, expected, atol=1e-8 * float(np.linalg.norm(about[0])))
    P = traj.spatial_momentum[:, :3]
    np.testing.assert_allclose(P, P[:1].repeat(201, 0), atol=1e-10)
    assert traj.energy_balance.labels == ("brake",)
    np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-8)
    if engine == "compiled":
        assert pinred.compare(traj).passed


@pytest.mark.parametrize("group", ["R", "SO2"])
@pytest.mark.sampled
def test_push_equals_closed_form(group: str) -> None:
    """A constant force moves the CoM along R; a constant moment adds to J of SO(2)."""
    system = pinred.load(random_model(group, 1, 3))
    for engine in ENGINES:
        traj = pinred.simulate(system, seed=3, duration=2.0, forces=[Wrench([0.8])], engine=engine)
        J = traj.spatial_momentum[:, 0]
        np.testing.assert_allclose(J - J[0], 0.8 * traj.t, atol=1e-10)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("root", "along", "push"),
    [
        (pin.JointModelPX(), pin.JointModelPX(), [0.8]),
        (climbing_joint(), pin.JointModelPZ(), [0.8, 0.0, 0.0, 0.0]),
    ],
)
@pytest.mark.sampled
def test_push_along_free_slide(
    root: pin.JointModel, along: pin.JointModel, push: list[float], engine: Engine
) -> None:
    """No inertia depends on the slide's position, yet it must be integrated."""
    model = pin.Model()
    base = model.addJoint(0, root, pin.SE3.Identity(), "root")
    model.appendBodyToJoint(base, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
    slide = model.addJoint(base, along, pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(slide, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.gravity.setZero()
    system = pinred.load(model)
    options: dict[str, Any] = {"x0": [0.1], "xdot0": [0.3], "duration": 2.0, "engine": engine}
    traj = pinred.simulate(system, forces=[Wrench(push)], **options)
    t = traj.t
    np.testing.assert_allclose(traj.x[:, 0], 0.1 + 0.3 * t - 0.5 * 0.8 / 2.0 * t**2, atol=1e-9)
    np.testing.assert_allclose(traj.pose[:, 0], 0.5 * 0.8 / 2.0 * t**2, atol=1e-9)
    assert traj.plan.cyclic == ()
    assert pinred.simulate(system, **options).plan.cyclic == (0,)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", [Spline, Hold, pytest.param(Linear, marks=pytest.mark.by_hand)])
@pytest.mark.sampled(4)
def test_torque_from_table_equals_aba(kind: Any, engine: Engine) -> None:
    """ABA stops at every entry; report times lie on the entries, too."""
    system = pinred.load("planar_chain5")
    table = np.linspace(0.0, 2.0, 9)
    signal = kind(table, np.sin(5 * table) * 0.8)
    names = system.shape_names
    forces = [Torque({names[1]: signal, names[3]: 0.05})]
    traj = pinred.simulate(
        system, duration=2.0, forces=forces, engine=engine, times=np.linspace(0.0, 2.0, 41)
    )

    def tau(t: float, _q: Array, _v: Array) -> Array:
        return np.array([0, 0, 0, 0, float(signal.value(t)), 0, 0.05, 0])

    assert against_aba(traj, tau, tuple(table[1:-1])) < 1e-7
    if engine == "compiled":
        assert pinred.compare(traj).passed
    np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-8)


def wheels(*forces: Force) -> tuple[int, ...]:
    """Return the cyclic joints of the reaction wheel satellite under some forces."""
    return plan_of(pinred.Scene(system=SATELLITE, forces=forces)).cyclic


def test_forces_on_wheels_make_them_acyclic() -> None:
    """Torques on a wheel and forces of its angle do; forces of its rate do not."""
    hinge = SATELLITE.shape_names[0]
    damper = Damper("wheel_x", 0.01)
    assert wheels() == (1, 2, 3)
    assert wheels(damper) == (2, 3)
    plan = plan_of(pinred.Scene(system=SATELLITE, forces=[damper]))
    assert CompiledFlow.of_plan(plan).kernel.layout.cyclic == (2, 3)
    assert wheels(Torque({"wheel_y": 0.2})) == (1, 3)
    assert wheels(PD({"wheel_z": 1.0}, 0.1, 0.1)) == (1, 2)
    assert wheels(Controller(lambda *_: [0.1], 0.5, ("wheel_z",))) == (1, 2)
    assert wheels(Spring("wheel_y", 0.1, to=hinge)) == (1, 3)
    assert wheels(PotentialEnergy(lambda x: ca.cos(x[1]) * x[0])) == (2, 3)
    assert wheels(Torque(lambda _, x, *__: {hinge: ca.sin(x[3])})) == (1, 2)
    assert wheels(Wrench(lambda _, x, *__: [0, 0, 0, ca.sin(x[2]), 0, 0])) == (1, 3)
    assert wheels(Wrench([0, 0, 0, 0.1, 0, 0])) == (1, 2, 3)
    assert wheels(Damper(hinge, 0.1)) == (1, 2, 3)


@pytest.mark.parametrize("angle", [False, True])
def test_hinge_torque_of_wheel_rate_keeps_wheel_cyclic(angle: bool) -> None:
    """A torque on the hinge by the wheel's angle does not."""
    hinge = SATELLITE.shape_names[0]

    def law(x: Any, xdot: Any) -> Any:
        return -2 * x[0] + 0.1 * (x[1] if angle else xdot[1])

    force = Torque(lambda _, x, xdot, __: {hinge: law(x, xdot)})
    assert wheels(force) == ((2, 3) if angle else (1, 2, 3))
    traj = pinred.simulate(SATELLITE, duration=1.0, forces=[force])

    def tau(_t: float, q: Array, v: Array) -> Array:
        x = SATELLITE.configuration(q).x  # wheel_x stays within a turn on either side
        x[1] -= 2 * np.pi * round((x[1] - 20.0 * _t) / (2 * np.pi))
        return np.append(np.zeros(6), [law(x, v[6:]), 0, 0, 0])

    assert against_aba(traj, tau) < 1e-7


@pytest.mark.slow
def test_clock_is_integrated_only_if_needed() -> None:
    """For smooth functions of time; not for constants and step tables."""
    system = pinred.load("falling_cat")
    name = system.shape_names[0]

    def clock(*forces: Force) -> int:
        flow = CompiledFlow.of_plan(
            plan_of(pinred.Scene(system=system, seed=1, duration=2.0, forces=forces))
        )
        assert flow.y0.size == 10 + flow.kernel.layout.clock
        return flow.kernel.layout.clock

    assert clock() == 0
    assert clock(Damper(name, 1.0), Spring(name, 1.0)) == 0
    assert clock(Torque({name: 0.3})) == clock(Torque({name: Constant(0.3)})) == 0
    assert clock(Torque({name: Hold([0.0, 1.0], [0.1, 0.2])})) == 0
    assert clock(Torque(lambda _, x, __, mu: {name: mu[3] * x[0]})) == 0
    assert clock(Torque({name: Linear([0.0, 2.0], [0.1, 0.2])})) == 1
    assert clock(Torque(lambda t, *_: {name: t})) == 1
