"""Signals: scalar functions of time, as CasADi expressions and as numbers.

Signals prescribe joints, serve as references of controllers, and describe torques.  The value,
rate and acceleration of a signal are the function and its first two derivatives.  An Attitude of
three signals does the same for a ball joint.
"""

from .forces.signals.attitude_signal import Attitude
from .forces.signals.signal import Constant, Expression, Fourier, Hold, Linear, Signal, Spline

__all__ = ["Attitude", "Constant", "Expression", "Fourier", "Hold", "Linear", "Signal", "Spline"]
