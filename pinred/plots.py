"""Plots of motions, gaits and fields: the public namespace of views/plots."""

import sys
from typing import TYPE_CHECKING

from .views import plots as _plots

if TYPE_CHECKING:
    from .views.plots import *  # noqa: F403
else:
    sys.modules[__name__] = _plots
