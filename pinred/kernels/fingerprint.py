"""The fingerprint by which the cache of kernels tells robots apart."""

from __future__ import annotations

import hashlib

import numpy as np

from ..reduction.tree.free_bodies import NOTHING, Freed
from ..system.system import System
from ..system.variants import nominal


def model_bytes(system: System, freed: Freed = NOTHING) -> bytes:
    """Return a digest of every number of the model that the equations depend on.

    freed: the numbers of bodies that are inputs.
    """
    model, own = system.model, nominal(system).model
    placed = [body for body, _ in freed.steps]
    digest = hashlib.sha256(f"{system.group.name} {system.group.axes}".encode())
    for i in range(1, model.njoints):
        joint, Y = model.joints[i], model.inertias[i]
        digest.update(f"{joint.shortname()} {model.parents[i]} {joint.nq};".encode())
        # Frames are those of the placements that the robot came with, wherever its joints are.
        digest.update(own.jointPlacements[i].homogeneous.tobytes())
        if i - 1 not in placed:
            digest.update(model.jointPlacements[i].homogeneous.tobytes())
        if i - 1 not in freed.inertias:
            digest.update(np.concatenate([[Y.mass], Y.lever, Y.inertia.ravel()]).tobytes())
        axes = np.asarray(joint.createData().S)  # what tells slanted joints apart
        digest.update(axes.tobytes())
    digest.update(np.asarray(model.armature).tobytes())
    if system.coupled is not None:
        for numbers in (system.coupled.of, system.coupled.ratio, system.coupled.offset):
            digest.update(numbers.tobytes())
    return digest.digest()
