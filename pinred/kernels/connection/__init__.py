"""Machine code of local connections: defining forms, their graphs, compilation, validation."""
