"""Loading: names, files and models become systems with the right root, inertia and coordinates."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robot_texts import FLOATING, HINGE, MASS, body, joint, link, mjcf, robot, write
from strategies import Case, cases, groups, make_case, seeds
from trees import inertia, random_model

import pinred
from pinred.common.arrays import Array
from pinred.lie import GROUPS
from pinred.system.find_robot_files import bundled_robots, has_example_robots
from pinred.system.joints import root_joint
from pinred.system.loops.kinematics import loop_jacobian, loop_values

needs_robots = pytest.mark.skipif(
    not has_example_robots(), reason="example-robot-data is not installed"
)
EARTH = [0.0, 0.0, -9.81]
ARM = f'<body name="arm" pos="0 0.2 0.3">{HINGE}{MASS}</body>'


def mass_matrix(model: pin.Model, q: Array) -> Array:
    """Return Pinocchio's complete mass matrix."""
    H = np.triu(pin.crba(model, model.createData(), q))
    return np.asarray(H + np.triu(H, 1).T)


def some_q(model: pin.Model) -> Array:
    """Return a configuration without zero or equal entries."""
    return np.asarray(pin.integrate(model, pin.neutral(model), np.linspace(-1.0, 0.9, model.nv)))


BRANCHED = robot(
    *(link(name) for name in "abcd"),
    joint("a", "b", "prismatic", '<axis xyz="0 3 4"/>'),
    joint("b", "c", "continuous"),
    joint("a", "d", content='<axis xyz="1 1 0"/>'),
)
ANCHORED = robot(link("w", 0), link("a"), link("b"), joint("w", "a"), joint("a", "b"))


def test_bundled_robot_matches_catalogue() -> None:
    """Every bundled robot has the group, gravity and initial state of its catalogue entry."""
    for name, entry in bundled_robots().items():
        system = pinred.load(name)
        raw = pin.buildModelFromUrdf(str(entry.path))
        assert (system.name, system.group.name) == (name, entry.group)
        assert system.mass == pytest.approx(sum(Y.mass for Y in raw.inertias))
        assert system.gravity == pytest.approx(entry.gravity)
        assert system.initial is not None
        assert system.initial.x.shape == (system.nx,)
        assert system.initial.xdot.shape == (system.m,)
        assert bool(system.space.balls) == entry.balls
        assert system.loops == entry.loops
        if system.loops:
            np.testing.assert_allclose(loop_values(system, system.initial.x), 0.0, atol=1e-12)
            J = loop_jacobian(system, system.initial.x)
            np.testing.assert_allclose(J @ system.initial.xdot, 0.0, atol=1e-12)
        assert system.initial.xi.shape == (system.r,)


def test_initial_state_is_dropped_for_other_group_or_lock() -> None:
    """With a locked joint or another group, the initial state would not fit."""
    assert pinred.load("elroys_beanie", lock=["beanie"]).initial is None
    assert pinred.load("satellite_two_arms", group="SO3").initial is None


@pytest.mark.parametrize("as_type", [str, Path])
def test_path_and_group_in_all_forms(tmp_path: Path, as_type: type) -> None:
    """A path is text or Path and gives the name; a group is its name or a Group."""
    system = pinred.load(as_type(write(tmp_path, FLOATING)), group=GROUPS["SE2"])
    assert system.group is GROUPS["SE2"]
    assert (system.name, system.shape_names, system.mass) == ("arm", ("a-b",), 4.0)
    assert system.gravity.tolist() == EARTH


def anchored(kind: str) -> str:
    """Return one body on a joint of the world."""
    return robot(link("w", 0), link("a"), joint("w", "a", kind))


