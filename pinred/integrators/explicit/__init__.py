"""Explicit Runge–Kutta methods: by tableau, and Munthe-Kaas's method on Lie groups."""
