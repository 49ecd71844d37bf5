"""Questions about a robot beside its motions.  Imports `simulation` and what lies below it."""
