"""How fast the solver is, and where it holds."""
