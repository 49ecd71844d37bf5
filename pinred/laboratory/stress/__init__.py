"""The stress suite: accuracy of pinred in numerically difficult cases.

Each check yields cases: a measured number and its bound. The numbers are
errors against a closed form, against Pinocchio's ABA on the full state, or against Pinocchio's
energy and momentum. Invariance checks compare motions in other frames, other units, or reversed
time. docs/stress.md derives the bounds.
"""

from . import accuracy_and_conservation as accuracy_and_conservation
from . import extreme_parameters as extreme_parameters
from .check import CHECKS as CHECKS
