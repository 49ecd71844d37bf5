"""Frames in which a connection disturbs least, surface integrals of curvature, and flatness."""
