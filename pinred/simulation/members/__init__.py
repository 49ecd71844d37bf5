"""Members of simulate_many: their options, their integration, and their motions."""
