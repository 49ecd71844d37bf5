"""Numbers of URDF extensions against closed forms and against models built with Pinocchio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from robot_texts import link, robot, write
from test_urdf_words import BALL, GAZEBO, Y, bar, drake_loop, four_bar, gazebo_loop, on

import pinred
from pinred import LeftOutWarning, ModelError
from pinred.common.arrays import Array
from pinred.forces import Damper, Spring
from pinred.system.read_urdf import read_urdf
from pinred.views.playback.drawn_bodies import drawn_bodies

WEIGHTLESS = [0.0, 0.0, 0.0]


def mass_matrix(path: Path, x: list[float]) -> Array:
    """Return pinred's mass matrix at a shape."""
    return pinred.Reduction(pinred.load(path, gravity=WEIGHTLESS)).mass_matrix(x)


def two(inside: str = "", kind: str = "revolute") -> str:
    """Return two links on a joint j."""
    return robot(bar("a"), bar("b"), on("j", "a", "b", kind, f"<axis xyz='0 0 1'/>{inside}"))


def test_quaternions_match_pinocchio(tmp_path: Path) -> None:
    """Of joints and inertial frames, against Pinocchio's reading of the untouched file."""
    turned = 'quat_xyzw="0.1 0.7 0.1 0.7"'
    text = robot(
        bar("a"), bar("b", turned=turned), on("j", "a", "b", inside=f"<origin {turned}/>{Y}")
    ).replace("<robot", '<robot version="1.1"')  # fmt: skip
    text = text.replace("</joint>", '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>')
    path = write(tmp_path, text)
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    upper = np.triu(pin.crba(model, model.createData(), np.array([0, 0, 0, 0, 0, 0, 1, 0.3])))
    np.testing.assert_allclose(np.triu(mass_matrix(path, [0.3])), upper, atol=1e-14)


@pytest.mark.parametrize(
    "limit", ['effort="-1" velocity="-1"', 'effort="inf" velocity="-inf"', 'effort="nan"']
)
def test_numbers_that_state_no_limit_are_read(limit: str, tmp_path: Path) -> None:
    """Negative, infinite and NaN limits state none, as zero does; position limits stay."""
    path = write(tmp_path, two(f'<limit lower="-1" upper="inf" {limit}/>'))
    system = pinred.load(path)
    assert [left.what for left in system.left_out] == ["joint limits"]
    model = system.model
    assert (model.lowerPositionLimit[-1], model.upperPositionLimit[-1]) == (-1.0, np.inf)
    planar = pinred.load(write(tmp_path, two(f"<limit {limit}/>", "planar")))
    assert planar.left_out == ()


@pytest.mark.parametrize("limit", ['effort="x"', 'lower="1 2" upper="3"', 'velocity=""'])
def test_limits_that_are_no_numbers_are_refused(limit: str, tmp_path: Path) -> None:
    """The message names the joint and the line."""
    with pytest.raises(ModelError, match=r"limit of joint 'j' \(line 1\)"):
        pinred.load(write(tmp_path, two(f"<limit {limit}/>")))


def test_version_one_two_demands_position_limits(tmp_path: Path) -> None:
    """As URDF's parser does."""
    text = two('<limit lower="-1" effort="1" velocity="1"/>')
    assert pinred.load(write(tmp_path, text)).m == 1
    with pytest.raises(ModelError, match=r"lacks the attribute upper, which URDF 1.2 demands"):
        pinred.load(write(tmp_path, text.replace("<robot", '<robot version="1.2"')))


def rotor(inertia: float, gear: float, joint: str = "j") -> str:
    """Return a transmission with a rotor."""
    return (
        f'<transmission><joint name="{joint}"/><actuator name="m"><drake:rotor_inertia '
        f'value="{inertia}"/><drake:gear_ratio value="{gear}"/></actuator></transmission>'
    )


