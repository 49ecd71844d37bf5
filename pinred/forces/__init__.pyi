"""Every name and where it stands: for type checkers, and for the first use of a name."""

from .kinds import PD as PD
from .kinds import Action as Action
from .kinds import ComputedTorque as ComputedTorque
from .kinds import Controller as Controller
from .kinds import Damper as Damper
from .kinds import Force as Force
from .kinds import Limit as Limit
from .kinds import PotentialEnergy as PotentialEnergy
from .kinds import Spring as Spring
from .kinds import Torque as Torque
from .kinds import Wrench as Wrench
