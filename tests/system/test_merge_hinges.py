"""Three hinges that meet at one point at right angles become a ball that moves alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest
from trees import Rng, inertia, placement, unit

from pinred.common.arrays import Array
from pinred.common.errors import InputError, ModelError, PinredError
from pinred.system.coordinates import InitialState
from pinred.system.hinge_triples import ball_name, hinge_triples
from pinred.system.merge_hinges import Merge, merge_of, requested_balls
from pinred.system.passive import Damper, Friction, Spring

NAMES = ("neck_yaw", "neck_pitch", "neck_roll")


def perpendicular(axis: Array, rng: Rng) -> Array:
    """Return a random unit vector at a right angle to an axis."""
    other = np.cross(axis, unit(rng))
    return np.asarray(other / np.linalg.norm(other))


def along(axis: Array) -> Array:
    """Return a rotation, (3, 3), whose x axis is the given one."""
    return np.asarray(pin.Quaternion.FromTwoVectors(np.eye(3)[0], axis).toRotationMatrix())


def add_triple(model: pin.Model, parent: int, rng: Rng, names: Sequence[str] = NAMES) -> int:
    """Add three hinges through one point with random placements; return the last one.

    The axes are at right angles one after the other; the first and third have a random angle. The
    joints' origins are moved along their axes, away from the point.
    """
    # Axes in the frame of the second hinge at zero, whose origin is the common point.
    second = unit(rng)
    axes = [perpendicular(second, rng), second, perpendicular(second, rng)]
    centre, under = placement(rng), pin.SE3.Identity()
    for name, axis in zip(names, axes, strict=True):
        origin = centre * pin.SE3(along(axis), rng.uniform(-0.3, 0.3) * axis)
        joint = pin.JointModelRX() if rng.random() < 0.5 else pin.JointModelRUBX()
        parent = model.addJoint(parent, joint, under.inverse() * origin, name)
        model.addJointFrame(parent)
        under = origin
    model.appendBodyToJoint(parent, inertia(rng), placement(rng))
    model.addBodyFrame(f"{names[0]} link", parent, placement(rng), 0)
    return parent


def tree(seed: int, *, armature: float = 0.0) -> pin.Model:
    """Return a branched tree with two triples on a free base, and bodies behind them."""
    rng, model = np.random.default_rng(seed), pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(root, inertia(rng), pin.SE3.Identity())
    trunk = model.addJoint(root, pin.JointModelRX(), placement(rng), "trunk")
    model.appendBodyToJoint(trunk, inertia(rng), pin.SE3.Identity())
    neck = add_triple(model, trunk, rng)
    jaw = model.addJoint(neck, pin.JointModelPZ(), placement(rng), "jaw")
    model.appendBodyToJoint(jaw, inertia(rng), pin.SE3.Identity())
    model.addBodyFrame("tooth", jaw, placement(rng), 0)
    add_triple(model, root, rng, ("hip1", "hip2", "hip3"))
    for name in (*NAMES, "hip1", "hip2", "hip3"):
        model.armature[model.joints[model.getJointId(name)].idx_v] = armature
    return model


def value(model: pin.Model, q: Array, name: str) -> float:
    """Return the angle or displacement of a joint."""
    joint = model.joints[model.getJointId(name)]
    entries = q[joint.idx_q : joint.idx_q + joint.nq]
    return float(np.arctan2(entries[1], entries[0]) if joint.nq == 2 else entries[0])


def merged_state(model: pin.Model, merge: Merge, q: Array, v: Array) -> tuple[Array, Array]:
    """Return the state (q, v) of the merged model."""
    names = list(model.names)[2:]
    x = {name: np.array([value(model, q, name)]) for name in names}
    xdot = {name: v[[model.joints[model.getJointId(name)].idx_v]] for name in names}
    x, xdot = merge.values(x, xdot)
    assert list(x) == list(merge.model(model).names)[2:]
    return np.concatenate([q[:7], *x.values()]), np.concatenate([v[:6], *xdot.values()])


def body_motions(model: pin.Model, q: Array, v: Array, a: Array) -> Array:
    """Return places, twists and accelerations of the link frames, in one row for each."""
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    rows = []
    for k, frame in enumerate(model.frames):
        if frame.type == pin.FrameType.BODY:
            twist = pin.getFrameVelocity(model, data, k).vector
            acceleration = pin.getFrameAcceleration(model, data, k).vector
            rows.append(np.concatenate([data.oMf[k].homogeneous.ravel(), twist, acceleration]))
    return np.array(rows)


@pytest.mark.parametrize("seed", range(10))
def test_merged_tree_moves_like_the_original(seed: int) -> None:
    """Places, twists and accelerations (ABA, with gravity) of all links, away from the lock."""
    model, rng = tree(seed), np.random.default_rng(seed)
    merge = merge_of(model, True)
    assert [triple.name for triple in merge.triples] == ["neck", "hip"]
    merged = merge.model(model)
    assert (merged.nq, merged.nv) == (7 + 1 + 4 + 1 + 4, model.nv)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.6, 0.6, model.nv))
    v = rng.normal(size=model.nv)
    state = merged_state(model, merge, q, v)
    motions = []
    for other, (q_, v_) in ((model, (q, v)), (merged, state)):
        a = pin.aba(other, other.createData(), q_, v_, np.zeros(other.nv))
        motions.append(body_motions(other, q_, v_, a))
    locks = [abs(np.sin(_lock_angle(model, triple.hinges, q))) for triple in merge.triples]
    bound = 1e-13 * max(1.0, np.abs(motions[0]).max()) / min(locks) ** 2
    assert np.abs(motions[1] - motions[0]).max() <= bound


def _lock_angle(model: pin.Model, names: Sequence[str], q: Array) -> float:
    """Return the angle between the first and third axis, which vanishes at the gimbal lock."""
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    columns = [model.joints[model.getJointId(name)].idx_v for name in names]
    first, _, third = (data.J[3:, k] for k in columns)
    return float(np.arccos(np.clip(first @ third, -1.0, 1.0)))


def test_hinges_at_right_angles_reach_every_attitude() -> None:
    """The first and the third axis reach every angle only if the second is normal to both.

    The angle between them determines which attitudes are reached: cos = a₁ᵀ R(a₂, θ) a₃.
    """
    angles, rng = np.linspace(-np.pi, np.pi, 721), np.random.default_rng(0)

    def reach(axes: Array) -> tuple[float, float]:
        cosines = [axes[0] @ pin.exp3(axes[1] * angle) @ axes[2] for angle in angles]
        return min(cosines), max(cosines)

    for triple in merge_of(tree(1), True).triples:
        assert reach(triple.axes) == pytest.approx((-1.0, 1.0), abs=1e-4)
    oblique = np.array([unit(rng), unit(rng), unit(rng)])
    assert reach(oblique) != pytest.approx((-1.0, 1.0), abs=1e-2)


def test_frames_between_hinges_are_left_out() -> None:
    """Frames on the massless bodies have no place on the ball; those behind it stay."""
    model = tree(2)
    model.addBodyFrame("gimbal", model.getJointId("neck_pitch"), pin.SE3.Identity(), 0)
    merged = merge_of(model, ("neck",)).model(model)
    frames = {str(frame.name) for frame in merged.frames}
    assert frames.isdisjoint({"gimbal", *NAMES})
    assert {"neck_yaw link", "tooth", "hip1", "hip3"} <= frames


def test_selection_by_ball_or_by_hinge() -> None:
    """A list merges the named triples only."""
    model = tree(3)
    for names in (("neck",), ("neck_pitch",), ("neck", "neck_roll")):
        merge = merge_of(model, names)
        assert [triple.hinges for triple in merge.triples] == [NAMES]
    assert merge_of(model, False).model(model) is model
    assert not merge_of(model, ()).triples
    merged = merge_of(model, ("neck",)).model(model)
    assert not merge_of(merged, ("neck",)).triples  # a ball already


def test_armature_acts_equally_in_all_directions() -> None:
    """With a warning, because the hinges' armature acts along axes that are not perpendicular."""
    model = tree(4, armature=0.3)
    merge = merge_of(model, True)
    merged = merge.model(model)
    neck = merged.joints[merged.getJointId("neck")].idx_v
    assert merged.armature[neck : neck + 3].tolist() == [0.3, 0.3, 0.3]
    (warning,) = merge.warnings(model)
    assert "armature of merged hinges acts about all axes of the balls neck, hip" in warning
    assert not merge_of(tree(4), True).warnings(tree(4))


