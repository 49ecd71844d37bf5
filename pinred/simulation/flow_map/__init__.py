"""Flow maps: scenes as maps from initial state and parameters to states, with derivatives."""
