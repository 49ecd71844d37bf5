"""Tests of compiled kernels against Pinocchio, and of motions against ABA."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from strategies import Case, cases, examples
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.common.machine_code import NativeCode
from pinred.common.object_cache import ObjectCache
from pinred.kernels.build import build_kernel
from pinred.kernels.kernel import Structure
from pinred.kernels.validation import validate_kernel
from pinred.lie import GROUPS
from pinred.reduction.cyclic_joints import cyclic_joints
from pinred.simulation.compiled.compiled_flow import CompiledFlow, kernel_of
from pinred.simulation.pinocchio_engine import PinocchioFlow
from pinred.simulation.plan import plan_of
from pinred.system.find_robot_files import bundled_robots

LONG = {"four_bar", "parallel_biped"}  # whose motion over 3 s takes several seconds


# Every run compares motions of both engines below.
@pytest.mark.by_hand
@pytest.mark.slow
@examples(3, 8)
@given(cases(0, 6))
def test_kernel_rate_equals_readable_route(case: Case) -> None:
    """Random groups, joints and springs, with and without momentum."""
    system = case.system
    springs = dict.fromkeys(system.shape_names[::2], (1.5, 0.4))
    for momentum in (None, np.zeros(system.r)):
        options = {"xi0": case.xi} if momentum is None else {"momentum": momentum}
        scene = pinred.Scene(
            system=system, x0=case.x, xdot0=case.xdot, pose0=case.pose, springs=springs, **options
        )
        compiled, readable = CompiledFlow.of_plan(plan_of(scene)), PinocchioFlow(plan_of(scene))
        kernel = compiled.kernel
        assert kernel.structure.zero_momentum == (not readable.base.has_momentum)
        rate = kernel.evaluate_rate(compiled.y0, compiled.parameters)
        expected = readable.rate(0.0, readable.y0)
        layout, m = kernel.layout, system.m
        active, cyclic = list(layout.active), list(layout.cyclic)
        rows = [*active, *(m + k for k in active), *cyclic, *range(2 * m, len(expected))]
        scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
        np.testing.assert_allclose(rate, expected[rows], rtol=0, atol=1e-10 * scale)


@pytest.mark.by_hand
@settings(max_examples=8)
@given(cases(1, 5))
def test_kernel_rate_satisfies_hamilton_poincare(case: Case) -> None:
    """ẋ and π̇ = ṗ + Ȧᵀμ + Aᵀμ̇ of the kernel equal those of the reduced equations.

    p = π − Aᵀμ.  The equations use the mass matrix, its derivatives and the curvature.
    """
    system, red = case.system, pinred.Reduction(case.system)
    scene = pinred.Scene(system=system, x0=case.x, xdot0=case.xdot, xi0=case.xi, pose0=case.pose)
    flow = CompiledFlow.of_plan(plan_of(scene))
    mu = flow.sample(0.0, flow.y0).mu  # about the centre of mass
    at = red.at(case.x)
    p = at.reduced_metric @ case.xdot
    equations = pinred.equations.hamilton_poincare(red, case.x, p, mu)
    pidot = equations.shape.total + mu @ (at.dA @ case.xdot)
    pidot += equations.momentum.total @ at.local_connection
    rate = flow.kernel.evaluate_rate(flow.y0, flow.parameters)
    active, k = list(flow.kernel.layout.active), len(flow.kernel.layout.active)
    scale = max(1.0, float(np.abs(pidot).max()))
    np.testing.assert_allclose(rate[:k], case.xdot[active], rtol=0, atol=1e-9)
    np.testing.assert_allclose(rate[k : 2 * k], pidot[active], rtol=0, atol=1e-9 * scale)
    y = flow.y0
    np.testing.assert_allclose(y[k : 2 * k], (p + mu @ at.local_connection)[active], atol=1e-9)


# Smaller robots have balls and free roots.
# Both engines agree on loops in test_loop_motion.py.
@pytest.mark.by_hand("diver", "astronaut", "gripper")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.by_hand) if name in LONG else name
        for name in sorted(bundled_robots())
    ],
)
@pytest.mark.sampled
def test_compiled_and_pinocchio_engines_agree(name: str) -> None:
    """Both engines give the same motion in all fields."""
    system = pinred.load(name)
    a = pinred.simulate(system, duration=3.0, rtol=1e-11, atol=1e-13)
    b = pinred.simulate(system, duration=3.0, rtol=1e-11, atol=1e-13, engine="pinocchio")
    assert (a.run.engine, b.run.engine) == ("compiled", "pinocchio")
    for field in pinred.State.__dataclass_fields__:
        x, y = getattr(a, field), getattr(b, field)
        scale = max(1.0, float(np.abs(y).max(initial=0.0)))
        np.testing.assert_allclose(x, y, rtol=0, atol=3e-8 * scale, err_msg=field)


@pytest.mark.slow
def test_kernel_with_gravity_on_shape_agrees_with_aba() -> None:
    """A pendulum chain about the vertical and a slanted cart, with V(x) in the kernel."""
    for group, gravity in (("R", (1.0, -2.0, 3.0)), ("SO2", None)):
        model = random_model(group, 3, 12)
        if gravity is None:
            axis = model.jointPlacements[1].rotation @ np.array(model.joints[1].createData().S)[3:]
            gravity = tuple(-9.81 * axis.ravel())
        system = pinred.load(model, gravity=gravity)
        report = pinred.compare(pinred.simulate(system, seed=2, duration=1.0))
        assert report.passed, str(report)


@pytest.mark.slow
def test_cyclic_joints_are_integrated_by_quadrature() -> None:
    """Cyclic joints have no momentum in the state, and their angles agree with ABA."""
    system = pinred.load("reaction_wheel_satellite")
    traj = pinred.simulate(system, duration=5.0)
    flow = CompiledFlow.of_plan(plan_of(traj.scene))
    assert len(flow.y0) == 2 + 3 + 4
    assert len(flow.kernel.layout.cyclic) == 3
    assert pinred.compare(traj).passed
    sprung = pinred.simulate(system, duration=1.0, springs={"wheel_x": (0.1, 0.0)})
    assert len(CompiledFlow.of_plan(plan_of(sprung.scene)).kernel.layout.cyclic) == 2
    assert pinred.compare(sprung).passed


def test_zero_momentum_kernel_needs_exact_zero() -> None:
    """A momentum of 1e-300 uses the kernel with momentum."""
    system = pinred.load("falling_cat")
    xdot0 = np.full(system.m, 0.3)
    still = CompiledFlow.of_plan(plan_of(pinred.Scene(system=system, xdot0=xdot0, momentum=0)))
    tiny = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1e-300])
    off = CompiledFlow.of_plan(plan_of(pinred.Scene(system=system, xdot0=xdot0, momentum=tiny)))
    assert still.kernel.layout.base.spin == 0
    assert off.kernel.layout.base.spin == 3
    assert still.kernel.instructions < off.kernel.instructions


def test_kernel_of_other_robot_is_rejected() -> None:
    """The error message states the deviation."""
    cat = pinred.load("falling_cat")
    kernel = kernel_of(plan_of(pinred.Scene(system=cat, seed=0)), zero_momentum=False)
    validate_kernel(kernel)
    other = pinred.load("falling_cat")
    inertia = other.model.inertias[2]
    inertia.mass = inertia.mass * (1 + 1e-8)
    other.model.inertias[2] = inertia
    with pytest.raises(pinred.KernelMismatch, match=r"falling_cat.*disagrees.*off by"):
        validate_kernel(replace(kernel, system=other))


def test_build_kernel_reuses_cached_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second build compiles nothing; another parameter value needs another kernel."""
    cache = ObjectCache(tmp_path / "kernels")
    system = pinred.load("falling_cat")
    structure = Structure(zero_momentum=False)
    first = build_kernel(system, structure, cache=cache)

    def forbidden(*_: object, **__: object) -> bytes:
        raise AssertionError("compiled again")

    monkeypatch.setattr("pinred.kernels.build.compile_object", forbidden)
    second = build_kernel(pinred.load("falling_cat"), structure, cache=cache)
    y = np.linspace(0.1, 0.9, first.layout.size)
    p = np.ones(first.layout.parameters)
    np.testing.assert_array_equal(first.evaluate_rate(y, p), second.evaluate_rate(y, p))
    heavier = pinred.load("falling_cat")
    inertia = heavier.model.inertias[1]
    inertia.mass = inertia.mass + 1e-9
    heavier.model.inertias[1] = inertia
    with pytest.raises(AssertionError, match="compiled again"):
        build_kernel(heavier, structure, cache=cache)