def test_armature_is_reflected_by_the_gear(tmp_path: Path) -> None:
    """Gear ratio squared times rotor inertia, of all motors; <dynamics> states the product."""
    plain = mass_matrix(write(tmp_path, two()), [0.2])
    motors = two().replace("</robot>", rotor(0.01, 10) + rotor(0.02, 5) + "</robot>")
    direct = two('<dynamics rotor_inertia="1.5" armature="1.5"/>')
    for text in (motors, direct):
        expected = plain + np.diag([0, 0, 0, 0, 0, 0, 1.5])
        actual = mass_matrix(write(tmp_path, text), [0.2])
        np.testing.assert_allclose(actual, expected, atol=1e-14)


def test_contradicting_armature_is_refused(tmp_path: Path) -> None:
    """Two words for one quantity must agree."""
    text = two('<dynamics rotor_inertia="1.5" armature="1.4"/>')
    with pytest.raises(ModelError, match=r"'j' .*armature = 1.4 and rotor_inertia = 1.5"):
        pinred.load(write(tmp_path, text))
    text = two('<dynamics stiffness="1.5" spring_stiffness="1.4"/>')
    with pytest.raises(ModelError, match=r"'j' .*stiffness = 1.5 and spring_stiffness = 1.4"):
        pinred.load(write(tmp_path, text))
    for factor, is_refused in ((1 + 3e-6, True), (1 + 3e-7, False)):  # files round numbers
        text = two(f'<dynamics rotor_inertia="1.5" armature="{1.5 * factor}"/>')
        if is_refused:
            with pytest.raises(ModelError, match="for one quantity; state it once"):
                pinred.load(write(tmp_path, text))
        else:
            assert pinred.load(write(tmp_path, text)).model.armature[-1] == pytest.approx(1.5)
    lost = two().replace("</robot>", rotor(1, 1, "k") + "</robot>")
    with pytest.raises(ModelError, match=r"'m' \(line 1\) has a rotor and the joints k"):
        pinred.load(write(tmp_path, lost))


def test_springs_of_joints_with_several_freedoms_are_left_out(tmp_path: Path) -> None:
    """So is their armature, except that of a ball; both are listed."""
    words = '<dynamics stiffness="3" armature="0.1"/>'
    text = robot(
        bar("a"), bar("b"), bar("c"), on("j", "a", "b"), on("k", "b", "c", "planar", words + Y)
    )
    with pytest.warns(LeftOutWarning, match=r"springs.*\(1\), armature of joints with several"):
        system = pinred.load(write(tmp_path, text))
    assert not system.model.armature.any()
    assert system.passive == ()


def test_springs_and_dampers_of_extensions_act(tmp_path: Path) -> None:
    """Springs of <dynamics> and of Gazebo, with rest position; zero stiffness is no spring."""
    spring = '<dynamics stiffness="5" spring_reference="0.4" damping="0.1"/>'
    expected = (Spring("j", 5.0, 0.4), Damper("j", 0.1))
    assert pinred.load(write(tmp_path, two(spring))).passive == expected
    gazebo = (
        '<gazebo reference="j"><springStiffness>5</springStiffness><springReference value="0.4"/>'
        '</gazebo><gazebo reference="b"><springStiffness>0</springStiffness></gazebo></robot>'
    )
    text = two('<dynamics damping="0.1" stiffness="0"/>').replace("</robot>", gazebo)
    with pytest.raises(
        ModelError, match=r"stiffness = 0 and springStiffness of <gazebo> \(line 1\) = 5"
    ):
        pinred.load(write(tmp_path, text))
    with pytest.warns(LeftOutWarning, match="springs"):  # of link b
        system = pinred.load(write(tmp_path, text.replace(' stiffness="0"', "")))
    assert system.passive == expected


# The same joint as URDF extensions write it, and as Pinocchio's joints.
SPECIAL = {
    "spherical": ("spherical", "", pin.JointModelSpherical()),
    "ball": ("ball", "", pin.JointModelSpherical()),
    "universal": ("universal", "", pin.JointModelUniversal(*np.eye(3)[:2])),
    "screw": (
        "screw", '<axis xyz="0 3 4"/><drake:screw_thread_pitch value="0.5"/>',
        pin.JointModelHelicalUnaligned(np.array([0, 0.6, 0.8]), 0.25 / np.pi),
    ),
}  # fmt: skip


