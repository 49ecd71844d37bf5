"""Every error that pinred raises on purpose, in one tree.

A message says what was given, what was expected, and what to do about it.
"""


class PinredError(Exception):
    """Base of all errors raised by pinred."""


class LoadError(PinredError):
    """A robot could not be found or read."""


class ModelError(PinredError, ValueError):
    """A robot was read, but its model is outside what pinred can reduce."""


class InputError(PinredError, ValueError):
    """An argument has a value that cannot be used."""


class ShapeError(InputError):
    """An array argument has the wrong length or holds a number that is not finite."""


class SymmetryError(PinredError, ValueError):
    """Something acts on the system that its symmetry group does not leave unchanged."""


class SingularInertiaError(PinredError, ArithmeticError):
    """The mass matrix is not positive definite at a shape."""


class IntegrationError(PinredError, ArithmeticError):
    """The integration had to stop before its end time."""
