"""Integer codes of compiled code: outcomes of steps and runs, solvers, contents of the rows."""

# Return values of `advance`. WANTED: the run needs the derivative of the kernel to continue.
DONE, PAUSED, FULL, WANTED, UNDERFLOW, NOT_FINITE, TOO_MANY, DIVERGED = range(8)
AGAIN = 8  # return value of an attempted step that was rejected

# Solvers of implicit steps.
AUTO, FIXED_POINT, NEWTON = 1, 2, 3

# Contents of the work rows: the states at the ends of a step, also its stages, or also the terms of
# its dense output.
ENDS, STEP, DENSE = range(3)
