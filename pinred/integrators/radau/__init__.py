"""Radau IIA of order 5 with step control, for stiff systems."""
