"""Follower joints: URDF and MJCF files, locks, refusals, and coordinates."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import CoupledCase, coupled_cases, make_case
from hypothesis import given, settings
from robot_texts import joint, link, robot, write
from trees import inertia, placement, random_model

import pinred
from pinred import InputError, ModelError
from pinred.system.coupling import resolved
from pinred.system.robot_file_contents import Contents, Coupling
from pinred.system.singular_mass_matrix import singular_shapes

AXIS = '<axis xyz="0 0 1"/>'


def arm(*mimics: str, last: float = 2.0) -> str:
    """Return a URDF of links a, b, c, d in a chain, with content for joints a-b, b-c and c-d."""
    links = [*(link(name) for name in "abc"), link("d", last)]
    pairs = zip("abc", "bcd", (*mimics, "", "", "")[:3], strict=True)
    return robot(*links, *(joint(p, c, content=AXIS + more) for p, c, more in pairs))


def mimic(leader: str, numbers: str = "") -> str:
    """Return a <mimic> element."""
    return f'<mimic joint="{leader}" {numbers}/>'


@settings(max_examples=8)
@given(coupled_cases())
def test_coordinates_of_coupled_joints_round_trip(case: CoupledCase) -> None:
    """All joints are G y + b, also for batches of states, and q and v give y back."""
    system, rng = case.system, case.rng
    x, xdot = rng.uniform(-2.0, 2.0, (3, system.m)), rng.normal(size=(3, system.m))
    pose, xi = system.group.exp(rng.normal(size=system.r)), rng.normal(size=system.r)
    q, v = system.q(pose, x), system.v(xi, xdot)
    np.testing.assert_allclose(system.joint_values(x), x @ case.G.T + case.b, atol=1e-13)
    np.testing.assert_allclose(v[:, system.r :], xdot @ case.G.T, atol=1e-13)
    back = system.configuration(q)
    np.testing.assert_allclose(np.exp(1j * back.x), np.exp(1j * x), atol=1e-14)
    np.testing.assert_array_equal(system.velocity(v).xdot, xdot)
    f = rng.normal(size=system.model.nv)
    np.testing.assert_allclose(system.on_shape(f), case.whole.T @ f, atol=1e-13)
    assert set(system.shape_names).isdisjoint(system.followers)


def test_urdf_mimic_gives_ratio_and_offset(tmp_path: Path) -> None:
    """Multiplier and offset default to 1 and 0; followers of followers are resolved."""
    text = arm("", mimic("a-b"), mimic("b-c", 'multiplier="-2" offset="0.3"'))
    system = pinred.load(write(tmp_path, text))
    assert system.shape_names == ("a-b",)
    assert [str(each) for each in system.couplings] == ["b-c = 1·a-b", "c-d = -2·b-c + 0.3"]
    np.testing.assert_allclose(system.joint_values(np.array([0.5])), [0.5, 0.5, -0.7])
    told = str(pinred.inspect(system))
    assert "followers   b-c = 1·a-b" in told
    assert "c-d = -2·b-c + 0.3" in told
    assert "c-d = -2·b-c + 0.3" in system._repr_html_()


def test_mimic_of_fixed_joint_is_ignored(tmp_path: Path) -> None:
    """A <mimic> element in a fixed joint makes no coupling."""
    text = robot(link("a"), link("b"), joint("a", "b", "fixed", mimic("far")))
    assert pinred.load(write(tmp_path, text)).m == 0


def test_locking_leader_locks_followers(tmp_path: Path) -> None:
    """A follower is locked with its leader, and not without it."""
    text = arm("", mimic("a-b", 'multiplier="2"'), mimic("b-c", 'offset="0.3"'))
    path = write(tmp_path, text)
    free = pinred.load(path)
    system = pinred.load(path, lock={"a-b": 0.2})
    assert (system.m, system.couplings) == (0, ())
    whole = pinred.Reduction(free).locked_inertia([0.2])
    np.testing.assert_allclose(pinred.Reduction(system).locked_inertia([]), whole, atol=1e-14)
    assert pinred.load(path, lock={"a-b": 0.2, "c-d": 0.7}).m == 0
    with pytest.raises(InputError, match=r"'c-d' follows 'a-b' .* Lock 'a-b'"):
        pinred.load(path, lock=["c-d"])
    with pytest.raises(InputError, match=r"'c-d' .* the value 0\.7, not 0\.6. Lock only 'a-b'"):
        pinred.load(path, lock={"a-b": 0.2, "c-d": 0.6})
    assert pinred.load(write(tmp_path, arm("", mimic("far"))), lock=["b-c"]).m == 2


@pytest.mark.parametrize(
    ("mimics", "words"),
    [
        (("", mimic("far"), mimic("x")), ["'b-c'", "'far'", "lock=['b-c', 'c-d']"]),
        (
            (mimic("c-d"), mimic("a-b"), mimic("b-c")),
            ["cycle", "a-b", "'b-c' (line 1) follows joint 'a-b' (line 1)"],
        ),
        (
            (mimic("b-c"), mimic("a-b")),
            ["cycle", "'b-c' (line 1)", "'a-b' (line 1)", "'b-c' (line 1)", "remove one"],
        ),
    ],
)
def test_invalid_mimic_is_refused(
    tmp_path: Path, mimics: tuple[str, ...], words: list[str]
) -> None:
    """The message is one line with the names and a way out."""
    with pytest.raises(ModelError) as caught:
        pinred.load(write(tmp_path, arm(*mimics)))
    told = str(caught.value)
    assert [word for word in words if word not in told] == []
    assert "\n" not in told


def test_coupling_of_root_is_refused() -> None:
    """The motion of the root is the symmetry, so the root is neither follower nor leader."""
    model = random_model("SO2", 2, 0)
    pairs = (("joint1", "joint0"), ("joint0", "joint1"))
    for pair in pairs:
        contents = Contents(couplings=(Coupling(pair[0], {pair[1]: 1.0}, 0.0),))
        with pytest.raises(
            ModelError, match=r"root joint 'joint0'.* motion .*is the symmetry.*Lock"
        ):
            pinred.System(model, contents=contents)


def test_leader_that_becomes_root_can_be_locked(tmp_path: Path) -> None:
    """On a massless anchor the first joint is the root; locking it locks its follower."""
    parts = [link("a", 0.0), link("b"), link("c"), joint("a", "b")]
    path = write(tmp_path, robot(*parts, joint("b", "c", content=AXIS + mimic("a-b"))))
    with pytest.raises(
        ModelError, match=r"'b-c' \(line 1\) follows 'a-b'.*root joint 'a-b'.*Lock 'a-b'"
    ):
        pinred.load(path)
    assert pinred.load(path, lock=["a-b"], group="SE3").m == 0


def test_two_leaders_or_infinite_ratio_are_refused() -> None:
    """A joint follows one other joint, with finite ratio and offset."""
    names = ["a", "b", "c"]
    with pytest.raises(ModelError, match=r"'a' follows several joints: b, c"):
        resolved([Coupling("a", {"b": 1.0}, 0.0), Coupling("a", {"c": 1.0}, 0.0)], names)
    with pytest.raises(ModelError, match=r"'a' follows 'b'.*state finite numbers"):
        resolved([Coupling("a", {"b": np.inf}, 0.0)], names)


@pytest.mark.parametrize("kind", [pin.JointModelPY(), pin.JointModelRZ(), None])
@pytest.mark.parametrize("ratio", [2.0, -0.7])
def test_pinocchio_mimics_become_couplings(kind: pin.JointModel | None, ratio: float) -> None:
    """Mass matrix and gravity of the coupled plain joints equal Pinocchio's with mimic joints."""
    rng = np.random.default_rng(0)
    plain = random_model("SE3", 4, 3, armature=False)
    if kind is None:
        kind = pin.JointModelRevoluteUnaligned(np.array([0.6, 0.0, -0.8]))
    last = plain.addJoint(2, kind, placement(rng), "last")
    plain.appendBodyToJoint(last, inertia(rng), pin.SE3.Identity())
    leader = next(i for i in range(2, last) if plain.joints[i].nq == 1)
    plain.gravity.linear = np.array([1.0, 2.0, 3.0])
    model = pin.transformJointIntoMimic(plain, leader, last, ratio, 0.3)
    system = pinred.load(model)
    assert [str(each) for each in system.couplings] == [f"last = {ratio:g}·joint{leader - 1} + 0.3"]
    x = rng.normal(size=system.m)
    pose = system.group.exp(rng.normal(size=6))
    full = dict(zip(system.shape_names, x, strict=True))
    q = pin.neutral(model)
    q[:7] = pose
    for i in range(2, last):
        j = model.joints[i]
        y = full[model.names[i]]
        q[j.idx_q : j.idx_q + j.nq] = [y] if j.nq == 1 else [np.cos(y), np.sin(y)]
    upper = np.triu(pin.crba(model, model.createData(), q))
    order = [model.names[i] for i in range(2, last)]
    rows = [*range(6), *(6 + order.index(name) for name in system.shape_names)]
    H = (upper + np.triu(upper, 1).T)[np.ix_(rows, rows)]
    np.testing.assert_allclose(pinred.Reduction(system).mass_matrix(x), H, atol=1e-12)
    data = system.model.createData()
    own = pin.computeGeneralizedGravity(system.model, data, system.q(pose, x))
    weight = pin.computeGeneralizedGravity(model, model.createData(), q)[rows]
    np.testing.assert_allclose(system.on_shape(own), weight, atol=1e-12)


