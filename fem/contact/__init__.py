"""Instruments that push on the surface of a mesh."""
