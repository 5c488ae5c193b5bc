"""Borges, Verdult and Ayala Botto: separable least squares for composite local linear models."""

from replications.borges.paper import paper

__all__ = ["paper"]
