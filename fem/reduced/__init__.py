"""Reduced models from datasets: basis, cubature, fit; see docs/reduced.md."""
