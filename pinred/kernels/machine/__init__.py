"""Compilation of CasADi Functions to machine code: translation to LLVM IR, and loading."""
