"""Pepona: linear fractional transformations with splines and with piecewise affine maps."""

from replications.pepona.paper import paper

__all__ = ["paper"]
