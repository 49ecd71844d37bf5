"""Random MJCF trees with springs, dampers and friction, and the forces that MuJoCo computes."""

from __future__ import annotations

from typing import Any

import mujoco as mj
import numpy as np

from pinred.common.arrays import Array

_HEAD = '<option gravity="0 0 0"/><default><geom contype="0" conaffinity="0"/></default>'


def passive_tree(seed: int, joints: int = 6, *, smooth: bool = False) -> str:
    """Return a floating tree of hinges and slides with all kinds of passive forces.

    smooth: without terms in |v|.
    """
    rng = np.random.default_rng(seed)
    bodies: list[list[str]] = [[] for _ in range(joints + 1)]
    heads = []
    for k in range(joints):
        kind = rng.choice(["hinge", "slide"])
        axis, position, size = (
            rng.normal(size=3),
            rng.uniform(-0.3, 0.3, 3),
            rng.uniform(0.1, 0.3, 3),
        )
        stiff, damp = rng.uniform(0.5, 4.0, 3), rng.uniform(0.05, 0.4, 3)
        damp *= [1.0, 0.0 if smooth else 1.0, 1.0]
        count = rng.integers(1, 4)  # number of polynomial coefficients
        values = {
            "stiffness": _words(stiff[:count] * [1.0, 0.3, 1.0][:count]),
            "damping": _words(damp[: rng.integers(1, 4)]),
            "frictionloss": _words(rng.uniform(0.1, 0.5, 1)),
            "springref": _words(rng.uniform(-0.4, 0.4, 1)),
            "ref": _words(rng.uniform(-0.4, 0.4, 1)),
        }
        for name in rng.choice(list(values), rng.integers(0, 3), replace=False):
            del values[name]
        attributes = " ".join(f'{key}="{value}"' for key, value in values.items())
        heads.append(
            f'<body name="b{k}" pos="{_words(position)}">'
            f'<joint name="j{k}" type="{kind}" axis="{_words(axis)}" {attributes}/>'
            f'<geom type="ellipsoid" size="{_words(size)}" density="100"/>'
        )
        bodies[rng.integers(0, k + 1)].append(str(k + 1))

    def text(body: int) -> str:
        children = "".join(text(int(child)) for child in bodies[body])
        return f"{heads[body - 1]}{children}</body>" if body else children

    base = f'<body name="base"><freejoint/><geom size=".3" density="100"/>{text(0)}</body>'
    angles = '<compiler angle="radian"/>'
    return f"<mujoco>{angles}{_HEAD}<worldbody>{base}</worldbody></mujoco>"


class MujocoForces:
    """Spring and damper forces that MuJoCo computes for a file."""

    def __init__(self, text: str, joints: tuple[str, ...]) -> None:
        """Compile the file.  joints: names of the joints, in the order of the forces."""
        self.model: Any = mj.MjModel.from_xml_string(text)
        self.data: Any = mj.MjData(self.model)
        ids = [self.model.joint(name).id for name in joints]
        self.q_at = [int(self.model.jnt_qposadr[j]) for j in ids]
        self.v_at = [int(self.model.jnt_dofadr[j]) for j in ids]

    def at(self, x: Array, xdot: Array) -> Array:
        """Return qfrc_spring + qfrc_damper, (m,), at a shape and its rate."""
        self.data.qpos[self.q_at], self.data.qvel[self.v_at] = x, xdot
        mj.mj_fwdPosition(self.model, self.data)
        mj.mj_fwdVelocity(self.model, self.data)
        return np.array((self.data.qfrc_spring + self.data.qfrc_damper)[self.v_at])

    def frictionloss(self) -> Array:
        """Return the dry friction of each joint, (m,)."""
        return np.array(self.model.dof_frictionloss[self.v_at])


def _words(numbers: Any) -> str:
    return " ".join(f"{value:.6g}" for value in np.atleast_1d(numbers))
