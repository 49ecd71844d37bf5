"""Keyframes of MuJoCo, from states of a robot that was loaded from an MJCF file."""

from __future__ import annotations

from collections.abc import Iterable
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ..locked_joints import separate_attitudes
from ..system import System
from .compile import compiled
from .equality_constraints import locked_with_followers
from .tree import RootMotion, Tree, tree_of
from .world import Joint, World, robot_in

_ITERATIONS = 50  # largest number of Newton steps for the joints of a base
_EXACT = 1e-12  # error of the pose of the base [m | rad], relative to its size


class KeyframeExport:
    """The conversion of states to MuJoCo's qpos and qvel."""

    def __init__(self, system: System) -> None:
        """Compile the file of a system again.

        Args:
            system: System that was loaded from an MJCF file.
        Raises:
            InputError: The system is not from an MJCF file, or has joints that differ from the
                file's.
        """
        origin, contents = system.origin, system.contents
        if contents.merged or contents.loops:
            raise InputError(
                f"'{system.name}': keyframes need the joints of the file; load it without balls= "
                "and without loops"
            )
        world = None if origin is None else _world_of(origin.source, origin.text, origin.root)
        if origin is None or world is None:
            raise InputError(
                f"'{system.name}': expected a robot from an MJCF file, whose keyframes have the "
                "order of its joints. Save .npz or .csv"
            )
        names = {world.joint_names[joint]: world.kind(joint) for joint in world.all_joints}
        balls = [name for name, kind in names.items() if kind == "ball"]
        changed = {
            name.removesuffix(".lock"): float(value)
            for name, value in system.parameters.items()
            if name.endswith(".lock")
        }
        values, attitudes = separate_attitudes({**origin.lock, **changed}, balls, names)
        locked, _, _ = locked_with_followers(world, values)
        self._system = system
        self._tree: Tree = tree_of(world, locked, system.gravity, attitudes=attitudes)
        self._qpos = np.array(world.model.qpos0)
        for joint, value in self._tree.locked.items():
            name, at = world.joint_names[joint], int(world.model.jnt_qposadr[joint])
            if names[name] == "ball":
                self._qpos[at : at + 4] = np.roll(attitudes.get(name, (0.0, 0.0, 0.0, 1.0)), 1)
            elif names[name] != "free":
                self._qpos[at] = value

    def state(self, pose: Array, x: Array, xi: Array, xdot: Array) -> tuple[Array, Array]:
        """Convert one state.

        Successive states start from each other's joint values, so that angles stay continuous.

        Args:
            pose: Pose of the base, (size,).
            x: Shape, (nx,) [rad | m].
            xi: Body twist of the base, (r,).
            xdot: Shape rate, (m,) [rad/s | m/s].
        Returns:
            qpos and qvel of the compiled model.
        """
        system, model = self._system, self._tree.world.model
        qpos, qvel = self._qpos.copy(), np.zeros(model.nv)
        if self._tree.root is not None:
            _set_root(system, self._tree.root, qpos, qvel, pose, xi)
        values = {joint.name: x[joint.x] for joint in system.space.joints}
        rates = {joint.name: xdot[joint.v] for joint in system.space.joints}
        for coupling in system.couplings:
            values[coupling.follower] = np.array([coupling.offset])
            rates[coupling.follower] = np.zeros(1)
            for leader, ratio in coupling.ratios.items():
                values[coupling.follower] += ratio * values[leader]
                rates[coupling.follower] += ratio * rates[leader]
        for joint in self._tree.shape:
            if joint.name in values:
                _set_joint(joint, qpos, qvel, values[joint.name], rates[joint.name])
        self._qpos = qpos
        return qpos, qvel


def write_keyframes(
    system: System, states: Iterable[tuple[float, Array, Array, Array, Array]]
) -> str:
    """Return an MJCF file of keyframes, which the robot's file can include.

    Args:
        system: System that was loaded from an MJCF file.
        states: Time [s], pose, shape, twist and shape rate of each keyframe.
    Returns:
        The XML text; keyframes are called t=0, t=0.1 and so on.
    """
    export, text = KeyframeExport(system), StringIO()
    text.write("<mujoco>\n  <keyframe>\n")
    for t, *state in states:
        qpos, qvel = (" ".join(map(repr, v.tolist())) for v in export.state(*state))
        name = quoteattr(f"t={t:.9g}")
        text.write(f'    <key name={name} time="{t!r}" qpos="{qpos}" qvel="{qvel}"/>\n')
    text.write("  </keyframe>\n</mujoco>\n")
    return text.getvalue()


def _world_of(source: str, text: str | None, root: str | None) -> World | None:
    """Return the robot in an MJCF file or text; None if it is not MJCF."""
    if text is not None:
        if "<mujoco" not in text:
            return None
        with TemporaryDirectory() as folder:
            path = Path(folder) / "robot.xml"
            path.write_text(text, encoding="utf-8")
            return robot_in(compiled(path), root, "the text")
    path = Path(source)
    if path.suffix not in (".xml", ".mjcf") or not path.is_file():
        return None
    return robot_in(compiled(path), root, source)


def _set_joint(joint: Joint, qpos: Array, qvel: Array, value: Array, rate: Array) -> None:
    """Write coordinates and rates of a slide, hinge or ball to qpos and qvel."""
    if joint.kind == "ball":
        value = np.roll(value, 1)
    qpos[joint.q_at : joint.q_at + len(value)] = value
    qvel[joint.v_at : joint.v_at + joint.nv] = rate


def _set_root(
    system: System, root: RootMotion, qpos: Array, qvel: Array, pose: Array, xi: Array
) -> None:
    """Write the motion of the base to qpos and qvel.

    Args:
        system: The system.
        root: Motion of the base.
        qpos: Coordinates, changed in place; its values start Newton's method.
        qvel: Velocities, changed in place.
        pose: Pose of the base, (size,).
        xi: Body twist of the base, (r,).
    Raises:
        InputError: The joints of the base cannot reach the pose.
    """
    *_, last = root.joints
    at = last.q_at
    if last.kind == "free":
        qpos[at : at + 3], qpos[at + 3 : at + 7] = pose[:3], np.roll(pose[3:], 1)
    elif last.kind == "ball":
        qpos[at : at + 4] = np.roll(pose[-4:], 1)
    columns = [k for joint in root.joints for k in range(joint.v_at, joint.v_at + joint.nv)]
    units = np.zeros((len(columns), len(qvel)))
    units[np.arange(len(columns)), columns] = 1.0
    moving = [joint for joint in root.joints if joint.nv == 1]
    group, size = system.group, 1.0 + float(np.abs(pose).max())
    for _ in range(_ITERATIONS):
        jacobian = np.array([root.twist(qpos, unit) for unit in units]).T
        off: Any = group.log(group.compose(group.inverse(root.pose(qpos)), pose))
        if np.abs(off).max() <= _EXACT * size:
            qvel[columns] = np.linalg.solve(jacobian, xi)
            return
        step = np.linalg.lstsq(jacobian, off, rcond=None)[0]
        for joint in moving:
            qpos[joint.q_at] += step[columns.index(joint.v_at)]
    raise InputError(
        f"'{system.name}': the joints {root.name} of the base cannot reach the pose {pose}, so it "
        "has no keyframe. Use a free joint"
    )
