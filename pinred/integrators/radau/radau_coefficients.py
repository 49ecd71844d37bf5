"""Coefficients of Radau IIA of order 5, in Hairer's transformation to a diagonal matrix.

The inverse of the method's matrix is T Λ T⁻¹ with a real eigenvalue and a conjugate pair: E.
Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., Springer 1996, section IV.8,
and radau5.f. The values are those of SciPy, whose module takes long to import.
"""

from __future__ import annotations

import numpy as np

_S6 = 6**0.5

C1, C2 = (4 - _S6) / 10, (4 + _S6) / 10  # times of the stages; the last stage is the end
E1, E2, E3 = (float(e) for e in np.array([-13 - 7 * _S6, -13 + 7 * _S6, -1]) / 3)  # error weights
# The C library computes powers, whose last digit may differ between platforms, and with it the key
# of the shipped bitcode.
_CUBE_ROOT, _CUBE_ROOT_SQUARED = 1.4422495703074083, 2.080083823051904  # of 3
GAMMA = 3 + _CUBE_ROOT_SQUARED - _CUBE_ROOT  # real eigenvalue
# Real and imaginary part of an eigenvalue of the pair.
ALPHA = 3 + 0.5 * (_CUBE_ROOT - _CUBE_ROOT_SQUARED)
BETA = -0.5 * (2.498049532966813 + 3.6028108655280087)  # of 3^(5/6) and 3^(7/6)
T = np.array(
    [
        [0.09443876248897524, -0.14125529502095421, 0.03002919410514742],
        [0.25021312296533332, 0.20412935229379994, -0.38294211275726192],
        [1.0, 1.0, 0.0],
    ]
)
T_INVERSE = np.array(
    [
        [4.17871859155190428, 0.32768282076106237, 0.52337644549944951],
        [-4.17871859155190428, -0.32768282076106237, 0.47662355450055044],
        [0.50287263494578682, -2.57192694985560522, 0.59603920482822492],
    ]
)
