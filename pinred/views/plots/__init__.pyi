"""Public names and their modules, for type checkers and for the lazy import."""

from .branch_diagram import branches as branches
from .by_kind import options_of as options_of
from .by_kind import plot as plot
from .connection_field import curvature as curvature
from .connection_field import field as field
from .gait_cycles import cycles as cycles
from .gait_cycles import loop as loop
from .phase_space import phase as phase
from .phase_space import poincare as poincare
from .phase_space import sphere as sphere
from .sweep_figures import heatmap as heatmap
from .sweep_figures import histogram as histogram
from .sweep_figures import quantiles as quantiles
from .sweep_figures import scatter as scatter
from .time_series import base as base
from .time_series import energy as energy
from .time_series import error as error
from .time_series import limits as limits
from .time_series import momentum as momentum
from .time_series import rates as rates
from .time_series import shape as shape
from .time_series import torques as torques
from .work_against_error import work_precision as work_precision

INSTALL: str
KINDS: tuple[str, ...]
