"""Rules that skip terms: scenes to which they apply, and scenes close to these."""

from __future__ import annotations

from typing import Any

import aba
import numpy as np
import pytest
from trees import random_model

import pinred
from pinred.forces import Torque, Wrench
from pinred.lie import GROUPS
from pinred.scene.scene import ENGINES
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.pinocchio_engine import PinocchioFlow
from pinred.simulation.plan import plan_of

MOVING = {"R": [0.3], "SO2": [0.3], "SE2": [0.3, -0.1, 0.4], "SO3": [0.3, -0.2, 0.4]}
MOVING["SE3"] = [0.1, 0.2, -0.1, 0.3, -0.2, 0.4]
MOVING["RxSE2"] = [0.2, 0.3, -0.1, 0.4]
# Numbers of the base: all of it, none asked for, and the same at zero momentum.
SIZES = {"R": (0, 0, 0, 0), "SO2": (1, 0, 1, 0), "SE2": (1, 0, 1, 0), "RxSE2": (1, 0, 1, 0)}
SIZES |= dict.fromkeys(("SO3", "SE3"), (4, 3, 4, 0))


@pytest.mark.by_hand("RxSE2")
@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.sampled
def test_shape_outputs_integrate_fewer_variables(group: str) -> None:
    """The shape agrees with ABA."""
    system = pinred.load(random_model(group, 2, 7, armature=group == "SE3"))
    for k, momentum in enumerate((MOVING[group], [0.0] * system.r)):
        every = pinred.Scene(
            system=system, x0=[0.3, -0.2], xdot0=[0.5, 0.4], momentum=momentum, duration=1.0,
            times=np.linspace(0.0, 1.0, 11),
        )  # fmt: skip
        shape = pinred.Scene(
            system=system, x0=[0.3, -0.2], xdot0=[0.5, 0.4], momentum=momentum, duration=1.0,
            times=np.linspace(0.0, 1.0, 11), outputs="shape",
        )  # fmt: skip
        for scene, base in ((every, SIZES[group][2 * k]), (shape, SIZES[group][2 * k + 1])):
            cyclic = len(CompiledFlow.of_plan(plan_of(scene)).kernel.layout.cyclic)
            assert PinocchioFlow(plan_of(scene)).y0.size == 4 + base
            assert CompiledFlow.of_plan(plan_of(scene)).y0.size == 4 - cyclic + base
        start = every.start
        q0, v0 = system.q(start.pose, start.x), system.v(start.xi, start.xdot)
        q, v = aba.integrate(system.model, q0, v0, every.report_times)
        for engine in ENGINES:
            whole, part = (pinred.simulate(s, engine=engine) for s in (every, shape))
            assert aba.max_difference(system.model, q, whole.q) < 1e-8
            found = system.configuration(q).x
            np.testing.assert_allclose(np.exp(1j * part.x), np.exp(1j * found), atol=1e-8)
            np.testing.assert_allclose(part.xdot, system.velocity(v).xdot, atol=1e-8)
            np.testing.assert_allclose(part.energy, part.energy[0], rtol=1e-9)


def flow(system: pinred.System, **options: Any) -> CompiledFlow:
    """Return the compiled flow of a scene."""
    return CompiledFlow.of_plan(plan_of(pinred.Scene(system=system, **options)))


@pytest.mark.parametrize("momentum", [1e-300, 1e-12])
def test_tiny_momentum_is_not_skipped(momentum: float) -> None:
    """The motion agrees with that of zero momentum within the momentum."""
    system = pinred.load("falling_cat")
    mu = np.array([0.0, 0.0, 0.0, 0.0, 0.0, momentum])
    options: dict[str, Any] = {"xdot0": np.full(3, 0.3), "duration": 2.0}
    for outputs, none, some in (("all", 4, 4), ("shape", 0, 3)):
        still = flow(system, momentum=0, outputs=outputs, **options)
        moving = flow(system, momentum=mu, outputs=outputs, **options)
        assert still.y0.size == 6 + none
        assert moving.y0.size == 6 + some
        assert still.kernel.instructions < moving.kernel.instructions
    for engine in ENGINES:
        a = pinred.simulate(system, momentum=0, engine=engine, **options)
        b = pinred.simulate(system, momentum=mu, engine=engine, **options)
        np.testing.assert_allclose(a.q, b.q, atol=1e-8)
        np.testing.assert_allclose(b.spatial_momentum[:, 5], momentum, rtol=0, atol=1e-16)
        q, _ = aba.integrate(system.model, b.q[0], b.v[0], b.t[::100], rtol=1e-10)
        assert aba.max_difference(system.model, q, b.q[::100]) < 1e-7


@pytest.mark.parametrize("offset", [0.0, 1e-9, 1e-3])
def test_slightly_unbalanced_wheel_is_not_cyclic(offset: float) -> None:
    """Its centre of mass is a nanometre off its axis."""
    model = pinred.load("reaction_wheel_satellite").model.copy()
    k = model.getJointId("wheel_x")
    inertia = model.inertias[k]
    inertia.lever = inertia.lever + np.array([0.0, offset, 0.0])
    model.inertias[k] = inertia
    system = pinred.load(model)
    scene = pinred.Scene(
        system=system, x0=[0.4, 0, 0, 0], xdot0=[0.2, 20, -15, 30], xi0=MOVING["SE3"],
        times=[0.0, 0.5, 1.0],
    )  # fmt: skip
    assert CompiledFlow.of_plan(plan_of(scene)).kernel.layout.cyclic == (
        (1, 2, 3) if offset == 0.0 else (2, 3)
    )
    traj = pinred.simulate(scene)
    q, _ = aba.integrate(model, traj.q[0], traj.v[0], traj.t, rtol=1e-10)
    assert aba.max_difference(model, q, traj.q) < 1e-7


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-6])
def test_tiny_gravity_across_a_rail(size: float) -> None:
    """Gravity of 1e-300 is skipped, of 1e-6 is a potential; both agree with ABA."""
    system = pinred.load("cartpole", gravity=(0.0, 0.0, -size))
    scene = pinred.Scene(system=system, x0=[1.0], xdot0=[0.5], xi0=[0.3], duration=2.0)
    assert (CompiledFlow.of_plan(plan_of(scene)).kernel.structure.gravity != ()) == (size == 1e-6)
    for engine in ENGINES:
        traj = pinred.simulate(scene, engine=engine)
        q, _ = aba.integrate(system.model, traj.q[0], traj.v[0], traj.t[::50])
        assert aba.max_difference(system.model, q, traj.q[::50]) < 1e-9


def test_wrench_makes_momentum_and_path_variables() -> None:
    """A wrench adds variables even if its value is zero."""
    system = pinred.load("falling_cat")
    options: dict[str, Any] = {"xdot0": np.full(3, 0.3), "momentum": 0, "duration": 1.0}
    bare = pinred.simulate(system, **options)
    zero = Wrench([0.0] * 6)
    assert flow(system, forces=[zero], **options).y0.size == 6 + 4 + 3 + 6
    assert flow(system, forces=[zero], outputs="shape", **options).y0.size == 6 + 3
    pushed = pinred.simulate(system, forces=[zero], **options)
    np.testing.assert_allclose(pushed.q, bare.q, atol=1e-8)
    still = Torque({system.shape_names[0]: 0.0})
    assert flow(system, forces=[still], **options).y0.size == 6 + 4
