"""From CasADi Functions to machine code: operations, sines of many angles at once, loading."""
