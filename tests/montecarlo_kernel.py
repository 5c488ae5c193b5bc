"""A compiled kernel of the tests, apart because numba takes a second to import."""

from sysid._compile import compiled


@compiled
def total(x):
    result = 0.0
    for value in x:
        result += value
    return result