# Text and requested group: expected group, root joint, shape joints and moving mass.
ROOTS = {
    "massive root floats": (FLOATING, None, "SE3", "root_joint", ["a-b"], 4),
    "massive root in the plane": (FLOATING, "SE2", "SE2", "root_joint", ["a-b"], 4),
    "massive root on a pivot": (FLOATING, "SO3", "SO3", "root_joint", ["a-b"], 4),
    "anchor": (ANCHORED, None, "SO2", "w-a", ["a-b"], 4),
    "anchor, group said": (ANCHORED, "SO2", "SO2", "w-a", ["a-b"], 4),
    "anchor, sliding": (anchored("prismatic"), None, "R", "w-a", [], 2),
    "anchor, planar": (anchored("planar"), None, "SE2", "w-a", [], 2),
    "anchor, floating": (anchored("floating"), None, "SE3", "w-a", [], 2),
    "fixed on world": (
        ANCHORED.replace("revolute", "fixed", 1), None, "SE3", "root_joint", ["a-b"], 4,
    ),
    "name taken by a link": (
        FLOATING.replace('"a"', '"root_joint"'), None, "SE3", "root_joint_", ["a-b"], 4,
    ),
    "name taken by a joint": (
        FLOATING.replace("a-b", "root_joint"), None, "SE3", "root_joint_", ["root_joint"], 4,
    ),
    "joint and link of one name": (
        FLOATING.replace("a-b", "b"), None, "SE3", "root_joint", ["b"], 4,
    ),
    "MJCF free": (mjcf(body("<freejoint/>" + ARM)), None, "SE3", "base_free", ["hinge"], 4),
    "MJCF welded": (mjcf(body(ARM)), None, "SE3", "root_joint", ["hinge"], 4),
    "MJCF ball": (mjcf(body('<joint name="j" type="ball"/>')), None, "SO3", "j", [], 2),
    "MJCF hinge": (mjcf(body('<joint name="j"/>' + ARM)), None, "SO2", "j", ["hinge"], 4),
}  # fmt: skip


@pytest.mark.parametrize("row", ROOTS.values(), ids=ROOTS.keys())
def test_root_follows_file_or_group(
    tmp_path: Path, row: tuple[str, str | None, str, str, list[str], float]
) -> None:
    """The root is the free joint or anchor in the file, or a new joint of the group."""
    text, asked, group, root, shape, mass = row
    system = pinred.load(write(tmp_path, text), group=asked)
    assert (system.group.name, system.root_name) == (group, root)
    assert list(system.shape_names) == shape
    assert system.mass == pytest.approx(mass)


@pytest.mark.parametrize("group", sorted(GROUPS))
def test_added_root_keeps_dynamics(tmp_path: Path, group: str) -> None:
    """Inertia, armature, gravity, frames and limits equal those of Pinocchio's floating model."""
    path = write(tmp_path, BRANCHED)
    raw = pin.buildModelFromUrdf(str(path))
    raw.armature = np.array([0.1, 0.2, 0.3])
    raw.gravity.linear = np.array([1.0, 2.0, 3.0])
    system = pinred.load(raw, group=group)
    other = pin.buildModelFromUrdf(str(path), root_joint(GROUPS[group]))
    other.armature = np.concatenate([np.zeros(system.r), raw.armature])
    other.gravity = raw.gravity
    q = some_q(other)
    assert list(system.model.names) == list(other.names)
    assert mass_matrix(system.model, q) == pytest.approx(mass_matrix(other, q), abs=1e-14)
    models = system.model, other
    torque = [pin.computeGeneralizedGravity(m, m.createData(), q) for m in models]
    assert torque[0] == pytest.approx(torque[1], abs=1e-12)
    assert system.model.upperPositionLimit[-raw.nq :].tolist() == raw.upperPositionLimit.tolist()
    data = [m.createData() for m in models]
    for m, d in zip(models, data, strict=True):
        pin.framesForwardKinematics(m, d, q)
    for name in ("a", "b", "c", "d", "a-d"):
        place = [d.oMf[m.getFrameId(name)] for m, d in zip(models, data, strict=True)]
        assert place[0].isApprox(place[1], 1e-12)


def test_welded_mjcf_base_floats_as_with_free_joint(tmp_path: Path) -> None:
    """The mass matrix equals Pinocchio's with a free joint, armature included."""
    path = write(tmp_path, mjcf(body("<freejoint/>" + ARM)))
    free = pin.buildModelFromMJCF(str(path))
    path = write(tmp_path, mjcf(body(ARM), '<option gravity="0 0 -1.6"/>'))
    welded = pinred.load(path)
    assert welded.model.armature.tolist() == [0, 0, 0, 0, 0, 0, 0.3]
    assert welded.gravity.tolist() == [0.0, 0.0, -1.6]
    q = some_q(free)
    assert mass_matrix(welded.model, q) == pytest.approx(mass_matrix(free, q), abs=1e-14)


