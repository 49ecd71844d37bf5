"""Parts of SciPy, loaded from their files alone: `ode`, coefficients of DOP853, LAPACK's dposv.

Importing their packages, scipy.integrate and scipy.linalg, takes longer than most comparisons.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from runpy import run_path
from types import ModuleType
from typing import Any

import scipy

_FOLDER = Path(scipy.__file__).parent


def _load(file: str, name: str, public: str) -> Any:
    """Return an object from its file, or from its package if other versions of SciPy need that.

    Args:
        file: The file's module inside SciPy, such as "integrate._ode".
        name: Name of the object.
        public: Module of SciPy that documents the object.
    Returns:
        The object.
    """
    folder, module = file.split(".")
    package = ModuleType(f"{__name__}_{folder}")  # stands in for the package of the file
    package.__path__ = [str(_FOLDER / folder)]
    sys.modules[package.__name__] = package
    try:
        return getattr(import_module(f"{package.__name__}.{module}"), name)
    except (ImportError, AttributeError):
        return getattr(import_module(public), name)


ode = _load("integrate._ode", "ode", "scipy.integrate")
dposv = _load("linalg._flapack", "dposv", "scipy.linalg.lapack")
# Coefficients of the dense output: A and C of the additional stages, and D.
_coefficients = run_path(str(_FOLDER / "integrate" / "_ivp" / "dop853_coefficients.py"))
_first = _coefficients["N_STAGES"] + 1
A_EXTRA, C_EXTRA = _coefficients["A"][_first:], _coefficients["C"][_first:]
D = _coefficients["D"]
