"""One place that decides how numerical kernels are compiled."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar, cast

import numba
from numba.extending import intrinsic

Kernel = TypeVar("Kernel", bound=Callable[..., object])


# numba makes two more functions of each one, for calls from C and from Python: a third of its work.
_njit: Any = partial(numba.njit, nogil=True, no_cfunc_wrapper=True)


def compiled(function: Kernel) -> Kernel:
    """Compile a kernel with numba: cached on disk, the interpreter lock released.

    ``fastmath`` stays off so that a result is the same to the bit on every run.  Where neither the
    package's folder nor the user's can hold the cache, each process compiles for itself.
    """
    return _kept(function)


def part_of_kernels(function: Kernel) -> Kernel:
    """Compile as `compiled` does a function that kernels call and Python cannot."""
    return _kept(function, no_cpython_wrapper=True)


def _kept(function: Kernel, **options: bool) -> Kernel:
    try:
        return cast(Kernel, _njit(cache=True, **options)(function))
    except RuntimeError:
        return cast(Kernel, _njit(**options)(function))


def inlined(function: Kernel) -> Kernel:
    """Compile a function into the kernels that call it: a call would cost more than what it does.

    Python cannot call it.  A division by zero is no error: its branch would take the place of vectors.
    """
    return cast(Kernel, _njit(forceinline=True, error_model="numpy", no_cpython_wrapper=True)(function))


def pointer(kernel: object, kind: Any, address: int) -> Any:
    """Return a compiled function as kernels take it: by its address, with its type looked up once.

    Parameters
    ----------
    kernel : object
        What has to stay alive.
    kind : numba signature
    address : int
    """

    class Pointer:
        """The address of a compiled function, which it keeps alive."""

        function = kernel
        # numba reads its type here; it would build the type anew in every call otherwise.
        _numba_type_ = numba.types.FunctionType(kind)

        def __wrapper_address__(self) -> int:
            return address

        def signature(self) -> Any:
            return kind

    return Pointer()


def called_by_kernels(signature: str) -> Callable[[Kernel], Kernel]:
    """Return a decorator that compiles a function which kernels take as an argument and call.

    Kernels are compiled once for all functions of one signature, not for each.
    """

    def decorate(function: Kernel) -> Kernel:
        try:
            return cast(Kernel, numba.cfunc(signature, cache=True)(function))
        except RuntimeError:
            return cast(Kernel, numba.cfunc(signature)(function))

    return decorate


def _without_count(_: Any, array: Any) -> Any:
    """Return the signature of `uncounted` for one type of array, and what generates its code."""

    def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
        held = context.make_array(array)(context, builder, values[0])
        held.meminfo = held.meminfo.type(None)
        return held._getvalue()

    return array(array), generate


uncounted: Any = intrinsic(_without_count)
"""In a kernel, the array that it was given, but nobody counts who refers to its rows: its caller holds it.

Cores agree about each count, which takes longer than most of what is done with a row.
"""
