"""Random pairs of robots whose frames meet, and the impulse of their capture by multipliers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pinocchio as pin
from ball_trees import ball_tree
from coupled_trees import make_case
from loop_robots import random_loops
from trees import placement, random_model

import pinred
from pinred.common.arrays import Array
from pinred.system.loops.loop import Loop, LoopKind
from pinred.system.robot_file_contents import Contents
from pinred.system.system import System

LOCAL = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
Twists = dict[str, Array]


@dataclass(frozen=True)
class Pair:
    """Two robots, the second with the pose at which its frame "tip" meets that of the first.

    Attributes:
        a: Scene of the first.
        b: Scene of the second.
    """

    a: pinred.Scene
    b: pinred.Scene


def framed(system: System, rng: np.random.Generator, *, flat: bool = False) -> System:
    """Return a system with a link for each joint, and a frame "tip" on a random link."""
    model = framed_model(system.model, rng, flat=flat)
    return System(model, system.name, contents=system.contents)


def framed_model(model: pin.Model, rng: np.random.Generator, *, flat: bool = False) -> pin.Model:
    """Return a copy with a link for each joint, and a frame "tip" on a random link."""
    model = model.copy()
    for joint in range(1, model.njoints):
        link = pin.Frame(f"link {joint}", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY)
        model.addFrame(link, False)
    joint = int(rng.integers(1, model.njoints))
    at = placement(rng)
    if flat:
        at = pin.SE3(np.eye(3), np.array([*at.translation[:2], 0.0]))
    number = model.getFrameId(f"link {joint}", pin.FrameType.BODY)
    model.addFrame(pin.Frame("tip", joint, number, at, pin.FrameType.OP_FRAME), False)
    return model


def flat_tree(seed: int, joints: int) -> System:
    """Return a planar tree of hinges, and slides in the plane."""
    rng, model = np.random.default_rng(seed), pin.Model()
    model.gravity.setZero()
    model.name = f"flat {seed}"
    root = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root")
    bodies = [root]
    for k in range(joints):
        kind = pin.JointModelRZ() if rng.random() < 0.7 else pin.JointModelPY()
        at = pin.SE3(
            pin.utils.rotate("z", rng.uniform(-2, 2)), np.array([*rng.normal(size=2), 0.0])
        )
        bodies.append(model.addJoint(int(rng.integers(1, model.njoints)), kind, at, f"j{k}"))
    for body in bodies:
        com = np.array([*0.3 * rng.normal(size=2), 0.0])
        inertia = pin.Inertia(rng.uniform(0.5, 2.0), com, rng.uniform(0.1, 0.5) * np.eye(3))
        model.appendBodyToJoint(body, inertia, pin.SE3.Identity())
    return System(model, model.name)


def random_robot(kind: str, seed: int, rng: np.random.Generator) -> System:
    """Return a robot with balls, followers, loops, all hinges and slides, or in a plane."""
    joints = int(rng.integers(1, 7))
    if kind == "balls":
        return framed(ball_tree(seed, joints), rng)
    if kind == "followers":
        return framed(make_case("SE3", joints + 2, seed).system, rng)
    if kind == "loops":
        loop_kinds: tuple[LoopKind, ...] = ("3d", "6d", "z")
        model, loops = random_loops(seed, (loop_kinds[seed % 3],), 4, balls=seed % 2 > 0)
        model = framed_model(model, rng)
        return System(model, model.name, contents=Contents(loops=tuple(loops)))
    if kind == "flat":
        return framed(flat_tree(seed, joints), rng, flat=True)
    model = random_model("SE3", joints, seed)
    model.gravity.setZero()
    return framed(System(model, f"tree {seed}"), rng)


@cache
def make_pair(kind: str, seed: int) -> Pair:
    """Return a random pair; both robots have the same kind and the same names."""
    rng = np.random.default_rng(seed)
    first, second = (random_robot(kind, 2 * seed + k, rng) for k in (0, 1))
    a, b = (pinred.Scene(system=s, seed=int(rng.integers(1000))) for s in (first, second))
    starts = a.start, b.start
    pose = first.group.exp(rng.normal(size=first.r))
    a = pinred.Scene(
        system=first, pose0=pose, x0=starts[0].x, xdot0=starts[0].xdot, xi0=rng.normal(size=first.r)
    )
    meeting = frame_of(first, pose, starts[0].x)
    onto = frame_of(second, second.group.identity(), starts[1].x)
    place = second.model.jointPlacements[1]
    target = place.inverse() * meeting * onto.inverse() * place
    if kind == "flat":
        angle = np.arctan2(target.rotation[1, 0], target.rotation[0, 0])
        pose_b = np.array([*target.translation[:2], angle])
    else:
        pose_b = pin.SE3ToXYZQUAT(target)
    b = pinred.Scene(
        system=second, pose0=pose_b, x0=starts[1].x, xdot0=starts[1].xdot,
        xi0=rng.normal(size=second.r),
    )  # fmt: skip
    return Pair(a, b)


def frame_of(system: System, pose: Array, x: Array, name: str = "tip") -> pin.SE3:
    """Return the placement of a frame in the world."""
    model, data = system.model, system.model.createData()
    pin.framesForwardKinematics(model, data, system.q(pose, x))
    return data.oMf[model.getFrameId(name)].copy()


class Full:
    """A robot with all joints of its model: mass matrix, velocities, and rows of constraints.

    Attributes:
        inner: Rows that vanish if followers follow and loops stay closed.
    """

    def __init__(self, scene: pinred.Scene) -> None:
        """Compute the mass matrix at the start of a scene."""
        system, start = scene.system, scene.start
        self.model, self.data = system.sorted_model, system.sorted_model.createData()
        self.q = system.sorted_q(start.pose, start.x)
        self.v = system.sorted_v(start.xi, start.xdot)
        upper = np.triu(pin.crba(self.model, self.data, self.q))
        self.H = upper + np.triu(upper, 1).T
        followers = np.zeros((len(system.couplings), self.model.nv))
        for row, coupling in zip(followers, system.couplings, strict=True):
            for name, ratio in {
                coupling.follower: 1.0,
                **{k: -r for k, r in coupling.ratios.items()},
            }.items():
                row[self.model.joints[self.model.getJointId(name)].idx_v] = ratio
        self.inner = np.vstack([followers, *(self.loop_rows(loop) for loop in system.loops)])

    def loop_rows(self, loop: object) -> Array:
        """Return rows that vanish if both frames of a loop, which coincide, move alike."""
        assert isinstance(loop, Loop)
        apart = self.rows(loop.frame_a) - self.rows(loop.frame_b)
        turns = self.data.oMf[self.model.getFrameId(loop.frame_a)].rotation.T @ apart[3:]
        kept = {"3d": [], "6d": [0, 1, 2]}.get(
            loop.kind, [k for k in range(3) if "xyz"[k] != loop.kind]
        )
        return np.vstack([apart[:3], turns[kept]])

    def rows(self, frame: str) -> Array:
        """Return the Jacobian of a frame in world axes, (6, nv)."""
        pin.computeJointJacobians(self.model, self.data, self.q)
        pin.updateFramePlacements(self.model, self.data)
        return np.array(
            pin.getFrameJacobian(self.model, self.data, self.model.getFrameId(frame), LOCAL)
        )

    def placement(self) -> pin.SE3:
        """Return the placement of the root body in the world."""
        pin.forwardKinematics(self.model, self.data, self.q)
        return self.data.oMi[1].copy()

    def twists(self, v: Array, prefix: str = "") -> Twists:
        """Return the twists of all links in world axes."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, self.q, v)
        pin.updateFramePlacements(self.model, data)
        return {
            prefix + frame.name: pin.getFrameVelocity(self.model, data, k, LOCAL).vector
            for k, frame in enumerate(self.model.frames)
            if frame.type == pin.FrameType.BODY and frame.parentJoint
        }

    def momentum(self, v: Array) -> Array:
        """Return the momentum about the origin of the world, (6,)."""
        data = self.model.createData()
        pin.computeCentroidalMomentum(self.model, data, self.q, v)
        return np.array(pin.SE3(np.eye(3), data.com[0]).act(data.hg).vector)


def stop(H: Array, rows: Array, v: Array) -> tuple[Array, Array]:
    """Return velocities after an impact at which rows v = 0, and multipliers, by projection."""
    L = np.linalg.cholesky(H)
    K = np.linalg.solve(L, rows.T)
    multipliers = -np.asarray(np.linalg.lstsq(K, L.T @ v, rcond=1e-11)[0], dtype=float)
    return v + np.linalg.solve(L.T, K @ multipliers), multipliers
