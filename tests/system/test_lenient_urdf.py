"""URDF that strict parsers refuse and whose meaning is clear; what is asked for where it is not."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import python
from robot_texts import AXIS, FLOATING, joint, link, robot, write

import pinred
from pinred import LoadError, ModelError
from pinred.lie import SE2, SE3
from pinred.system.admission import WORKSPACE_BYTES

LIMIT = re.compile("<limit[^>]*>")
SAME = {  # the same robot, written otherwise
    "blanks around numbers": FLOATING.replace('value="2.0"', 'value=" 2.0\t"').replace(
        'xyz="0 0 1"', 'xyz="  0\n0  1 "'
    ),
    "limit without effort": FLOATING.replace(' effort="1"', ""),
    "limit without velocity": FLOATING.replace(' velocity="1"', ""),
    "declaration on the second line": f'\n<?xml version="1.0"?>\n{FLOATING}',
    "declaration after a comment": f'<!-- made by hand --><?xml version="1.0"?>{FLOATING}',
    "prefix without declaration": FLOATING.replace("</robot>", '<g:b k:x="1"/></robot>'),
    "no limits at all": LIMIT.sub("", FLOATING),
    "bad shapes": FLOATING.replace("<inertial>", "<visual><geometry/></visual><inertial>"),
}


@pytest.mark.parametrize("case", SAME)
def test_the_same_robot(case: str, tmp_path: Path) -> None:
    """Mass matrix and placements are those of the file that says it properly."""
    expected = pinred.load(write(tmp_path, FLOATING))
    found = pinred.load(write(tmp_path, SAME[case]))
    x = np.array([0.7])
    H = [pinred.Reduction(each).mass_matrix(x) for each in (found, expected)]
    np.testing.assert_array_equal(H[0], H[1])


def test_no_limits_are_none(tmp_path: Path) -> None:
    """A joint without <limit> moves anywhere; one that gives its ends keeps them."""
    free = pinred.load(write(tmp_path, LIMIT.sub("", FLOATING))).model
    assert (free.lowerPositionLimit[-1], free.upperPositionLimit[-1]) == (-np.inf, np.inf)
    held = pinred.load(write(tmp_path, FLOATING.replace(' effort="1"', ""))).model
    assert (held.lowerPositionLimit[-1], held.upperPositionLimit[-1]) == (-1.0, 1.0)


@pytest.mark.parametrize(
    "text",
    [
        '<robot name="r" xmlns:xacro="x"><xacro:include filename="a"/><link name="a"/></robot>',
        FLOATING.replace('"2.0"', '"${mass}"'),
        FLOATING.replace('"a-b"', '"$(arg name)"'),
    ],
)
def test_templates_say_what_to_run(text: str, tmp_path: Path) -> None:
    """A file that xacro has to expand is refused with the command, which spares the file."""
    path = write(tmp_path, text)
    with pytest.raises(LoadError) as caught:
        pinred.load(path)
    assert f"`xacro {path} > arm_expanded.urdf`" in str(caught.value)


def test_two_inertias_are_none(tmp_path: Path) -> None:
    """Which of two counts is not clear."""
    inertial = "<inertial>" + link("a").split("<inertial>")[1].removesuffix("</link>")
    with pytest.raises(ModelError, match="'a' has 2 inertial elements"):
        pinred.load(write(tmp_path, FLOATING.replace(inertial, 2 * inertial, 1)))


def test_groups_in_any_letters(tmp_path: Path) -> None:
    """Small letters name the same group."""
    path = write(tmp_path, FLOATING)
    assert pinred.load(path, group="se3").group is SE3


def test_rounded_quaternions() -> None:
    """Quaternions, cosines and sines of few decimals are brought to length one, others refused."""
    pose = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.9999])
    np.testing.assert_array_equal(SE3.pose(pose), [1, 2, 3, 0, 0, 0, 1])
    np.testing.assert_allclose(SE2.pose([1.0, 2.0, 0.7071, 0.7071]), [1, 2, np.pi / 4])
    with pytest.raises(pinred.InputError, match="norm 1"):
        SE3.pose(np.append(pose[:6], 0.99))


def chain(count: int, kind: str) -> str:
    """Links in a row."""
    links = (link(f"l{k}") for k in range(count + 1))
    return robot(*links, *(joint(f"l{k}", f"l{k + 1}", kind) for k in range(count)))


@pytest.mark.slow
def test_deep_trees(tmp_path: Path) -> None:
    """Two thousand links on fixed joints are one body; a fault in them is still an error."""
    text = chain(2000, "fixed")
    system = pinred.load(write(tmp_path, text))
    assert system.m == 0
    assert system.mass == pytest.approx(2.0 * 2001)
    with pytest.raises(LoadError, match="l7"):
        pinred.load(write(tmp_path, text.replace('<link name="l7">', '<link name="x">')))


def test_too_many_joints_are_refused_in_advance(tmp_path: Path) -> None:
    """The message says how much memory they would take."""
    with pytest.raises(ModelError, match=r"407 degrees of freedom, more than 400.* GB"):
        pinred.load(write(tmp_path, chain(401, "revolute")))


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_memory_that_is_told() -> None:
    """The work space of Pinocchio for 150 joints takes what the refusal would say of it."""
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
    """Six joints in a row on links without mass, with a body and an arm at the end."""
    text = "".join(link(f"l{k}", 0) for k in range(6)) + link("l6") + link("arm")
    for k, (kind, axis) in enumerate(kinds):
        made = joint(f"l{k}", f"l{k + 1}", kind, AXIS.replace("0 0 1", axis))
        text += made.replace("0 0.2 0.3", "0 0 0").replace("0.1 0.2 0.3", turned)
    return robot(text, joint("l6", "arm"))


@pytest.mark.parametrize("kinds", [SLIDES + TURNS, TURNS + SLIDES, SLIDES[:2] + TURNS + SLIDES[2:]])
def test_three_slides_and_three_hinges_float(
    kinds: tuple[tuple[str, str], ...], tmp_path: Path
) -> None:
    """In any order and however they are turned, they are SE3, as in MJCF."""
    system = pinred.load(write(tmp_path, six(kinds)))
    free = pinred.load(write(tmp_path, robot(link("l6"), link("arm"), joint("l6", "arm"))))
    assert (system.group, system.shape_names) == (SE3, ("l6-arm",))
    H = [pinred.Reduction(each).mass_matrix([0.4]) for each in (system, free)]
    np.testing.assert_allclose(H[0], H[1], atol=1e-14)


def test_six_joints_that_do_not_move_everywhere(tmp_path: Path) -> None:
    """Two slides along one line leave a direction out: the joints stay what they are."""
    kinds = (SLIDES[0], SLIDES[1], SLIDES[1], *TURNS)
    with pytest.raises(ModelError, match="mass"):
        pinred.load(write(tmp_path, six(kinds, "0 0 0")))
