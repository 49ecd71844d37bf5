"""Kernels are built, judged and kept here."""

from __future__ import annotations

import json
import struct
from dataclasses import asdict
from typing import Any

from ..forces.model import ForceModel, touched_by
from ..reduction.base_parts import BaseParts
from ..reduction.cyclic_joints import cyclic_of
from ..reduction.potential import pivot_weight, shape_gravity
from ..reduction.tree.limbs import Lanes
from ..system.system import System
from .fingerprint import model_bytes
from .judge import judge
from .kernel import Kernel, KernelStore
from .machine.native import compile_object, load_object
from .reduced_graph import Layout, ReducedGraph, Structure
from .store import ObjectCache, cache_key


def structure_of(
    system: System, forces: ForceModel | None, *, zero_momentum: bool, base: bool = True
) -> Structure:
    """Return what decides which terms a scene has.

    zero_momentum: of the base.  base: whether it is asked for.  Raises SymmetryError if
    gravity breaks the symmetry.
    """
    weight = pivot_weight(system)
    direction = shape_gravity(system).direction
    if weight.any():
        x, y, z = (weight / system.mass).tolist()
        direction = (x, y, z)
    return Structure(
        zero_momentum=zero_momentum,
        cyclic=cyclic_of(system, touched_by(forces)),
        gravity=direction,
        base=base,
    )


def build_kernel(
    system: System,
    structure: Structure,
    forces: ForceModel | None = None,
    cache: KernelStore | None = None,
) -> Kernel:
    """Return the kernel of a system and structure: from the cache, or compiled and cached.

    Raises KernelMismatch if it disagrees with Pinocchio; then nothing runs.
    """
    cache = ObjectCache() if cache is None else cache
    kind = asdict(structure) | {"forces": None if forces is None else forces.key}
    key = cache_key(model_bytes(system), json.dumps(kind))
    stored = cache.get(key)
    if stored is None:
        lanes = Lanes()
        graph = ReducedGraph(system, structure, forces, lanes)
        rate, outputs = graph.rate(), graph.outputs()
        meta = {"layout": asdict(graph.layout), "instructions": rate.n_instructions()}
        codes = [compile_object(f, f.name(), lanes.marks[f.name()]) for f in (rate, outputs)]
        stored = _pack(json.dumps(meta).encode(), *codes)
        cache.put(key, stored)
    head, rate_code, outputs_code = _unpack(stored)
    meta = json.loads(head)
    kernel = Kernel(
        system=system,
        structure=structure,
        forces=forces,
        layout=_layout(meta["layout"]),
        rate=load_object(rate_code, "rate"),
        outputs=load_object(outputs_code, "outputs"),
        instructions=int(meta["instructions"]),
    )
    judge(kernel)
    return kernel


def _layout(entries: dict[str, Any]) -> Layout:
    """Return the layout that JSON has kept, where tuples are lists."""
    tuples = {
        name: tuple(int(k) for k in entries[name]) for name in ("active", "cyclic", "prescribed")
    }
    return Layout(
        **tuples,
        base=BaseParts(**entries["base"]),
        wanted=bool(entries["wanted"]),
        heavy=bool(entries["heavy"]),
        clock=int(entries["clock"]),
        numbers=int(entries["numbers"]),
    )


def _pack(*parts: bytes) -> bytes:
    return b"".join(struct.pack("<Q", len(part)) + part for part in parts)


def _unpack(packed: bytes) -> list[bytes]:
    parts, at = [], 0
    while at < len(packed):
        (size,) = struct.unpack_from("<Q", packed, at)
        parts.append(packed[at + 8 : at + 8 + size])
        at += 8 + size
    return parts
