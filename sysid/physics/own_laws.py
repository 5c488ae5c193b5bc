"""Forces and gains of the user's own, given as expressions, as the simulation calls them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

_SIGNATURE = "f8(i8, f8, f8, f8[::1])"


@dataclass(frozen=True)
class OwnLaw:
    """Forces that oppose the input, and factors of the input, with the names of their parameters.

    Attributes
    ----------
    terms : tuple of (str, str, tuple of str)
        Port ``"force"`` or ``"gain"``, expression, names.  A force depends on position ``x`` and speed ``v``,
        a gain on the output ``y``; the parameters of all terms follow one another.
    """

    terms: tuple[tuple[str, str, tuple[str, ...]], ...] = ()

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(len(names) for _, _, names in self.terms)


NO_OWN_LAW = OwnLaw()


@lru_cache(maxsize=256)
def kernel_of(law: OwnLaw) -> Any:
    """Return a law compiled for the simulation, which finds its parameters behind those of the plant.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.physics.forced_kernels import SIZE
    >>> w = np.append(np.zeros(SIZE), [2.0, 0.5])
    >>> law = kernel_of(OwnLaw((("force", "c*v**3", ("c",)), ("gain", "1 + g*y", ("g",))))).function
    >>> float(law(0, 1.0, 3.0, w)), float(law(1, 4.0, 0.0, w))
    (54.0, 3.0)
    """
    import numba

    from sysid._compile import pointer
    from sysid.physics.generator import functions_of

    (own,), kept = functions_of(source_of(law), __name__, "own")
    kernel: Any = numba.cfunc(_SIGNATURE, cache=kept, error_model="numpy")(own)
    return pointer(kernel, kernel._sig, kernel._wrapper_address)


def source_of(law: OwnLaw, first: int | None = None) -> str:
    """Return the Python source of a law, made from the checked trees of its expressions alone.

    ``first`` is the place of its first parameter.
    """
    from sysid.physics.expressions import code
    from sysid.physics.forced_kernels import SIZE
    from sysid.physics.grammar import parse

    place = SIZE if first is None else first
    forces, factors = ["0.0"], ["1.0"]
    for port, expression, names in law.terms:
        signals = {"x": "a", "v": "b"} if port == "force" else {"y": "a"}
        inside = signals | {name: f"w[{place + i}]" for i, name in enumerate(names)}
        (forces if port == "force" else factors).append(code(parse(expression, set(inside)), inside))
        place += len(names)
    return (
        "import numpy as np\n\n\ndef own(kind, a, b, w):\n    if kind == 0:\n"
        f"        return {' + '.join(forces)}\n    return {' * '.join(factors)}\n"
    )


def renamed(expression: str, names: Mapping[str, str]) -> str:
    """Return an expression with other names; functions keep theirs.

    Examples
    --------
    >>> renamed("c*max(v - 1e3, 0)", {"v": "speed", "c": "law_c", "x": "position"})
    'law_c*max(speed - 1e3, 0)'
    """
    return re.sub(r"\b[A-Za-z_]\w*", lambda word: names.get(word[0], word[0]), expression)
