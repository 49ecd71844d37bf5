"""A flow as a PyTorch function: derivatives agree with differences, batches run in SIMD lanes."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import lazy_loader
import numpy as np
import pytest
from perturbed_cat import AT, BATCH, flow_of
from twelve_gains import OTHER, OWN, assert_same_bits, flow_pair

from pinred import InputError, ShapeError
from pinred.simulation.flow_map.flow_columns import Columns

torch: Any = lazy_loader.load("torch") if find_spec("torch") else pytest.importorskip("torch")
pytestmark = [
    pytest.mark.slow,
    # PyTorch warns of its own ways.
    pytest.mark.filterwarnings("ignore:`torch.jit", "ignore:The .grad attribute"),
]


@pytest.fixture(scope="module")
def function() -> Any:
    """Return the PyTorch function of one flow."""
    return flow_of().torch()


@pytest.fixture(scope="module")
def columns() -> Columns:
    """Return the same flow between vectors."""
    return flow_of().columns()


def tensors() -> list[Any]:
    """Return the inputs as tensors."""
    return [torch.tensor(each, requires_grad=True) for each in AT]


@pytest.mark.by_hand
def test_derivatives_agree_with_differences() -> None:
    """Both modes agree in double precision, also for batches with shared inputs."""
    function = flow_of(method="Gauss(0.01)").torch()
    options = {"eps": 1e-5, "atol": 1e-7, "check_forward_ad": True}
    assert torch.autograd.gradcheck(function, tensors(), **options)
    batch = [torch.tensor(BATCH[:3], requires_grad=True), *tensors()[1:]]
    assert torch.autograd.gradcheck(function, batch, **options)


def test_values_and_derivatives_agree_with_flow(function: Any, columns: Columns) -> None:
    """They agree with torch.func and vmap, too."""
    np.testing.assert_array_equal(function(*AT), columns.value(*AT))
    at = [each.detach() for each in tensors()]
    for mode in (torch.func.jacrev, torch.func.jacfwd):
        for found, J in zip(mode(function, (0, 1, 2))(*at), columns.jacobian(*AT), strict=True):
            np.testing.assert_allclose(found, J, atol=1e-12)
    batch = torch.tensor(BATCH)
    for found in (function(batch, *at[1:]), torch.vmap(function, (0, None, None))(batch, *at[1:])):
        for row, x in zip(found, BATCH, strict=True):
            np.testing.assert_allclose(row, columns.value(x, *AT[1:]), rtol=1e-10, atol=1e-11)
    slopes = torch.vmap(torch.func.jacrev(lambda x: function(x, *at[1:])))(batch)
    for row, x in zip(slopes, BATCH, strict=True):
        np.testing.assert_allclose(row, columns.jacobian(x, *AT[1:])[0], atol=1e-10)
    assert function(batch[:0]).shape == (0, columns.size)


def test_batch_is_one_call(monkeypatch: pytest.MonkeyPatch) -> None:
    """A batch runs in SIMD lanes, directly and under vmap."""
    calls = []
    real = Columns.values

    def counted(self: Columns, *given: Any, **how: Any) -> Any:
        calls.append(len(given[0]))
        return real(self, *given, **how)

    monkeypatch.setattr(Columns, "values", counted)
    function = flow_of().torch()
    function(torch.tensor(BATCH))
    torch.vmap(function)(torch.tensor(BATCH))
    assert calls == [len(BATCH)] * 2


def test_single_precision_runs_in_double(function: Any, columns: Columns) -> None:
    """Outputs have the precision of the inputs; the flow runs in double precision."""
    x = torch.tensor(AT[0], dtype=torch.float32, requires_grad=True)
    found = function(x, kick=0.5)
    assert found.dtype == torch.float32
    expected = columns.value(x.detach().double().numpy(), 0.5, columns.starts[2])
    np.testing.assert_array_equal(found.detach(), expected.astype(np.float32))
    found.sum().backward()
    assert x.grad.dtype == torch.float32


def test_torch_compile_skips_flow(function: Any) -> None:
    """torch.compile calls the flow without tracing it."""
    program = torch.compile(lambda x: (2.0 * function(2.0 * x)).sum(), backend="eager")
    x = torch.tensor(AT[0], requires_grad=True)
    program(x).backward()
    again = torch.tensor(AT[0], requires_grad=True)
    (2.0 * function(2.0 * again)).sum().backward()
    np.testing.assert_array_equal(x.grad, again.grad)


def test_invalid_inputs_are_rejected(function: Any) -> None:
    """The message names the input."""
    with pytest.raises(InputError, match=r"no input 'kik'.*kick"):
        function(kik=1.0)
    with pytest.raises(ShapeError, match=r"x0 must have shape \(…, 3\), got \(2,\)"):
        function(torch.zeros(2))
    with pytest.raises(ShapeError, match="leading axes of inputs must broadcast"):
        function(torch.zeros(2, 3), torch.zeros(5, 1))
    with pytest.raises(InputError, match=r"x0 must be real numbers, got torch\.complex64"):
        function(torch.zeros(3, dtype=torch.complex64))
    with pytest.raises(InputError, match="x0 must be numbers, got 'fast'"):
        function("fast")
    with pytest.raises(ShapeError, match="must be finite"):
        function(torch.full((3,), np.nan))
    with pytest.raises(InputError, match="must be above zero"):
        function(**{"back.mass": -1.0})
    x = torch.tensor(AT[0], requires_grad=True)
    (slope,) = torch.autograd.grad(function(x).sum(), x, create_graph=True)
    with pytest.raises(InputError, match="only have first derivatives"):
        slope.sum().backward()


def test_vector_has_the_bits_of_scalars_in_torch() -> None:
    """The PyTorch function has one tensor, and its derivatives are those of scalars."""
    one, many = flow_pair()
    f, g = one.torch(), many.torch()
    x = torch.tensor([0.1, 0.2, -0.1], dtype=torch.float64)
    u = torch.tensor(OTHER, requires_grad=True)
    columns = [torch.tensor([value], requires_grad=True) for value in OTHER]
    y, z = f(u, x), g(*columns, x)
    assert_same_bits(y.detach(), z.detach())
    (back,) = torch.autograd.grad((y * y).sum(), u)
    assert_same_bits(back, torch.cat(torch.autograd.grad((z * z).sum(), columns)))
    along = torch.func.jvp(lambda v: f(v, x), (u.detach(),), (torch.tensor(OWN),))[1]
    directions = tuple(torch.tensor([value]) for value in OWN)
    points = tuple(column.detach() for column in columns)
    assert_same_bits(along, torch.func.jvp(lambda *v: g(*v, x), points, directions)[1])
    with pytest.raises(ShapeError, match=r"u must have shape \(…, 12\), got \(11,\)"):
        f(u[:11], x)
