"""Other tools that solve the same problems; the package of a tool is imported on first use.

A peer is omitted, with a message, if its package is not installed, if it cannot represent the
system, or if its mass matrix or accelerations differ from Pinocchio's.
"""
