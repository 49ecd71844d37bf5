"""The faces of the package: every name once, in a stub that types and imports both follow."""

from __future__ import annotations

from importlib import import_module

import pytest
from commands import python

import pinred

FACES = ("pinred", "pinred.forces", "pinred.laboratory.bench", "pinred.views.plots")


@pytest.mark.parametrize("face", FACES)
def test_every_name_can_be_imported(face: str) -> None:
    """The names that a face lists are there, and nothing else is."""
    module = import_module(face)
    assert dir(module) == sorted(module.__all__)
    for name in dir(module):
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match=f"No {face} attribute nope"):
        _ = module.nope


def test_type_checkers_know_the_names() -> None:
    """A name that there is not is an error of types: mypy refuses an ignore without need."""
    with pytest.raises(AttributeError):
        _ = pinred.nope  # type: ignore[attr-defined]


@pytest.mark.slow
def test_a_function_is_not_hidden_by_its_module() -> None:
    """Functions stay functions, in any order of imports."""
    code = (
        "import pinred.judge.compare, pinred.simulation.simulate\n"
        "import pinred.simulation.simulate_many, pinred.system.load, pinred\n"
        "names = ('compare', 'simulate', 'simulate_many', 'load', 'inspect', 'plot', 'play')\n"
        "print(all(callable(getattr(pinred, name)) for name in names))"
    )
    assert python(code) == "True\n"


@pytest.mark.slow
def test_aliases_of_folders() -> None:
    """The short paths of what stands deeper: as modules, and to import from."""
    code = (
        "import pinred.plots, pinred.signals, pinred.equations\n"
        "from pinred.signals import Spline\n"
        "from pinred.plots import curvature\n"
        "from pinred.equations import hamilton_poincare\n"
        "print(pinred.plots.curvature is curvature, pinred.signals.Spline is Spline)"
    )
    assert python(code) == "True True\n"


@pytest.mark.slow
def test_all_at_once() -> None:
    """No name needs another to be imported first: with EAGER_IMPORT, all are, in any order."""
    for seed in "01":
        code = f"import {', '.join(FACES)}; print('ok')"
        assert python(code, EAGER_IMPORT="1", PYTHONHASHSEED=seed) == "ok\n"


def test_errors_of_integrators_can_be_caught() -> None:
    """Why an integrator stopped can be told apart by name."""
    for name in ("NoConvergence", "NonFiniteState", "StepSizeUnderflow", "TooManySteps"):
        assert issubclass(getattr(pinred, name), pinred.IntegrationError)
    assert issubclass(pinred.UnsupportedOperationError, pinred.PinredError)
