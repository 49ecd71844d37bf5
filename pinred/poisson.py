"""Poisson brackets of the reduced phase space, and its Casimirs."""

from .reduction.poisson_brackets import Casimir as Casimir
from .reduction.poisson_brackets import Observable as Observable
from .reduction.poisson_brackets import PhaseSpace as PhaseSpace
from .reduction.poisson_brackets import bracket as bracket
from .reduction.poisson_brackets import casimirs as casimirs
from .reduction.poisson_brackets import phase_space as phase_space
from .reduction.poisson_brackets import tensor as tensor
