"""Wiener systems behind a known static nonlinearity that need not be invertible.

* `identify_wiener`: the preimage method of Lacy, Erwin and Bernstein (2001), all four kinds of preimage;
* `maximum_likelihood`: the same model by maximum likelihood, started from it;
* `nonlinearity_from_steps`: the nonlinearity from step tests (their Section 6);
* `information_bound`, `score`: how good an estimate can be, and how good it is.
"""

from sysid.wiener.bound import information_bound
from sysid.wiener.criterion import Criterion, equation_error_matrix
from sysid.wiener.estimate import WienerFit, identify_wiener, naive_fit
from sysid.wiener.identifiability import Identifiability
from sysid.wiener.maximum_likelihood import LikelihoodFit, maximum_likelihood
from sysid.wiener.response import Score, frequency_response, score
from sysid.wiener.solvers import Candidate
from sysid.wiener.step_tests import nonlinearity_from_steps

__all__ = [
    "Candidate",
    "Criterion",
    "Identifiability",
    "LikelihoodFit",
    "Score",
    "WienerFit",
    "equation_error_matrix",
    "frequency_response",
    "identify_wiener",
    "information_bound",
    "maximum_likelihood",
    "naive_fit",
    "nonlinearity_from_steps",
    "score",
]
