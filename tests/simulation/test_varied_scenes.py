"""Robot parameters together with forces that depend on them: on links, or computed torque."""

from __future__ import annotations

from typing import Any

import aba
import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import couple
from forced_trees import GRAVITY
from trees import inertia, placement, random_model

import pinred
from pinred.forces import PD, ComputedTorque, Damper, Spring, Wrench
from pinred.lie import GROUPS
from pinred.signals import Fourier
from pinred.system.robot_file_contents import Contents

TURNED = [0.1, 0.2, 0.3, 0.2, -0.4, 0.7]
JOINTS = 3


def with_links(group: str, seed: int) -> pin.Model:
    """Return a random tree with a link on each body, in gravity where its group allows it."""
    rng, model = np.random.default_rng(seed), random_model(group, JOINTS, seed)
    model.gravity.linear = np.array(GRAVITY.get(group, (0.0, 0.0, 0.0)))
    for i in range(1, model.njoints):
        link = pin.Frame(f"link{i - 1}", i, 0, placement(rng), pin.FrameType.BODY)
        model.addFrame(link, False)
    return model


def forces_on(system: pinred.System, rng: np.random.Generator) -> list[Any]:
    """Return wrenches on links in all frames, with computed torque where possible."""
    a, b, *rest = system.shape_names

    def gust(t: Any, x: Any, _xdot: Any, _mu: Any) -> Any:
        return [0.5 * ca.sin(3 * t), x[0], 0.3, 0.1, -0.2, 0.1 * x[1]]

    links = [f"link{k}" for k in rng.permutation(JOINTS + 1)[:2]]
    at = rng.normal(size=3).tolist()
    forces = [
        Wrench(gust, link=links[0], at=at, frame="world", name="gust"),
        Wrench([0.2, -0.3, 0.4], link=links[1], at=at[::-1], name="push"),
        Spring(a, 2.0, 0.1),
        Damper(b, 0.3),
    ]
    if system.group.name == "SO3" and system.gravity.any():
        return [*forces, PD({b: 0.2}, kp=3.0, kd=1.0)]
    wanted: dict[str, Any] = {a: Fourier(0.1, [0.2], [], 1.5), b: 0.2, **dict.fromkeys(rest, -0.1)}
    return [*forces, ComputedTorque(wanted, kp=4.0, kd=2.0)]


def varied(model: pin.Model, rng: np.random.Generator) -> tuple[dict[str, Any], pin.Model]:
    """Return values of some robot parameters, and a model with these values."""
    other, values = model.copy(), dict[str, Any]()
    turned, moved = rng.permutation(np.arange(2, model.njoints))[:2].tolist()
    rpy, p, shift = rng.uniform(-1.0, 1.0, 3), rng.normal(size=3), rng.normal(size=3)
    values[f"{model.names[turned]}.placement"] = [*p, *rpy]
    other.jointPlacements[turned] = pin.SE3(pin.rpy.rpyToMatrix(*rpy), p)
    values[f"{model.names[moved]}.translation"] = shift
    other.jointPlacements[moved] = pin.SE3(model.jointPlacements[moved].rotation, shift)
    heavy, whole = rng.permutation(np.arange(1, model.njoints))[:2].tolist()
    Y, new = model.inertias[heavy], inertia(rng)
    values[f"link{heavy - 1}.mass"] = mass = rng.uniform(0.5, 2.0)
    other.inertias[heavy] = pin.Inertia(mass, Y.lever, Y.inertia)
    I = new.inertia
    values[f"link{whole - 1}.mass"], values[f"link{whole - 1}.com"] = new.mass, new.lever
    values[f"link{whole - 1}.inertia"] = [I[0, 0], I[0, 1], I[0, 2], I[1, 1], I[1, 2], I[2, 2]]
    other.inertias[whole] = new
    if np.any(model.gravity.linear):
        values["gravity"] = 0.7 * model.gravity.linear
        other.gravity.linear = values["gravity"]
    return values, other


