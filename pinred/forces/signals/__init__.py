"""Signals: scalar functions of time, as CasADi expressions and as numbers.

A prescribed joint, the reference of a controller or a torque from a table is one of these.
Value, rate and acceleration are the function and its first two derivatives.
"""

from .formulas import Constant, Expression, Fourier
from .signal import Signal
from .tabulated import Hold, Linear, Spline

__all__ = ["Constant", "Expression", "Fourier", "Hold", "Linear", "Signal", "Spline"]
