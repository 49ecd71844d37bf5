"""Random trees with massless or point-like bodies and with coincident axes."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from trees import JOINTS, ROOTS, inertia, placement, unit

from pinred.common.arrays import Array

Rng = np.random.Generator
_POINT = np.zeros((3, 3))


def odd_inertia(rng: Rng, kind: int) -> pin.Inertia:
    """Return an unusual body.

    Kinds 0 to 6: empty, point mass, rod, point mass with one moment, one moment without mass,
    moments that no mass distribution has, and a regular body.
    """
    lever = rng.choice([np.zeros(3), np.eye(3)[rng.integers(3)], unit(rng)]) * 0.4
    mass = float(rng.uniform(0.5, 2.0))
    axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.7 else unit(rng)
    projector = np.outer(axis, axis)
    rod = (np.eye(3) - projector) * 0.05
    return [
        pin.Inertia(0.0, np.zeros(3), _POINT),
        pin.Inertia(mass, lever, _POINT),
        pin.Inertia(mass, lever, rod),
        pin.Inertia(mass, lever, projector * 0.05),
        pin.Inertia(0.0, np.zeros(3), projector * 0.05),
        pin.Inertia(mass, lever, np.eye(3) * 0.01 + projector * 0.05),
        inertia(rng),
    ][kind]


def odd_placement(rng: Rng) -> pin.SE3:
    """Return a random placement, often with quarter turns and a step along an axis."""
    if rng.random() < 0.3:
        return placement(rng)
    rotation = pin.exp3(np.eye(3)[rng.integers(3)] * np.pi / 2 * rng.integers(4))
    translation = np.eye(3)[rng.integers(3)] * rng.choice([0.0, 0.3, 0.5])
    return pin.SE3(rotation, translation)


def odd_model(group: str, joints: int, seed: int) -> pin.Model:
    """Return a tree like `trees.random_model`, but with odd bodies, some armature, no gravity."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"odd-{group}-{joints}-{seed}"
    model.gravity.setZero()
    probabilities = rng.dirichlet(np.full(7, 0.7))
    for k in range(joints + 1):
        joint_types = JOINTS if k else ROOTS[group]
        path = list(model.supports[k])[1:] if k else [0]
        parent = int(path[-1] if rng.random() < 0.7 else rng.choice(path))
        joint_type = joint_types[rng.integers(len(joint_types))](rng)
        i = model.addJoint(parent, joint_type, odd_placement(rng), f"joint{k}")
        body = odd_inertia(rng, int(rng.choice(7, p=probabilities)))
        model.appendBodyToJoint(i, body, pin.SE3.Identity())
    rotors = rng.choice([0.0, 0.05], joints, p=[0.8, 0.2])
    model.armature = np.concatenate([np.zeros(model.joints[1].nv), rotors])
    return model


def mass_matrix(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Return Pinocchio's mass matrix with both triangles, (nv, nv)."""
    H = np.triu(pin.crba(model, data, q))
    return np.asarray(H + np.triu(H, 1).T)
