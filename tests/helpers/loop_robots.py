"""Robots with closed loops for tests: four-bar, gripper, delta, Cassie-like biped, random trees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from pinred.common.arrays import Array
from pinred.system.loops.loop import Loop, LoopKind

FOUR_BAR = {"crank": 0.4, "coupler": 0.9, "rocker": 0.8, "frame": 1.0}  # lengths [m]


def four_bar(
    kind: LoopKind = "3d", lengths: Mapping[str, float] = FOUR_BAR, *, ball: bool = False
) -> tuple[pin.Model, list[Loop]]:
    """Return a four-bar linkage whose frame floats in the plane, and its loop.

    The crank and the rocker are hinged to the frame; the coupler is hinged to the crank, or with
    `ball` attached by a ball.
    """
    model = pin.Model()
    model.name = "four_bar"
    model.gravity.setZero()
    base = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "base")
    joints = {"frame": base}
    for name, parent, x in (
        ("crank", "frame", 0.0),
        ("coupler", "crank", lengths["crank"]),
        ("rocker", "frame", lengths["frame"]),
    ):
        at = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        joint = pin.JointModelSpherical() if ball and name == "coupler" else pin.JointModelRZ()
        joints[name] = model.addJoint(joints[parent], joint, at, name)
    for k, (name, joint) in enumerate(joints.items()):
        length, mass = lengths[name], 3.0 / (k + 1)
        lever = np.array([0.5 * length, 0.0, 0.0])
        inertia = pin.Inertia(mass, lever, mass * length**2 / 12.0 * np.diag([0.1, 1.0, 1.0]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addJointFrame(joint)
        tip = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
        frame = pin.Frame(f"{name}_tip", joint, 0, tip, pin.FrameType.OP_FRAME)
        model.addFrame(frame)
    return model, [Loop("coupler_tip", "rocker_tip", kind, "tips")]


def five_bar() -> tuple[pin.Model, list[Loop]]:
    """Return a five-bar linkage whose frame floats in the plane: two cranks, two couplers."""
    model = pin.Model()
    model.name = "five_bar"
    model.gravity.setZero()
    base = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "base")
    lever = np.array([0.5, 0.0, 0.0])
    model.appendBodyToJoint(base, _bar(2.0, 1.0), pin.SE3(np.eye(3), lever))
    model.addJointFrame(base)
    frame_type = pin.FrameType.OP_FRAME
    for side, x in (("left", 0.0), ("right", 1.0)):
        parent, at = base, x
        for name, length in ((f"{side}_crank", 0.5), (f"{side}_coupler", 0.9)):
            place = pin.SE3(np.eye(3), np.array([at, 0.0, 0.0]))
            parent = model.addJoint(parent, pin.JointModelRZ(), place, name)
            model.appendBodyToJoint(
                parent, _bar(length, length), pin.SE3(np.eye(3), length * lever)
            )
            model.addJointFrame(parent)
            at = length
        tip = pin.SE3(np.eye(3), np.array([at, 0.0, 0.0]))
        model.addFrame(pin.Frame(f"{side}_tip", parent, 0, tip, frame_type))
    return model, [Loop("left_tip", "right_tip", "3d", "tips")]


def sliding_bars() -> tuple[pin.Model, list[Loop]]:
    """Return a floating bar with a sliding arm and a jointed arm, welded together in the plane."""
    model = pin.Model()
    model.name = "sliding_bars"
    model.gravity.setZero()
    base = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, _bar(2.0, 1.0), pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])))
    arms = (
        (0.0, 0.9, (pin.JointModelRZ(), pin.JointModelPX())),
        (1.0, 1.2, (pin.JointModelRZ(), pin.JointModelRZ())),
    )
    frame_type = pin.FrameType.OP_FRAME
    for x, angle, joints in arms:
        parent, place = base, pin.SE3(pin.utils.rotate("z", angle), np.array([x, 0.0, 0.0]))
        for k, joint in enumerate(joints):
            parent = model.addJoint(parent, joint, place, f"arm{x:.0f}_{k}")
            body = pin.SE3(np.eye(3), np.array([0.3, 0.1, 0.0]))
            model.appendBodyToJoint(parent, _bar(1.0, 0.6), body)
            place = pin.SE3(pin.utils.rotate("z", 0.5), np.array([0.6, 0.0, 0.0]))
        model.addFrame(pin.Frame(f"end{x:.0f}", parent, 0, place, frame_type))
    data, ends = model.createData(), [model.getFrameId(name) for name in ("end0", "end1")]
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    gap = data.oMf[ends[1]].actInv(data.oMf[ends[0]])
    model.frames[ends[1]].placement = model.frames[ends[1]].placement * gap
    return model, [Loop("end0", "end1", "6d", "weld")]


def _bar(mass: float, length: float) -> pin.Inertia:
    return pin.Inertia(mass, np.zeros(3), mass * length**2 / 12.0 * np.diag([0.1, 1.0, 1.0]))


def crank_angles(crank: float, branch: float = -1.0) -> tuple[float, float]:
    """Return the angles of coupler and rocker of the four-bar at a crank angle, in closed form.

    The tips meet where two circles intersect: below the line from the crank's tip to the rocker's
    hinge on branch −1, above it on branch 1.
    """
    a, b, c, d = (FOUR_BAR[name] for name in ("crank", "coupler", "rocker", "frame"))
    tip = a * np.exp(1j * crank)
    across = d - tip
    inner = np.arccos((abs(across) ** 2 + b**2 - c**2) / (2.0 * abs(across) * b))
    end = tip + b * np.exp(1j * (np.angle(across) + branch * inner))
    return float(np.angle(end - tip) - crank), float(np.angle(end - d))


def random_loops(
    seed: int, kinds: tuple[LoopKind, ...], joints: int | Sequence[int] = 9, *, balls: bool = False
) -> tuple[pin.Model, list[Loop]]:
    """Return a random floating tree with a loop of each kind that closes at a random shape.

    Each loop ties the ends of two random branches.  `joints` is the number of joints of a branch,
    or of each branch.  With `balls` the first joint of each branch is a ball.
    """
    lengths = [joints] * (2 * len(kinds)) if isinstance(joints, int) else list(joints)
    rng, model = np.random.default_rng(seed), pin.Model()
    model.name = f"random_loops_{seed}"
    model.gravity.setZero()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, _inertia(rng, 4.0), pin.SE3.Identity())
    loops, ends = [], []
    for k, length in enumerate(lengths):
        parent = base
        for n in range(length):
            at = pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3))
            axis = rng.normal(size=3)
            joint = pin.JointModelRevoluteUnaligned(*(axis / np.linalg.norm(axis)))
            if n == 0 and balls:
                joint = pin.JointModelSpherical()
            elif n == 1:
                joint = pin.JointModelPrismaticUnaligned(*(axis / np.linalg.norm(axis)))
            parent = model.addJoint(parent, joint, at, f"j{k}_{n}")
            model.appendBodyToJoint(parent, _inertia(rng, 1.0), pin.SE3.Identity())
        ends.append(parent)
    data = model.createData()
    q = pin.integrate(model, pin.neutral(model), 0.3 * rng.normal(size=model.nv))
    pin.forwardKinematics(model, data, q)
    for k, kind in enumerate(kinds):
        a, b = ends[2 * k : 2 * k + 2]
        placement = pin.SE3(pin.exp3(rng.normal(size=3)), 0.1 * rng.normal(size=3))
        other = data.oMi[b].actInv(data.oMi[a] * placement)
        for joint, at, name in ((a, placement, f"a{k}"), (b, other, f"b{k}")):
            model.addFrame(pin.Frame(name, joint, 0, at, pin.FrameType.OP_FRAME))
        loops.append(Loop(f"a{k}", f"b{k}", kind))
    return model, loops


def planar_legs(seed: int = 0) -> tuple[pin.Model, list[Loop]]:
    """Return a floating body with three planar legs of four hinges, and two more hinges.

    Each leg closes by a weld, whose six equations have rank three: 14 joints, 18 equations of rank
    9.
    """
    rng, model = np.random.default_rng(seed), pin.Model()
    model.name = "planar_legs"
    model.gravity.setZero()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, _inertia(rng, 4.0), pin.SE3.Identity())
    frame_type, loops = pin.FrameType.OP_FRAME, []
    for leg in range(3):
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, 2.0 * np.pi * leg / 3.0)
        at = pin.SE3(turn, turn @ np.array([0.3, 0.0, 0.0]))
        points = [(0.0, 0.0), (0.4, -0.3), (0.1, -0.8), (-0.2, -0.4)]  # a quadrangle in x and z
        parent, place = base, at
        for k in range(4):
            start, end = (np.array([x, 0.0, z]) for x, z in (points[k], points[(k + 1) % 4]))
            parent = model.addJoint(parent, pin.JointModelRY(), place, f"leg{leg}_{k}")
            model.appendBodyToJoint(parent, _inertia(rng, 0.5), pin.SE3.Identity())
            place = pin.SE3(np.eye(3), end - start)
        model.addFrame(pin.Frame(f"end{leg}", parent, 0, place, frame_type))
        model.addFrame(pin.Frame(f"hip{leg}", base, 0, at, frame_type))
        loops.append(Loop(f"hip{leg}", f"end{leg}", "6d", f"leg{leg}"))
    parent = base
    for k in range(2):
        at = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3]))
        parent = model.addJoint(parent, pin.JointModelRX(), at, f"arm{k}")
        model.appendBodyToJoint(parent, _inertia(rng, 0.5), pin.SE3.Identity())
    return model, loops


def _inertia(rng: np.random.Generator, mass: float) -> pin.Inertia:
    A = 0.1 * rng.normal(size=(3, 3))
    spread: Array = mass * A @ A.T
    return pin.Inertia(mass, 0.1 * rng.normal(size=3), np.trace(spread) * np.eye(3) - spread)


GRIPPER = """
<mujoco model="gripper">
  <option gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <body name="palm" pos="0 0 0">
      <freejoint name="float"/>
      <geom type="box" size="0.03 0.05 0.02" mass="0.8"/>
      {fingers}
    </body>
  </worldbody>
  <equality>
    <connect name="right" body1="right_follower" body2="right_finger" anchor="-0.018 0 0.0655"/>
    <connect name="left" body1="left_follower" body2="left_finger" anchor="-0.018 0 0.0655"/>
    <joint name="both" joint1="left_driver" joint2="right_driver"/>
  </equality>
