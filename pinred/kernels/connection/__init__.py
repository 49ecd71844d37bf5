"""Local connections as machine code: the forms that define them, their expressions, their judge."""
