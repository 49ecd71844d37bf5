"""Explicit Runge–Kutta methods: of any tableau, and Munthe-Kaas's on groups."""
