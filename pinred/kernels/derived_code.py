"""Further machine code of a kernel: made when first asked for, kept on disk, and judged."""

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
    """Return machine code of a kernel's equations, made once.

    name: of its function.  kind: sets it apart from other code of the same equations.  make:
    gives the object code.  judge: raises an error if it disagrees with the kernel, which
    Pinocchio has judged.
    """

    def native() -> NativeCode:
        forces = None if kernel.forces is None else kernel.forces.key
        whole = asdict(kernel.structure) | {"forces": forces} | kind
        cache, key = (
            ObjectCache(),
            cache_key(model_bytes(kernel.system, kernel.structure.freed), json.dumps(whole)),
        )
        code = cache.get(key)
        if code is None:
            code = make(ReducedGraph(kernel.system, kernel.structure, kernel.forces))
            cache.put(key, code)
        made = load_object(code, name)
        judge(made)
        return made

    return once(kernel, (derived_code, json.dumps(kind)), native)