def test_cache_key_depends_on_joint_axes(tmp_path: Path) -> None:
    """Robots that differ in the direction of an axis do not share a kernel."""
    cache = ObjectCache(tmp_path / "kernels")
    text = """<robot name="r"><link name="a"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1.5" izz="2" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <link name="b"><inertial><origin xyz="1 0 0"/><mass value="1"/>
    <inertia ixx="1" iyy="1.5" izz="2" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="{}"/></joint>
    </robot>"""
    for axis in ("0.6 0 0.8", "0.8 0 0.6"):
        path = tmp_path / "r.urdf"
        path.write_text(text.format(axis))
        build_kernel(pinred.load(path), Structure(zero_momentum=False), cache=cache)
    assert len(cache.entries()) == 2


def test_kernel_propagates_nan() -> None:
    """NaN in the state gives NaN in all dependent rates."""
    cat = pinred.load("falling_cat")
    kernel = kernel_of(plan_of(pinred.Scene(system=cat, seed=0)), zero_momentum=False)
    y, p = np.full(kernel.layout.size, 0.3), np.ones(kernel.layout.parameters)
    assert np.isfinite(kernel.evaluate_rate(y, p)).all()
    y[0] = np.nan
    assert np.isnan(kernel.evaluate_rate(y, p)).all()


