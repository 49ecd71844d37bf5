"""A flow as a PyTorch function: custom operators with autograd, also for batches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from itertools import count
from typing import Any

import numpy as np

from ...common.errors import InputError, ShapeError, optional_package
from ...common.memo import once_for_all
from ...common.names import brief
from .flow_columns import FIRST_ORDER, Batched, Columns

# Registered flows; operators refer to a flow by its number.  Entries are never removed.
_flows: dict[int, Batched] = {}
_numbers = count()


def torch_function(columns: Columns) -> Callable[..., Any]:
    """Build the PyTorch function of a flow, with autograd, forward mode and vmap.

    Inputs are tensors (…, size) whose leading axes broadcast; a batch runs in SIMD lanes.  Outputs
    have the precision of the inputs.  The flow itself runs in double precision on the processor.

    Args:
        columns: The flow between vectors.
    Returns:
        f(*columns, **columns) → output.
    Raises:
        MissingPackageError: PyTorch is not installed.
    """
    torch = optional_package("torch", "this needs PyTorch: pip install torch")
    apply, number = _function(), next(_numbers)
    _flows[number] = Batched(columns)

    def flow(*positional: Any, **named: Any) -> Any:
        values = columns.arranged(positional, named)
        tensors = [value for value in values if isinstance(value, torch.Tensor)]
        floats = [tensor.dtype for tensor in tensors if tensor.is_floating_point()]
        dtype = reduce(torch.promote_types, floats) if floats else torch.float64
        inputs = []
        for name, size, value in zip(columns.names, columns.sizes, values, strict=True):
            try:
                # Arrays of the scene are read-only, and tensors must not share their memory.
                tensor = torch.as_tensor(value.copy() if isinstance(value, np.ndarray) else value)
            except (TypeError, ValueError, RuntimeError):
                raise InputError(f"{name} must be numbers, got {brief(value)}") from None
            if tensor.is_complex() or tensor.dtype == torch.bool:
                raise InputError(f"{name} must be real numbers, got {tensor.dtype}")
            tensor = tensor.to(torch.float64)
            tensor = tensor.reshape(1) if tensor.ndim == 0 else tensor
            if tensor.shape[-1] != size:
                raise ShapeError(f"{name} must have shape (…, {size}), got {tuple(tensor.shape)}")
            inputs.append(tensor)
        try:
            np.broadcast_shapes(*(tensor.shape[:-1] for tensor in inputs))
        except ValueError:
            shapes = ", ".join(str(tuple(tensor.shape)) for tensor in inputs)
            raise ShapeError(
                f"leading axes of inputs must broadcast, got shapes {shapes}"
            ) from None
        return apply(number, columns.size, *inputs).to(dtype)

    # torch.compile cannot trace autograd functions with a forward mode, so it must skip `flow`.
    untraced: Callable[..., Any] = torch.compiler.disable(flow)
    return untraced


def _to_numpy(tensors: Sequence[Any]) -> list[Any]:
    import torch

    return [tensor.detach().to(dtype=torch.float64, device="cpu").numpy() for tensor in tensors]


@once_for_all
def _function() -> Any:
    """Return the autograd function of all flows.

    Operators take only tensors and numbers, so the flow is identified by its number.
    """
    import torch

    def like(array: Any, tensor: Any) -> Any:
        return torch.from_numpy(np.ascontiguousarray(array)).to(tensor)

    def leading_shape(tensors: Sequence[Any]) -> Any:
        return torch.broadcast_shapes(*(tensor.shape[:-1] for tensor in tensors))

    def value(number: int, _size: int, columns: Any) -> Any:
        return like(_flows[number].value(_to_numpy(columns)), columns[0])

    def jvp(number: int, _size: int, columns: Any, directions: Any) -> Any:
        return like(_flows[number].along(_to_numpy(columns), _to_numpy(directions)), columns[0])

    def vjp(number: int, columns: Any, covector: Any) -> Any:
        derivatives = _flows[number].back(_to_numpy(columns), _to_numpy([covector])[0])
        return [like(derivative, columns[0]) for derivative in derivatives]

    def move_batch_axes(tensors: Any, axes: Any) -> list[Any]:
        """Return tensors of equal rank with their batch axis first."""
        pairs = list(zip(tensors, axes, strict=True))
        rank = max(tensor.ndim - (axis is not None) for tensor, axis in pairs)
        batches = []
        for tensor, axis in pairs:
            batch = tensor.unsqueeze(0) if axis is None else tensor.movedim(axis, 0)
            missing = (1,) * (rank + 1 - batch.ndim)
            batches.append(batch.reshape(batch.shape[0], *missing, *batch.shape[1:]))
        return batches

    def make_operator(name: str, schema: str, call: Any, shapes: Any) -> Any:
        operator = torch.library.custom_op(f"pinred::{name}", call, mutates_args=(), schema=schema)
        operator.register_fake(shapes)
        return operator

    value_op = make_operator(
        "flow", "(int number, int size, Tensor[] columns) -> Tensor", value,
        lambda _number, size, columns: columns[0].new_empty((*leading_shape(columns), size)),
    )  # fmt: skip
    jvp_op = make_operator(
        "flow_along",
        "(int number, int size, Tensor[] columns, Tensor[] directions) -> Tensor", jvp,
        lambda _number, size, columns, directions: columns[0].new_empty(
            (*leading_shape([*columns, *directions]), size)
        ),
    )  # fmt: skip
    vjp_op = make_operator(
        "flow_back", "(int number, Tensor[] columns, Tensor covector) -> Tensor[]", vjp,
        lambda _number, columns, covector: [
            column.new_empty((*leading_shape([*columns, covector]), column.shape[-1]))
            for column in columns
        ],
    )  # fmt: skip

    class FirstOrder(torch.autograd.Function):  # type: ignore[misc]
        """A function without derivatives; its first two arguments are numbers."""

        @staticmethod
        def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
            """Save nothing, because second derivatives are rejected."""

        @staticmethod
        def backward(_ctx: Any, *_: Any) -> Any:
            """Reject a second derivative.  Raises InputError."""
            raise InputError(FIRST_ORDER)

        @staticmethod
        def jvp(_ctx: Any, *_: Any) -> Any:
            """Reject a second derivative.  Raises InputError."""
            raise InputError(FIRST_ORDER)

    class Jvp(FirstOrder):
        """The derivative along directions; the arguments are the columns and the directions."""

        @staticmethod
        def forward(number: int, size: int, *both: Any) -> Any:
            """Compute the derivative."""
            half = len(both) // 2
            return jvp_op(number, size, list(both[:half]), list(both[half:]))

        @staticmethod
        def vmap(_info: Any, axes: Any, number: int, size: int, *both: Any) -> Any:
            """Compute the derivatives of a batch in one call."""
            return Jvp.apply(number, size, *move_batch_axes(both, axes[2:])), 0

    class Vjp(FirstOrder):
        """The derivatives of covector · output; the last argument is the covector."""

        @staticmethod
        def forward(number: int, _size: int, *both: Any) -> Any:
            """Compute the derivatives."""
            return tuple(vjp_op(number, list(both[:-1]), both[-1]))

        @staticmethod
        def vmap(_info: Any, axes: Any, number: int, size: int, *both: Any) -> Any:
            """Compute the derivatives of a batch in one call."""
            derivatives = Vjp.apply(number, size, *move_batch_axes(both, axes[2:]))
            return derivatives, (0,) * len(derivatives)

    class FlowFunction(torch.autograd.Function):  # type: ignore[misc]
        """The flow with its derivatives in both modes."""

        @staticmethod
        def forward(number: int, size: int, *columns: Any) -> Any:
            """Compute the output."""
            return value_op(number, size, list(columns))

        @staticmethod
        def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
            """Save the inputs for derivatives."""
            del output
            ctx.number, ctx.size, *columns = inputs
            ctx.save_for_backward(*columns)
            ctx.save_for_forward(*columns)

        @staticmethod
        def backward(ctx: Any, *covectors: Any) -> Any:
            """Compute the derivatives with respect to the inputs."""
            columns = ctx.saved_tensors
            derivatives = Vjp.apply(ctx.number, ctx.size, *columns, covectors[0])
            pairs = zip(derivatives, columns, strict=True)
            return None, None, *(slope.sum_to_size(column.shape) for slope, column in pairs)

        @staticmethod
        def jvp(ctx: Any, _number: None, _size: None, *directions: Any) -> Any:
            """Compute the derivative along directions of the inputs."""
            columns = ctx.saved_tensors
            along = [
                torch.zeros_like(column) if direction is None else direction
                for direction, column in zip(directions, columns, strict=True)
            ]
            return Jvp.apply(ctx.number, ctx.size, *columns, *along)

        @staticmethod
        def vmap(_info: Any, axes: Any, number: int, size: int, *columns: Any) -> Any:
            """Compute the outputs of a batch in one call."""
            return FlowFunction.apply(number, size, *move_batch_axes(columns, axes[2:])), 0

    return FlowFunction.apply
