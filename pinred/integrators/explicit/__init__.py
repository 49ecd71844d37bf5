"""Explicit Runge–Kutta methods: methods defined by a tableau, and Munthe-Kaas's method."""
