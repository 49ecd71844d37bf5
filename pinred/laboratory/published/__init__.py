"""Published and closed-form results beside those of pinred (`pinred published`).

The rows are in the order of the modules. Their code uses public names: `from pinred import …` gives
the same objects.
"""

from . import dynamics as dynamics
from . import locomotion as locomotion
from .row import ROWS as ROWS
