"""The fingerprint by which the cache of kernels tells robots apart."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from ..system.system import System


def model_bytes(system: System, free: Sequence[int] = ()) -> bytes:
    """Return a digest of every number of the model that the equations depend on.

    free: indices of bodies whose inertias are inputs.
    """
    model = system.model
    digest = hashlib.sha256(f"{system.group.name} {system.group.axes}".encode())
    for i in range(1, model.njoints):
        joint, Y = model.joints[i], model.inertias[i]
        digest.update(f"{joint.shortname()} {model.parents[i]} {joint.nq};".encode())
        digest.update(model.jointPlacements[i].homogeneous.tobytes())
        if i - 1 not in free:
            digest.update(np.concatenate([[Y.mass], Y.lever, Y.inertia.ravel()]).tobytes())
        axes = np.asarray(joint.createData().S)  # what tells slanted joints apart
        digest.update(axes.tobytes())
    digest.update(np.asarray(model.armature).tobytes())
    if system.coupled is not None:
        for numbers in (system.coupled.of, system.coupled.ratio, system.coupled.offset):
            digest.update(numbers.tobytes())
    return digest.digest()
