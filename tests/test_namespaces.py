"""The public namespaces: every name is listed once, in a stub for type checkers and imports."""

from __future__ import annotations

from importlib import import_module

import pytest
from commands import python

import pinred

NAMESPACES = ("pinred", "pinred.forces", "pinred.laboratory.bench", "pinred.views.plots")


@pytest.mark.parametrize("namespace", NAMESPACES)
def test_namespace_provides_exactly_its_listed_names(namespace: str) -> None:
    """Every name in `__all__` can be imported, and no other name exists."""
    module = import_module(namespace)
    assert dir(module) == sorted(module.__all__)
    for name in dir(module):
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match=f"No {namespace} attribute nope"):
        _ = module.nope


def test_type_checkers_reject_an_unknown_name() -> None:
    """Mypy reports an unused `ignore`, so this test fails to type-check if `nope` were known."""
    with pytest.raises(AttributeError):
        _ = pinred.nope  # type: ignore[attr-defined]


@pytest.mark.by_hand
def test_function_is_not_hidden_by_the_module_of_its_name() -> None:
    """A function remains callable after its module was imported, in any order of imports."""
    code = (
        "import pinred.judge.compare, pinred.simulation.simulate\n"
        "import pinred.simulation.simulate_many, pinred.system.load, pinred\n"
        "names = ('compare', 'simulate', 'simulate_many', 'load', 'inspect', 'plot', 'play')\n"
        "print(all(callable(getattr(pinred, name)) for name in names))"
    )
    assert python(code) == "True\n"


@pytest.mark.by_hand
def test_aliases_provide_the_same_objects() -> None:
    """The short module paths can be imported, and their names are those of the deeper modules."""
    code = (
        "import pinred.plots, pinred.signals, pinred.equations\n"
        "from pinred.signals import Spline\n"
        "from pinred.plots import curvature\n"
        "from pinred.equations import hamilton_poincare\n"
        "print(pinred.plots.curvature is curvature, pinred.signals.Spline is Spline)"
    )
    assert python(code) == "True True\n"


@pytest.mark.by_hand
def test_eager_import_of_all_names_succeeds() -> None:
    """No name requires that another was imported before; EAGER_IMPORT imports all of them."""
    for seed in "01":
        code = f"import {', '.join(NAMESPACES)}; print('ok')"
        assert python(code, EAGER_IMPORT="1", PYTHONHASHSEED=seed) == "ok\n"


def test_integration_errors_can_be_caught_by_name() -> None:
    """Each reason for which an integrator stops has its own exception class."""
    for name in ("NoConvergence", "NonFiniteState", "StepSizeUnderflow", "TooManySteps"):
        assert issubclass(getattr(pinred, name), pinred.IntegrationError)
    assert issubclass(pinred.UnsupportedOperationError, pinred.PinredError)
