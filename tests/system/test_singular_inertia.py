"""Which mass matrices are singular: the structural rule against the eigenvalues of CRBA."""

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
from robot_texts import joint, link, robot, write
from strategies import groups, seeds
from trees import random_model

import pinred
from pinred import ModelError, ModelWarning
from pinred.common.arrays import Array
from pinred.forces.signals import Spline
from pinred.reduction.canonical_form import CanonicalForm
from pinred.reduction.inertia_split import lost_inertia
from pinred.reduction.potential import Potential
from pinred.scene.scene import Engine
from pinred.system.massless_motions import bound_massless_twists, moves_no_mass, tree_of
from pinred.system.singular_mass_matrix import SingularShapes, singular_shapes

ZERO = 1e-11  # of the usual inertia
POINT = np.zeros((3, 3))


class Least:
    """The least eigenvalue of the mass matrix, each coordinate scaled by its usual inertia."""

    def __init__(self, model: pin.Model) -> None:
        """Find the usual inertias, at random shapes."""
        self._model, self._data, self.m = model, model.createData(), model.njoints - 2
        self._scale = np.ones(1)
        rng = np.random.default_rng(1)
        diagonals = [np.diag(self._matrix(rng.uniform(-3, 3, self.m))) for _ in range(40)]
        usual = np.max(diagonals, axis=0)
        usual[usual <= 1e-12 * usual.max()] = 1.0
        self._scale = np.sqrt(np.outer(usual, usual))

    def __call__(self, x: Array) -> float:
        """Return it at shape x (m,)."""
        return float(np.linalg.eigvalsh(self._matrix(x) / self._scale)[0])

    def _matrix(self, x: Array) -> Array:
        q = pin.neutral(self._model)
        for k, value in enumerate(x):
            at = self._model.joints[k + 2]
            turned = [value] if at.nq == 1 else [np.cos(value), np.sin(value)]
            q[at.idx_q : at.idx_q + at.nq] = turned
        return mass_matrix(self._model, self._data, q)


def corners(m: int) -> list[Array]:
    """Shapes of quarter turns, where what people draw is singular."""
    quarters = (0.0, np.pi / 2, np.pi, -np.pi / 2)
    return [np.array(c) for c in itertools.islice(itertools.product(quarters, repeat=m), 64)]


def agrees(model: pin.Model, found: SingularShapes, rng: np.random.Generator) -> None:
    """Check what was found against eigenvalues at random shapes and at quarter turns."""
    least = Least(model)
    shapes = [rng.uniform(-3, 3, least.m) for _ in range(8)]
    if found.everywhere:
        assert max(least(x) for x in [*shapes, *corners(least.m)]) < ZERO
        return
    assert min(least(x) for x in shapes) > ZERO
    if not found.isolated:
        assert min(least(x) for x in corners(least.m)) > ZERO
    for shape in found.isolated:
        for x in shapes:
            for name, value in shape.at.items():
                x[model.getJointId(name) - 2] = value
            assert least(x) < 1e2 * ZERO, shape


@pytest.mark.slow
@settings(max_examples=60)
@given(groups, st.integers(1, 5), seeds)
@example("SE3", 4, 114)
@example("SO3", 3, 53)
@example("SO2", 3, 56)
@example("R", 5, 140116907)
def test_the_rule_against_eigenvalues(group: str, joints: int, seed: int) -> None:
    """Refused: singular at all shapes tried.  Named: singular there.  Accepted: nowhere."""
    model = odd_model(group, joints, seed)
    agrees(model, singular_shapes(model), np.random.default_rng(seed))


@pytest.mark.slow
@given(groups, st.integers(1, 6), seeds)
def test_locking_what_is_named_is_the_way_out(group: str, joints: int, seed: int) -> None:
    """Without the joints that move no mass at any shape, the others do at most shapes."""
    model = odd_model(group, joints, seed)
    found = singular_shapes(model).everywhere
    if not found or model.names[1] in found:
        return
    if len(found) == joints or not any(body.mass for body in model.inertias):
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        try:
            # Not at zero, which for what people draw is a shape of its own.
            system = pinred.load(model, lock=dict.fromkeys(found, 0.7))
        except pinred.ModelError as error:
            # Joints at the root may be one then, whose armature is another thing to refuse.
            if "armature" in str(error):
                return
            raise
    assert not set(found) & set(system.shape_names)


