"""Robots with balls from files: loaded, simulated and compared with ABA."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from commands import run
from robot_texts import joint, link, robot, write
from test_merge_hinges import tree as hinged_tree
from test_mjcf_balls import DIVER, HUMANOID

import pinred
from pinred.common.arrays import Array
from pinred.system.hinge_triples import HingeTriple
from pinred.system.merge_hinges import merge_of

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*(not simulated|armature of merged hinges|singular at single shapes)"
)


def mjcf(folder: Path, text: str) -> Path:
    """Write an MJCF file."""
    path = folder / "robot.xml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "balls", "sizes"),
    [
        (DIVER, False, (7, 9)),
        pytest.param(HUMANOID, True, (7, 9), marks=pytest.mark.by_hand),
        (HUMANOID, ["head"], (7, 8)),
    ],
)
@pytest.mark.sampled
def test_balls_of_mjcf_are_simulated(
    tmp_path: Path, text: str, balls: bool | list[str], sizes: tuple[int, int]
) -> None:
    """From a keyframe, with gravity; ABA on q and v is the reference."""
    system = pinred.load(mjcf(tmp_path, text), balls=balls)
    assert (system.m, system.nx) == sizes
    start = next(iter(system.keyframes))
    traj = pinred.simulate(system, keyframe=start, duration=0.3, passive=True, friction=0.05)
    assert pinred.compare(traj).passed


def test_free_joint_of_urdf_is_simulated(tmp_path: Path) -> None:
    """A second body floats relative to the first."""
    text = robot(*(link(name) for name in "abc"), joint("a", "b", content="<axis xyz='1 0 0'/>"))
    path = write(tmp_path, text.replace("</robot>", joint("b", "c", "floating", "") + "</robot>"))
    system = pinred.load(path)
    assert (system.m, system.nx) == (7, 8)
    assert pinred.compare(pinred.simulate(system, seed=0, duration=0.3)).passed
    assert pinred.load(path, lock=["b-c"]).m == 1
    assert pinred.load(path, lock=["b-c.ball"]).m == 4


def _lock_angle(triple: HingeTriple) -> float:
    """Return the angle of the second hinge at which the first and third axes are parallel."""
    first, second, third = triple.axes
    # With right angles, the first and third axes are normal to the second.
    return float(np.arctan2(np.cross(third, first) @ second, third @ first))


def _states(model: pin.Model, triple: HingeTriple, offset: float) -> tuple[Array, ...]:
    """Return (x, ẋ) of the hinges at an offset from their lock, and of the ball."""
    rng, names = np.random.default_rng(0), list(model.names)[2:]
    x, xdot = np.zeros(len(names)), rng.normal(size=len(names))
    x[2] = _lock_angle(triple) + offset
    columns = [triple.rate(x[1:4], rate) for rate in np.eye(3)]
    xdot[1:4] = np.linalg.solve(np.array(columns).T, [1.0, 0.5, -0.7])
    entries = (dict(zip(names, values[:, None], strict=True)) for values in (x, xdot))
    ball = merge_of(model, True).values(*entries)
    return x, xdot, *(np.concatenate([*values.values()]) for values in ball)


def test_ball_takes_no_more_evaluations_near_the_gimbal_lock() -> None:
    """The hinges need ever more; their motion is that of the ball."""
    model = hinged_tree(3)
    model.gravity.linear = np.zeros(3)
    hinges, balls = pinred.load(model), pinred.load(model, balls=True)
    neck, counts = balls.contents.merged[0], []
    for offset in (0.1, 1e-2, 1e-3, 1e-4):
        x, xdot, x_ball, xdot_ball = _states(model, neck, offset)
        with_hinges, with_balls = (
            pinred.simulate(system, x0=x0, xdot0=xdot0, xi0=np.full(6, 0.3), duration=2.0)
            for system, x0, xdot0 in ((hinges, x, xdot), (balls, x_ball, xdot_ball))
        )
        attitude = neck.attitude(with_hinges.x[-1, 1:4])
        quaternion = with_balls.x[-1, 1:5]
        assert min(np.abs(attitude - s * quaternion).max() for s in (-1, 1)) < 1e-8
        counts.append((with_hinges.run.evaluations, with_balls.run.evaluations))
    evaluations = np.array(counts, dtype=float)
    assert np.ptp(evaluations[:, 1]) <= 0.05 * evaluations[0, 1]
    assert evaluations[-1, 0] > 3.0 * evaluations[-1, 1]


# The previous test has a ball in place of three hinges in a smaller file.
@pytest.mark.by_hand
def test_human_has_six_balls_and_no_singular_shapes() -> None:
    """The gimbal locks of its hinges are singular shapes, which the balls do not have."""
    pytest.importorskip("example_robot_data")
    hinges, balls = pinred.load("human"), pinred.load("human", balls=True)
    assert len(balls.contents.merged) == 6
    assert (hinges.m, balls.m, balls.nx) == (36, 36, 42)
    assert "'left_hip_Z' moves no mass at 'left_hip_X'" in hinges.doubts[0]
    assert balls.doubts == ()
    assert [left.what for left in balls.left_out if not left.demanded] == [
        "limits of merged hinges"
    ]


def test_option_of_commands_and_scene_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--balls and [load] balls act like load(balls=…); inspect lists what can be merged."""
    path = mjcf(tmp_path, HUMANOID)
    code, out, _ = run(capsys, "inspect", str(path))
    assert code == 0
    assert "headrz, headry, headrx → ball 'head', which has no gimbal lock" in out
    for option, names in (("all", "lfemur, head"), ("head,lfemurrz", "lfemur, head")):
        code, out, _ = run(capsys, "inspect", str(path), "--balls", option)
        assert code == 0
        assert out.count("(merged)") == 2, names
    for value, size in (("true", 9), ("['head']", 8), ("false", 7)):
        scene = tmp_path / "scene.toml"
        scene.write_text(
            f"robot = 'robot.xml'\nstart = {{ seed = 1 }}\nload = {{ balls = {value} }}\n"
        )
        assert pinred.load_scene(scene).system.nx == size


def test_refusals_of_load() -> None:
    """With the joint's name and a remedy."""
    model = hinged_tree(0)
    with pytest.raises(pinred.InputError, match=r"balls must be True, False, or a list of names"):
        pinred.load(model, balls="neck")
    with pytest.raises(pinred.InputError, match=r"no ball or hinge 'nose'; balls can be neck, hip"):
        pinred.load(model, balls=["nose"])
    with pytest.raises(pinred.ModelError, match=r"'jaw' is not one of three consecutive hinges"):
        pinred.load(model, balls=["jaw"])
