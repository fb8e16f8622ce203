"""Hexahedral meshes, from shapes or files, and their node grids."""
