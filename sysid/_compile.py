"""One place that decides how numerical kernels are compiled."""

import contextlib
import hashlib
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, TypeVar, cast

import numba
from numba.core import sigutils
from numba.core.ccallback import CFunc
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


def compiled_for(*signatures: Any) -> Callable[[Kernel], Kernel]:
    """Return a decorator that compiles as `compiled` does, but at once and for these signatures alone.

    A kernel that is handed functions would be compiled for each of them otherwise.
    """

    def decorate(function: Kernel) -> Kernel:
        kernel: Any = _kept(function)
        for signature in signatures:
            kernel.compile(signature)
        kernel.disable_compile()
        return cast(Kernel, kernel)

    return decorate


def _kept(function: Kernel, **options: bool) -> Kernel:
    try:
        return cast(Kernel, _stamped(_njit(cache=True, **options)(function)))
    except RuntimeError:
        return cast(Kernel, _njit(**options)(function))


def _stamped(kernel: Any) -> Any:
    """Return a kernel whose cache is out of date when a file whose kernels or constants it uses has changed.

    numba looks at a kernel's own file alone, though what it calls is compiled into it.
    """
    held: Any = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if hasattr(held, "_source_stamp"):
        held._source_stamp = (held._source_stamp, *sorted(_made_of(kernel.__wrapped__.__globals__)))
    return kernel


_MADE_OF: dict[str, frozenset[str]] = {}


def _made_of(module: Mapping[str, Any]) -> frozenset[str]:
    """Return what kernels of a module depend on: the contents of files, and the values of constants.

    Seen at its first kernel, when all that is imported is there; what follows stands in the file itself.
    """
    name = module["__name__"]
    if name not in _MADE_OF:
        # Modules that lead back to it see no more of it than its file.
        _MADE_OF[name] = frozenset([_digest_of(module.get("__file__"))])
        _MADE_OF[name] |= frozenset(part for used in module.items() for part in _parts_of(name, *used))
    return _MADE_OF[name]


def _parts_of(module: str, name: str, used: Any) -> Iterable[str]:
    """Return what a kernel depends on where it uses one of its module's globals."""
    if isinstance(used, bool | int | float):
        return [f"{name} = {used!r}"]
    if isinstance(used, ModuleType):
        same = used.__name__.partition(".")[0] == module.partition(".")[0]
        return _made_of(vars(used)) if same else ()
    inner = getattr(used, "__wrapped__", None)
    return _made_of(inner.__globals__) if isinstance(inner, FunctionType) else ()


def _digest_of(path: str | None) -> str:
    """Return a digest of a source file; none of what was never a file."""
    try:
        return hashlib.sha256(Path(path or "").read_bytes()).hexdigest()
    except OSError:
        return ""


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
    read: Any = sigutils.normalize_signature

    def decorate(function: Kernel) -> Kernel:
        # As numba.cfunc does it, which compiles before a cache could be told what it depends on.
        callback: Any = CFunc(function, read(signature), locals={}, options={})
        with contextlib.suppress(RuntimeError):
            callback.enable_caching()
        _stamped(callback).compile()
        return cast(Kernel, callback)

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
