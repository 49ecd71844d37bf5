"""Best gaits: what is wanted of a loop, what it costs, what bounds it, and how it is found."""
