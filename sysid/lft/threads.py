"""Linear algebra on one thread: the same bits whatever the number of workers."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cache, wraps
from typing import TYPE_CHECKING, ParamSpec, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def one_thread() -> AbstractContextManager[object]:
    """Hold linear algebra to one thread; its libraries are looked for once, which takes milliseconds."""
    limit: AbstractContextManager[object] = _controller().limit(limits=1)
    return limit


def on_one_thread(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Run a function with its linear algebra on one thread: factors are narrow, further threads only wait.

    A sum over several threads rounds otherwise than one over a single thread.
    """

    @wraps(function)
    def held(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with one_thread():
            return function(*args, **kwargs)

    return held


@cache
def _controller() -> "ThreadpoolController":
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
