"""Hexahedral meshes, from shapes or files, and their node grids."""

from fem.former import moved

__getattr__ = moved(__name__)