def test_mjcf_coupling_matches_mujoco() -> None:
    """MuJoCo's constraint residual is zero at the follower's value, with references included."""
    system = pinred.load(_gripper())
    model = _gripper()
    data = mujoco.MjData(model)
    x = np.array([0.37])
    q = system.q(system.group.identity(), x)
    for name, value in zip(list(system.model.names)[2:], q[7:], strict=True):
        data.qpos[model.joint(name).qposadr] = value
    mujoco.mj_forward(model, data)
    assert data.nefc == 2
    np.testing.assert_allclose(data.efc_pos, 0.0, atol=1e-15)
    # Velocities satisfy its Jacobian, and its mass matrix equals ours in the coupled joints.
    names = list(system.model.names)[2:]
    at = [model.jnt_dofadr[model.joint(name).id] for name in names]
    rates = system.v(np.zeros(6), [1.0])[6:]
    np.testing.assert_allclose(data.efc_J.reshape(2, -1)[:, at] @ rates, 0.0, atol=1e-15)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    own = pinred.Reduction(system).mass_matrix(x)[6:, 6:]
    assert own[0, 0] == pytest.approx(rates @ M[np.ix_(at, at)] @ rates, rel=1e-13)
    assert [each.follower for each in system.couplings] == ["left", "tip"]
    assert system.keyframes["open"].x == pytest.approx([0.2])


