"""Singular mass matrices: the structural rule against the eigenvalues of CRBA."""

from __future__ import annotations

import itertools
import re
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from odd_trees import mass_matrix, odd_model
from point_pendulum import GRAVITY, URDF, Lagrangian
from robot_texts import body, joint, link, mjcf, robot, write
from strategies import groups, seeds
from trees import random_model

import pinred
from pinred import ModelError, ModelWarning
from pinred.common.arrays import Array
from pinred.forces.signals import Spline
from pinred.reduction.canonical_form import CanonicalForm, lost_inertia
from pinred.reduction.potential import Potential
from pinred.scene.scene import Engine
from pinred.system.singular_mass_matrix import (
    SingularShapes,
    bound_massless_twists,
    moves_no_mass,
    singular_shapes,
    tree_of,
)

ZERO = 1e-11  # scaled inertia that counts as zero
POINT = np.zeros((3, 3))


class Least:
    """The least eigenvalue of the mass matrix, each coordinate scaled by its usual inertia."""

    def __init__(self, model: pin.Model) -> None:
        """Find the usual inertias at random shapes."""
        self._model, self._data, self.m = model, model.createData(), model.njoints - 2
        self._scale = np.ones(1)
        rng = np.random.default_rng(1)
        diagonals = [np.diag(self._matrix(rng.uniform(-3, 3, self.m))) for _ in range(40)]
        usual = np.max(diagonals, axis=0)
        usual[usual <= 1e-12 * usual.max()] = 1.0
        self._scale = np.sqrt(np.outer(usual, usual))

    def __call__(self, x: Array) -> float:
        """Return the least eigenvalue at shape x (m,)."""
        return float(np.linalg.eigvalsh(self._matrix(x) / self._scale)[0])

    def _matrix(self, x: Array) -> Array:
        q = pin.neutral(self._model)
        for k, value in enumerate(x):
            at = self._model.joints[k + 2]
            turned = [value] if at.nq == 1 else [np.cos(value), np.sin(value)]
            q[at.idx_q : at.idx_q + at.nq] = turned
        return mass_matrix(self._model, self._data, q)


def corners(m: int) -> list[Array]:
    """Return shapes of quarter turns, where typical drawings are singular."""
    quarters = (0.0, np.pi / 2, np.pi, -np.pi / 2)
    return [np.array(c) for c in itertools.islice(itertools.product(quarters, repeat=m), 64)]


def agrees(model: pin.Model, verdict: SingularShapes, rng: np.random.Generator) -> None:
    """Check a verdict against eigenvalues at random shapes and at quarter turns."""
    least = Least(model)
    shapes = [rng.uniform(-3, 3, least.m) for _ in range(8)]
    if verdict.everywhere:
        assert max(least(x) for x in [*shapes, *corners(least.m)]) < ZERO
        return
    assert min(least(x) for x in shapes) > ZERO
    if not verdict.isolated:
        assert min(least(x) for x in corners(least.m)) > ZERO
    for shape in verdict.isolated:
        for x in shapes:
            for name, value in shape.at.items():
                x[model.getJointId(name) - 2] = value
            assert least(x) < 1e2 * ZERO, shape


@pytest.mark.slow
@settings(max_examples=4)
@given(groups, st.integers(1, 5), seeds)
@example("SE3", 4, 114)
@example("SO3", 3, 53)
@example("SO2", 3, 56)
@example("R", 5, 140116907)
def test_verdict_matches_eigenvalues(group: str, joints: int, seed: int) -> None:
    """Refused models are singular at all shapes, named shapes are singular, others are not."""
    model = odd_model(group, joints, seed)
    agrees(model, singular_shapes(model), np.random.default_rng(seed))


@pytest.mark.slow
@given(groups, st.integers(1, 6), seeds)
def test_locking_named_joints_makes_matrix_regular(group: str, joints: int, seed: int) -> None:
    """Without the joints that move no mass at any shape, the matrix is regular at most shapes."""
    model = odd_model(group, joints, seed)
    verdict = singular_shapes(model).everywhere
    if not verdict or model.names[1] in verdict:
        return
    if len(verdict) == joints or not any(body.mass for body in model.inertias):
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        try:
            # Zero is often a special shape of drawn robots, so lock elsewhere.
            system = pinred.load(model, lock=dict.fromkeys(verdict, 0.7))
        except pinred.ModelError as error:
            # The remaining joints at the root may be one joint, which cannot have armature.
            if "armature" in str(error):
                return
            raise
    assert not set(verdict) & set(system.shape_names)


