"""The building of kernels: compiled or taken from the cache, and judged."""

from __future__ import annotations

import json
import struct
from dataclasses import asdict, replace

from ..forces.force_model import ForceModel
from ..reduction.tree.limbs import Lanes
from ..system.system import System
from .fingerprint import model_bytes
from .kernel import Kernel, KernelStore
from .layout import Structure, layout_of
from .machine.native import compile_object, load_object
from .object_cache import ObjectCache, cache_key
from .reduced_graph import ReducedGraph
from .reference_state import perturb_parameters
from .validation import explain_ill_scaling, validate_kernel


def build_kernel(
    system: System,
    structure: Structure,
    forces: ForceModel | None = None,
    cache: KernelStore | None = None,
) -> Kernel:
    """Return the kernel of a system and structure: from the cache, or compiled and cached.

    Raises KernelMismatch if it disagrees with Pinocchio, ModelError if that
    is because the system is ill-scaled; then nothing runs.
    """
    cache = ObjectCache() if cache is None else cache
    kind = asdict(structure) | {"forces": None if forces is None else forces.key}
    key = cache_key(model_bytes(system, structure.freed), json.dumps(kind))
    stored = cache.get(key)
    if stored is None:
        lanes = Lanes()
        graph = ReducedGraph(system, structure, forces, lanes)
        rate, outputs = graph.rate(), graph.outputs()
        meta = {"instructions": rate.n_instructions()}
        codes = [compile_object(f, f.name(), lanes.marks[f.name()]) for f in (rate, outputs)]
        stored = _pack(json.dumps(meta).encode(), *codes)
        cache.put(key, stored)
    head, rate_code, outputs_code = _unpack(stored)
    meta = json.loads(head)
    kernel = Kernel(
        system=system,
        structure=structure,
        forces=forces,
        layout=layout_of(system, structure, forces),
        rate=load_object(rate_code, "rate"),
        outputs=load_object(outputs_code, "outputs"),
        instructions=int(meta["instructions"]),
    )
    with explain_ill_scaling(system):
        validate_kernel(kernel)
        if structure.freed:  # with other numbers, too
            other = perturb_parameters(system, structure.freed, structure.cyclic)
            moved = None if forces is None else forces.on(other)
            validate_kernel(replace(kernel, system=other, forces=moved))
    return kernel


def _pack(*parts: bytes) -> bytes:
    return b"".join(struct.pack("<Q", len(part)) + part for part in parts)


def _unpack(packed: bytes) -> list[bytes]:
    parts, at = [], 0
    while at < len(packed):
        (size,) = struct.unpack_from("<Q", packed, at)
        parts.append(packed[at + 8 : at + 8 + size])
        at += 8 + size
    return parts
