"""Published and closed-form results beside those of pinred (`pinred published`).

The rows are in the order of the modules at the end. The public names above them are those that
the rows use; `from pinred import …` gives the same objects.
"""

from ...analysis.connections.connection import Connection as Connection
from ...analysis.connections.connection_physics import Ellipse as Ellipse
from ...analysis.connections.connection_physics import Ellipsoid as Ellipsoid
from ...analysis.connections.connection_physics import Rod as Rod
from ...analysis.connections.connection_physics import Wheel as Wheel
from ...analysis.connections.mixed import follow_mixed as follow_mixed
from ...analysis.connections.mixed import mixed_connection as mixed_connection
from ...analysis.connections.mixed import simulate_mixed as simulate_mixed
from ...analysis.equilibria.find import relative_equilibria as relative_equilibria
from ...analysis.floating_arm import FloatingArm as FloatingArm
from ...analysis.full_reduction import Reduction as Reduction
from ...analysis.phases.gait import Gait as Gait
from ...analysis.phases.phase import phase as phase
from ...analysis.phases.phase import rigid_body_phase as rigid_body_phase
from ...analysis.stability.along_motions import linearise as linearise
from ...scene.event import Event as Event
from ...scene.scene import Scene as Scene
from ...scene.stop import Stop as Stop
from ...simulation.contact.capture import capture as capture
from ...simulation.contact.capture import land as land
from ...simulation.simulate import simulate as simulate
from ...system.load import load as load
from ...system.robot_description import Model as Model

from . import dynamics as dynamics  # isort: skip
from . import locomotion as locomotion  # isort: skip