def test_initial_state_is_converted() -> None:
    """The angles become a quaternion, their rates an angular velocity."""
    model, rng = tree(5), np.random.default_rng(5)
    merge = merge_of(model, ("neck",))
    names = list(model.names)[2:]
    state = InitialState(rng.normal(size=8), rng.normal(size=8), np.zeros(6), 1.0)
    new = merge.initial(state, names)
    (triple,) = merge.triples
    assert new.x.shape == (9,)
    assert new.xdot.shape == (8,)
    assert new.x[1:5] == pytest.approx(triple.attitude(state.x[1:4]))
    # The angular velocity by a difference quotient of the attitude.
    h = 1e-6
    R = [pin.Quaternion(triple.attitude(state.x[1:4] + s * state.xdot[1:4])) for s in (-h, h)]
    numerical = pin.log3(R[0].toRotationMatrix().T @ R[1].toRotationMatrix()) / (2.0 * h)
    assert new.xdot[1:4] == pytest.approx(numerical, abs=1e-8)
    assert (new.x[5:] == state.x[4:]).all()
    assert merge_of(model, False).initial(state, names) is state


@dataclass(frozen=True)
class Case:
    """A change of a tree that forbids the ball "neck", and words of the message."""

    change: Callable[[pin.Model], object]
    words: str


