"""Members of simulate_many: what each of them is given, how they run, and their motions."""