@pytest.mark.parametrize(
    ("group", "seed"),
    [
        pytest.param("SE2", 1, marks=pytest.mark.slow),
        *(pytest.param(g, s, marks=pytest.mark.by_hand) for g in GROUPS for s in range(2, 5)),
    ],
)
def test_scene_parameters_agree_with_changed_robot(group: str, seed: int) -> None:
    """simulate, flows and members agree, and ABA of the changed robot passes."""
    model, rng = with_links(group, seed), np.random.default_rng(seed)
    values, other = varied(model, rng)
    ties = Contents(couplings=couple(model, rng, 1) if seed % 2 == 0 else ())
    system, written = (pinred.System(each, model.name, contents=ties) for each in (model, other))
    options: dict[str, Any] = {
        "x0": rng.uniform(-1.0, 1.0, system.m), "xdot0": rng.normal(size=system.m),
        "xi0": 0.3 * rng.normal(size=system.r), "times": [0.0, 0.1, 0.3], "method": "DOP853",
        "forces": forces_on(system, rng),
    }  # fmt: skip
    expected = pinred.simulate(written, **options)
    found = pinred.simulate(system, parameters=values, **options)
    report = pinred.compare(found)  # whose model Pinocchio has, and judges by ABA
    assert report.passed, report
    flow: Any = pinred.flow(system, wrt=[*values], **options)(**values)
    members = {name: np.array([value, np.multiply(value, 0.9)]) for name, value in values.items()}
    many = pinred.simulate_many(system, members=members, **options)
    for state in (found.q, many[0].q):
        assert aba.max_difference(other, state, expected.q) < 1e-8
    second = pinred.simulate(many[1].scene)
    assert aba.max_difference(other, many.q[1], second.q) < 1e-8
    assert aba.max_difference(other, second.q, expected.q) > 1e-4
    np.testing.assert_allclose(flow.x, expected.x, rtol=0, atol=1e-8)
    np.testing.assert_allclose(flow.xi, expected.xi, rtol=0, atol=1e-8)


BEHIND = Wrench(lambda t, *_: [0.1, 0.2 * ca.cos(t), 0.3], link="spine2", at=[0.1, 0.0, 0.2])
BACK = Wrench([0.1, 0.2, 0.3], link="back", at=[0.0, 0.1, 0.0], frame="world", name="on the back")
HELD = ComputedTorque({"bend": 0.1, "twist": Fourier(0.0, [0.2], [], 2.0)}, 9.0, 6.0)
NUMBERS: dict[str, Any] = {"back.mass": 2.0, "bend.placement": TURNED, "sway.lock": 0.7}


@pytest.mark.by_hand
@pytest.mark.parametrize("method", [
    pytest.param("DOP853", marks=pytest.mark.slow),
    pytest.param("AdaptiveGauss", marks=pytest.mark.by_hand),
    pytest.param("Gauss(0.02)", marks=pytest.mark.by_hand),
])  # fmt: skip
def test_derivatives_agree_with_differences(method: str) -> None:
    """A step agrees with Richardson's differences, and the adjoint with the tangent."""
    flow = pinred.flow(
        pinred.load("falling_cat", lock={"sway": 0.3}), seed=1, duration=0.1, wrt=[*NUMBERS],
        method=method, forces=[BEHIND, BACK, HELD],
    )  # fmt: skip
    rng, step = np.random.default_rng(0), flow.step(0.02)
    start = flow.scene.start
    slopes, first = step.linear(start, **NUMBERS).by_parameters[6:], 0
    for name, value in NUMBERS.items():
        v = rng.normal(size=np.shape(value))
        found = slopes[:, first : first + v.size] @ v.ravel()
        first += v.size
        errors = []
        for h in (3e-2, 1e-2, 3e-3, 1e-3, 3e-4):
            low, less, more, most = (
                _column(step(start, **{**NUMBERS, name: np.add(value, s * h * v)}))
                for s in (-2, -1, 1, 2)
            )
            expected = (8.0 * (more - less) - (most - low)) / (12.0 * h)
            errors.append(np.abs(found - expected).max() / np.abs(found).max())
        assert min(errors) < 1e-8, (name, errors)
    jacobian = flow.jacobian(**NUMBERS)
    covector = rng.normal(size=len(jacobian["back.mass"]))
    for name, back in flow.vjp(covector, **NUMBERS).items():
        size = float(np.linalg.norm(covector) * np.linalg.norm(jacobian[name]))
        np.testing.assert_allclose(back, covector @ jacobian[name], rtol=0, atol=1e-12 * size)


