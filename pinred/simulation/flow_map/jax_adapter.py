"""A flow as a JAX function: one XLA call under jit, grad, jvp and vmap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import numpy as np

from ...common.errors import InputError, MissingPackageError
from ...common.installation import optional_package
from ...common.memo import once_for_all
from . import xla_call
from .flow_columns import FIRST_ORDER, Batched, Columns

_OLDEST = (0, 10, 0)  # Oldest version of JAX with the call frames that xla_call reads.


def jax_function(columns: Columns) -> Callable[..., Any]:
    """Build the JAX function of a flow, with first derivatives in forward and reverse mode.

    The function takes and returns JAX's floats, in single precision unless jax_enable_x64 is set.
    The flow itself runs in double precision on the processor.

    Args:
        columns: The flow between vectors.
    Returns:
        f(*columns, **columns) → output.
    Raises:
        MissingPackageError: JAX is not installed, or is too old.
    """
    jax = optional_package("jax", "this needs JAX: pip install jax")
    jnp = jax.numpy
    if jax.__version_info__ < _OLDEST:
        raise MissingPackageError(
            f"this needs JAX 0.10 or newer, but version {jax.__version__} is installed"
        )
    primitives = _primitives()
    numbers = tuple(map(xla_call.numbered, _xla_functions(columns)))

    def flow(*positional: Any, **named: Any) -> Any:
        arrays = []
        for k, value in enumerate(columns.arranged(positional, named)):
            array = jnp.asarray(value)
            if not (jnp.issubdtype(array.dtype, jnp.floating) or array.dtype.kind in "iu"):
                raise InputError(f"{columns.names[k]} must be real numbers, got {array.dtype}")
            columns.refuse_shape(k, array.shape)
            arrays.append(jnp.reshape(array, (-1,)).astype(float))
        (output,) = primitives.value.bind(*arrays, numbers=numbers, sizes=(columns.size,))
        return output

    return flow


def _xla_functions(columns: Columns) -> list[xla_call.Function]:
    """Return the functions that XLA calls: value, jvp and vjp.

    The arguments of jvp are the inputs and their directions; the arguments of vjp are the inputs
    and a covector of the output.
    """
    batched, count, n = Batched(columns), len(columns.sizes), sum(columns.sizes)

    def value(inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        outputs[0][...] = batched.value(inputs)

    def jvp(inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        outputs[0][...] = batched.along(inputs[:count], inputs[count:])

    def vjp(inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        derivatives = batched.back(inputs[:count], inputs[count])
        for output, derivative in zip(outputs, derivatives, strict=True):
            output[...] = derivative

    return [
        xla_call.Function(columns.value_of, n, value),
        xla_call.Function(lambda both: columns.jvp_of(both[:n], both[n:]), 2 * n, jvp),
        xla_call.Function(lambda both: columns.vjp_of(both[:n], both[n:]), n + columns.size, vjp),
    ]


class _Primitives:
    """The JAX primitives of value, jvp and vjp.

    Their parameters are the registration numbers of the three functions and the sizes of outputs.
    Batch axes come first.  Arguments without batch axes get axes of length one, so that a batch
    is a single call.
    """

    def __init__(self) -> None:
        from jax.extend.core import Primitive
        from jax.interpreters import ad

        self.value = self._register(Primitive("pinred_flow"), 0)
        self.jvp = self._register(Primitive("pinred_flow_along"), 1)
        self.vjp = self._register(Primitive("pinred_flow_back"), 2)

        def differentiate_value(primals: Any, tangents: Any, *, numbers: Any, sizes: Any) -> Any:
            output = self.value.bind(*primals, numbers=numbers, sizes=sizes)
            directions = [ad.instantiate_zeros(tangent) for tangent in tangents]
            return output, self.jvp.bind(*primals, *directions, numbers=numbers, sizes=sizes)

        def transpose_jvp(covectors: Any, *arguments: Any, numbers: Any, sizes: Any) -> Any:
            del sizes
            columns = arguments[: len(arguments) // 2]
            widths = tuple(column.shape[-1] for column in columns)
            covector = ad.instantiate_zeros(covectors[0])
            cotangents = self.vjp.bind(*columns, covector, numbers=numbers, sizes=widths)
            return [None] * len(columns) + _sum_cotangents(cotangents, arguments[len(columns) :])

        def differentiate_jvp(primals: Any, tangents: Any, *, numbers: Any, sizes: Any) -> Any:
            fixed = len(primals) // 2
            return _differentiate_linear(self.jvp, primals, tangents, fixed, numbers, sizes)

        def differentiate_vjp(primals: Any, tangents: Any, *, numbers: Any, sizes: Any) -> Any:
            fixed = len(primals) - 1
            return _differentiate_linear(self.vjp, primals, tangents, fixed, numbers, sizes)

        ad.primitive_jvps[self.value] = differentiate_value
        ad.primitive_jvps[self.jvp] = differentiate_jvp
        ad.primitive_jvps[self.vjp] = differentiate_vjp
        ad.primitive_transposes[self.jvp] = transpose_jvp

    def _register(self, primitive: Any, index: int) -> Any:
        """Register evaluation and batching of a primitive, whose function is numbers[index]."""
        import jax
        from jax.core import ShapedArray
        from jax.interpreters import batching, mlir

        xla_call.register()
        primitive.multiple_results = True

        def output_shapes(*arguments: Any, sizes: Any, **_: Any) -> list[Any]:
            leading = np.broadcast_shapes(*(a.shape[:-1] for a in arguments))
            return [ShapedArray((*leading, size), arguments[0].dtype) for size in sizes]

        def call(*arguments: Any, numbers: Any, sizes: Any) -> Any:
            shapes = [
                jax.ShapeDtypeStruct(a.shape, a.dtype)
                for a in output_shapes(*arguments, sizes=sizes)
            ]
            if not prod(shapes[0].shape):
                return [jax.numpy.zeros(a.shape, a.dtype) for a in shapes]
            target = jax.ffi.ffi_call(xla_call.TARGET, shapes)
            return target(*arguments, function=np.int64(numbers[index]))

        def batch(arguments: Any, axes: Any, **parameters: Any) -> Any:
            leading = [
                jax.numpy.expand_dims(a, 0) if axis is None else jax.numpy.moveaxis(a, axis, 0)
                for a, axis in zip(arguments, axes, strict=True)
            ]
            outputs = primitive.bind(*leading, **parameters)
            return outputs, [0] * len(outputs)

        primitive.def_impl(jax.jit(call, static_argnames=("numbers", "sizes")))
        primitive.def_abstract_eval(output_shapes)
        batching.primitive_batchers[primitive] = batch
        mlir.register_lowering(primitive, mlir.lower_fun(call, multiple_results=True))
        return primitive


_primitives = once_for_all(_Primitives)


def _sum_cotangents(cotangents: Sequence[Any], inputs: Sequence[Any]) -> list[Any]:
    """Sum cotangents over the axes along which their inputs were broadcast."""
    sums = []
    for cotangent, like in zip(cotangents, inputs, strict=True):
        shape = like.aval.shape
        axes = [k for k, size in enumerate(shape) if size == 1 and cotangent.shape[k] != 1]
        sums.append(cotangent.sum(axes, keepdims=True) if axes else cotangent)
    return sums


def _differentiate_linear(
    primitive: Any, primals: Any, tangents: Any, fixed: int, numbers: Any, sizes: Any
) -> Any:
    """Return value and tangent of a primitive that is linear in its last arguments.

    Args:
        primitive: The primitive.
        primals: Arguments of the primitive.
        tangents: Tangents of the arguments.
        fixed: Number of leading arguments in which the primitive is not linear.
        numbers: Registration numbers of the functions.
        sizes: Sizes of the outputs.
    Returns:
        The value and its tangent.
    Raises:
        InputError: A second derivative is requested.
    """
    from jax.interpreters import ad

    if not all(type(tangent) is ad.Zero for tangent in tangents[:fixed]):
        raise InputError(FIRST_ORDER)
    directions = [ad.instantiate_zeros(tangent) for tangent in tangents[fixed:]]
    parameters = {"numbers": numbers, "sizes": sizes}
    return (
        primitive.bind(*primals, **parameters),
        primitive.bind(*primals[:fixed], *directions, **parameters),
    )
