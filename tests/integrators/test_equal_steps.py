"""Methods with steps of one length: how many steps they make, and how many are too many."""

from __future__ import annotations

import pytest

from pinred.common.errors import InputError
from pinred.integrators.methods import METHODS, EqualSteps, Gauss

KINDS = [kind for kind in METHODS.values() if issubclass(kind, EqualSteps)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("part", "total"), [(-0.5, 10), (0.0, 10), (5e-13, 10), (2e-12, 11)])
def test_a_step_is_no_longer_than_asked_for(
    kind: type[EqualSteps], part: float, total: int
) -> None:
    """But for round-off: a part in a trillion of ten steps does not take another one."""
    end = 3.0 * ((1.0 + part) if part > 0.0 else (10.0 + part) / 10.0)
    told = kind(0.3).registers(end)
    assert (told["total"], told["max_steps"]) == (total, total)
    assert told["h"] == pytest.approx(end / total, rel=1e-15)
    assert kind(0.3).registers(0.1)["total"] == 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("step", [1e-3, 1.0, 1e3])
def test_steps_that_nobody_can_wait_for_are_refused(kind: type[EqualSteps], step: float) -> None:
    """More than a trillion; that many are not."""
    method = kind(step)
    assert method.registers(step * 1e12)["total"] == pytest.approx(1e12, rel=1e-11)
    with pytest.raises(InputError, match=r"at most 1e\+12 steps"):
        method.registers(step * 1.1e12)


@pytest.mark.parametrize("order", range(2, 17, 2))
def test_gauss_says_what_it_takes(order: int) -> None:
    """Half as many stages as its order, evaluated at once; the derivative for Newton only."""
    for solver in ("auto", "fixed point", "Newton"):
        method = Gauss(0.1, order, solver)
        assert (method.dense_order, method.name) == (order, f"Gauss{order}")
        assert 2 * method.stages == order
        assert method.stages <= method.lanes <= max(4, 2 * method.stages)
        assert method.stepper().needs_tangent == (solver == "Newton")