def _column(state: Any) -> Any:
    """Return the entries of a state after its pose."""
    return np.concatenate([state.x, state.xdot, state.xi])


@pytest.mark.slow
def test_computed_torque_on_unbalanced_pivot_is_rejected() -> None:
    """It is rejected only if a variable parameter lets gravity turn the base."""
    swung = pinred.load("satellite_two_arms", group="SO3", gravity=(0, 0, -9.81))
    still = pinred.load("satellite_two_arms", group="SO3", gravity=(0, 0, 0))
    options: dict[str, Any] = {
        "seed": 1, "duration": 0.1, "forces": [ComputedTorque(dict.fromkeys(still.shape_names, 0.1),
                                                              4.0, 2.0)],
    }  # fmt: skip
    weight: dict[str, Any] = {"gravity": [0.0, 0.0, -1.0]}
    with pytest.raises(pinred.SymmetryError, match="gravity rotates the base"):
        pinred.simulate(still, parameters=weight, **options)
    with pytest.raises(pinred.SymmetryError, match="gravity rotates the base"):
        pinred.flow(swung, wrt=["gravity"], **options)
    with pytest.raises(pinred.SymmetryError, match="gravity rotates the base"):
        pinred.simulate_many(still, members={"gravity": [[0.0, 0.0, -1.0]] * 2}, **options)
    free = pinred.simulate(swung, parameters={"gravity": [0.0, 0.0, 0.0]}, **options)
    expected = pinred.simulate(still, **options)
    np.testing.assert_allclose(free.q, expected.q, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_wrench_on_link_follows_lock_value() -> None:
    """The lock value changes the place at which the wrench acts."""
    options: dict[str, Any] = {
        "seed": 1, "times": [0.1, 0.3], "method": "DOP853", "forces": [BEHIND, BACK, HELD]
    }  # fmt: skip
    system = pinred.load("falling_cat", lock={"sway": 0.3})
    locks = [0.7, -0.4]
    many = pinred.simulate_many(system, members={"sway.lock": locks}, **options)
    flow = pinred.flow(system, wrt=["sway.lock"], **options)
    for k, value in enumerate(locks):
        expected = pinred.simulate(pinred.load("falling_cat", lock={"sway": value}), **options)
        found = pinred.simulate(system, parameters={"sway.lock": value}, **options)
        end: Any = flow(**{"sway.lock": value})
        for q in (found.q, many.q[k], end.q):
            np.testing.assert_allclose(q, expected.q, rtol=0, atol=1e-9)
    assert np.abs(many.q[0] - many.q[1]).max() > 1e-3


def test_explain_lists_links_with_forces() -> None:
    """explain= lists links with forces whose placement parameters may change."""
    satellite = pinred.load("satellite_two_arms")
    pull = Wrench([0.0, 0.0, 0.1], link="left_hand")
    locked = pinred.load("satellite_two_arms", lock={"left_wrist": 0.2})
    said = pinred.flow(locked, seed=0, duration=0.1, forces=[pull], wrt=["left_wrist.lock"])
    assert (
        "inputs: placements of left_hand on their bodies, because forces act there"
        in said.explain()
    )
    fixed = pinred.flow(satellite, seed=0, duration=0.1, forces=[pull], wrt=["x0"])
    assert "placements of" not in fixed.explain()
