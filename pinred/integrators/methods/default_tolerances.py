"""Default tolerances of a step, for methods with error control and for scenes."""

from __future__ import annotations

from ...common.default_marker import Default

RTOL = Default(1e-10)  # relative tolerance
ATOL = Default(1e-12)  # absolute tolerance, in the units of each entry of the state