@given(groups, st.integers(1, 6), seeds)
def test_positive_bodies_need_no_search(group: str, joints: int, seed: int) -> None:
    """With positive masses and moments no motion moves no mass, and nothing is computed."""
    tree = tree_of(random_model(group, joints, seed))
    assert not tree.suspects
    bounds = bound_massless_twists(tree, 1e-6)
    assert not any(moves_no_mass(tree, i, N, 1e-6) for i, N in enumerate(bounds))


def pendulum(
    joints: list[tuple[pin.JointModel, float, Array]], step_between: float = 0.0
) -> pin.Model:
    """A free body, and on it a chain of joints along z, each with a point mass at a lever."""
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


def test_named_shapes_are_exact() -> None:
    """A universal joint with a point mass: singular where its rod lies along the first axis."""
    model = pendulum([(RX, 0.0, NONE), (RY, 1.0, UP)])
    found = singular_shapes(model)
    assert {shape.joint for shape in found.isolated} == {"j0"}
    assert sorted(shape.at["j1"] for shape in found.isolated) == pytest.approx(
        [-HALF, HALF], abs=1e-12
    )
    # With the second axis further from the first than the rod is long, the point never gets there.
    apart = [singular_shapes(pendulum([(RX, 0.0, NONE), (RY, 1.0, UP)], d)) for d in (0.5, 1.5)]
    cosines = np.cos([shape.at["j1"] for shape in apart[0].isolated])
    assert cosines == pytest.approx([-0.5, -0.5], abs=1e-12)
    assert apart[1] == SingularShapes()


def test_decimals_of_a_file() -> None:
    """A point mass off the axis by 3e-8 of its rod is told, by 1e-12 refused, by 1e-3 accepted."""
    found = [
        singular_shapes(pendulum([(RZ, 1.0, np.array([off, 0.0, 1.0]))]))
        for off in (1e-12, 3e-8, 1e-3)
    ]
    assert found == [
        SingularShapes(everywhere=("j0",)),
        SingularShapes(nearly=("j0",)),
        SingularShapes(),
    ]


def test_several_angles_decide() -> None:
    """A point on three axes: singular wherever their Jacobian is, examples of which are found."""
    model = pendulum([(RX, 0.0, NONE), (RZ, 0.0, NONE), (RY, 1.0, OUT)], 0.3)
    tree = tree_of(model)
    assert tree.suspects
    found = singular_shapes(model)
    assert found.isolated
    agrees(model, found, np.random.default_rng(0))


def refusal(model: pin.Model) -> str:
    """The message with which a model is refused."""
    with pytest.raises(ModelError) as caught:
        pinred.load(model)
    return str(caught.value)


def test_a_wrist_without_mass_is_refused_with_the_way_out() -> None:
    """Joints that move no mass are named with what to lock; locking it loads."""
    model = pendulum([(RX, 1.0, UP), (RZ, 0.0, NONE), (RY, 0.0, NONE)])
    message = refusal(model)
    assert "'j2'" in message
    assert "no mass" in message
    assert "lock=['j2', 'j1']" in message
    assert pinred.load(model, lock=["j2", "j1"]).shape_names == ("j0",)
    model.armature = np.concatenate([np.zeros(7), [0.1, 0.1]])
    assert pinred.load(model).m == 3


