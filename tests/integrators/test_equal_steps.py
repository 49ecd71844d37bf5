"""Methods with equal steps: the number of steps and its limit."""

from __future__ import annotations

import pytest

from pinred.common.errors import InputError
from pinred.integrators.methods import METHODS, EqualSteps, Gauss

KINDS = [kind for kind in METHODS.values() if issubclass(kind, EqualSteps)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("part", "total"), [(-0.5, 10), (0.0, 10), (5e-13, 10), (2e-12, 11)])
def test_equal_steps_are_at_most_the_requested_length(
    kind: type[EqualSteps], part: float, total: int
) -> None:
    """A relative excess of 1e-12 by round-off does not add a step."""
    end = 3.0 * ((1.0 + part) if part > 0.0 else (10.0 + part) / 10.0)
    registers = kind(0.3)._registers(end)
    assert (registers["total"], registers["max_steps"]) == (total, total)
    assert registers["h"] == pytest.approx(end / total, rel=1e-15)
    assert kind(0.3)._registers(0.1)["total"] == 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("step", [1e-3, 1.0, 1e3])
def test_more_than_1e12_steps_are_rejected(kind: type[EqualSteps], step: float) -> None:
    """1e12 steps are allowed."""
    method = kind(step)
    assert method._registers(step * 1e12)["total"] == pytest.approx(1e12, rel=1e-11)
    with pytest.raises(InputError, match=r"at most 1e\+12 steps"):
        method._registers(step * 1.1e12)


@pytest.mark.parametrize("order", range(2, 17, 2))
def test_gauss_states_stages_and_derivative_needs(order: int) -> None:
    """Half as many stages as its order; only Newton's method needs the derivative."""
    for solver in ("auto", "fixed point", "Newton"):
        method = Gauss(0.1, order, solver)
        assert (method.dense_order, method.name) == (order, f"Gauss{order}")
        assert 2 * method.stages == order
        assert method.stages <= method.lanes <= max(4, 2 * method.stages)
        assert method._stepper().needs_tangent == (solver == "Newton")
