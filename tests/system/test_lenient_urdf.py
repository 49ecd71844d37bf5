"""URDF files that strict parsers refuse: accepted if unambiguous, otherwise refused."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import python
from robot_texts import AXIS, FLOATING, joint, link, robot, write

import pinred
from pinred import LoadError, ModelError, ModelWarning
from pinred.lie import SE2, SE3
from pinred.system.admission import WORKSPACE_BYTES
from pinred.views.playback.drawn_bodies import drawn_bodies

LIMIT = re.compile("<limit[^>]*>")
SAME = {  # equivalent texts of one robot
    "blanks around numbers": FLOATING.replace('value="2.0"', 'value=" 2.0\t"').replace(
        'xyz="0 0 1"', 'xyz="  0\n0  1 "'
    ),
    "limit without effort": FLOATING.replace(' effort="1"', ""),
    "limit without velocity": FLOATING.replace(' velocity="1"', ""),
    "declaration on the second line": f'\n<?xml version="1.0"?>\n{FLOATING}',
    "comment with dashes": f"<!-- a -- b --->{FLOATING}",
    "declaration after a comment": f'<!-- made by hand --><?xml version="1.0"?>{FLOATING}',
    "prefix without declaration": FLOATING.replace("</robot>", "<sensor><g:b/></sensor></robot>"),
    "no limits at all": LIMIT.sub("", FLOATING),
    "bad shapes": FLOATING.replace("<inertial>", "<visual><geometry/></visual><inertial>"),
}


@pytest.mark.parametrize("case", SAME)
def test_lenient_urdf_equals_strict_one(case: str, tmp_path: Path) -> None:
    """Mass matrix and placements equal those of the correct file."""
    expected = pinred.load(write(tmp_path, FLOATING))
    actual = pinred.load(write(tmp_path, SAME[case]))
    x = np.array([0.7])
    H = [pinred.Reduction(entry).mass_matrix(x) for entry in (actual, expected)]
    np.testing.assert_array_equal(H[0], H[1])


COMMAS = FLOATING.replace("0 0.2 0.3", "0, 0.2,0.3").replace("0.1 0.2 0.3", " 0.1 , 2e-1,+.3")


def test_commas_in_number_lists_are_read_as_blanks(tmp_path: Path) -> None:
    """With a warning: mass matrix, placements and drawn shapes equal those of the correct file."""
    box = '<visual><geometry><box size="1 2 3"/></geometry></visual><inertial>'
    plain, commas = (
        text.replace("<inertial>", box.replace("1 2 3", size), 1)
        for text, size in ((FLOATING, "1 2 3"), (COMMAS, "1,2,3"))
    )
    expected = pinred.load(write(tmp_path, plain))
    shapes = repr(drawn_bodies(expected).solids)
    with pytest.warns(ModelWarning, match=r"3 lists of numbers have commas, such as size='1,2,3'"):
        actual = pinred.load(write(tmp_path, commas))
    x = np.array([0.7])
    H = [pinred.Reduction(entry).mass_matrix(x) for entry in (actual, expected)]
    np.testing.assert_array_equal(H[0], H[1])
    assert repr(drawn_bodies(actual).solids) == shapes
    assert "box" in shapes


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0 0.2 0.3", "0 0,2 0,3"),  # decimal commas
        ("0 0.2 0.3", "0,2 0"),  # blanks and commas, which leave the meaning open
        ("0 0.2 0.3", "0,,2,3"),
        ("0 0.2 0.3", "0,1,2,3"),
        ('"2.0"', '"2,0"'),
        ('xyz="0 0 1"', 'xyz="0,1"'),
    ],
)
def test_other_commas_are_refused(old: str, new: str, tmp_path: Path) -> None:
    """Decimal commas, mixed separators and lists of another length."""
    with pytest.raises((LoadError, ModelError)):
        pinred.load(write(tmp_path, FLOATING.replace(old, new)))


def test_missing_limits_are_infinite(tmp_path: Path) -> None:
    """A joint without <limit> is unlimited; given limits are kept."""
    free = pinred.load(write(tmp_path, LIMIT.sub("", FLOATING))).model
    assert (free.lowerPositionLimit[-1], free.upperPositionLimit[-1]) == (-np.inf, np.inf)
    limited = pinred.load(write(tmp_path, FLOATING.replace(' effort="1"', ""))).model
    assert (limited.lowerPositionLimit[-1], limited.upperPositionLimit[-1]) == (-1.0, 1.0)


@pytest.mark.parametrize(
    "text",
    [
        '<robot name="r" xmlns:xacro="x"><xacro:include filename="a"/><link name="a"/></robot>',
        FLOATING.replace('"2.0"', '"${mass}"'),
        FLOATING.replace('"a-b"', '"$(arg name)"'),
    ],
)
def test_xacro_template_is_refused_with_command(text: str, tmp_path: Path) -> None:
    """The suggested command does not overwrite the template."""
    path = write(tmp_path, text)
    with pytest.raises(LoadError) as caught:
        pinred.load(path)
    assert f"`xacro {path} > arm_expanded.urdf`" in str(caught.value)


def test_two_inertial_elements_are_refused(tmp_path: Path) -> None:
    """It is unclear which of the two counts."""
    inertial = "<inertial>" + link("a").split("<inertial>")[1].removesuffix("</link>")
    with pytest.raises(ModelError, match="'a' has 2 inertial elements"):
        pinred.load(write(tmp_path, FLOATING.replace(inertial, 2 * inertial, 1)))


def test_group_name_ignores_case(tmp_path: Path) -> None:
    """Lower-case letters name the same group."""
    path = write(tmp_path, FLOATING)
    assert pinred.load(path, group="se3").group is SE3


def test_rounded_unit_vectors_are_normalised() -> None:
    """Quaternions, and cosine-sine pairs, with few decimals are normalised; others are refused."""
    pose = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.9999])
    np.testing.assert_array_equal(SE3.pose(pose), [1, 2, 3, 0, 0, 0, 1])
    np.testing.assert_allclose(SE2.pose([1.0, 2.0, 0.7071, 0.7071]), [1, 2, np.pi / 4])
    with pytest.raises(pinred.InputError, match="norm 1"):
        SE3.pose(np.append(pose[:6], 0.99))


def chain(count: int, kind: str) -> str:
    """Return a URDF of links in a chain."""
    links = (link(f"l{k}") for k in range(count + 1))
    return robot(*links, *(joint(f"l{k}", f"l{k + 1}", kind) for k in range(count)))


@pytest.mark.slow
def test_deep_tree_of_fixed_joints_is_one_body(tmp_path: Path) -> None:
    """Links beyond the depth of Python's recursion are one body; errors in them are reported."""
    text = chain(1020, "fixed")
    system = pinred.load(write(tmp_path, text))
    assert system.m == 0
    assert system.mass == pytest.approx(2.0 * 1021)
    with pytest.raises(
        ModelError, match=r"child of joint 'l6-l7' .* 'l7', which the file does not"
    ):
        pinred.load(write(tmp_path, text.replace('<link name="l7">', '<link name="x">')))


