"""The digest of a robot model, used as part of cache keys."""

from __future__ import annotations

import hashlib

import numpy as np

from ..reduction.tree.free_bodies import NOTHING, Freed
from ..system.system import System
from ..system.variants import nominal


def model_bytes(system: System, freed: Freed = NOTHING) -> bytes:
    """Compute a digest of all model parameters that the equations of motion depend on.

    Args:
        system: The system.
        freed: Variable parameters; their values do not enter the digest.
    Returns:
        The SHA-256 digest.
    """
    model, reference = system.model, nominal(system).model
    variable_placements = [body for body, _ in freed.steps]
    digest = hashlib.sha256(f"{system.group.name} {system.group.axes}".encode())
    for i in range(1, model.njoints):
        joint, Y = model.joints[i], model.inertias[i]
        digest.update(f"{joint.shortname()} {model.parents[i]} {joint.nq};".encode())
        # Body frames follow the nominal placements, even if joint placements vary.
        digest.update(reference.jointPlacements[i].homogeneous.tobytes())
        if i - 1 not in variable_placements:
            digest.update(model.jointPlacements[i].homogeneous.tobytes())
        if i - 1 not in freed.inertias:
            digest.update(np.concatenate([[Y.mass], Y.lever, Y.inertia.ravel()]).tobytes())
        digest.update(np.asarray(joint.createData().S).tobytes())  # axes of unaligned joints
    digest.update(np.asarray(model.armature).tobytes())
    if system.coupled is not None:
        for numbers in (system.coupled.of, system.coupled.ratio, system.coupled.offset):
            digest.update(numbers.tobytes())
    return digest.digest()
