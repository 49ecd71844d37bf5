"""SciPy's class `ode` and the coefficients of DOP853, loaded from their files alone.

Importing their package, scipy.integrate, takes longer than most comparisons.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from runpy import run_path
from types import ModuleType
from typing import Any

import scipy

_PACKAGE = f"{__name__}_package"  # stands in for scipy.integrate, from which the file imports
_FOLDER = Path(scipy.__file__).with_name("integrate")


def _load_ode() -> Any:
    """Return the class from its file, or from its package if other versions of SciPy need that."""
    package = ModuleType(_PACKAGE)
    package.__path__ = [str(_FOLDER)]
    sys.modules[_PACKAGE] = package
    try:
        return import_module(f"{_PACKAGE}._ode").ode
    except (ImportError, AttributeError):
        from scipy.integrate import ode

        return ode


ode = _load_ode()
# Coefficients of the dense output: A and C of the additional stages, and D.
_coefficients = run_path(str(_FOLDER / "_ivp" / "dop853_coefficients.py"))
_first = _coefficients["N_STAGES"] + 1
A_EXTRA, C_EXTRA = _coefficients["A"][_first:], _coefficients["C"][_first:]
D = _coefficients["D"]
