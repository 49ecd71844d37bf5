"""Poisson brackets of the reduced phase space, and its Casimirs (see reduction/poisson.py)."""

from .reduction.poisson import Casimir as Casimir
from .reduction.poisson import Observable as Observable
from .reduction.poisson import PhaseSpace as PhaseSpace
from .reduction.poisson import bracket as bracket
from .reduction.poisson import casimirs as casimirs
from .reduction.poisson import phase_space as phase_space
from .reduction.poisson import tensor as tensor
