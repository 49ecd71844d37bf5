"""A discrete Lagrange–Poincaré integrator."""
