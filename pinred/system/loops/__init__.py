"""Closed kinematic loops: constraints between links of a robot, their kinematics and assembly."""
