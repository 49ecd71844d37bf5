"""Public names and their modules, for type checkers and for the lazy import."""

from .accuracy import DEFAULT as DEFAULT
from .accuracy import FULL as FULL
from .accuracy import QUICK as QUICK
from .accuracy import SOLVERS as SOLVERS
from .accuracy import Effort as Effort
from .accuracy import Reference as Reference
from .accuracy import bench_accuracy as bench_accuracy
from .accuracy import own_method as own_method
from .accuracy import reference_of as reference_of
from .accuracy_record import Point as Point
from .accuracy_record import WorkPrecision as WorkPrecision
from .accuracy_record import read_record as read_record
from .accuracy_record import write_record as write_record
from .problems import SCENES as SCENES
from .problems import End as End
from .problems import PreparedRun as PreparedRun
from .problems import Problem as Problem
from .problems import Solver as Solver
from .problems import problems_named as problems_named
from .timing import Table as Table
from .timing import bench_compare as bench_compare
from .timing import bench_first_calls as bench_first_calls
from .timing import bench_kernels as bench_kernels
from .timing import bench_many as bench_many
from .timing import bench_threads as bench_threads
