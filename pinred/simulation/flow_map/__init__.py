"""The flow of a scene as a prepared map from initial state and parameters, with derivatives."""