@given(groups, st.integers(1, 6), seeds)
def test_positive_inertias_are_regular_without_search(group: str, joints: int, seed: int) -> None:
    """With positive masses and moments every motion moves mass."""
    tree = tree_of(random_model(group, joints, seed))
    assert not tree.suspects
    bounds = bound_massless_twists(tree, 1e-6)
    assert not any(moves_no_mass(tree, i, N, 1e-6) for i, N in enumerate(bounds))


def pendulum(
    joints: list[tuple[pin.JointModel, float, Array]], step_between: float = 0.0
) -> pin.Model:
    """Return a free body with a chain of joints along z, each with a point mass at a lever."""
    model = pin.Model()
    at = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(at, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    for k, (kind, mass, lever) in enumerate(joints):
        step = pin.SE3(np.eye(3), np.array([0.0, 0.0, step_between if k else 0.5]))
        at = model.addJoint(at, kind, step, f"j{k}")
        model.appendBodyToJoint(at, pin.Inertia(mass, np.array(lever), POINT), pin.SE3.Identity())
    return model


RX, RY, RZ = pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ()
NONE, OUT, UP = np.zeros(3), np.array([0.3, 0.0, 0.4]), np.array([0.0, 0.0, 1.0])
HALF = np.pi / 2


def test_universal_joint_with_point_mass_names_exact_shapes() -> None:
    """It is singular where its rod is along the first axis."""
    model = pendulum([(RX, 0.0, NONE), (RY, 1.0, UP)])
    verdict = singular_shapes(model)
    assert {shape.joint for shape in verdict.isolated} == {"j0"}
    assert sorted(shape.at["j1"] for shape in verdict.isolated) == pytest.approx(
        [-HALF, HALF], abs=1e-12
    )
    # If the rod is shorter than the distance of the axes, the point never reaches the first axis.
    verdicts = [singular_shapes(pendulum([(RX, 0.0, NONE), (RY, 1.0, UP)], d)) for d in (0.5, 1.5)]
    cosines = np.cos([shape.at["j1"] for shape in verdicts[0].isolated])
    assert cosines == pytest.approx([-0.5, -0.5], abs=1e-12)
    assert verdicts[1] == SingularShapes()


def test_nearly_singular_matrix_is_reported() -> None:
    """An offset of 3e-8 of the rod is reported, 1e-12 is refused, and 1e-3 is accepted."""
    verdict = [
        singular_shapes(pendulum([(RZ, 1.0, np.array([off, 0.0, 1.0]))]))
        for off in (1e-12, 3e-8, 1e-3)
    ]
    assert verdict == [
        SingularShapes(everywhere=("j0",)),
        SingularShapes(nearly=("j0",)),
        SingularShapes(),
    ]


def test_singular_shapes_of_several_angles_are_found() -> None:
    """A point on three axes is singular where their Jacobian is; examples are named."""
    model = pendulum([(RX, 0.0, NONE), (RZ, 0.0, NONE), (RY, 1.0, OUT)], 0.3)
    tree = tree_of(model)
    assert tree.suspects
    verdict = singular_shapes(model)
    assert verdict.isolated
    agrees(model, verdict, np.random.default_rng(0))


def refusal(model: pin.Model) -> str:
    """Return the message with which a model is refused."""
    with pytest.raises(ModelError) as caught:
        pinred.load(model)
    return str(caught.value)


def test_massless_wrist_is_refused_with_lock() -> None:
    """The message names the joints to lock; with the lock, or with armature, the model loads."""
    model = pendulum([(RX, 1.0, UP), (RZ, 0.0, NONE), (RY, 0.0, NONE)])
    message = refusal(model)
    assert "'j2'" in message
    assert "no mass" in message
    assert "lock=['j2', 'j1']" in message
    assert pinred.load(model, lock=["j2", "j1"]).shape_names == ("j0",)
    model.armature = np.concatenate([np.zeros(7), [0.1, 0.1]])
    assert pinred.load(model).m == 3


def test_refusal_precedes_compilation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loading refuses the model before any expression is made."""
    import pinred.kernels.build as build

    monkeypatch.setattr(build, "ReducedGraph", None)
    assert "j0" in refusal(pendulum([(RZ, 1.0, UP)]))


def test_reduction_at_singular_shape_raises() -> None:
    """Quantities that divide by the inertia raise there, and exist at a shape close by."""
    model = pendulum([(RX, 0.0, NONE), (RY, 1.0, UP)])
    with pytest.warns(ModelWarning, match="'j0' moves no mass"):
        system = pinred.load(model, gravity=(0, 0, 0))
    red, solve = pinred.Reduction(system), CanonicalForm(system, Potential(system)).velocity
    momentum = np.ones(system.n)
    for ask in (red.split, red.at, red.christoffel, red.riemann, lambda x: solve(x, momentum)):
        with pytest.raises(pinred.SingularInertiaError, match="j0"):
            ask(np.array([0.1, HALF]))
        ask(np.array([0.1, HALF + 1e-3]))


@pytest.mark.slow
def test_run_at_singular_shape_names_joint() -> None:
    """Both engines name the joint that lost its inertia; away from the shape the robot runs."""
    model = pendulum([(RX, 0.0, NONE), (RY, 1.0, UP)])
    with pytest.warns(ModelWarning, match="'j0' moves no mass at 'j1' = -1.5708 rad or 1.5708 rad"):
        system = pinred.load(model, gravity=(0, 0, 0))
    engines: tuple[Engine, ...] = ("compiled", "pinocchio")
    for engine in engines:
        with pytest.raises((pinred.IntegrationError, pinred.SingularInertiaError)) as caught:
            pinred.simulate(system, x0=[0.1, HALF], xdot0=[0, 0], duration=0.1, engine=engine)
        assert "joint 'j0'" in str(caught.value)
    with pytest.raises(pinred.SingularInertiaError, match="j0"):
        pinred.Reduction(system).split([0.1, HALF])
    traj = pinred.simulate(system, x0=[0.1, 0.4], xdot0=[0.5, 0.2], duration=1.0)
    assert pinred.compare(traj).passed


def test_lost_inertia_is_reported_below_millionth() -> None:
    """The threshold is found by bisection, and compared with CRBA's least eigenvalue."""
    model = pendulum([(RX, 0.0, NONE), (RY, 0.2, 0.3 * UP)])
    with pytest.warns(ModelWarning, match="'j0' moves no mass"):
        system = pinred.load(model, gravity=(0, 0, 0))
    rng, least = np.random.default_rng(5), Least(model)
    usual = float(np.median([least(rng.uniform(-3, 3, 2)) for _ in range(200)]))
    silent, reported = 0.1, 1e-6
    assert lost_inertia(system, np.array([0.1, HALF + silent])) == ""
    for _ in range(30):
        middle = np.sqrt(silent * reported)
        words = lost_inertia(system, np.array([0.1, HALF + middle]))
        silent, reported = (silent, middle) if words else (middle, reported)
    assert words == "" or "'j0'" in words
    assert least(np.array([0.1, HALF + reported])) == pytest.approx(1e-6 * usual, rel=0.7)


def test_strict_refuses_isolated_singular_shapes() -> None:
    """strict=True turns the warning into an error."""
    with pytest.raises(ModelError, match="j1"):
        pinred.load(pendulum([(RX, 0.0, NONE), (RY, 1.0, UP)]), strict=True)


def test_singular_shapes_of_mjcf_are_reported(tmp_path: Path) -> None:
    """A point mass on two hinges of one body, as in a URDF file."""
    hinges = '<joint name="swing" axis="1 0 0"/><joint name="lift" axis="0 1 0"/>'
    point = '<inertial pos="0 0 1" mass="1" diaginertia="1e-15 1e-15 1e-15"/>'
    arm = f'<freejoint/><body name="arm">{hinges}{point}</body>'
    path = write(tmp_path, mjcf(body(arm)))
    with pytest.warns(pinred.ModelWarning, match="'swing' moves no mass at 'lift'"):
        pinred.load(path)
    with pytest.raises(pinred.ModelError, match=r"refused because of strict=True.*'swing'"):
        pinred.load(path, strict=True)


def pointed(tmp_path: Path) -> pinred.System:
    """Return the double spherical pendulum of point masses."""
    with pytest.warns(ModelWarning) as reported:
        system = pinred.load(write(tmp_path, URDF))
    text = str(reported[0].message)
    assert re.search(r"'azimuth' moves no mass at 'tilt1' = 0 rad or 3.14159 rad", text)
    assert re.search(r"'swing2' moves no mass at 'tilt2' = -1.5708 rad or 1.5708 rad", text)
    assert len(reported) == 1
    return system


def test_point_pendulum_matches_lagrangian(tmp_path: Path) -> None:
    """H, and the accelerations of ABA, equal those of two points on two rods."""
    system, lagrangian = pointed(tmp_path), Lagrangian()
    assert (system.group.name, system.m) == ("SO2", 3)
    red, rng = pinred.Reduction(system), np.random.default_rng(0)
    data = system.model.createData()
    for _ in range(20):
        y, v = rng.uniform(-3, 3, 4), rng.normal(size=4)
        M, acceleration, _ = lagrangian(y, v)
        assert red.mass_matrix(y[1:]) == pytest.approx(M, abs=1e-12)
        q = system.q(y[:1], y[1:])
        verdict = pin.aba(system.model, data, q, v, np.zeros(4))
        size = float(np.linalg.cond(M)) * np.abs(acceleration).max()
        assert verdict == pytest.approx(acceleration, abs=1e-13 * size)


@pytest.mark.slow
def test_point_pendulum_motion_obeys_euler_lagrange(tmp_path: Path) -> None:
    """The simulation agrees with ABA, and with the Euler–Lagrange equations of two points."""
    system, lagrangian = pointed(tmp_path), Lagrangian()
    assert system.gravity[2] == -GRAVITY
    x0, xdot0 = [0.5, 0.3, -0.2], [0.2, -0.3, 0.4]
    traj = pinred.simulate(
        system, x0=x0, xdot0=xdot0, xi0=[2.0], duration=3.0, rtol=1e-12, atol=1e-14
    )
    assert pinred.compare(traj).passed
    step = 1e-3
    for t in np.linspace(0.1, 2.9, 8):
        at = traj(np.array([t - 2 * step, t - step, t, t + step, t + 2 * step]))
        y, v = np.hstack([at.pose, at.x]), np.hstack([at.xi, at.xdot])
        _, acceleration, energy = lagrangian(y[2], v[2])
        slope = (v[0] - 8 * v[1] + 8 * v[3] - v[4]) / (12 * step)  # of order 4
        assert slope == pytest.approx(acceleration, rel=1e-6, abs=1e-6)
        assert energy == pytest.approx(traj.energy[0], abs=1e-9)


@pytest.mark.slow
def test_run_driven_into_singular_shape_names_joint() -> None:
    """A prescribed joint lays the rod on the first axis, about which the speed then diverges."""
    with pytest.warns(ModelWarning):
        system = pinred.load(pendulum([(RX, 0.0, NONE), (RY, 1.0, UP)]), gravity=(0, 0, 0))
    plan = {"j1": Spline([0.0, 1.0, 2.0], [0.0, HALF, 2.0])}
    with pytest.raises(pinred.IntegrationError, match="joint 'j0' moves no mass"):
        pinred.simulate(
            system,
            x0=[0.1, 0.0],
            xdot0=[1.0, 0.0],
            duration=2.0,
            prescribed=plan,
            rtol=1e-3,
            atol=1e-5,
        )
    assert lost_inertia(system, np.array([0.3, 1.0])) == ""
    assert "'j0'" in lost_inertia(system, np.array([0.3, HALF + 1e-4]))


def test_massless_link_is_accepted_inside_and_refused_at_end(tmp_path: Path) -> None:
    """A massless link between two joints is fine; at the end of a chain it is refused."""
    middle = robot(link("a"), link("b", 0), link("c"), joint("a", "b"), joint("b", "c"))
    assert pinred.load(write(tmp_path, middle), strict=True).m == 2
    end = robot(link("a"), link("b"), link("c", 0), joint("a", "b"), joint("b", "c"))
    with pytest.raises(
        ModelError, match=r"link 'c' \(line 1\) moved by joint 'b-c' .* has no mass.*lock=\['b-c'\]"
    ):
        pinred.load(write(tmp_path, end))
