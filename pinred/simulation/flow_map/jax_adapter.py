"""A flow as a function of JAX: under jit, grad, jvp and vmap, a call of XLA for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import numpy as np

from ...common.errors import InputError, MissingPackageError
from ...common.memo import once_for_all
from . import xla_call
from .batched import FIRST_ORDER, Batched
from .flow_columns import Columns

_OLDEST = (0, 10, 0)


def jax_function(columns: Columns) -> Callable[..., Any]:
    """Return f(*columns, **columns) → output, with derivatives of first order in both modes.

    Numbers come and go as JAX's floats, in single precision unless jax_enable_x64 is set; between,
    they are doubles.  It runs on the processor.  Raises MissingPackageError without JAX.
    """
    try:
        import jax
        import jax.numpy as jnp
    except ImportError as missing:
        raise MissingPackageError("this needs JAX: pip install jax") from missing
    if jax.__version_info__ < _OLDEST:  # whose call frames are others
        raise MissingPackageError(f"this needs JAX 0.10 or newer, and {jax.__version__} is there")
    primitives = _primitives()
    numbers = tuple(map(xla_call.numbered, _calls(columns)))

    def flow(*given: Any, **named: Any) -> Any:
        arrays = []
        for k, value in enumerate(columns.arranged(given, named)):
            array = jnp.asarray(value)
            if not (jnp.issubdtype(array.dtype, jnp.floating) or array.dtype.kind in "iu"):
                raise InputError(f"{columns.names[k]} must be real numbers, got {array.dtype}")
            columns.refuse_shape(k, array.shape)
            arrays.append(jnp.reshape(array, (-1,)).astype(float))
        (out,) = primitives.value.bind(*arrays, numbers=numbers, sizes=(columns.size,))
        return out

    return flow


def _calls(columns: Columns) -> list[xla_call.Function]:
    """Return what XLA calls: value, derivatives along directions, which follow the columns, back.

    Of the last, a covector follows the columns.
    """
    batched, count, n = Batched(columns), len(columns.sizes), sum(columns.sizes)

    def value(inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        outputs[0][...] = batched.value(inputs)

    def along(inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        outputs[0][...] = batched.along(inputs[:count], inputs[count:])

    def back(inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        found = batched.back(inputs[:count], inputs[count])
        for out, slope in zip(outputs, found, strict=True):
            out[...] = slope

    return [
        xla_call.Function(columns.value_of, n, value),
        xla_call.Function(lambda both: columns.along_of(both[:n], both[n:]), 2 * n, along),
        xla_call.Function(lambda both: columns.back_of(both[:n], both[n:]), n + columns.size, back),
    ]


class _Primitives:
    """The three functions as JAX knows them; parameters: their numbers and the sizes of outputs.

    Batches are leading axes, and what has none there has a one, so that a call is one call.
    """

    def __init__(self) -> None:
        from jax.extend.core import Primitive
        from jax.interpreters import ad

        self.value = self._made(Primitive("pinred_flow"), 0)
        self.along = self._made(Primitive("pinred_flow_along"), 1)
        self.back = self._made(Primitive("pinred_flow_back"), 2)

        def push(primals: Any, tangents: Any, *, numbers: Any, sizes: Any) -> Any:
            out = self.value.bind(*primals, numbers=numbers, sizes=sizes)
            along = [ad.instantiate_zeros(tangent) for tangent in tangents]
            return out, self.along.bind(*primals, *along, numbers=numbers, sizes=sizes)

        def pull(covectors: Any, *given: Any, numbers: Any, sizes: Any) -> Any:
            del sizes
            columns = given[: len(given) // 2]
            widths = tuple(a.shape[-1] for a in columns)
            covector = ad.instantiate_zeros(covectors[0])
            back = self.back.bind(*columns, covector, numbers=numbers, sizes=widths)
            return [None] * len(columns) + _summed(back, given[len(columns) :])

        def push_along(primals: Any, tangents: Any, *, numbers: Any, sizes: Any) -> Any:
            return _linear(self.along, primals, tangents, len(primals) // 2, numbers, sizes)

        def push_back(primals: Any, tangents: Any, *, numbers: Any, sizes: Any) -> Any:
            return _linear(self.back, primals, tangents, len(primals) - 1, numbers, sizes)

        ad.primitive_jvps[self.value] = push
        ad.primitive_jvps[self.along] = push_along
        ad.primitive_jvps[self.back] = push_back
        ad.primitive_transposes[self.along] = pull

    def _made(self, primitive: Any, which: int) -> Any:
        import jax
        from jax.core import ShapedArray
        from jax.interpreters import batching, mlir

        xla_call.register()
        primitive.multiple_results = True

        def outputs(*given: Any, sizes: Any, **_: Any) -> list[Any]:
            lead = np.broadcast_shapes(*(a.shape[:-1] for a in given))
            return [ShapedArray((*lead, size), given[0].dtype) for size in sizes]

        def call(*given: Any, numbers: Any, sizes: Any) -> Any:
            shapes = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in outputs(*given, sizes=sizes)]
            if not prod(shapes[0].shape):
                return [jax.numpy.zeros(a.shape, a.dtype) for a in shapes]
            made = jax.ffi.ffi_call(xla_call.TARGET, shapes)
            return made(*given, function=np.int64(numbers[which]))

        def batched(given: Any, axes: Any, **how: Any) -> Any:
            moved = [
                jax.numpy.expand_dims(a, 0) if axis is None else jax.numpy.moveaxis(a, axis, 0)
                for a, axis in zip(given, axes, strict=True)
            ]
            out = primitive.bind(*moved, **how)
            return out, [0] * len(out)

        primitive.def_impl(jax.jit(call, static_argnames=("numbers", "sizes")))
        primitive.def_abstract_eval(outputs)
        batching.primitive_batchers[primitive] = batched
        mlir.register_lowering(primitive, mlir.lower_fun(call, multiple_results=True))
        return primitive


_primitives = once_for_all(_Primitives)


def _summed(slopes: Sequence[Any], wanted: Sequence[Any]) -> list[Any]:
    """Return slopes summed over the axes along which their inputs were one."""
    out = []
    for slope, like in zip(slopes, wanted, strict=True):
        shape = like.aval.shape
        axes = [k for k, size in enumerate(shape) if size == 1 and slope.shape[k] != 1]
        out.append(slope.sum(axes, keepdims=True) if axes else slope)
    return out


def _linear(
    primitive: Any, primals: Any, tangents: Any, fixed: int, numbers: Any, sizes: Any
) -> Any:
    """Return the derivative of what is linear but in its first entries.  Raises InputError."""
    from jax.interpreters import ad

    if not all(type(tangent) is ad.Zero for tangent in tangents[:fixed]):
        raise InputError(FIRST_ORDER)
    along = [ad.instantiate_zeros(tangent) for tangent in tangents[fixed:]]
    how = {"numbers": numbers, "sizes": sizes}
    return (
        primitive.bind(*primals, **how),
        primitive.bind(*primals[:fixed], *along, **how),
    )
