"""Signals: scalar functions of time, as CasADi expressions and as numbers.

A signal is a prescribed joint motion, the reference of a controller, or a torque. The value, rate
and acceleration of a signal are the function and its first two derivatives.
"""

from .attitude_signal import Attitude
from .signal import Constant, Expression, Fourier, Hold, Linear, Signal, Spline

__all__ = ["Attitude", "Constant", "Expression", "Fourier", "Hold", "Linear", "Signal", "Spline"]
