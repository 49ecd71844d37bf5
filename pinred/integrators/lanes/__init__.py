"""Many runs at once: members of a batch in the lanes of vectors, each with steps of its own."""
