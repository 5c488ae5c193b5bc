"""Lacy, Erwin, Bernstein: Wiener systems with known noninvertible nonlinearities."""

from replications.lacy.paper import paper

__all__ = ["paper"]
