"""The version of pinred."""

__version__ = "0.1.0"