@pytest.mark.parametrize("tag", ["joint", "drake:joint"])
@pytest.mark.parametrize("case", SPECIAL)
def test_joints_of_other_programs_match_pinocchio(case: str, tag: str, tmp_path: Path) -> None:
    """Accelerations by ABA of the reduced and the original joint, at a random state."""
    kind, inside, joint = SPECIAL[case]
    more = '<origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/><dynamics damping="0.2" armature="0.1"/>'
    more = more if joint.nv != 2 else more.replace(' armature="0.1"', "")
    text = robot(bar("a"), bar("b"), bar("c"), on("i", "a", "b", "continuous", Y))
    text = text.replace("</robot>", on("j", "b", "c", kind, inside + more) + "</robot>")
    if tag != "joint":
        text = text.replace('<joint name="j"', f'<{tag} name="j"')
        text = f"</{tag}>".join(text.rsplit("</joint>", 1))
    raw = read_urdf(write(tmp_path, text)).model
    # The same tree without the text: Pinocchio's parser reads a fixed joint in its place.
    base = text.replace("drake:", "").replace(f'type="{kind}"', 'type="fixed"')
    tree = pin.buildModelFromXML(base.replace("screw_thread_pitch", "junk"))
    body = tree.frames[tree.getFrameId("j", pin.FrameType.FIXED_JOINT)]
    model = pin.Model()
    first = model.addJoint(0, tree.joints[1], tree.jointPlacements[1], "i")
    plain = pin.buildModelFromXML(robot(bar("b")))
    model.appendBodyToJoint(first, plain.inertias[0], pin.SE3.Identity())
    second = model.addJoint(first, joint, body.placement, "j")
    model.appendBodyToJoint(second, plain.inertias[0], pin.SE3.Identity())
    model.armature[1:] = 0.0 if joint.nv == 2 else 0.1
    rng = np.random.default_rng(3)
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    v, tau = rng.normal(size=(2, model.nv))
    actual, expected = (pin.aba(m, m.createData(), q, v, tau) for m in (raw, model))
    np.testing.assert_allclose(actual, expected, rtol=1e-11)
    np.testing.assert_array_equal(raw.damping[1:], 0.2)


def test_ball_of_urdf_can_be_simulated(tmp_path: Path) -> None:
    """A ball in the tree keeps its name, and a motion agrees with ABA."""
    text = robot(bar("a"), bar("b"), on("j", "a", "b", "spherical"))
    system = pinred.load(write(tmp_path, text))
    assert system.shape_names == ("j.x", "j.y", "j.z")
    assert pinred.compare(pinred.simulate(system, seed=0, duration=0.2)).passed


@pytest.mark.parametrize("normal", ["1 0 0", "0 0 -1", "0.6 0 0.8", "0 0 1"])
def test_planar_joint_moves_in_the_plane_of_its_normal(normal: str, tmp_path: Path) -> None:
    """As slides along two axes and a hinge about the normal, turned from x, y and z."""
    n = np.array(normal.split(), dtype=float)
    R = (
        np.diag([1.0, -1.0, -1.0])
        if n[2] == -1.0
        else np.array(pin.Quaternion.FromTwoVectors(np.eye(3)[2], n).matrix())
    )
    at = '<origin xyz="0.1 0.2 0.3" rpy="0.3 0.1 0.2"/>'
    axes = [" ".join(map(repr, R[:, k].tolist())) for k in range(3)]
    kinds = ("prismatic", "prismatic", "continuous")
    chain = "".join(
        on(f"j{k}", "abcd"[k], "bcde"[k], kind, f'{at if k == 0 else ""}<axis xyz="{axis}"/>')
        for k, (kind, axis) in enumerate(zip(kinds, axes, strict=True))
    )
    end = on("k", "d", "e", inside=Y)
    first = bar("r") + on("i", "r", "a", inside=Y)
    chain = robot(first, bar("a"), link("b", 0), link("c", 0), bar("d"), bar("e"), chain, end)
    plane = robot(
        first, bar("a"), bar("d"), bar("e"),
        on("j", "a", "d", "planar", f'{at}<axis xyz="{normal}"/>'), end,
    )  # fmt: skip
    for x in ([0.1, 0.2, 0.3, 0.4, 0.5], [0.7, -0.3, 0.1, 2.0, -0.5]):
        plane_M = mass_matrix(write(tmp_path, plane), x)
        chain_M = mass_matrix(write(tmp_path, chain), x)
        np.testing.assert_allclose(plane_M, chain_M, atol=1e-13)


