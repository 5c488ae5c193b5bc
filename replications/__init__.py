"""Replications of the source papers, one package a paper; `sysid` finds them by their entry points."""
