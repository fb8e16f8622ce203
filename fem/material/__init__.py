"""Constitutive laws of soft tissue."""