def test_nothing_is_compiled_for_what_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal comes from loading, before any expression is made."""
    import pinred.kernels.build as build

    monkeypatch.setattr(build, "ReducedGraph", None)
    assert "j0" in refusal(pendulum([(RZ, 1.0, UP)]))


def test_a_singular_shape_has_no_metric() -> None:
    """Nothing that divides by it is given there; a hair beside it, all of it is."""
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
def test_a_run_that_reaches_a_singular_shape_names_the_joint() -> None:
    """Both engines end with the joint that has lost its inertia; elsewhere the robot runs."""
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


def test_words_begin_at_a_millionth_of_the_usual() -> None:
    """Half way down to where the rod lies on the first axis, by CRBA's least eigenvalue."""
    model = pendulum([(RX, 0.0, NONE), (RY, 0.2, 0.3 * UP)])
    with pytest.warns(ModelWarning, match="'j0' moves no mass"):
        system = pinred.load(model, gravity=(0, 0, 0))
    rng, least = np.random.default_rng(5), Least(model)
    usual = float(np.median([least(rng.uniform(-3, 3, 2)) for _ in range(200)]))
    silent, told = 0.1, 1e-6
    assert lost_inertia(system, np.array([0.1, HALF + silent])) == ""
    for _ in range(30):
        middle = np.sqrt(silent * told)
        words = lost_inertia(system, np.array([0.1, HALF + middle]))
        silent, told = (silent, middle) if words else (middle, told)
    assert words == "" or "'j0'" in words
    assert least(np.array([0.1, HALF + told])) == pytest.approx(1e-6 * usual, rel=0.7)


def test_strictly_a_warning_is_a_refusal() -> None:
    """strict=True refuses singular single shapes."""
    with pytest.raises(ModelError, match="j1"):
        pinred.load(pendulum([(RX, 0.0, NONE), (RY, 1.0, UP)]), strict=True)


def pointed(tmp_path: Path) -> pinred.System:
    """The double spherical pendulum of point masses."""
    with pytest.warns(ModelWarning) as told:
        system = pinred.load(write(tmp_path, URDF))
    text = str(told[0].message)
    assert re.search(r"'azimuth' moves no mass at 'tilt1' = 0 rad or 3.14159 rad", text)
    assert re.search(r"'swing2' moves no mass at 'tilt2' = -1.5708 rad or 1.5708 rad", text)
    assert len(told) == 1
    return system


def test_point_pendulum_has_the_mass_matrix_of_its_lagrangian(tmp_path: Path) -> None:
    """H, and the accelerations of full ABA, are those of two points on two rods."""
    system, lagrangian = pointed(tmp_path), Lagrangian()
    assert (system.group.name, system.m) == ("SO2", 3)
    red, rng = pinred.Reduction(system), np.random.default_rng(0)
    data = system.model.createData()
    for _ in range(20):
        y, v = rng.uniform(-3, 3, 4), rng.normal(size=4)
        M, acceleration, _ = lagrangian(y, v)
        assert red.mass_matrix(y[1:]) == pytest.approx(M, abs=1e-12)
        q = system.model_q(y[:1], y[1:])
        found = pin.aba(system.model, data, q, v, np.zeros(4))
        size = float(np.linalg.cond(M)) * np.abs(acceleration).max()
        assert found == pytest.approx(acceleration, abs=1e-13 * size)


@pytest.mark.slow
def test_point_pendulum_moves_as_its_lagrangian_says(tmp_path: Path) -> None:
    """Simulated and judged by ABA; its states obey the Euler–Lagrange equations of two points."""
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
def test_a_run_driven_into_a_singular_shape_names_the_joint() -> None:
    """A plan that lays the rod on the first axis lets its momentum turn ever faster; it ends."""
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
            rtol=1e-6,
            atol=1e-8,
        )
    assert lost_inertia(system, np.array([0.3, 1.0])) == ""
    assert "'j0'" in lost_inertia(system, np.array([0.3, HALF + 1e-4]))


def test_links_without_mass_in_a_file(tmp_path: Path) -> None:
    """A link without inertia between two joints is fine; at the end it is refused by name."""
    middle = robot(link("a"), link("b", 0), link("c"), joint("a", "b"), joint("b", "c"))
    assert pinred.load(write(tmp_path, middle), strict=True).m == 2
    end = robot(link("a"), link("b"), link("c", 0), joint("a", "b"), joint("b", "c"))
    with pytest.raises(
        ModelError, match=r"link 'c' moved by joint 'b-c' has no mass.*lock=\['b-c'\]"
    ):
        pinred.load(write(tmp_path, end))
