"""The contents of a robot file other than bodies and joints, as properties of a system."""

from __future__ import annotations

from collections.abc import Mapping

from ..common.argument_kinds import checks_arguments
from ..common.errors import InputError, UnsupportedOperationError
from ..common.names import listed
from .actuator import Actuator
from .coupling import following
from .force_interface import Force
from .loops.loop import Constraint
from .robot_file_contents import Contents, Coupling, Keyframe, LeftOut


@checks_arguments
class FromFile:
    """Base of System with the properties that its file defines, and with the refusal of some.

    Attributes:
        name: Name of the robot.
        contents: Contents of the file other than bodies and joints.
    """

    name: str
    contents: Contents

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """Couplings of follower joints to their leaders, from the file."""
        return self.contents.couplings

    @property
    def followers(self) -> tuple[str, ...]:
        """Names of the follower joints, in the order of the couplings."""
        return tuple(coupling.follower for coupling in self.couplings)

    @property
    def loops(self) -> tuple[Constraint, ...]:
        """Constraints that close kinematic loops."""
        return self.contents.loops

    def refuse_loops(self, what: str, remedy: str = "") -> None:
        """Reject closed loops where only trees are supported.

        Args:
            what: Beginning of the error message.
            remedy: Sentence that says what to do instead; empty: remove the loops.
        Raises:
            UnsupportedOperationError: The robot has closed loops.
        """
        if self.loops:
            names = listed([loop.name for loop in self.loops], 6)
            raise UnsupportedOperationError(
                f"{what}: closed loops are not supported here, and '{self.name}' has the loops "
                f"{names}. {remedy or 'Remove them, or lock the joints between them.'}"
            )

    def refuse_follower(self, name: str, what: str) -> None:
        """Reject a follower joint, which is not a shape coordinate.

        Args:
            name: Name of the joint.
            what: Beginning of the error message.
        Raises:
            InputError: The joint is a follower.
        """
        if words := following(name, self.couplings):
            raise InputError(f"{what}: {words}; use the joint that it follows")

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Actions in the file that are not simulated, by kind."""
        return self.contents.left_out

    @property
    def passive(self) -> tuple[Force, ...]:
        """Springs, dampers and dry friction at shape joints, from the file.

        The types are forces.Spring, Damper and Friction.  Springs and dampers act in scenes with
        passive=True.  Friction acts only if the scene sets its width.
        """
        return self.contents.passive

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Actuators of the file whose forces are linear in control and state.

        They act in scenes that state their controls.
        """
        return self.contents.actuators

    @property
    def keyframes(self) -> Mapping[str, Keyframe]:
        """Named states in the file."""
        return self.contents.keyframes
