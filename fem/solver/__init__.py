"""Solvers: internal forces, explicit time integration, states of rest."""

from fem.former import moved

__getattr__ = moved(__name__)
