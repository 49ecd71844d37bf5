"""A flow as a function of JAX: under jit, grad and vmap, by callbacks to the host."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...common.errors import MissingPackageError
from .columns import Columns


def jax_function(columns: Columns) -> Callable[..., Any]:
    """Return f(*columns) → output in float64, with reverse derivatives (jax.grad, jax.jacrev).

    Raises MissingPackageError without JAX.
    """
    try:
        import jax
    except ImportError as missing:
        raise MissingPackageError("this needs JAX: pip install jax") from missing
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    out = jax.ShapeDtypeStruct((columns.size,), jnp.float64)
    slopes = tuple(jax.ShapeDtypeStruct((size,), jnp.float64) for size in columns.sizes)

    def forward(*given: Any) -> Any:
        def call(*arrays: Any) -> Any:
            return columns.value(*arrays)

        whole = [jnp.reshape(jnp.asarray(a, jnp.float64), (-1,)) for a in given]
        return jax.pure_callback(call, out, *whole, vmap_method="sequential")

    def ahead(*given: Any) -> Any:
        return forward(*given), given

    def back(given: Any, covector: Any) -> Any:
        def call(along: Any, *arrays: Any) -> Any:
            found = columns.vjp(arrays, along)
            return tuple(np.asarray(part) for part in found)

        whole = [jnp.reshape(jnp.asarray(a, jnp.float64), (-1,)) for a in given]
        found = jax.pure_callback(call, slopes, covector, *whole, vmap_method="sequential")
        return tuple(jnp.reshape(g, jnp.shape(a)) for g, a in zip(found, given, strict=True))

    flow: Any = jax.custom_vjp(forward)
    flow.defvjp(ahead, back)
    checked: Callable[..., Any] = flow
    return checked
