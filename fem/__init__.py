"""Explicit finite elements for viscoelastic soft tissue, in NumPy and SciPy."""
