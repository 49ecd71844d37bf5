"""Further machine code of a kernel: compiled on demand, cached on disk, and validated."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict

from ..common.memo import once
from .fingerprint import model_bytes
from .kernel import Kernel
from .machine.native import NativeCode, load_object
from .object_cache import ObjectCache, cache_key
from .reduced_graph import ReducedGraph


def derived_code(
    kernel: Kernel,
    name: str,
    kind: dict[str, int],
    make: Callable[[ReducedGraph], bytes],
    judge: Callable[[NativeCode], None],
) -> NativeCode:
    """Return further machine code of a kernel's equations, compiled and validated once.

    Args:
        kernel: The kernel, already validated against Pinocchio.
        name: Name of the compiled function.
        kind: Key that distinguishes this code from other code of the same equations.
        make: Function that compiles the object code from the graph.
        judge: Function that raises an error if the code disagrees with the kernel.
    Returns:
        The machine code.
    """

    def load() -> NativeCode:
        forces = None if kernel.forces is None else kernel.forces.key
        settings = asdict(kernel.structure) | {"forces": forces} | kind
        key = cache_key(model_bytes(kernel.system, kernel.structure.freed), json.dumps(settings))

        def compile_code() -> bytes:
            return make(ReducedGraph(kernel.system, kernel.structure, kernel.forces))

        native = load_object(ObjectCache().get_or_compile(key, compile_code), name)
        judge(native)
        return native

    return once(kernel, (derived_code, json.dumps(kind)), load)