def test_drakes_world_needs_no_link(tmp_path: Path) -> None:
    """A joint on the undeclared link "world" is one on a link without mass."""
    declared = robot(
        link("world", 0), bar("a"), bar("b"), on("w", "world", "a", "fixed"), on("j", "a", "b")
    )
    implied = declared.replace(link("world", 0), "")
    M = [mass_matrix(write(tmp_path, text), [0.3]) for text in (declared, implied)]
    np.testing.assert_array_equal(M[0], M[1])


# The four-bar is a rectangle of bars at zero, so all closings describe one robot.
ONSHAPE = "".join(
    f'<link name="closing_rear_{k}"/>' + on(
        f"frame_{k}", parent, f"closing_rear_{k}", "fixed", f'<origin xyz="{xyz}"/>'
    )
    for k, parent, xyz in ((1, "right", "0 0 0.2"), (2, "top", "0.3 0 0"))
)  # fmt: skip
PINNED = '<link name="pin"/>' + on("fix", "top", "pin", "fixed", '<origin xyz="0.3 0 0"/>')
PINNED += on("close", "right", "pin", "continuous", f'<origin xyz="0 0 0.2"/>{Y}')
CLOSINGS = {
    "gazebo": (four_bar(GAZEBO), "close", 5),
    "gazebo, ball": (four_bar(GAZEBO.replace("revolute", "ball")), "close", 3),
    "gazebo, oblique": (
        four_bar(gazebo_loop("<pose>0.3 0 0 0.4 0 0</pose>", "<axis><xyz>0 0.92106099400288510 "
                             "-0.38941834230865052</xyz></axis>")), "close", 5,
    ),
    "gazebo, axis of the model": (
        four_bar(gazebo_loop("<pose>0.3 0 0 0.4 0.3 0.2</pose>", "<axis><use_parent_model_frame>"
                             "true</use_parent_model_frame><xyz>0 1 0</xyz></axis>")), "close", 5,
    ),
    "drake": (four_bar(drake_loop()), "close", 5),
    "drake, ball constraint": (four_bar(BALL), "ball_constraint_1", 3),
    "link on two joints": (four_bar(PINNED), "close", 5),
    "onshape-to-robot": (four_bar(ONSHAPE), "closing_rear", 3),
}  # fmt: skip


@pytest.mark.parametrize("case", CLOSINGS)
def test_four_bar_of_a_file_moves_as_a_parallelogram(case: str, tmp_path: Path) -> None:
    """Kinetic energy in closed form: the top bar translates, and both sides turn alike."""
    text, name, equations = CLOSINGS[case]
    system = pinred.load(write(tmp_path, text), gravity=WEIGHTLESS)
    (loop,) = (*system.loops, *system.contents.coupled_loops)
    assert (loop.name, loop.equations) == (name, equations)
    assert (system.shape_dim, system.left_out) == (1, ())
    rng = np.random.default_rng(0)
    tree = system.open_tree()
    for angle in rng.uniform(-1.0, 1.0, 3):
        x = {"j_left": angle, "j_right": angle, "j_top": -angle}
        rate = np.array(
            [{"j_left": 1.0, "j_right": 1.0, "j_top": -1.0}[n] for n in tree.shape_names]
        )
        order = [x[n] for n in tree.shape_names]
        H = pinred.Reduction(tree).mass_matrix(order)[6:, 6:]
        # Sides: inertia about the pivot.  Top: mass 0.5 kg on a circle of 0.2 m.
        moment = (
            pin.rpy.rpyToMatrix(0.1, 0.2, 0.3)
            @ np.array([[0.01, 0.001, 0.002], [0.001, 0.02, 0.003], [0.002, 0.003, 0.025]])
            @ pin.rpy.rpyToMatrix(0.1, 0.2, 0.3).T
        )
        sides = 2.0 * (moment[1, 1] + 0.5 * 0.1**2)
        assert rate @ H @ rate == pytest.approx(sides + 0.5 * 0.2**2, rel=1e-13)


