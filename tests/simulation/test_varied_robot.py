"""Placements, locked joints and gravity as inputs: values, derivatives and rejected values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred import InputError
from pinred.forces import Damper
from pinred.reduction.tree.body_frames import bodies_of
from pinred.simulation.plan import plan_of
from pinred.simulation.simulate import explain_plan

TURNED = [0.1, 0.2, 0.3, 0.2, -0.4, 0.7]
CASES: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "any placement": ("falling_cat", {}, {"bend.placement": TURNED}),
    "beside inertias": (
        "satellite_two_arms", {}, {"left_elbow.placement": TURNED, "left_hand.mass": 3.0},
    ),
    "a slide": ("cartpole", {}, {"pole_pivot.translation": [0.1, 0.2, 0.3]}),
    "two locks": ("planar_chain5", {"joint2": 0.2, "joint4": 0.1}, {
        "joint2.lock": -0.5, "joint4.lock": 0.4,
    }),
    "locks in a row": ("satellite_two_arms", {"left_shoulder": 0.0, "left_elbow": 0.5}, {
        "left_elbow.lock": 0.4, "left_shoulder.lock": -0.2,
    }),
    "gravity": ("cartpole", {}, {"gravity": [0.5, 1.0, -2.0]}),
    "gravity in free fall": ("falling_cat", {}, {"gravity": [0.5, 1.0, -2.0]}),
    "strength of gravity": ("cartpole", {}, {"gravity.strength": 3.0}),
}  # fmt: skip
SOME = ("any placement", "two locks", "strength of gravity")  # the others by hand


def loaded(case: str) -> tuple[pinred.System, dict[str, Any]]:
    """Return the robot of a case, and the values."""
    name, lock, values = CASES[case]
    return pinred.load(name, lock=lock), values


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=pytest.mark.slow if c in SOME else pytest.mark.by_hand) for c in CASES],
)
@pytest.mark.sampled
def test_motions_agree_with_aba_and_derivatives_with_differences(case: str) -> None:
    """ABA uses the changed model."""
    system, values = loaded(case)
    traj = pinred.simulate(system, seed=1, duration=0.3, parameters=values)
    report = pinred.compare(traj)
    assert report.passed, report
    flow = pinred.flow(
        system, seed=1, duration=0.3, wrt=[*values], method="DOP853", rtol=1e-12,
        of=["x", "xdot", "pose", "xi", "energy"],
    )  # fmt: skip
    end: Any = flow(**values)
    np.testing.assert_allclose(end.x, traj.x[-1], rtol=0, atol=1e-8)
    np.testing.assert_allclose(end.pose, traj.pose[-1], rtol=0, atol=1e-8)
    jacobian = flow.jacobian(**values)
    rng, h, group = np.random.default_rng(1), 1e-4, system.group
    covector = rng.normal(size=len(next(iter(jacobian.values()))))
    for key, found in flow.vjp(covector, **values).items():
        np.testing.assert_allclose(found, covector @ jacobian[key], rtol=0, atol=1e-11)
    for key, value in values.items():
        v = rng.normal(size=np.shape(value))
        sides: list[Any] = [flow(**{**values, key: np.add(value, s * h * v)}) for s in (-1, 1)]
        low, high = sides
        found = flow.jvp({key: v}, **values)
        for row in ("x", "xdot", "xi", "energy"):
            expected = (getattr(high, row) - getattr(low, row)) / (2.0 * h)
            size = max(1.0, float(np.abs(expected).max()))
            np.testing.assert_allclose(found[flow.outputs[row]], [expected] if row == "energy"
                                       else expected, rtol=0, atol=2e-6 * size)  # fmt: skip
        poses = [side.pose for side in (low, high)]
        turned = group.log(group.compose(group.inverse(poses[0]), poses[1])) / (2.0 * h)
        np.testing.assert_allclose(found[flow.outputs["pose"]], turned, rtol=0, atol=2e-6)


def test_lock_value_agrees_with_load() -> None:
    """Another value of a locked joint gives the robot that is loaded with it."""
    system, values = loaded("locks in a row")
    varied = pinred.Scene(system=system, seed=1, parameters=values).system.model
    other = pinred.load("satellite_two_arms", lock={k[:-5]: v for k, v in values.items()}).model
    for i in range(1, other.njoints):
        np.testing.assert_allclose(
            varied.inertias[i].matrix(), other.inertias[i].matrix(), rtol=0, atol=1e-13
        )
        np.testing.assert_allclose(
            varied.jointPlacements[i].homogeneous, other.jointPlacements[i].homogeneous,
            rtol=0, atol=1e-15,
        )  # fmt: skip
    for k, frame in enumerate(other.frames):
        found = varied.frames[k]
        assert (found.name, found.parentJoint) == (frame.name, frame.parentJoint)
        np.testing.assert_allclose(
            found.placement.homogeneous, frame.placement.homogeneous, rtol=0, atol=1e-15
        )


def test_body_frames_agree_with_kinematics() -> None:
    """Placements in constant frames agree with the kinematics of Pinocchio."""
    system, rng = pinred.load("satellite_two_arms"), np.random.default_rng(0)
    own, root = system.model, bodies_of(system)
    names = list(own.names)
    for _ in range(20):
        joint = int(rng.integers(2, own.njoints))
        value = np.append(rng.normal(size=3), rng.uniform(-3.0, 3.0, 3))
        scene = pinred.Scene(system=system, seed=1, parameters={f"{names[joint]}.placement": value})
        body = bodies_of(scene.system)[joint - 1]
        place = scene.system.model.jointPlacements[joint]
        step = root[body.parent].frame.actInv(place * body.frame)
        angles = [body.beta, body.alpha, body.delta, (np.cos(body.offset), np.sin(body.offset))]
        R = np.eye(3)
        for (c, s), axis in zip(angles, "zxyz", strict=True):
            R = R @ pin.utils.rotate(axis, float(np.arctan2(s, c)))
        np.testing.assert_allclose(R, step.rotation, rtol=0, atol=1e-14)
        np.testing.assert_allclose(body.r, step.translation, rtol=0, atol=1e-14)


def test_zero_patterns_of_placements_are_folded() -> None:
    """A longer link adds one parameter; flows accept any placement."""
    chain = pinred.load("planar_chain5")
    place = chain.model.jointPlacements[4].translation
    along = {"joint3.translation": [1.3 * place[0], 0.0, 0.0]}
    scene = pinred.Scene(system=chain, seed=1, duration=0.1, parameters=along)
    assert plan_of(scene).freed().steps == ((3, "nnnnnx00"),)
    turned = {"joint3.placement": TURNED}
    scene = pinred.Scene(system=chain, seed=1, duration=0.1, parameters=turned)
    assert plan_of(scene).freed().steps == ((3, "xxxxxxxx"),)
    flow = pinred.flow(chain, seed=1, duration=0.1, wrt=["joint3.translation"])
    assert flow.propagator.kernel.structure.freed.steps == ((3, "nnnnnxxx"),)
    assert "placements of joint3, within their pattern" in flow.explain()
    free = pinred.flow(chain, seed=1, duration=0.1, wrt=["joint3.placement"])
    assert "placements of joint3, of any kind" in free.explain()


def test_names_without_values_use_those_of_the_robot() -> None:
    """Names alone, or "all", are inputs at the values of the robot, where values may vary."""
    cat = pinred.load("falling_cat")
    plain = pinred.simulate(cat, seed=1, duration=0.2)
    for parameters in (["back.mass", "sway.placement", "gravity"], "all"):
        scene = pinred.Scene(system=cat, seed=1, duration=0.2, parameters=parameters)
        np.testing.assert_array_equal(pinred.simulate(scene).x, plain.x)
        assert "inputs: inertias of the bodies on" in explain_plan(plan_of(scene))
        many = pinred.simulate_many([scene])
        np.testing.assert_allclose(many.x[0], plain.x, rtol=0, atol=1e-9)
    assert len(scene.parameters) == 4 * 3 + 3


# test_varied_scenes.py compares members with other masses, locks and gravity.
@pytest.mark.by_hand
@pytest.mark.slow
def test_members_with_robot_parameters_agree_with_simulate() -> None:
    """Placements, masses, locks and gravity differ between members in SIMD lanes."""
    cat, rng = pinred.load("falling_cat", lock={"twist": 0.1}), np.random.default_rng(0)
    masses, places = rng.uniform(0.5, 2.0, 10), rng.normal(size=(10, 6))
    members = {"spine1.mass": masses, "sway.placement": places, "xdot0": rng.normal(size=(10, 2))}
    options: dict[str, Any] = {"duration": 0.3, "times": [0.1, 0.3], "method": "DOP853"}
    many = pinred.simulate_many(cat, members=members, x0=[0.1, 0.2], momentum=0, **options)
    alone = pinred.simulate_many(
        cat, members={n: v[3:4] for n, v in members.items()}, x0=[0.1, 0.2], momentum=0, **options
    )
    np.testing.assert_array_equal(alone.q[0], many.q[3])
    for k in (0, 3, 9):
        one = pinred.simulate(many[k].scene)
        np.testing.assert_allclose(many.q[k], one.q, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(many[k].scene.parameters["sway.placement"], places[k])
    locks = pinred.simulate_many(cat, members={"twist.lock": masses}, seed=1, **options)
    scenes = [
        pinred.Scene(system=cat, seed=1, parameters={"twist.lock": m}, **options) for m in masses
    ]
    found = pinred.simulate_many(scenes)
    np.testing.assert_allclose(found.q, locks.q, rtol=0, atol=1e-13)


def test_invalid_robot_parameters_are_rejected() -> None:
    """Unknown, duplicate and non-numeric parameters are rejected by name."""
    cat = pinred.load("falling_cat")
    locked = pinred.load("falling_cat", lock={"sway": 0.3})

    def refused(match: str, system: Any = cat, **options: Any) -> None:
        with pytest.raises(InputError, match=match):
            pinred.Scene(system=system, seed=1, **options)

    refused("no joint 'bent' .* did you mean 'bend'", parameters={"bent.placement": TURNED})
    refused("that is the root", parameters={f"{cat.root_name}.placement": TURNED})
    refused("must have shape", parameters={"bend.placement": TURNED[:3]})
    refused("must be finite", parameters={"bend.placement": [np.nan] * 6})
    refused("belong to the same joint", parameters={
        "bend.placement": TURNED, "bend.translation": TURNED[:3],
    })  # fmt: skip
    refused("no locked joint 'sway'", parameters={"sway.lock": 0.1})
    refused("the value of a locked joint. Omit one", locked, parameters={
        "sway.lock": 0.1, "bend.body.mass": 1.0,
    })  # fmt: skip
    refused("is determined by sway.lock", locked, parameters={
        "sway.lock": 0.1, "twist.placement": TURNED,
    })  # fmt: skip
    refused("gravity or gravity.strength, not both", parameters={
        "gravity": [0, 0, 1], "gravity.strength": 1.0,
    })  # fmt: skip
    refused("has zero gravity", pinred.load("falling_cat", gravity=(0, 0, 0)),
            parameters={"gravity.strength": 1.0})  # fmt: skip
    refused("parameters must be {name: value}, a list of names", parameters="al")
    refused("there is no 'bck'", parameters=["bck"])
    pole = pinred.load("cartpole", gravity=(0, 0, 0))
    flow = pinred.flow(pole, seed=1, duration=0.1, parameters=["gravity"])
    with pytest.raises(InputError, match="prepared for gravity along other axes"):
        flow(gravity=[0.0, 0.0, -9.81])


def test_hostile_values_are_rejected() -> None:
    """Non-numeric or huge values, and ambiguous names, raise errors of pinred."""
    cat = pinred.load("falling_cat")
    options: dict[str, Any] = {"seed": 1, "duration": 0.1, "method": "DOP853"}
    flow = pinred.flow(cat, wrt=["back.mass", "bend.placement", "gravity"], **options)

    def refused(match: str, **values: Any) -> None:
        with pytest.raises(InputError, match=match):
            flow(**values)

    refused("'back.mass' must be above zero", **{"back.mass": -1.0})
    for value in (float("nan"), None, "heavy", [1.0, 2.0]):
        refused(r"parameters\['back.mass'\]", **{"back.mass": value})
    refused("products overflow", **{"bend.placement": [1e200] * 6})
    refused(r"parameters\['gravity'\] must have shape", gravity=[0.0, 0.0])
    refused("no input 'foo'", foo=1.0)
    pinred.flow(cat, wrt=[], **options).vjp(np.ones(18))  # of nothing: nothing
    with pytest.raises(InputError, match="wrt must be a list of names"):
        pinred.flow(cat, wrt=None, **options)  # type: ignore[arg-type]
    for name, what in (
        ("back.mass", "is a robot parameter and also the name"),
        ("x0", "of another input"),
    ):
        twin = pinred.Parameter(name, 1.0)
        with pytest.raises(InputError, match=what):
            pinred.flow(cat, wrt=[name], forces=[Damper("bend", twin)], **options)
    turned = pinred.flow(cat, wrt=["bend.placement"], **options)
    with pytest.raises(InputError, match="by a right angle from the robot's placement"):
        turned.jacobian(**{"bend.placement": [0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2 - 5e-7]})
    with pytest.raises(InputError, match=r"member 1: parameters: 'back.mass' must be above zero"):
        pinred.simulate_many(cat, members={"back.mass": [1.0, -1.0]}, invalid="raise", **options)
    x0 = np.zeros((2, 3))
    same = pinred.simulate_many(cat, members={"x0": x0}, parameters="all", momentum=0, duration=0.1)
    assert same.x.shape[:2] == (2, 201)


def test_variable_centre_of_pivot_keeps_gravity() -> None:
    """The kernel includes gravity that acts only at other values."""
    body = pinred.load("rigid_body", gravity=(0, 0, -9.8))
    name, com = f"{body.root_name}.com", [0.1, 0.0, 0.2]
    traj = pinred.simulate(body, seed=1, duration=0.2, parameters={name: com})
    assert pinred.compare(traj).passed
    end: Any = pinred.flow(body, seed=1, duration=0.2, wrt=[name])(**{name: com})
    np.testing.assert_allclose(end.xi, traj.xi[-1], rtol=0, atol=1e-9)
    still = pinred.simulate(body, seed=1, duration=0.2)
    assert np.abs(still.xi[-1] - traj.xi[-1]).max() > 0.1


def test_different_nominal_placements_have_separate_kernels(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The frames of bodies follow from the placement at loading."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))
    cat = pinred.load("falling_cat")
    model = cat.model.copy()
    turn = pin.SE3(pin.rpy.rpyToMatrix(0.7, -0.4, 0.3), np.array([0.1, 0.0, 0.2]))
    model.jointPlacements[3] = turn * model.jointPlacements[3]
    values = {"sway.placement": TURNED}
    ends = [
        pinred.simulate(
            pinred.load(one), x0=[0.1, 0.2, 0.3], xdot0=[1.0, 0.0, -1.0], xi0=np.zeros(6),
            duration=0.2, parameters=values,
        ).v[-1]
        for one in (cat.model, model)
    ]  # fmt: skip
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-9)