def _gripper() -> mujoco.MjModel:
    body = '<inertial pos=".1 0 .02" mass="1" diaginertia=".1 .2 .25"/>'
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><worldbody><body><freejoint/>'
        f'{body}<body pos="0 .1 0"><joint name="right" axis="0 1 0" ref=".4" armature=".1"/>{body}'
        f'</body><body pos="0 -.1 0"><joint name="left" type="slide" ref=".3" armature=".2"/>{body}'
        f'<body pos=".1 0 0"><joint name="tip" axis="1 0 0"/>{body}</body></body>'
        '</body></worldbody><equality><joint joint1="left" joint2="right" polycoef=".1 -2"/>'
        '<joint joint1="tip" joint2="left" polycoef="0 .5"/></equality>'
        '<keyframe><key name="open" qpos="0 0 0 1 0 0 0 .2 .7 9"/></keyframe></mujoco>'
    )


def test_coupled_joints_out_of_order_keep_q_and_v() -> None:
    """Both keep the order of the original model, followers included."""
    model, rng = pin.Model(), np.random.default_rng(0)
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    a = model.addJoint(root, pin.JointModelRX(), pin.SE3.Random(), "a")
    b = model.addJoint(root, pin.JointModelRY(), pin.SE3.Random(), "b")
    c = model.addJoint(a, pin.JointModelRZ(), pin.SE3.Random(), "c")
    for i in (root, a, b, c):
        model.appendBodyToJoint(i, inertia(rng), pin.SE3.Identity())
    couplings = (Coupling("c", {"b": 2.0}, 0.5),)
    system = pinred.System(model, contents=Contents(couplings=couplings))
    names = dict(zip(system.shape_names, (0.1, 0.2), strict=True))
    x = [names[name] for name in system.shape_names]
    q = system.q(system.group.identity(), x)
    np.testing.assert_allclose(q[7:], [names["a"], names["b"], 2.0 * names["b"] + 0.5])
    np.testing.assert_allclose(system.configuration(q).x, x)
    v = system.v(np.zeros(6), x)
    np.testing.assert_allclose(v[6:], [names["a"], names["b"], 2.0 * names["b"]])


