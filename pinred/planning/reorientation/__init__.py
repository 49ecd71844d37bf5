"""Turning the base by loops of the joints: first loops, plans, what remains."""
