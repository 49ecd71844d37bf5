"""Local connections of every kind: mechanics, drag, fluid, wheels; seen from other frames."""