def test_gravity_argument_overrides_robot(tmp_path: Path) -> None:
    """The argument replaces the robot's gravity."""
    path = write(tmp_path, FLOATING)
    assert pinred.load(path, gravity=[1, 0, -2]).gravity.tolist() == [1.0, 0.0, -2.0]
    assert pinred.load("falling_cat", gravity=EARTH).gravity.tolist() == EARTH


def test_fixed_links_merge_into_carrier(tmp_path: Path) -> None:
    """Links on fixed joints add their inertia to the link that carries them."""
    parts = link("a"), link("b"), link("c", 3.0), joint("a", "b"), joint("b", "c", "fixed")
    system = pinred.load(write(tmp_path, robot(*parts)))
    assert (system.shape_names, system.mass) == (("a-b",), 7.0)
    place = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.0, 0.2, 0.3]))
    b, c = (pin.Inertia(m, np.array([0.1, 0, 0]), np.diag([1, 2, 2.5])) for m in (2.0, 3.0))
    assert system.model.inertias[2].isApprox(b + place.act(c), 1e-12)


def test_missing_mesh_is_no_error(tmp_path: Path) -> None:
    """A mesh file that does not exist does not matter."""
    mesh = '<geometry><mesh filename="package://none/none.stl"/></geometry>'
    shapes = f"<visual>{mesh}</visual><collision>{mesh}</collision></link>"
    path = write(tmp_path, FLOATING.replace("</link>", shapes))
    assert pinred.load(path).mass == 4.0


def test_loaded_model_is_copied() -> None:
    """Loading neither changes nor shares the original model."""
    model = random_model("SE3", 3, seed=1)
    before = model.copy()
    system = pinred.load(model, gravity=EARTH)
    assert system.gravity.tolist() == EARTH
    system.model.armature = np.zeros(system.n)
    assert model == before
    assert system.name == model.name


@given(groups, seeds, st.booleans())
def test_lock_freezes_joint_at_value(group: str, seed: int, floats: bool) -> None:
    """The mass matrix of the locked system is a block of the free one's at the locked values."""
    rng = np.random.default_rng(seed)
    model = random_model(group, 5, seed)
    for i in range(1, model.njoints):
        model.addJointFrame(i)
    if floats:
        model.appendBodyToJoint(0, inertia(rng), pin.SE3.Identity())
    free = pinred.load(model)
    lock = {n: float(rng.uniform(-2, 2)) for n in rng.permutation(free.shape_names)[:2]}
    system = pinred.load(model, lock=lock)
    assert system.group is free.group
    assert list(system.shape_names) == [n for n in free.shape_names if n not in lock]
    x = {n: float(rng.uniform(-2, 2)) for n in system.shape_names}
    pose = system.group.exp(rng.normal(size=system.r))
    rows = [*range(system.r), *(system.r + free.shape_names.index(n) for n in x)]
    complete = mass_matrix(free.model, free.q(pose, [(x | lock)[n] for n in free.shape_names]))
    q = system.q(pose, list(x.values()))
    assert mass_matrix(system.model, q) == pytest.approx(complete[np.ix_(rows, rows)], abs=1e-11)


def test_lock_list_freezes_at_zero(tmp_path: Path) -> None:
    """A list of names locks at zero."""
    parts = [link(name) for name in "abc"]
    path = write(tmp_path, robot(*parts, joint("a", "b"), joint("b", "c")))
    system = pinred.load(path, lock=["b-c"])
    assert (system.shape_names, system.mass) == (("a-b",), 6.0)
    assert pinred.load(path, lock={"b-c": 0.0}).model.inertias[2] == system.model.inertias[2]