def test_diverging_motion_raises_with_robot_and_time() -> None:
    """A diverging joint ends with an error that states robot and time."""
    system = pinred.load("coupled_planar")
    with pytest.raises(pinred.IntegrationError, match=r"coupled_planar.*t = ") as caught:
        pinred.simulate(system, x0=[1.0], duration=100.0, springs={"hinge": (-1e6, 0.0)})
    assert 0.0 < caught.value.time < 100.0  # type: ignore[attr-defined]


@pytest.mark.parametrize("group", GROUPS)
def test_casadi_functions_equal_reduction(group: str) -> None:
    """H, I, A, M and B, and the Jacobian of the vector field."""
    system = pinred.load(random_model(group, 3, 5))
    functions, x = pinred.casadi_functions(system), np.array([0.3, -0.8, 1.1])
    at = pinred.Reduction(system).at(x)
    for name in ("mass_matrix", "locked_inertia", "local_connection", "reduced_metric"):
        found = np.array(getattr(functions, name)(x))
        np.testing.assert_allclose(found, getattr(at, name), atol=1e-13)
    B = np.array(functions.curvature(x)).reshape(system.r, 3, 3)
    np.testing.assert_allclose(B, at.curvature, atol=1e-12)
    rng = np.random.default_rng(0)
    y, p = rng.normal(size=functions.layout.size), rng.normal(size=functions.layout.parameters)

    def rate(state: Array) -> Array:
        return np.array(functions.vector_field(state, p)).ravel()

    step, columns = 1e-3, []
    for e in np.eye(len(y)):
        weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
        parts = [w * (rate(y + k * step * e) - rate(y - k * step * e)) for k, w in weights.items()]
        columns.append(np.sum(parts, axis=0) / step)
    jacobian = np.array(functions.vector_field_jacobian(y, p))
    np.testing.assert_allclose(jacobian, np.stack(columns, axis=1), atol=1e-7)


@pytest.mark.by_hand
@pytest.mark.slow
def test_kernels_of_extreme_robots_pass_validation() -> None:
    """Sixty joints, a mass ratio of a million, a spin of 1000 rad/s."""
    chain = pinred.load(random_model("SE3", 60, 1, armature=False))
    kernel = build_kernel(chain, Structure(zero_momentum=False))
    assert isinstance(kernel.rate, NativeCode)
    cat = pinred.load("falling_cat")
    inertia = cat.model.inertias[4]
    inertia.mass, inertia.inertia = inertia.mass * 1e6, inertia.inertia * 1e6
    cat.model.inertias[4] = inertia
    build_kernel(cat, Structure(zero_momentum=False))
    top = pinred.simulate(pinred.load("rigid_body"), xi0=[1.0, 2.0, 1000.0], duration=0.1)
    assert pinred.compare(top).passed


def test_validation_is_independent_of_units() -> None:
    """A robot in mg and hm, whose momenta cancel to a thousandth, is accepted."""
    model = pinred.load("falling_cat").model.copy()
    for i in range(1, model.njoints):
        place, body = model.jointPlacements[i], model.inertias[i]
        model.jointPlacements[i] = pin.SE3(place.rotation, 1e-2 * place.translation)
        model.inertias[i] = pin.Inertia(1e6 * body.mass, 1e-2 * body.lever, 1e2 * body.inertia)
    traj = pinred.simulate(pinred.load(model), seed=0, duration=0.1)
    assert pinred.compare(traj).passed


def test_explain_lists_skipped_joints_and_sizes(capsys: pytest.CaptureFixture[str]) -> None:
    """explain=True reports skipped joints and the number of integrated entries."""
    satellite = pinred.load("reaction_wheel_satellite")
    pinred.simulate(satellite, duration=0.1, explain=True)
    text = capsys.readouterr().out
    assert "wheel_x, wheel_y, wheel_z" in text
    full = satellite.model.nq + satellite.n
    assert f"integrated: {full} → 9 numbers" in text
    assert cyclic_joints(pinred.Reduction(satellite)) == (1, 2, 3)
