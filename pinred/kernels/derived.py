"""Further machine code of a kernel: made when first asked for, kept on disk, and judged."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict

from .fingerprint import model_bytes
from .kernel import Kernel
from .machine.native import NativeCode, load_object
from .reduced_graph import ReducedGraph
from .store import ObjectCache, cache_key


def derived_code(
    kernel: Kernel,
    name: str,
    kind: dict[str, int],
    make: Callable[[ReducedGraph], bytes],
    judge: Callable[[NativeCode], None],
) -> NativeCode:
    """Return machine code of a kernel's equations, made once.

    name: of its function.  kind: what tells it from other code of the same equations.  make:
    gives the object code.  judge: raises an error if it disagrees with the kernel, which
    Pinocchio has judged.
    """
    ready: dict[str, NativeCode] = kernel.__dict__.setdefault("_derived", {})
    text = json.dumps(kind)
    if text not in ready:
        forces = None if kernel.forces is None else kernel.forces.key
        whole = asdict(kernel.structure) | {"forces": forces} | kind
        cache, key = ObjectCache(), cache_key(model_bytes(kernel.system), json.dumps(whole))
        code = cache.get(key)
        if code is None:
            code = make(ReducedGraph(kernel.system, kernel.structure, kernel.forces))
            cache.put(key, code)
        native = load_object(code, name)
        judge(native)
        # Another thread may have been faster, and its address may be in use.
        return ready.setdefault(text, native)
    return ready[text]
