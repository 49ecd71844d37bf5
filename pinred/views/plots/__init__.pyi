"""Public names and their modules, for type checkers and for the lazy import."""

from .by_kind import options_of as options_of
from .by_kind import plot as plot
from .connection_field import curvature as curvature
from .connection_field import field as field
from .figures_of_many_runs import branches as branches
from .figures_of_many_runs import heatmap as heatmap
from .figures_of_many_runs import histogram as histogram
from .figures_of_many_runs import quantiles as quantiles
from .figures_of_many_runs import scatter as scatter
from .figures_of_many_runs import work_precision as work_precision
from .gait_cycles import cycles as cycles
from .gait_cycles import loop as loop
from .phase_space import phase as phase
from .phase_space import poincare as poincare
from .phase_space import sphere as sphere
from .time_series import base as base
from .time_series import energy as energy
from .time_series import error as error
from .time_series import limits as limits
from .time_series import momentum as momentum
from .time_series import rates as rates
from .time_series import shape as shape
from .time_series import torques as torques

INSTALL: str
KINDS: tuple[str, ...]
