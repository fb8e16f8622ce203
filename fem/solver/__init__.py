"""Solvers: internal forces, explicit time integration, states of rest."""
