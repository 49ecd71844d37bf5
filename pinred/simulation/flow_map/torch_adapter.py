"""A flow as a function of PyTorch with autograd."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...common.errors import MissingPackageError
from .columns import Columns


def torch_function(columns: Columns) -> Callable[..., Any]:
    """Return f(*columns) → output as tensors of float64, with autograd.

    Raises MissingPackageError without PyTorch.
    """
    try:
        import torch
    except ImportError as missing:
        raise MissingPackageError("this needs PyTorch: pip install torch") from missing

    def numbers(tensors: Any) -> list[Any]:
        return [tensor.detach().to(dtype=torch.float64, device="cpu").numpy() for tensor in tensors]

    class FlowFunction(torch.autograd.Function):  # type: ignore[misc]
        """The flow, with its adjoint."""

        @staticmethod
        def forward(ctx: Any, *given: Any) -> Any:
            """Return the output."""
            ctx.save_for_backward(*given)
            return torch.from_numpy(columns.value(*numbers(given))).to(given[0])

        @staticmethod
        def backward(ctx: Any, *covectors: Any) -> Any:
            """Return the slopes by the inputs."""
            given = ctx.saved_tensors
            (covector,) = numbers(covectors)
            found = columns.vjp(numbers(given), covector)
            return tuple(
                torch.from_numpy(part).to(tensor).reshape(tensor.shape)
                for part, tensor in zip(found, given, strict=True)
            )

    checked: Callable[..., Any] = FlowFunction.apply
    return checked