def test_lock_joint_with_name_of_link(tmp_path: Path) -> None:
    """A joint and a link may have the same name."""
    text = robot(*(link(name) for name in "abc"), joint("a", "b"), joint("b", "c"))
    system = pinred.load(write(tmp_path, text.replace("a-b", "b")), lock=["b"])
    assert (system.shape_names, system.mass) == (("b-c",), 6.0)


@pytest.mark.slow
def test_lock_model_without_joint_frames() -> None:
    """The model is locked in a separate process, since it might crash."""
    code = (
        "import pinred, trees\n"
        "system = pinred.load(trees.random_model('SE3', 3, 0), lock=['joint2'])\n"
        "assert system.shape_names == ('joint1', 'joint3'), system.shape_names"
    )
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# The other quadruped runs by default.
# The bundled robots match their catalogue, and other tests use these robots.
@pytest.mark.by_hand
@pytest.mark.by_hand("anymal_c")
@needs_robots
@pytest.mark.parametrize("name", ["solo12", "talos", "anymal_c"])
@pytest.mark.sampled
def test_example_robot_matches_its_loader(name: str) -> None:
    """Armature and mass matrix equal those of example_robot_data's loader."""
    from example_robot_data import load

    other = load(name).model
    system = pinred.load(name)
    assert (system.name, system.group.name) == (name, "SE3")
    assert list(system.shape_names) == list(other.names)[2:]
    assert system.model.armature == pytest.approx(other.armature, abs=0)
    assert name != "talos" or other.armature.max() == pytest.approx(0.1)
    q = some_q(other)
    assert mass_matrix(system.model, q) == pytest.approx(mass_matrix(other, q), abs=1e-11)


@given(cases())
def test_conversions_to_q_and_v_round_trip(case: Case) -> None:
    """Both give pose, shape and rates back, for single states and along a time axis."""
    system = case.system
    at, rate = system.configuration(case.q), system.velocity(case.v)
    assert at.pose == pytest.approx(case.pose, abs=1e-15)
    assert at.x == pytest.approx(case.x, abs=1e-15)
    assert np.array_equal(rate.xi, case.xi)
    assert np.array_equal(rate.xdot, case.xdot)
    x, xdot = np.linspace(0, 1, 4)[:, None] * case.x, np.linspace(0, 1, 4)[:, None] * case.xdot
    q, v = system.q(case.pose, x), system.v(case.xi, xdot)
    assert np.array_equal(q, [system.q(case.pose, row) for row in x])
    assert np.array_equal(v, [system.v(case.xi, row) for row in xdot])
    assert system.configuration(q).x == pytest.approx(x, abs=1e-15)
    assert system.velocity(v).xi.shape == (4, system.r)


@given(cases(), st.floats(0.01, 1.0))
def test_conversions_agree_with_pinocchio(case: Case, dt: float) -> None:
    """Integrating q by v moves the pose by exp ξ and the shape by ẋ, and the difference gives v."""
    system, group = case.system, case.system.group
    moved_mass = pin.integrate(system.model, case.q, dt * case.v)
    pose = group.compose(case.pose, group.exp(dt * case.xi))
    target = system.q(pose, case.x + dt * case.xdot)
    assert pin.difference(system.model, moved_mass, target) == pytest.approx(
        np.zeros(system.n), abs=1e-9
    )
    x = case.x + np.clip(dt * case.xdot, -3.0, 3.0)  # less than half a turn
    back = system.velocity(pin.difference(system.model, case.q, system.q(pose, x)))
    error = group.log(group.compose(group.inverse(case.pose), pose))
    assert back.xdot == pytest.approx(x - case.x, abs=1e-9)
    assert group.error(group.exp(back.xi), group.exp(error)).rotation < 1e-9
    assert group.error(group.exp(back.xi), group.exp(error)).translation < 1e-9


def test_unwrapped_angles_give_same_q() -> None:
    """Two turns more in a continuous joint give the same q; a slide has no turns."""
    case = make_case("SE3", 8, seed=5)
    turns = [4 * np.pi * (j.nq == 2) for j in list(case.system.model.joints)[2:]]
    assert max(turns) > 0
    assert case.system.q(case.pose, case.x + turns) == pytest.approx(case.q, abs=1e-14)
