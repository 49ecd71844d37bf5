"""What one asks of a robot beside its motions.  Imports `simulation` and what lies below it."""
