"""A flow as a JAX function: one XLA call under jit, grad, jvp and vmap, without a compiler.

XLA passes the address of a call frame, a C structure of version 0 of xla/ffi/api/c_api.h, which
jaxlib contains.  The frame is read as words of eight bytes.  Only the fields whose
word indices are defined below are read; fields that newer versions append are ignored.  One
handler serves all functions: an attribute of the call is the number of the function.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from math import prod
from typing import Any

import numpy as np
from llvmlite import ir

from ...common.arrays import Array
from ...common.errors import InputError, MissingPackageError, optional_package
from ...common.memo import once_for_all
from ...integrators.stepping.compiling import compiled, make_intrinsic, numba_core
from .flow_columns import FIRST_ORDER, Batched, Columns

_OLDEST = (0, 10, 0)  # Oldest version of JAX with the call frames that are read here.


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
    numbers = tuple(map(numbered, _xla_functions(columns)))

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


def _xla_functions(columns: Columns) -> list[Function]:
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
        Function(columns.value_of, n, value),
        Function(lambda both: columns.jvp_of(both[:n], both[n:]), 2 * n, jvp),
        Function(lambda both: columns.vjp_of(both[:n], both[n:]), n + columns.size, vjp),
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

        register()
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
            target = jax.ffi.ffi_call(TARGET, shapes)
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


TARGET = "pinred_function"

# Word indices of a frame: for arguments, results and attributes, their number and the list of their
# addresses.  Then the word indices of a buffer, XLA's data types, and the value of an attribute.
EXTENSION, API = 1, 2
ARGUMENTS, ARGUMENT_LIST, RESULTS, RESULT_LIST, ATTRIBUTES = 7, 9, 12, 14, 20
TYPE, DATA, RANK, DIMS = 2, 3, 4, 5
FLOAT, DOUBLE = 11, 12
SCALAR_VALUE = 1


def _memory(kind: str, pointed: Any) -> tuple[Any, Any]:
    """Return load(address) and store(address, value) for one numeric type of numba."""

    @make_intrinsic
    def load(typing: Any, address: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
            return builder.load(builder.inttoptr(arguments[0], pointed.as_pointer()))

        types: Any = numba_core.types
        return getattr(types, kind)(types.int64), generate

    @make_intrinsic
    def store(typing: Any, address: Any, value: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
            builder.store(arguments[1], builder.inttoptr(arguments[0], pointed.as_pointer()))
            return context.get_dummy_value()

        types: Any = numba_core.types
        return types.void(types.int64, getattr(types, kind)), generate

    return load, store


_word, _ = _memory("int64", ir.IntType(64))
_double, _set_double = _memory("float64", ir.DoubleType())
_float, _set_float = _memory("float32", ir.FloatType())


@compiled
def has_extension(frame: int) -> bool:
    """Return whether the frame has an extension, by which XLA can request metadata."""
    asks: bool = _word(frame + 8 * EXTENSION) != 0
    return asks


@compiled
def function_of(frame: int) -> int:
    """Return the number of the function to call, which is the only attribute of the call."""
    scalar = _word(_word(frame + 8 * ATTRIBUTES))
    value: int = _word(_word(scalar + 8 * SCALAR_VALUE))
    return value


@compiled
def take_column(frame: int, out: Array) -> bool:
    """Copy the arguments one after another to `out`; return whether they are vectors that fit."""
    fits: bool = _pass(frame, ARGUMENTS, ARGUMENT_LIST, out, True)
    return fits


@compiled
def give_column(frame: int, out: Array) -> bool:
    """Copy `out` to the results one after another; return whether they are vectors that fit."""
    fits: bool = _pass(frame, RESULTS, RESULT_LIST, out, False)
    return fits


@compiled
def _pass(frame: int, count: int, where: int, numbers: Array, take: bool) -> bool:
    """Move numbers between the buffers of a frame and an array."""
    buffers, total = _word(frame + 8 * where), 0
    for k in range(_word(frame + 8 * count)):
        buffer = _word(buffers + 8 * k)
        if _word(buffer + 8 * RANK) != 1:
            return False
        size = _word(_word(buffer + 8 * DIMS))
        kind, data = _word(buffer + 8 * TYPE) & 0xFFFFFFFF, _word(buffer + 8 * DATA)
        if total + size > numbers.shape[0] or (kind != FLOAT and kind != DOUBLE):
            return False
        for i in range(size):
            if kind == DOUBLE and take:
                numbers[total + i] = _double(data + 8 * i)
            elif kind == DOUBLE:
                _set_double(data + 8 * i, numbers[total + i])
            elif take:
                numbers[total + i] = _float(data + 4 * i)
            else:
                _set_float(data + 4 * i, numbers[total + i])
        total += size
    fits: bool = total == numbers.shape[0]
    return fits


@dataclass(frozen=True)
class Function:
    """A Python function that XLA calls.

    Attributes:
        one: Function from all inputs in one vector, (size,), to all outputs in one vector.
        size: Length of the vector of inputs.
        many: Function of lists of inputs and outputs with leading axes, which fills the outputs.
    """

    one: Callable[[Array], Array]
    size: int
    many: Callable[[Sequence[Any], Sequence[Any]], None]


_FRAME_WORDS, _BUFFER_WORDS = 21, 6  # Number of words of a frame and of a buffer.
# An extension of type 1 asks for the version of the interface, which is copied from the API to
# the metadata of the extension.  In both structures the version follows a few other words.
_ASKS_FOR_VERSION, _METADATA = 1, 3
_VERSION_IN_METADATA, _VERSION_IN_API, _VERSION_NUMBERS = 1, 2, 2
_MAKE_ERROR = 6  # Index in the API of the function that builds an error.
_INVALID, _INTERNAL = 3, 13  # XLA's error codes.
_FLOATS: dict[int, Any] = {FLOAT: ctypes.c_float, DOUBLE: ctypes.c_double}


class _ErrorArguments(ctypes.Structure):
    _fields_ = [
        ("size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("message", ctypes.c_char_p),
        ("code", ctypes.c_int),
    ]


_make_error = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_ErrorArguments))
_functions: dict[int, Function] = {}
_numbers = count()


def numbered(function: Function) -> int:
    """Register a function, which stays registered until the process ends.

    XLA does not report when the last program that calls the function is deleted.

    Args:
        function: The function.
    Returns:
        The number of the function, which calls pass as an attribute.
    """
    number = next(_numbers)
    _functions[number] = function
    return number


@once_for_all
def register() -> None:
    """Register the handler with XLA for the CPU platform.

    A call of `jax.ffi` names TARGET; its attribute `function` is the index of the function.
    """
    import jax

    jax.ffi.register_ffi_target(TARGET, jax.ffi.pycapsule(_HANDLER), platform="cpu")


def _words(address: int, size: int) -> Any:
    return (ctypes.c_int64 * size).from_address(address)


def _arrays(size: int, where: int) -> list[Any]:
    """Return arrays that share the memory of `size` buffers, whose addresses start at `where`."""
    arrays = []
    for address in _words(where, size):
        buffer = _words(address, _BUFFER_WORDS)
        shape = _words(buffer[DIMS], buffer[RANK])[:]
        number = _FLOATS[buffer[TYPE] & 0xFFFFFFFF]
        array = np.frombuffer((number * prod(shape)).from_address(buffer[DATA]), number)
        arrays.append(array if len(shape) == 1 else array.reshape(shape))
    return arrays


def _answer(frame: Any) -> bool:
    """Answer a request for the version; return whether the frame contains one."""
    extension = _words(frame[EXTENSION], _METADATA + 1)
    if extension[1] & 0xFFFFFFFF != _ASKS_FOR_VERSION:
        return False
    target = extension[_METADATA] + 8 * (_VERSION_IN_METADATA + _VERSION_NUMBERS)
    source = frame[API] + 8 * (_VERSION_IN_API + _VERSION_NUMBERS)
    ctypes.memmove(target, source, 8)
    return True


def _handle(address: int) -> int | None:
    """Execute a call frame; return None, or the address of an XLA error."""
    try:
        is_request = has_extension(address) and _answer(_words(address, _FRAME_WORDS))
        if not is_request:
            function = _functions[function_of(address)]
            column = np.empty(function.size)
            if not (take_column(address, column) and give_column(address, function.one(column))):
                frame = _words(address, _FRAME_WORDS)
                function.many(
                    _arrays(frame[ARGUMENTS], frame[ARGUMENT_LIST]),
                    _arrays(frame[RESULTS], frame[RESULT_LIST]),
                )
    except BaseException as error:  # No Python exception may propagate through C.
        invalid = isinstance(error, ValueError)
        text = str(error) if invalid else f"{type(error).__name__}: {error}"
        arguments = _ErrorArguments(
            ctypes.sizeof(_ErrorArguments),
            None,
            text.encode(errors="replace"),
            _INVALID if invalid else _INTERNAL,
        )
        xla_error: int | None = _make_error(
            _words(_words(address, _FRAME_WORDS)[API], _MAKE_ERROR + 1)[_MAKE_ERROR]
        )(ctypes.byref(arguments))
        return xla_error
    return None


_HANDLER = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(_handle)
