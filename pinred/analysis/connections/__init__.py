"""Local connections from momentum, drag, perfect fluids or wheels, and their changes of frame."""
