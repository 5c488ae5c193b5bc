"""Giri, Rochdi and Chaoui: recursive identification of systems with hard input nonlinearities."""

from replications.giri.paper import paper

__all__ = ["paper"]