def test_too_many_joints_are_refused_with_memory(tmp_path: Path) -> None:
    """The message states how much memory they would need."""
    with pytest.raises(ModelError, match=r"407 degrees of freedom, more than 400.* GB"):
        pinred.load(write(tmp_path, chain(401, "revolute")))


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_stated_memory_matches_pinocchio() -> None:
    """Pinocchio's work space for 150 joints has the size that the refusal would state."""
    code = (
        "import pinocchio as pin\n"
        "def held(): return 4096 * int(open('/proc/self/statm').read().split()[1])\n"
        "model = pin.Model()\n"
        "for k in range(150):\n"
        "    model.addJoint(k, pin.JointModelRX(), pin.SE3.Identity(), f'j{k}')\n"
        "before = held()\n"
        "data = pin.Data(model)\n"
        "print((held() - before) / model.nv**3)"
    )
    assert float(python(code)) == pytest.approx(WORKSPACE_BYTES, rel=0.25)


SLIDES = ("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("prismatic", "0 0 1")
TURNS = ("continuous", "1 0 0"), ("continuous", "0 1 0"), ("continuous", "0 0 1")


def six(kinds: tuple[tuple[str, str], ...], turned: str = "0.1 0.2 0.3") -> str:
    """Return a URDF of six joints between massless links, with a body and an arm at the end."""
    text = "".join(link(f"l{k}", 0) for k in range(6)) + link("l6") + link("arm")
    for k, (kind, axis) in enumerate(kinds):
        built = joint(f"l{k}", f"l{k + 1}", kind, AXIS.replace("0 0 1", axis))
        text += built.replace("0 0.2 0.3", "0 0 0").replace("0.1 0.2 0.3", turned)
    return robot(text, joint("l6", "arm"))


@pytest.mark.parametrize("kinds", [SLIDES + TURNS, TURNS + SLIDES, SLIDES[:2] + TURNS + SLIDES[2:]])
def test_three_slides_and_three_hinges_are_se3(
    kinds: tuple[tuple[str, str], ...], tmp_path: Path
) -> None:
    """They are SE3 in any order and orientation, as in MJCF."""
    system = pinred.load(write(tmp_path, six(kinds)))
    free = pinred.load(write(tmp_path, robot(link("l6"), link("arm"), joint("l6", "arm"))))
    assert (system.group, system.shape_names) == (SE3, ("l6-arm",))
    H = [pinred.Reduction(entry).mass_matrix([0.4]) for entry in (system, free)]
    np.testing.assert_allclose(H[0], H[1], atol=1e-14)


def test_six_dependent_joints_are_not_joined(tmp_path: Path) -> None:
    """Two slides along one line leave a direction out, so the joints stay separate."""
    kinds = (SLIDES[0], SLIDES[1], SLIDES[1], *TURNS)
    with pytest.raises(ModelError, match="mass"):
        pinred.load(write(tmp_path, six(kinds, "0 0 0")))