def _moved(model: pin.Model) -> None:
    roll = model.getJointId("neck_roll")
    shift = pin.SE3(np.eye(3), 0.01 * np.ones(3))
    model.jointPlacements[roll] = model.jointPlacements[roll] * shift


def _tilted(model: pin.Model) -> None:
    # Tilt the last hinge about the common point.
    roll = model.getJointId("neck_roll")
    (point,) = (triple.centre for triple in hinge_triples(model) if triple.hinges == NAMES)
    tilt = pin.SE3(pin.exp3(np.array([0.3, 0.2, 0.1])), np.zeros(3))
    at = model.jointPlacements[roll] * pin.SE3(np.eye(3), point)
    about = at * tilt * at.inverse()
    model.jointPlacements[roll] = about * model.jointPlacements[roll]


def _with_armature(model: pin.Model) -> None:
    model.armature[model.joints[model.getJointId("neck_pitch")].idx_v] = 0.2


CASES = {
    "not at one point": Case(_moved, r"do not meet at one point, but miss it by 0\.0.* m; give"),
    "not at right angles": Case(_tilted, r"axes of 'neck_pitch' and 'neck_roll' are at .*° *, so"),
    "mass between": Case(
        lambda m: m.appendBodyToJoint(
            m.getJointId("neck_yaw"), pin.Inertia.Random(), pin.SE3.Identity()
        ),
        r"body between 'neck_yaw' and 'neck_pitch' has mass",
    ),
    "another child": Case(
        lambda m: m.addJoint(
            m.getJointId("neck_pitch"), pin.JointModelRX(), pin.SE3.Identity(), "ear"
        ),
        r"moved by 'neck_pitch' also carries ear",
    ),
    "armature": Case(
        _with_armature, r"their armature differs \(0, 0\.2, 0\).*Make the values equal"
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_hinges_that_are_no_ball_are_refused_by_name(name: str) -> None:
    """With the reason and a remedy, and with the balls that are possible."""
    model = tree(6)
    CASES[name].change(model)
    with pytest.raises(ModelError, match=CASES[name].words) as caught:
        merge_of(model, ("neck",))
    assert str(caught.value).startswith(
        "balls: hinges neck_yaw, neck_pitch, neck_roll cannot become a ball, because "
    )
    assert str(caught.value).endswith("(balls can be hip)")
    assert [triple.name for triple in merge_of(model, True).triples] == ["hip"]


def test_differing_springs_damping_and_friction_are_refused() -> None:
    """Equal values are left out by the name of the ball, with their coefficients."""
    model = tree(7)
    for force in (Spring, Damper, Friction):
        passive = [force(name, 2.0) for name in NAMES]
        merge = merge_of(model, True, passive=passive)
        (left_out,) = merge.left_out(passive)
        assert left_out.names == (f"neck ({force.kind} 2)",)
        assert merge.forces([*passive, Damper("jaw", 1.0)]) == (Damper("jaw", 1.0),)
        passive[1] = force("neck_pitch", 3.0)
        with pytest.raises(ModelError, match=r"differ \(neck_yaw: .* 2; neck_pitch: .* 3; .*equal"):
            merge_of(model, ("neck",), passive=passive)
        merge = merge_of(model, True, passive=passive)
        assert [triple.name for triple in merge.triples] == ["hip"]
        (warning,) = merge.warnings(model)
        assert "neck_yaw, neck_pitch, neck_roll stay hinges, although balls=True" in warning


def test_limits_of_hinges_are_left_out() -> None:
    """A ball has no limits of angles; the limits of its hinges are listed."""
    model = tree(8)
    for name in ("neck_pitch", "hip2", "jaw"):
        joint = model.joints[model.getJointId(name)]
        model.upperPositionLimit[joint.idx_q] = 0.7
    bounded = [n for n in ("neck_pitch", "hip2") if model.joints[model.getJointId(n)].nq == 1]
    names = [name for left_out in merge_of(model, True).limits(model) for name in left_out.names]
    assert names == [n for n in (*NAMES, "hip1", "hip2", "hip3") if _limited(model, n)]
    assert {*bounded} <= {*names}
    merged = merge_of(model, True).model(model)
    neck = merged.joints[merged.getJointId("neck")].idx_q
    assert np.isinf(merged.upperPositionLimit[neck : neck + 4]).all()


def _limited(model: pin.Model, name: str) -> bool:
    joint = model.joints[model.getJointId(name)]
    limits = (model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q])
    return joint.nq == 1 and bool(np.isfinite(limits).any())


@pytest.mark.parametrize(
    ("balls", "error", "words"),
    [
        (("tail",), InputError, r"no ball or hinge 'tail'; balls can be neck, hip"),
        (("jaw",), ModelError, r"joint 'jaw' is not one of three consecutive hinges"),
        (("base",), ModelError, r"joint 'base' moves the root"),
    ],
)
def test_unknown_and_other_joints_are_refused(
    balls: tuple[str, ...], error: type[PinredError], words: str
) -> None:
    """Valid names are listed."""
    with pytest.raises(error, match=words):
        merge_of(tree(9), balls)


def test_locked_and_coupled_hinges_are_refused() -> None:
    """They must stay joints."""
    with pytest.raises(ModelError, match="neck_roll must stay, locked or coupled"):
        merge_of(tree(9), ("neck",), kept=["neck_roll"])


@pytest.mark.parametrize("balls", ["neck", 3, [1, 2], None])
def test_option_that_is_not_a_list_of_names_is_refused(balls: object) -> None:
    """Text is no list."""
    with pytest.raises(InputError, match="balls must be True, False, or a list of names"):
        requested_balls(balls)  # type: ignore[arg-type]
    assert requested_balls(["a", "a", "b"]) == ("a", "b")


def test_four_hinges_at_one_point_give_one_ball() -> None:
    """A joint is in one ball only; the last hinge stays."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(root, pin.Inertia.Random(), pin.SE3.Identity())
    parent = root
    for k, kind in enumerate("XYZX"):
        joint = getattr(pin, f"JointModelR{kind}")()
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"wrist{k}")
    model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Identity())
    merged = merge_of(model, True).model(model)
    assert list(merged.names)[1:] == ["base", "wrist", "wrist3"]


def test_hinges_on_a_massless_ground_are_the_root() -> None:
    """They set the symmetry group, so they are no ball of the shape."""
    model = pin.Model()
    add_triple(model, 0, np.random.default_rng(0))
    assert not merge_of(model, True).triples


@pytest.mark.parametrize(
    ("hinges", "links", "name"),
    [
        (("right_hip_x", "right_hip_z", "right_hip_y"), ["right_thigh"], "right_hip"),
        (("lfemurrz", "lfemurry", "lfemurrx"), ["lfemur"], "lfemur"),
        (("shoulderx", "shouldery", "shoulderz"), ["arm"], "shoulder"),
        (("neck_yaw", "neck_pitch", "neck_roll"), [], "neck"),
        (("j.yaw", "j.pitch", "j.roll"), [], "j"),
        (("yaw", "pitch", "roll"), [], "yaw"),
        (("torso_hinge", "torso_hinge2", "torso_hinge3"), ["torso"], "torso_hinge"),
    ],
)
def test_name_of_ball(hinges: tuple[str, ...], links: list[str], name: str) -> None:
    """The common beginning of the hinges' names, or the first name."""
    assert ball_name(hinges, links) == name


def test_names_of_balls_are_unique() -> None:
    """Balls with the name of a joint, or with the same name, are named after their first hinges."""
    rng, model = np.random.default_rng(0), pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "arm")
    model.appendBodyToJoint(root, inertia(rng), pin.SE3.Identity())
    add_triple(model, root, rng, ("arm1", "arm2", "arm3"))
    add_triple(model, root, rng, ("leg1", "leg2", "leg3"))
    add_triple(model, root, rng, ("leg4", "leg5", "leg6"))
    assert [t.name for t in merge_of(model, True).triples] == ["arm1", "leg1", "leg4"]
