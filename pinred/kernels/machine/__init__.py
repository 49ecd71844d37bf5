"""Compilation of CasADi Functions to machine code: lowering, vector sines, and loading."""
