"""Other tools on the same physics: each a file, its package imported when it is used.

A peer whose package is not installed, or which cannot have the system, or whose mass matrix
or accelerations are not Pinocchio's, is left out with a line that says so.
"""
