"""The symmetry groups, with operations on poses, twists, momenta and rotations.

This package imports only `common`.
"""

from .group import Group as Group
from .group import PoseError as PoseError
from .groups import GROUPS as GROUPS
from .groups import SE2 as SE2
from .groups import SE3 as SE3
from .groups import SO2 as SO2
from .groups import SO3 as SO3
from .groups import R as R
from .groups import RxSE2 as RxSE2
from .groups import group_named as group_named
