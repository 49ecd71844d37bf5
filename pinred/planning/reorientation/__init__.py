"""Reorientation of the base by loops of the joints."""
