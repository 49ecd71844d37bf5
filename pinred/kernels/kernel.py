"""Kernels: one robot and one kind of scene, compiled, judged against Pinocchio, kept on disk."""

from __future__ import annotations

import ctypes
import json
import struct
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ..common.arrays import Array
from ..forces.model import ForceModel
from ..reduction.base_parts import BaseParts
from ..reduction.cyclic_joints import cyclic_of
from ..reduction.potential import pivot_weight, shape_gravity
from ..reduction.tree.limbs import Lanes
from ..scene.scene import Scene
from ..system.system import System
from .fingerprint import model_bytes
from .judge import judge
from .machine.native import NativeCode, compile_object, load_object
from .reduced_graph import Layout, Outputs, ReducedGraph, Structure, outputs_of
from .store import ObjectCache, cache_key

_POINTER = ctypes.POINTER(ctypes.c_double)
_SIGNATURE = ctypes.CFUNCTYPE(None, _POINTER, _POINTER, _POINTER)


class KernelStore(Protocol):
    """Where kernels are kept: an ObjectCache, or something like it."""

    def get(self, key: str) -> bytes | None:
        """Return the code of `key`, if it is there."""

    def put(self, key: str, code: bytes) -> None:
        """Keep the code of `key`."""


@dataclass(frozen=True)
class Kernel:
    """Machine code of a reduced vector field and of its outputs.

    layout: where things stand in y and in the parameters.  rate: (y, parameters) → dy/dt.
    outputs: ((y, t), (parameters, c0, v0, g)) → everything of Outputs.  instructions:
    arithmetic operations of `rate`.
    """

    system: System
    structure: Structure
    forces: ForceModel | None
    layout: Layout
    rate: NativeCode
    outputs: NativeCode
    instructions: int

    @cached_property
    def _rate(self) -> Callable[..., None]:
        return _SIGNATURE(self.rate.address)

    @cached_property
    def _outputs(self) -> Callable[..., None]:
        return _SIGNATURE(self.outputs.address)

    def evaluate_rate(self, y: Array, parameters: Array) -> Array:
        """Return dy/dt, (size,)."""
        return self._call(self._rate, y, parameters, self.layout.size)

    def evaluate_outputs(self, t: float, y: Array, parameters: Array, line: Array) -> Array:
        """Return everything of Outputs, (where.size,), at a time.

        line: (3k,) where the centre of mass begins, how fast, and how it falls.
        """
        y = y if self.layout.clock else np.append(y, t)
        return self._call(self._outputs, y, np.append(parameters, line), self.where.size)

    @cached_property
    def where(self) -> Outputs:
        """Where things stand in the outputs."""
        return outputs_of(self.system, self.layout)

    @staticmethod
    def _call(function: Callable[..., None], y: Array, parameters: Array, size: int) -> Array:
        y, parameters = np.ascontiguousarray(y), np.ascontiguousarray(parameters)
        out = np.empty(size)
        function(*(array.ctypes.data_as(_POINTER) for array in (y, parameters, out)))
        return out


def kernel_for(scene: Scene, *, zero_momentum: bool, lifted: bool = False) -> Kernel:
    """Return the kernel of a kind of scene, built at most once for a System.

    zero_momentum: whether the angular momentum of its base is exactly zero.  lifted: see
    Structure.
    """
    system, forces = scene.system, scene.force_model
    kernels: dict[tuple[object, ...], Kernel] = system.__dict__.setdefault("_kernels", {})
    lifted = lifted and _can_be_lifted(scene, zero_momentum=zero_momentum)
    kind = (zero_momentum, lifted, scene.outputs, None if forces is None else forces.key)
    if kind not in kernels:
        structure = structure_of(
            system, forces, zero_momentum=zero_momentum, base=scene.outputs == "all"
        )
        structure = replace(structure, lifted=lifted)
        kernels[kind] = build_kernel(system, structure, forces)
    return kernels[kind]


def _can_be_lifted(scene: Scene, *, zero_momentum: bool) -> bool:
    """Return whether a scene has a constant angular momentum that turns in the body."""
    forces, group = scene.force_model, scene.system.group
    changing = bool(pivot_weight(scene.system).any()) or (forces is not None and forces.has_wrench)
    return group.dim - group.linear == 3 and not (zero_momentum or changing)


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
        cyclic=cyclic_of(system, forces),
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