def test_massless_leader_with_heavy_follower_is_admitted(tmp_path: Path) -> None:
    """A joint that moves no mass is admitted if its follower moves mass, and refused otherwise."""
    tree = [link("a"), link("b", 0.0), link("c"), joint("a", "b")]
    follows = joint("a", "c", content=AXIS + mimic("a-b"))
    system = pinred.load(write(tmp_path, robot(*tree, follows)))
    assert singular_shapes(system.model).everywhere == ("a-b",)
    assert system.doubts == ()
    assert system.m == 1
    for other in (joint("a", "c"), joint("a", "c", content=AXIS + mimic("a-b", 'multiplier="0"'))):
        with pytest.raises(ModelError, match=r"a-b.*lock=\['a-b'\]"):
            pinred.load(write(tmp_path, robot(*tree, other)))


def test_opposed_pair_around_point_mass_is_refused(tmp_path: Path) -> None:
    """Two coaxial joints with opposite rates do not move a point mass on the axis."""
    point = '<link name="{}"><inertial><mass value="1"/><inertia ixx="0" iyy="0" izz="0" ixy="0" '
    point += 'ixz="0" iyz="0"/></inertial></link>'
    plain = f'<joint name="{{}}" type="revolute"><parent link="{{}}"/><child link="{{}}"/>{AXIS}'
    plain += '<limit effort="1" velocity="1"/>{}</joint>'
    off = point.format("c").replace("<inertial>", '<inertial><origin xyz="0.3 0 0"/>')
    tree = [link("a"), link("b", 0.0), off, plain.format("one", "a", "b", "")]
    for ratio, fine in (("-1", False), ("-1.5", True)):
        last = plain.format("two", "b", "c", mimic("one", f'multiplier="{ratio}"'))
        path = write(tmp_path, robot(*tree, last))
        if fine:
            assert pinred.load(path).m == 1
        else:
            with pytest.raises(ModelError, match=r"'one'.*lock=\['one'\]"):
                pinred.load(path)


def test_random_cases_cover_all_kinds() -> None:
    """The random trees include chains, zero and negative ratios, and several leaders."""
    cases = [make_case("SE3", 8, seed) for seed in range(40)]
    found = [each for case in cases for each in case.system.couplings]
    ratios = [ratio for each in found for ratio in each.ratios.values()]
    assert min(ratios) < 0.0
    assert 0.0 in ratios
    assert sum(len(each.ratios) > 1 for each in found) > 20
    systems = [case.system for case in cases]
    assert any({n for each in s.couplings for n in each.leaders} & {*s.followers} for s in systems)


POINT = (
    '<link name="{}"><inertial><origin xyz="{} 0 0"/><mass value="1"/><inertia ixx="0" iyy="0" '
    'izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)


def test_singular_shape_of_coupled_joints_is_named(tmp_path: Path) -> None:
    """A geared elbow folds a point mass back onto the shoulder's axis at one angle."""
    plain = '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz='
    plain += '"{} 0 0"/><axis xyz="0 0 1"/><limit effort="1" velocity="1"/>{}</joint>'
    tree = [
        link("a"), link("b", 0.0), POINT.format("c", 0.5),
        plain.format("shoulder", "a", "b", 0, ""),
    ]  # fmt: skip
    elbow = plain.format("elbow", "b", "c", 0.5, mimic("shoulder", 'multiplier="1" offset="0.4"'))
    system = pinred.load(write(tmp_path, robot(*tree, elbow)))
    # |dp/dy|² = ¼ |1 + 2 exp(i (y + 0.4))|² is never zero: the mass moves at every shape.
    assert system.doubts == ()
    assert pinred.Reduction(system).reduced_metric([np.pi - 0.4])[0, 0] > 0.0
    still = elbow.replace('multiplier="1"', 'multiplier="0"').replace("0.4", "3.141592653589793")
    with pytest.raises(ModelError, match=r"'shoulder'.*lock=\['shoulder'\]"):
        pinred.load(write(tmp_path, robot(*tree, still)))
    # 0.5 + (1 + k) 0.25 exp(i (k y + 0.4)) is zero for k = 1 at π − 0.4.
    tree[2] = POINT.format("c", 0.25)
    with pytest.warns(
        pinred.ModelWarning, match=r"'shoulder' moves no mass at 'shoulder' = 2\.7415"
    ):
        system = pinred.load(write(tmp_path, robot(*tree, elbow)))
    assert np.linalg.eigvalsh(pinred.Reduction(system).mass_matrix([1.0]))[0] > 1e-3
    with pytest.raises(pinred.SingularInertiaError, match="'shoulder'"):
        pinred.Reduction(system).mass_matrix([np.pi - 0.4])
