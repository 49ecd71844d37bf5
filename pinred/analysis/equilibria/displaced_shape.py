"""Shapes displaced along the frame, as CasADi expressions."""

from __future__ import annotations

import casadi as ca

from ...system.coordinates import ShapeSpace


def displaced_shape(space: ShapeSpace, x: ca.SX, w: ca.SX) -> ca.SX:
    """Return x exp(w), (nx,), up to terms of second order in w.

    Args:
        space: Manifold of the shapes.
        x: Shape, (nx,).
        w: Displacement along the frame, (m,).
    """
    shape = ca.SX(space.nx, 1)
    for joint in space.joints:
        q, v = x[joint.x.start : joint.x.stop], w[joint.v.start : joint.v.stop]
        if joint.kind.is_ball:
            real = 1.0 - ca.sumsqr(v) / 8.0
            vector = real * q[:3] + 0.5 * (q[3] * v + ca.cross(q[:3], v))
            shape[joint.x] = ca.vertcat(vector, real * q[3] - 0.5 * ca.dot(q[:3], v))
        else:
            shape[joint.x] = q + v
    return shape
