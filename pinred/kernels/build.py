"""Construction of kernels: load machine code from the cache or compile it, then validate it."""

from __future__ import annotations

import hashlib
import json
import struct
from dataclasses import asdict, replace

import numpy as np

from ..common.machine_code import load_objects
from ..common.object_cache import ObjectCache, cache_key
from ..forces.force_model import ForceModel
from ..reduction.tree.free_bodies import NOTHING, Freed
from ..reduction.tree.identical_branches import Lanes
from ..reduction.tree.loop_constraints import GAUGE_RATE, needs_second_solution
from ..system.joints import axes_of
from ..system.loops.kinematics import law_of, loop_ends
from ..system.loops.loop import Loop
from ..system.system import System, nominal
from .kernel import Kernel, Structure, layout_of
from .machine.native import compile_object
from .reduced_graph import ReducedGraph
from .reference_state import perturb_parameters
from .validation import explain_ill_scaling, validate_kernel


def model_bytes(system: System, freed: Freed = NOTHING) -> bytes:
    """Compute a digest of all model parameters that the equations of motion depend on.

    Args:
        system: The system.
        freed: Variable parameters.  Their values are excluded from the digest, because they are
            inputs of the kernel.
    Returns:
        The SHA-256 digest.
    """
    model, reference = system.sorted_model, nominal(system).model
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
        # The motion axis of a joint that is not aligned with x, y or z is not part of its type.
        digest.update(axes_of(joint).tobytes())
    digest.update(np.asarray(model.armature).tobytes())
    if system.coupled is not None:
        for numbers in (system.coupled.leads, system.coupled.G, system.coupled.offset):
            digest.update(numbers.tobytes())
    if system.closure is not None:
        digest.update(system.closure.rows.tobytes() + str(GAUGE_RATE).encode())
        if needs_second_solution(system):  # Stores of earlier versions have none.
            digest.update(b"second solution")
        for loop in system.loops:
            if not isinstance(loop, Loop):
                digest.update(repr(loop).encode())
                digest.update(f"{law_of(model, loop).joints}".encode())
                continue
            digest.update(loop.kind.encode())
            for end in loop_ends(model, loop):
                digest.update(f"{end.joint}".encode() + end.placement.homogeneous.tobytes())
    return digest.digest()


def build_kernel(
    system: System,
    structure: Structure,
    forces: ForceModel | None = None,
    cache: ObjectCache | None = None,
) -> Kernel:
    """Load the kernel of a system and structure from the cache, or compile it; then validate it.

    Args:
        system: The system.
        structure: Structure of the reduced equations.
        forces: Forces on the system, or None.
        cache: Cache of machine code; by default the user's cache on disk.
    Returns:
        The validated kernel.
    Raises:
        KernelMismatch: The kernel disagrees with Pinocchio.
        ModelError: The kernel disagrees because the system is ill-scaled.
    """
    cache = ObjectCache() if cache is None else cache
    settings = asdict(structure) | {"forces": None if forces is None else forces.key}

    def compile_code() -> bytes:
        lanes = Lanes()
        graph = ReducedGraph(system, structure, forces, lanes)
        rate, outputs = graph.rate(), graph.outputs()
        meta = {"instructions": rate.n_instructions()}
        codes = [
            compile_object(f, f.name(), lanes.marks[f.name()], rare=f is outputs)
            for f in (rate, outputs)
        ]
        return _pack(json.dumps(meta).encode(), *codes)

    key = cache_key(model_bytes(system, structure.freed), json.dumps(settings))
    head, rate_code, outputs_code = _unpack(
        cache.get_or_compile(key, compile_code, f"the equations of '{system.name}'")
    )
    meta = json.loads(head)
    rate, outputs = load_objects({"rate": rate_code, "outputs": outputs_code})
    kernel = Kernel(
        system=system,
        structure=structure,
        forces=forces,
        layout=layout_of(system, structure, forces),
        rate=rate,
        outputs=outputs,
        instructions=int(meta["instructions"]),
    )
    with explain_ill_scaling(system):
        validate_kernel(kernel)
        if structure.freed:  # also validate with other values of the variable parameters
            validate_kernel(perturbed(kernel))
    return kernel


def perturbed(kernel: Kernel) -> Kernel:
    """Return a kernel with random values of its variable body parameters, or the kernel itself."""
    structure, forces = kernel.structure, kernel.forces
    if not structure.freed:
        return kernel
    system = perturb_parameters(
        kernel.system, structure.freed, (*structure.cyclic, *structure.rotors, *structure.axial)
    )
    return replace(kernel, system=system, forces=None if forces is None else forces.on(system))


def _pack(*blocks: bytes) -> bytes:
    return b"".join(struct.pack("<Q", len(block)) + block for block in blocks)


def _unpack(packed: bytes) -> list[bytes]:
    blocks, at = [], 0
    while at < len(packed):
        (size,) = struct.unpack_from("<Q", packed, at)
        blocks.append(packed[at + 8 : at + 8 + size])
        at += 8 + size
    return blocks
