"""The stress suite (short form), and proof that each check can fail."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred import RKMK4
from pinred.cli.command_line import main
from pinred.forces import Damper, Wrench
from pinred.laboratory.stress.check import (
    CHECKS,
    Case,
    Check,
    Outcome,
    Trial,
    run_check,
    table,
)

pytestmark = pytest.mark.slow

SHORT = Trial(effort="short")


def with_wrong_constants(function: Callable[..., Any], by: float) -> Callable[..., Any]:
    """Return simulate or simulate_many with relative errors in the constants of all bodies.

    The default initial state and times are those of the correct robot.
    """

    def run(system: pinred.System, **options: Any) -> Any:
        expected, wrong = system.initial, perturb_bodies(system, by)
        if expected is not None and "x0" not in options:
            options = {"x0": expected.x, "xdot0": expected.xdot, "xi0": expected.xi, **options}
            options.setdefault("times", np.linspace(0.0, expected.duration, 201))
        return function(wrong, **options)

    return run


def perturb_bodies(system: pinred.System, by: float) -> pinred.System:
    """Change the mass of each body and stretch it differently along each axis.

    The bodies stay physical, and flat if they were flat. The armature stays unchanged.
    """
    model = system.model.copy()
    for i in range(1, model.njoints):
        body = model.inertias[i]
        stretch = np.diag(1.0 + by * np.array([1.0, 0.3, -0.5]))
        spread = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia
        spread = (1.0 + by / i) * stretch @ spread @ stretch
        inertia = np.trace(spread) * np.eye(3) - spread
        model.inertias[i] = pin.Inertia(body.mass * (1.0 + by / i), body.lever, inertia)
    return pinred.load(model)


# Checks that take more than 5 s.
LONG = {
    "periods",
    "units",
    "zero_momentum",
    "energy",
    "tolerances",
    "casimirs",
    "mass_ratios",
    "between",
    "frames",
    "straight_chains",
}


def with_long_by_hand(names: Iterable[str]) -> list[Any]:
    """Return test parameters, of which the long checks are marked by_hand."""
    return [
        pytest.param(name, marks=pytest.mark.by_hand) if name in LONG else name for name in names
    ]


@pytest.mark.parametrize("name", with_long_by_hand(CHECKS))
@pytest.mark.sampled
def test_check_passes(name: str) -> None:
    """The short form of the check passes."""
    outcome = run_check(CHECKS[name], SHORT)
    assert outcome.passed, table([outcome])


def test_nan_fails_and_is_worst_case() -> None:
    """NaN is within no bound, and is the worst case."""
    case = Case("a", float("nan"), 1.0)
    assert not case.passed
    outcome = run_check(Check("c", "w", lambda _: iter([Case("b", 0.0, 1.0), case])), SHORT)
    assert not outcome.passed
    assert outcome.worst is case


def test_check_without_cases_fails() -> None:
    """A check without cases proves nothing."""
    assert not run_check(Check("c", "w", lambda _: iter([])), SHORT).passed


def test_check_that_stops_fails() -> None:
    """A motion that cannot be integrated is a failure with a reason."""

    def cases(trial: Trial) -> Any:
        yield Case("a", 0.0, 1.0)
        trial.simulate(pinred.load("falling_cat"), method=pinred.DOP853(max_steps=1))

    outcome = run_check(Check("c", "w", cases), SHORT)
    assert not outcome.passed
    assert "TooManySteps" in table([outcome])


def test_unknown_check_is_rejected(capsys: pytest.CaptureFixture[str]) -> None:
    """The message lists the checks."""
    assert main(["stress", "--only", "reversal,x"]) == 2
    assert "no check 'x'; the checks are tolerances, " in capsys.readouterr().err


def test_stress_command_prints_table(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It returns 1 if a check fails."""
    quick = Check("quick", "nothing", lambda _: iter([Case("a case", 0.5, 1.0)]))
    monkeypatch.setitem(CHECKS, "quick", quick)
    assert main(["stress", "--only", "quick"]) == 0
    assert "1 of 1 checks passed" in capsys.readouterr().out
    failing = replace(quick, cases=lambda _: iter([Case("a case", 2.0, 1.0)]))
    monkeypatch.setitem(CHECKS, "quick", failing)
    assert main(["stress", "--only", "quick"]) == 1
    printed = capsys.readouterr().out
    assert "FAILED" in printed
    assert "0 of 1 checks passed" in printed


