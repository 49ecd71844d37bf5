"""Kernels: one robot and one kind of scene, compiled, judged against Pinocchio, kept on disk."""

from __future__ import annotations

import ctypes
import hashlib
import json
import struct
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ..arrays import Array
from ..cyclic import cyclic_joints
from ..potential import Potential
from ..reduction import Reduction
from ..system import System
from .cache import ObjectCache, cache_key
from .judge import judge
from .lanes import Lanes
from .native import NativeCode, compile_object, load_object
from .symbolic import Layout, ReducedGraph, Structure

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
    outputs: (y, parameters) → (ξ, ẋ, c).  instructions: arithmetic operations of `rate`.
    """

    system: System
    structure: Structure
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

    def evaluate_outputs(self, y: Array, parameters: Array) -> Array:
        """Return (ξ, ẋ, c), (n + 3,)."""
        return self._call(self._outputs, y, parameters, self.system.n + 3)

    @staticmethod
    def _call(function: Callable[..., None], y: Array, parameters: Array, size: int) -> Array:
        y, parameters = np.ascontiguousarray(y), np.ascontiguousarray(parameters)
        out = np.empty(size)
        function(*(array.ctypes.data_as(_POINTER) for array in (y, parameters, out)))
        return out


def kernel_for(
    system: System, potential: Potential, springs: tuple[str, ...], *, zero_momentum: bool
) -> Kernel:
    """Return the kernel of a kind of scene, built at most once for a System.

    potential: of the system with these springs.  springs: names of the joints that have one.
    """
    kernels: dict[tuple[object, ...], Kernel] = system.__dict__.setdefault("_kernels", {})
    kind = (springs, zero_momentum)
    if kind not in kernels:
        structure = structure_of(system, potential, springs, zero_momentum=zero_momentum)
        kernels[kind] = build_kernel(system, structure)
    return kernels[kind]


def structure_of(
    system: System, potential: Potential, springs: tuple[str, ...], *, zero_momentum: bool
) -> Structure:
    """Return what decides which terms a scene has."""
    red = Reduction(system, springs=dict.fromkeys(springs, (1.0, 0.0)))
    return Structure(
        zero_momentum=zero_momentum,
        cyclic=cyclic_joints(red),
        springs=tuple(system.shape_names.index(name) for name in springs),
        gravity=potential.direction,
    )


def build_kernel(system: System, structure: Structure, cache: KernelStore | None = None) -> Kernel:
    """Return the kernel of a system and structure: from the cache, or compiled and cached.

    Raises KernelMismatch if it disagrees with Pinocchio; then nothing runs.
    """
    cache = ObjectCache() if cache is None else cache
    key = cache_key(_model_bytes(system), json.dumps(asdict(structure)))
    stored = cache.get(key)
    if stored is None:
        lanes = Lanes()
        graph = ReducedGraph(system, structure, lanes)
        rate, outputs = graph.rate(), graph.outputs()
        meta = {"layout": asdict(graph.layout), "instructions": rate.n_instructions()}
        codes = [compile_object(f, f.name(), lanes.marks[f.name()]) for f in (rate, outputs)]
        stored = _pack(json.dumps(meta).encode(), *codes)
        cache.put(key, stored)
    head, rate_code, outputs_code = _unpack(stored)
    meta = json.loads(head)
    layout = _layout(meta["layout"])
    kernel = Kernel(
        system=system,
        structure=structure,
        layout=layout,
        rate=load_object(rate_code, "rate"),
        outputs=load_object(outputs_code, "outputs"),
        instructions=int(meta["instructions"]),
    )
    judge(kernel)
    return kernel


def _model_bytes(system: System) -> bytes:
    """Return a digest of every number of the model that the equations depend on."""
    model = system.model
    digest = hashlib.sha256(system.group.name.encode())
    for i in range(1, model.njoints):
        joint, Y = model.joints[i], model.inertias[i]
        digest.update(f"{joint.shortname()} {model.parents[i]} {joint.nq};".encode())
        digest.update(model.jointPlacements[i].homogeneous.tobytes())
        digest.update(np.concatenate([[Y.mass], Y.lever, Y.inertia.ravel()]).tobytes())
        axes = np.asarray(joint.createData().S)  # what tells slanted joints apart
        digest.update(axes.tobytes())
    digest.update(np.asarray(model.armature).tobytes())
    return digest.digest()


def _layout(entries: dict[str, Any]) -> Layout:
    """Return the layout that JSON has kept, where tuples are lists."""
    names = ("active", "cyclic", "springs")
    tuples = {name: tuple(int(k) for k in entries[name]) for name in names}
    return Layout(**tuples, attitude=int(entries["attitude"]), spin=int(entries["spin"]))


def _pack(*parts: bytes) -> bytes:
    return b"".join(struct.pack("<Q", len(part)) + part for part in parts)


def _unpack(packed: bytes) -> list[bytes]:
    parts, at = [], 0
    while at < len(packed):
        (size,) = struct.unpack_from("<Q", packed, at)
        parts.append(packed[at + 8 : at + 8 + size])
        at += 8 + size
    return parts
