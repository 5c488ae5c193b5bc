"""Bai: identification of linear systems with hard input nonlinearities of known structure."""

from replications.bai.paper import paper

__all__ = ["paper"]