# Invariance checks pass for a wrong robot; other tests make them fail.
INVARIANT = ("reversal", "energy", "casimirs", "frames", "units")


# Smallest relative fault (power of ten) that the short form of a check detects (docs/stress.md).
NOTICED = {
    "tolerances": 1e-8,
    "between": 1e-7,
    "periods": 1e-8,
    "mass_ratios": 1e-7,
    "spins": 1e-9,
    "flat_bodies": 1e-8,
    "straight_chains": 1e-8,
    "singular_shapes": 1e-8,
    "stiff_springs": 1e-8,
    "long_chains": 1e-8,
    "zero_momentum": 1e-8,
    "time_scales": 1e-9,
    "chaos": 1e-8,
}


@pytest.mark.filterwarnings("ignore::pinred.ModelWarning")  # flat bodies cause warnings
@pytest.mark.parametrize(
    "name", with_long_by_hand([name for name in CHECKS if name not in INVARIANT])
)
@pytest.mark.sampled
def test_wrong_constant_fails(name: str) -> None:
    """The check fails for a robot with wrong constants, because of a case, not of an error."""
    outcome = run_with_fault(name, NOTICED[name])
    assert not outcome.stopped, outcome.stopped
    assert any(not case.passed for case in outcome.cases), table([outcome])


def run_with_fault(name: str, by: float) -> Outcome:
    """Run the short form of a check for robots with wrong constants."""
    wrong = replace(
        SHORT,
        simulate=with_wrong_constants(pinred.simulate, by),
        simulate_many=with_wrong_constants(pinred.simulate_many, by),
    )
    return run_check(CHECKS[name], wrong)


def test_jump_at_zero_momentum_fails_all_cases() -> None:
    """If the kernel without momentum gives another motion, every comparing case fails."""

    def run(system: pinred.System, *, momentum: Any, **options: Any) -> Any:
        still = np.all(momentum == 0.0, axis=1)
        pushed = np.where(still[:, None], 1e-5 * np.abs(momentum).max(axis=0), momentum)
        return pinred.simulate_many(system, momentum=pushed, **options)

    outcome = run_check(CHECKS["zero_momentum"], replace(SHORT, simulate_many=run))
    compared = [case for case in outcome.cases if "from that at zero" in case.name]
    small = [case for case in compared if "e-03" not in case.name and "0e+00" not in case.name]
    assert len(small) >= 26
    assert not any(case.passed for case in small), "\n".join(map(str, small))


def with_small_wrench(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return simulate or simulate_many with a small constant wrench on the base."""

    def run(system: pinred.System, **options: Any) -> Any:
        return function(system, forces=[Wrench([1e-6] * system.r)], **options)

    return run


@pytest.mark.parametrize("name", ["energy", "casimirs", "frames"])
@pytest.mark.sampled
def test_small_wrench_fails(name: str) -> None:
    """The check fails under a small unwanted wrench in the body frame."""
    wrong = replace(
        SHORT,
        simulate=with_small_wrench(pinred.simulate),
        simulate_many=with_small_wrench(pinred.simulate_many),
    )
    assert not run_check(CHECKS[name], wrong).passed


def test_method_that_depends_on_units_fails() -> None:
    """The check of units fails for a method with a step in seconds."""

    def run(system: pinred.System, **options: Any) -> Any:
        return pinred.simulate(system, **{**options, "method": RKMK4(0.5)})

    assert not run_check(CHECKS["units"], replace(SHORT, simulate=run)).passed


def test_method_that_loses_energy_fails_as_symplectic(monkeypatch: pytest.MonkeyPatch) -> None:
    """The check of energy fails for a method that falsely claims to be symplectic."""
    monkeypatch.setattr(RKMK4, "symplectic", True)
    assert not run_check(CHECKS["energy"], replace(SHORT, fixed=(RKMK4,))).passed


def test_friction_fails_time_reversal() -> None:
    """The check of reversal fails with small friction."""

    def run(system: pinred.System, **options: Any) -> Any:
        friction = [Damper(name, 1e-4) for name in system.shape_names]
        return pinred.simulate(system, forces=friction, **options)

    assert not run_check(CHECKS["reversal"], replace(SHORT, simulate=run)).passed


def test_page_lists_all_checks_in_order() -> None:
    """docs/stress.md describes each check, in the order of the table."""
    page = (Path(__file__).parents[2] / "docs" / "stress.md").read_text(encoding="utf-8")
    described = re.findall(r"^\| `(\w+)` \|", page, flags=re.MULTILINE)
    assert described == list(CHECKS)