</mujoco>
"""
_FINGER = """
<body name="{side}_base" pos="0 {y} 0.02" quat="{quat}">
  <body name="{side}_driver" pos="0 0.01 0.035">
    <joint name="{side}_driver" axis="1 0 0" armature="0.0005"/>
    <geom type="box" size="0.005 0.01 0.02" pos="0 0.015 0.02" mass="0.02"/>
    <body name="{side}_finger" pos="0 0.032 0.041">
      <joint name="{side}_finger" axis="1 0 0" armature="0.0001"/>
      <geom type="box" size="0.01 0.005 0.03" pos="0 0 0.03" mass="0.05"/>
    </body>
  </body>
  <body name="{side}_follower" pos="0 0.012 0.001">
    <joint name="{side}_follower" axis="1 0 0" armature="0.0001"/>
    <geom type="box" size="0.005 0.005 0.03" pos="0 0.02 0.03" mass="0.02"/>
  </body>
</body>
"""


def gripper() -> str:
    """Return a floating gripper in MJCF, in the manner of the Robotiq 2F-85.

    Two fingers on four-bars, closed by connect constraints; the left driver follows the right one.
    """
    sides = (("right", -0.01, "0 0 0 1"), ("left", 0.01, "1 0 0 0"))
    fingers = "".join(_FINGER.format(side=s, y=y, quat=q) for s, y, q in sides)
    return GRIPPER.format(fingers=fingers)


def delta() -> tuple[pin.Model, list[Loop]]:
    """Return a planar delta robot whose base floats, in the manner of robot_delta.

    Two arms of two bars carry an effector.  Two more bars with a transmission between them keep its
    attitude.  The loops are cut at balls that the URDF writes as hinges, so that each pair of balls
    spins: 14 joints, 18 equations of rank 9, closed shapes of dimension 5.  The bars are not exact
    parallelograms.
    """
    model = pin.Model()
    model.name = "delta"
    model.gravity.setZero()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, _bar(0.2, 0.2), pin.SE3.Identity())
    model.addJointFrame(base)
    at = {"base": (base, 0.0, 0.0)}  # joint, and its place in the plane of x and z at rest

    def add(name: str, parent: str, x: float, z: float, mass: float = 0.05) -> None:
        joint, x0, z0 = at[parent]
        place = pin.SE3(np.eye(3), np.array([x - x0, 0.0, z - z0]))
        index = model.addJoint(joint, pin.JointModelRY(), place, name)
        model.appendBodyToJoint(index, _bar(mass, 0.06), pin.SE3(np.eye(3), 0.01 * np.ones(3)))
        model.addJointFrame(index)
        at[name] = (index, x, z)

    left, right, elbow, other = (-0.01, 0.0), (0.012, 0.0), (-0.05, -0.02), (0.055, -0.024)
    tip, lift = (0.004, -0.075), (0.007, 0.018)
    add("left_arm", "base", *left)
    add("left_rod", "left_arm", *elbow)
    add("effector", "left_rod", *tip)
    add("right_arm", "base", *right)
    add("right_rod", "right_arm", *other)
    up, knee = (left[0] - 0.008, left[1] + 0.02), (elbow[0] - 0.007, elbow[1] + 0.021)
    hand = (tip[0] + lift[0], tip[1] + lift[1])
    add("transmission_bar", "base", *up)
    add("transmission", "left_arm", *elbow)
    add("transmission_rod", "transmission", elbow[0] + 0.008, elbow[1] + 0.017)
    pairs = (
        ("transmission_bar", "transmission", knee),
        ("right_rod", "effector", (tip[0] + 0.011, tip[1])),
        ("transmission_rod", "effector", hand),
    )
    loops = []
    for k, (first, second, (x, z)) in enumerate(pairs):
        for side, parent in (("A", first), ("B", second)):
            add(f"ball{k}{side}", parent, x, z, 0.005)
        loops.append(Loop(f"ball{k}A", f"ball{k}B", "6d"))
    return model, loops


_LEG = """
<body name="{s}_hip" pos="0 {y} 0"><joint name="{s}_roll" axis="1 0 0"/>
 <geom size=".04" pos="-.02 0 .01" mass="1.8"/>
 <body name="{s}_pelvis" pos=".02 0 -.05"><joint name="{s}_yaw" axis="0 .1 1"/>
  <geom size=".04" pos="0 .01 -.03" mass="1.2"/>
  <body name="{s}_thigh" pos="0 0 -.06"><joint name="{s}_pitch" axis="0 1 0"/>
   <geom size=".05" pos=".05 0 -.06" mass="5.5"/>
   <body name="{s}_rod" pos=".02 .045 0"><joint name="{s}_rod" type="ball"/>
    <geom type="capsule" size=".01" fromto="0 0 0 -.05 0 -.48" mass=".16"/></body>
   <body name="{s}_knee" pos=".12 0 -.05"><joint name="{s}_knee" axis="0 1 0"/>
    <geom size=".03" pos=".02 0 -.02" mass=".76"/>
    <body name="{s}_shin" pos=".06 0 -.04"><joint name="{s}_shin" axis="0 1 0" stiffness="1500"/>
     <geom size=".03" pos="-.03 0 -.15" mass=".58"/>
     <body name="{s}_tarsus" pos="-.05 0 -.42"><joint name="{s}_tarsus" axis="0 1 0"/>
      <geom size=".03" pos="-.08 0 -.1" mass=".78"/>
      <body name="{s}_heel" pos="-.02 0 .02">
       <joint name="{s}_heel" axis="0 1 .05" stiffness="1250"/>
       <geom type="capsule" size=".01" fromto="0 0 0 -.11 .045 .02" mass=".13"/></body>
      <body name="{s}_crank" pos="-.06 0 -.05"><joint name="{s}_crank" axis="0 1 0"/>
       <geom size=".02" pos="0 0 -.02" mass=".12"/>
       <body name="{s}_plantar" pos=".05 0 -.02"><joint name="{s}_plantar" axis="0 1 0"/>
        <geom type="capsule" size=".01" fromto="0 0 0 -.21 0 -.22" mass=".12"/></body></body>
      <body name="{s}_foot" pos="-.25 0 -.25"><joint name="{s}_foot" axis="0 1 0"/>
       <geom size=".03" pos=".02 0 -.03" mass=".15"/></body>
     </body></body></body></body></body></body>
"""


def cassie_like() -> str:
    """Return a biped with the joints and loops of Cassie in MJCF: 12 equations of rank 10.

    A rod on a ball at the hip meets the heel spring at a point, and the plantar rod meets the foot.
    """
    legs = "".join(_LEG.format(s=s, y=y) for s, y in (("left", 0.13), ("right", -0.13)))
    ties = "".join(
        f'<connect name="{s}_achilles" body1="{s}_heel" body2="{s}_rod" anchor="-.11 .045 .02"/>'
        f'<connect name="{s}_plantar" body1="{s}_foot" body2="{s}_plantar" anchor=".04 0 .02"/>'
        for s in ("left", "right")
    )
    return (
        '<mujoco model="cassie_like"><compiler angle="radian"/>'
        '<option gravity="0 0 0"><flag contact="disable"/></option><worldbody>'
        f'<body name="body" pos="0 0 0"><freejoint/><geom size=".12" mass="10"/>{legs}</body>'
        f"</worldbody><equality>{ties}</equality></mujoco>"
    )
