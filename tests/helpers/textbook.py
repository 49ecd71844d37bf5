"""Parameters of the textbook examples among the bundled robots, in SI units."""

from __future__ import annotations

# robots/elroys_beanie.urdf: moments of inertia of body and propeller
I1, I2 = 2.0, 1.0

# robots/coupled_planar.urdf: masses, distance of the joint, moments of inertia
M1, M2, D, J1, J2 = 3.0, 1.0, 0.5, 0.5, 0.25

M = M1 + M2

DELTA = M * (J1 + J2) + M1 * M2 * D**2