def test_losses_of_joints_that_close_loops_are_left_out(tmp_path: Path) -> None:
    """Such a joint has no coordinate; it cannot follow another joint either."""
    lossy = PINNED.replace("</joint>", '<dynamics damping="0.1"/><limit effort="1"/></joint>', 2)
    lossy = lossy.replace('<dynamics damping="0.1"/><limit effort="1"/>', "", 1)
    with pytest.warns(LeftOutWarning, match="springs, damping and friction"):
        system = pinred.load(write(tmp_path, four_bar(lossy)))
    assert [left.names for left in system.left_out] == [("close (line 1)",)] * 2
    mimic = PINNED.replace("</joint>", '<mimic joint="j_left"/></joint>')
    with pytest.raises(ModelError, match=r"'close' \(line 1\) closes a loop.*remove its <mimic>"):
        pinred.load(write(tmp_path, four_bar(mimic)))


@pytest.mark.parametrize(("slope", "kind"), [(0.0, "y"), (3e-13, "y"), (3e-12, "z")])
def test_hinges_along_other_axes_turn_the_frames(slope: float, kind: str, tmp_path: Path) -> None:
    """A hinge along an axis of its frame, up to round-off, keeps the axis; others get z."""
    text = four_bar(drake_loop().replace(Y, f'<axis xyz="{slope} 1 0"/>'))
    (loop,) = read_urdf(write(tmp_path, text)).loops
    assert loop.kind == kind


@pytest.mark.filterwarnings("ignore::pinred.LeftOutWarning")
def test_loops_of_other_kinds_are_left_out_by_name(tmp_path: Path) -> None:
    """A prismatic closure has four equations with an angle, which no kind of loop has."""
    text = four_bar(GAZEBO.replace("revolute", "prismatic"))
    (left,) = pinred.load(write(tmp_path, text)).left_out
    assert left.names == ("'close' (line 1)",)
    old = '<gazebo><joint:hinge name="tip"><body1>right</body1></joint:hinge></gazebo>'
    (left,) = pinred.load(write(tmp_path, four_bar(old))).left_out
    assert left.names == ("joint:hinge 'tip' (line 1)",)


def test_loops_of_locked_joints_are_dropped_and_requested_ones_replace(tmp_path: Path) -> None:
    """A loop without moving joints closes nothing; one of the same name is the caller's."""
    path = write(tmp_path, four_bar(ONSHAPE))
    locked = pinred.load(path, lock=["j_left", "j_right", "j_top"])
    assert (locked.m, locked.loops) == (0, ())
    loop = pinred.Loop("closing_rear_1", "closing_rear_2", "6d", "closing_rear")
    with pytest.raises(ModelError, match=r"nothing can move|do not close"):
        pinred.load(path, loops=[loop])
    kinds: tuple[tuple[Any, str], ...] = (("3d", "closing_rear_1"), ("y", "closing_rear_2"))
    for kind, first in kinds:
        second = f"closing_rear_{3 - int(first[-1])}"
        system = pinred.load(path, loops=[pinred.Loop(first, second, kind, coupled=False)])
        assert [str(loop) for loop in system.loops] == [f"{first} = {second} ({kind})"]
    for gap in (3e-10, 3e-9):  # points that are one up to round-off, and loops that contradict
        near = f'<frame name="near" link="right" xyz="{gap} 0 0.2"/></robot>'
        path = write(tmp_path, four_bar(ONSHAPE).replace("</robot>", near))
        loop = pinred.Loop("near", "closing_rear_2", "3d", coupled=False)
        if gap < 1e-9:
            assert pinred.load(path, loops=[loop]).loops == (loop,)
        else:
            with pytest.raises(ModelError, match="do not close"):
                pinred.load(path, loops=[loop])


