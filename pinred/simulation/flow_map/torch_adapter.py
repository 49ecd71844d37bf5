"""A flow as a function of PyTorch: custom operators with autograd, for batches too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from itertools import count
from typing import Any

import numpy as np

from ...common.errors import InputError, MissingPackageError, ShapeError
from ...common.memo import once_for_all
from ...common.plain_names import brief
from .batched import FIRST_ORDER, Batched
from .flow_columns import Columns

_flows: dict[int, Batched] = {}  # by the numbers that operators know them by, for ever
_numbers = count()


def torch_function(columns: Columns) -> Callable[..., Any]:
    """Return f(*columns, **columns) → output as tensors, with autograd, forward mode and vmap.

    Columns are (…, size), whose leading axes broadcast: a batch runs in lanes.  Numbers come and
    go in the precision of the tensors given; between, they are doubles on the processor.
    Raises MissingPackageError without PyTorch.
    """
    try:
        import torch
    except ImportError as missing:
        raise MissingPackageError("this needs PyTorch: pip install torch") from missing
    apply, number = _function(), next(_numbers)
    _flows[number] = Batched(columns)

    def flow(*given: Any, **named: Any) -> Any:
        arranged = columns.arranged(given, named)
        tensors = [each for each in arranged if isinstance(each, torch.Tensor)]
        floats = [each.dtype for each in tensors if each.is_floating_point()]
        dtype = reduce(torch.promote_types, floats) if floats else torch.float64
        out = []
        for name, size, value in zip(columns.names, columns.sizes, arranged, strict=True):
            try:
                # Arrays that stay as they are may be read only, which tensors may not.
                tensor = torch.as_tensor(value.copy() if isinstance(value, np.ndarray) else value)
            except (TypeError, ValueError, RuntimeError):
                raise InputError(f"{name} must be numbers, got {brief(value)}") from None
            if tensor.is_complex() or tensor.dtype == torch.bool:
                raise InputError(f"{name} must be real numbers, got {tensor.dtype}")
            tensor = tensor.to(torch.float64)
            tensor = tensor.reshape(1) if tensor.ndim == 0 else tensor
            if tensor.shape[-1] != size:
                raise ShapeError(f"{name} must have shape (…, {size}), got {tuple(tensor.shape)}")
            out.append(tensor)
        try:
            np.broadcast_shapes(*(each.shape[:-1] for each in out))
        except ValueError:
            shapes = ", ".join(str(tuple(each.shape)) for each in out)
            raise ShapeError(
                f"leading axes of inputs must broadcast, got shapes {shapes}"
            ) from None
        return apply(number, columns.size, *out).to(dtype)

    # Its tracing knows no functions of autograd with a forward mode: programs go around this.
    unfollowed: Callable[..., Any] = torch.compiler.disable(flow)
    return unfollowed


def _host(tensors: Sequence[Any]) -> list[Any]:
    import torch

    return [tensor.detach().to(dtype=torch.float64, device="cpu").numpy() for tensor in tensors]


@once_for_all
def _function() -> Any:
    """Return the function of autograd, made of custom operators.

    The operators are known by number, for they take tensors and numbers only.
    """
    import torch

    def like(array: Any, tensor: Any) -> Any:
        return torch.from_numpy(np.ascontiguousarray(array)).to(tensor)

    def lead(tensors: Sequence[Any]) -> Any:
        return torch.broadcast_shapes(*(each.shape[:-1] for each in tensors))

    def value(number: int, _size: int, columns: Any) -> Any:
        return like(_flows[number].value(_host(columns)), columns[0])

    def along(number: int, _size: int, columns: Any, directions: Any) -> Any:
        return like(_flows[number].along(_host(columns), _host(directions)), columns[0])

    def back(number: int, columns: Any, covector: Any) -> Any:
        found = _flows[number].back(_host(columns), _host([covector])[0])
        return [like(each, columns[0]) for each in found]

    def moved(tensors: Any, axes: Any) -> list[Any]:
        """Return tensors of one rank with their batch axis first."""
        pairs = list(zip(tensors, axes, strict=True))
        rank = max(each.ndim - (axis is not None) for each, axis in pairs)
        out = []
        for each, axis in pairs:
            first = each.unsqueeze(0) if axis is None else each.movedim(axis, 0)
            missing = (1,) * (rank + 1 - first.ndim)
            out.append(first.reshape(first.shape[0], *missing, *first.shape[1:]))
        return out

    def made(name: str, schema: str, call: Any, shapes: Any) -> Any:
        op = torch.library.custom_op(f"pinred::{name}", call, mutates_args=(), schema=schema)
        op.register_fake(shapes)
        return op

    value_op = made(
        "flow", "(int number, int size, Tensor[] columns) -> Tensor", value,
        lambda _number, size, columns: columns[0].new_empty((*lead(columns), size)),
    )  # fmt: skip
    along_op = made(
        "flow_along",
        "(int number, int size, Tensor[] columns, Tensor[] directions) -> Tensor", along,
        lambda _number, size, columns, directions: columns[0].new_empty(
            (*lead([*columns, *directions]), size)
        ),
    )  # fmt: skip
    back_op = made(
        "flow_back", "(int number, Tensor[] columns, Tensor covector) -> Tensor[]", back,
        lambda _number, columns, covector: [
            each.new_empty((*lead([*columns, covector]), each.shape[-1])) for each in columns
        ],
    )  # fmt: skip

    class Once(torch.autograd.Function):  # type: ignore[misc]
        """A function without derivatives; its first two arguments are numbers."""

        @staticmethod
        def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
            """Keep nothing."""

        @staticmethod
        def backward(_ctx: Any, *_: Any) -> Any:
            """Refuse."""
            raise InputError(FIRST_ORDER)

        @staticmethod
        def jvp(_ctx: Any, *_: Any) -> Any:
            """Refuse."""
            raise InputError(FIRST_ORDER)

    class Along(Once):
        """The derivative along directions, which come after the columns."""

        @staticmethod
        def forward(number: int, size: int, *both: Any) -> Any:
            """Return it."""
            half = len(both) // 2
            return along_op(number, size, list(both[:half]), list(both[half:]))

        @staticmethod
        def vmap(_info: Any, axes: Any, number: int, size: int, *both: Any) -> Any:
            """Return those of many, in one call."""
            return Along.apply(number, size, *moved(both, axes[2:])), 0

    class Back(Once):
        """The slopes by the inputs; a covector comes after the columns."""

        @staticmethod
        def forward(number: int, _size: int, *both: Any) -> Any:
            """Return them."""
            return tuple(back_op(number, list(both[:-1]), both[-1]))

        @staticmethod
        def vmap(_info: Any, axes: Any, number: int, size: int, *both: Any) -> Any:
            """Return those of many, in one call."""
            found = Back.apply(number, size, *moved(both, axes[2:]))
            return found, (0,) * len(found)

    class FlowFunction(torch.autograd.Function):  # type: ignore[misc]
        """The flow, with what goes along it and back."""

        @staticmethod
        def forward(number: int, size: int, *columns: Any) -> Any:
            """Return the output."""
            return value_op(number, size, list(columns))

        @staticmethod
        def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
            """Keep the inputs."""
            del output
            ctx.number, ctx.size, *columns = inputs
            ctx.save_for_backward(*columns)
            ctx.save_for_forward(*columns)

        @staticmethod
        def backward(ctx: Any, *covectors: Any) -> Any:
            """Return the slopes by the inputs."""
            columns = ctx.saved_tensors
            found = Back.apply(ctx.number, ctx.size, *columns, covectors[0])
            pairs = zip(found, columns, strict=True)
            return None, None, *(slope.sum_to_size(each.shape) for slope, each in pairs)

        @staticmethod
        def jvp(ctx: Any, _number: None, _size: None, *directions: Any) -> Any:
            """Return the derivative along directions of the inputs."""
            columns = ctx.saved_tensors
            along = [
                torch.zeros_like(column) if direction is None else direction
                for direction, column in zip(directions, columns, strict=True)
            ]
            return Along.apply(ctx.number, ctx.size, *columns, *along)

        @staticmethod
        def vmap(_info: Any, axes: Any, number: int, size: int, *columns: Any) -> Any:
            """Return the output of many inputs, in one call."""
            return FlowFunction.apply(number, size, *moved(columns, axes[2:])), 0

    return FlowFunction.apply
