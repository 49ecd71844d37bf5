"""CasADi Functions become machine code: operations, sines of many angles at once, loading."""