def test_loop_through_the_world_is_refused(tmp_path: Path) -> None:
    """On a base that stands, the message names the joint and the remedy."""
    text = four_bar(GAZEBO.replace("right", "ground")).replace(link("base"), link("base", 0))
    text = (
        text.replace("</robot>", "</robot>")
        .replace(on("j_right", "base", "right", "continuous", f'<origin xyz="0.3 0 0.0"/>{Y}'), "")
        .replace(bar("right"), "")
        .replace("ground", "base")
    )
    words = r"'close' \(line 1\) of .*through the world, so the base cannot .*remove it"
    with pytest.raises(ModelError, match=words):
        pinred.load(write(tmp_path, text))


@pytest.mark.parametrize(
    "tie",
    [
        '<gazebo><joint name="tie" type="fixed"><parent>world</parent><child>c</child></joint>'
        "</gazebo>",
        '<gazebo><joint name="tie" type="fixed"><parent>c</parent><child>world</child></joint>'
        "</gazebo>",
        '<loop_joint name="tie" type="ball"><link1 link="world"/><link2 link="c"/></loop_joint>',
    ],
)
def test_loop_from_a_floating_base_to_the_world_is_refused(tie: str, tmp_path: Path) -> None:
    """The message names the joint, its line, the base and the remedy."""
    tree = link("a") + link("b") + link("c") + on("ab", "a", "b") + on("bc", "b", "c")
    text = f'<robot name="r">{tree}\n{tie}</robot>'
    words = (
        r"'tie' \(line 2\) ties link 'c' to the world, so the base 'a' cannot move.*make 'c' the"
    )
    with pytest.raises(ModelError, match=words):
        pinred.load(write(tmp_path, text))


def test_second_joint_of_a_link_between_two_trees_is_refused(tmp_path: Path) -> None:
    """The message names both joints, their lines, and the links without a joint."""
    tree = link("a") + link("b") + link("c") + on("ab", "a", "b") + on("bc", "b", "c")
    text = f'<robot name="r"><link name="world"/>{tree}\n{on("wc", "world", "c")}</robot>'
    words = (
        r"'wc' \(line 2\) carries link 'c', which joint 'bc' \(line 1\).*so world, a have no joint"
    )
    with pytest.raises(ModelError, match=words):
        pinred.load(write(tmp_path, text))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<parent>right</parent>", "", r"'close' \(line 1\) closes a loop, but has no <parent>"),
        ("<parent>right</parent>", "<parent>rigth</parent>", r"'close' \(line 1\).*'rigth'.*right"),
        ("0.3 0 0 0 0.1 0", "0.3 0 0", r"pose of joint 'close' \(line 1\)"),
        ("0 1 0", "0 0 0", r"axis of joint 'close' \(line 1\) is zero"),
        ("<pose>", '<pose relative_to="j_left">', r"'close' \(line 1\).*'j_left'; refer to a link"),
    ],
)
def test_wrong_loops_are_refused_by_name(old: str, new: str, words: str, tmp_path: Path) -> None:
    """The message names the joint, the line and the remedy."""
    with pytest.raises(ModelError, match=words):
        pinred.load(write(tmp_path, four_bar(GAZEBO.replace(old, new))))


def test_frame_on_an_unknown_link_is_refused(tmp_path: Path) -> None:
    """The message names the frame and the link."""
    text = two().replace("</robot>", '<frame name="tip" link="c"/></robot>')
    with pytest.raises(ModelError, match=r"frame 'tip' \(line 1\) on the link 'c'"):
        pinred.load(write(tmp_path, text))


