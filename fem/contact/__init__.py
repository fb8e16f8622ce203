"""Instruments that push on the surface of a mesh."""

from fem.former import moved

__getattr__ = moved(__name__)
