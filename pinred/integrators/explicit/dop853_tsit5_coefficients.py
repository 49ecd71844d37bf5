"""Coefficients of the explicit methods DOP853 and Tsit5, as tableaus.

DOP853 is Dormand and Prince's method of order 8(5,3) in Hairer's form: E. Hairer, S. P. Nørsett,
G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., Springer 1993, sections II.5 and
II.6, and Hairer's code dop853.f. Tsit5 is from Ch. Tsitouras, Runge–Kutta pairs of order 5(4)
satisfying only the first column simplifying assumption, Comput. Math. Appl. 62 (2011) 770–775,
which contains the pair of methods and an interpolant of order 4 without additional stages.
"""

from __future__ import annotations

from pathlib import Path
from runpy import run_path

import numpy as np
import scipy

from ...common.memo import once_for_all
from .tableau import Tableau

_TSIT5_A = (
    (),
    (0.161,),
    (-0.008480655492356989, 0.335480655492357),
    (2.8971530571054935, -6.359448489975075, 4.3622954328695815),
    (5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525),
    (
        5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401,
        -0.028269050394068383,
    ),
    (
        0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081,
        2.324710524099774,
    ),
)  # fmt: skip
_TSIT5_ERRORS = (
    -0.00178001105222577714, -0.0008164344596567469, 0.007880878010261995, -0.1447110071732629,
    0.5823571654525552, -0.45808210592918697, 1 / 66,
)  # fmt: skip
# Coefficients of θ⁴ in the interpolant. Values and derivatives at both ends determine the lower
# terms.
_TSIT5_DENSE = (
    -1.0530884977290216, 0.1017, 2.490627285651253, -16.548102889244902, 47.37952196281928,
    -34.87065786149661, 2.5,
)  # fmt: skip


@once_for_all
def dop853_tableau() -> Tableau:
    """Return the coefficients of DOP853, which are taken from SciPy."""
    # The file is run alone, because importing its package, scipy.integrate, takes long.
    file = Path(scipy.__file__).with_name("integrate") / "_ivp" / "dop853_coefficients.py"
    found = run_path(str(file))
    return Tableau(found["A"], np.array([found["E5"], found["E3"]]), found["D"])


@once_for_all
def tsit5_tableau() -> Tableau:
    """Return the coefficients of Tsit5."""
    A = np.zeros((7, 7))
    for i, row in enumerate(_TSIT5_A):
        A[i, :i] = row
    return Tableau(A, np.array([_TSIT5_ERRORS]), np.array([_TSIT5_DENSE]))