@pytest.mark.parametrize("kind", ["spherical", "planar", "universal"])
def test_shapes_on_joints_of_other_programs_are_drawn_at_their_links(
    kind: str, tmp_path: Path
) -> None:
    """Limits and words that Pinocchio's parser refuses do not hide the shapes either."""
    box = '<visual><origin xyz="1 2 3"/><geometry><box size="1 2 3"/></geometry></visual></link>'
    moved = bar("c").replace("</link>", box)
    text = robot(bar("a"), bar("b"), moved, on("i", "a", "b", inside=Y))
    axis = '<axis xyz="1 0 0"/><limit effort="-1" velocity="inf"/>'
    system = pinred.load(
        write(tmp_path, text.replace("</robot>", on("j", "b", "c", kind, axis) + "</robot>"))
    )
    (solid,) = drawn_bodies(system).solids
    frame = system.model.frames[system.model.getFrameId("c", pin.FrameType.BODY)]
    assert solid.joint == frame.parentJoint
    expected = pin.SE3ToXYZQUAT(frame.placement * pin.SE3(np.eye(3), np.array([1.0, 2.0, 3.0])))
    np.testing.assert_allclose(solid.placement, expected, atol=1e-12)


LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
GAZEBO_SPRING = '<gazebo reference="j"><springStiffness>{}</springStiffness></gazebo>'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (two('<dynamics friction="-0.5"/>'), "'j' (line 4) has negative friction -0.5; it must"),
        (two('<dynamics armature="-2"/>'), "joint 'j' (line 4) has armature -2; it must be zero"),
        (two('<origin xyz="0.3\u00a00 0"/>'), "'j' (line 4): 'xyz' must be 3 finite number(s)"),
        (
            two().replace("</robot>", "".join(map(GAZEBO_SPRING.format, "34")) + "</robot>"),
            "springStiffness of <gazebo> (line 4) = 3 and springStiffness of <gazebo> (line 5) = 4",
        ),
        (two().replace('child link="b"', "child"), "joint 'j' (line 4) names no child"),
        (two().replace('type="revolute"', ""), "joint 'j' (line 4) has no type; state one of"),
        (two().replace("0 0 1", "0 0 0"), "the axis of joint 'j' (line 4) is zero; state a direc"),
        (two(kind="revolute").replace('mass value="', 'mass value="-'), "; it must be zero or"),
    ],
)  # fmt: skip
def test_message_names_element_line_and_remedy(text: str, words: str, tmp_path: Path) -> None:
    """Each element is on a line of its own."""
    lines = text.replace("<link", "\n<link").replace("<joint", "\n<joint")
    lines = "\n".join(line for line in lines.split("\n") if line)
    path = write(tmp_path, lines.replace("/gazebo><gazebo", "/gazebo>\n<gazebo"))
    with pytest.raises(ModelError) as caught:
        pinred.load(path)
    assert words in str(caught.value)


def test_followers_of_joints_without_one_axis_are_refused_by_name(tmp_path: Path) -> None:
    """The message names the joint that has no single axis, and its line."""
    mimic = f'{Y}{LIMIT}<mimic joint="j"/>'
    links = "\n".join(bar(name) for name in "abc")
    for kinds, name, line in (("spherical revolute", "j", 4), ("revolute planar", "k", 5)):
        first, second = kinds.split()
        follower = on("k", "b", "c", second, mimic)
        text = robot(links, f"\n{on('j', 'a', 'b', first, Y + LIMIT)}\n", follower)
        with pytest.raises(ModelError, match=rf"joint '{name}' \(line {line}\) does not move"):
            pinred.load(write(tmp_path, text))


def test_lines_are_added_to_messages_about_the_model(tmp_path: Path) -> None:
    """Also in texts, but not for names of several elements, nor to messages about arguments."""
    text = robot(bar("a"), "\n", link("b", 0.0), "\n", on("j", "a", "b", inside=Y + LIMIT))
    for source in ({"source": write(tmp_path, text)}, {"text": text}):
        with pytest.raises(ModelError, match=r"link 'b' \(line 2\) moved by joint 'j' \(line 3\)"):
            pinred.load(**source)
    with pytest.raises(pinred.InputError) as caught:
        pinred.load(text=two(), lock={"nix": 0.0})
    assert "line" not in str(caught.value)
