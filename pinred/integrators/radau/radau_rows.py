"""The work rows of a step of Radau IIA, see `state_rows` for the first two."""

from __future__ import annotations

from ..stepping.kernel_call import SEEDS

# Rows of `work`: rates at both ends of a step; stages minus the state; corrections at the ends;
# free rows; rows of Newton's method and of the Jacobian.
RATE, END_RATE, Z, CORRECTION, FREE, PIVOTS, ALONG = 2, 4, 5, 8, 11, 18, 21
SLOPES = ALONG + SEEDS
MATRIX = SLOPES + SEEDS  # the Jacobian, three systems of a step, and one of the corrections
KEPT = 4  # number of floats stored at a step end per entry of the state
