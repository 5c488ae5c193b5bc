"""Write and compile the simulation of a nonlinear model: fixed-step Runge-Kutta of fourth order.

The source is made from the checked tree alone: its names are ours, its numbers are finite constants.
It is stored in a cache folder so that numba can keep the compiled code beside it.
"""

import hashlib
import linecache
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from sysid.linear.forms import Floats
from sysid.physics.expressions import ZERO, Expression, code, derivative

Simulate = Callable[[Floats, Floats, Floats, float, int, Floats], None]
Sensitivities = Callable[[Floats, Floats, Floats, Floats, float, int, Floats, Floats], None]
STAGES = "abcd"
_HEADER = '"""Simulation generated from the equations of a model."""\n\nimport numpy as np\n\n\n'


class Writer:
    """Source of the two kernels of a model.

    The states are x_0, x_1, ..., the inputs u_0, ..., the parameters p_0, ...; the states at which a
    stage of the Runge-Kutta step takes its slopes are z_0, z_1, ...
    """

    def __init__(
        self,
        rates: Sequence[Expression],
        outputs: Sequence[Expression],
        states: Sequence[str],
        inputs: Sequence[str],
        parameters: Sequence[str],
    ) -> None:
        self.rates, self.outputs = rates, outputs
        self.states, self.inputs, self.parameters = states, inputs, parameters
        self.n = len(states)
        fixed = {name: f"u_{j}" for j, name in enumerate(inputs)}
        fixed |= {name: f"p_{j}" for j, name in enumerate(parameters)}
        self.at_x = fixed | {name: f"x_{i}" for i, name in enumerate(states)}
        self.at_z = fixed | {name: f"z_{i}" for i, name in enumerate(states)}

    def source(self) -> str:
        """Return the module's text."""
        return _HEADER + "\n\n".join(["\n".join(self.simulate()), "\n".join(self.sensitivities())]) + "\n"

    def simulate(self) -> list[str]:
        """Return the lines of the simulation."""
        lines = ["def simulate(u, start, p, step, substeps, y):", *self._prologue()]
        lines += ["    for k in range(u.shape[0]):", *self._inputs(), *self._outputs()]
        lines += ["        for _ in range(substeps):"]
        for stage in range(4):
            lines += self._stage_state(stage)
            lines += self._slopes(stage)
        return [*lines, *self._advance()]

    def sensitivities(self) -> list[str]:
        """Return the lines of the simulation with its derivatives by parameters and initial state.

        The derivative of a Runge-Kutta step is the same step of the variational equation, so these
        are derivatives of the numbers that ``simulate`` returns.
        """
        n, count = self.n, len(self.parameters)
        lines = ["def sensitivities(u, du, start, p, step, substeps, y, J):", *self._prologue()]
        lines += [f"    S = np.zeros(({n}, {count + n}))", f"    K = np.empty((4, {n}, {count + n}))"]
        lines += [f"    Z = np.empty(({n}, {count + n}))"]
        lines += [f"    S[{i}, {count + i}] = 1.0" for i in range(n)]
        lines += ["    for k in range(u.shape[0]):", *self._inputs(), *self._outputs()]
        lines += self._output_slopes()
        lines += ["        for _ in range(substeps):"]
        for stage in range(4):
            lines += self._stage_state(stage)
            lines += self._stage_sensitivity(stage)
            lines += self._slopes(stage)
            lines += self._sensitivity_slopes(stage)
        lines += [f"            for c in range({count + n}):"]
        lines += [
            f"                S[{i}, c] += step / 6.0 * (K[0, {i}, c] + 2.0 * K[1, {i}, c] "
            f"+ 2.0 * K[2, {i}, c] + K[3, {i}, c])"
            for i in range(n)
        ]
        return [*lines, *self._advance()]

    def _prologue(self) -> list[str]:
        lines = [f"    x_{i} = start[{i}]" for i in range(self.n)]
        return lines + [f"    p_{j} = p[{j}]" for j in range(len(self.parameters))]

    def _inputs(self) -> list[str]:
        return [f"        u_{j} = u[k, {j}]" for j in range(len(self.inputs))]

    def _outputs(self) -> list[str]:
        return [f"        y[k, {o}] = {code(e, self.at_x)}" for o, e in enumerate(self.outputs)]

    def _stage_state(self, stage: int) -> list[str]:
        if stage == 0:
            return [f"            z_{i} = x_{i}" for i in range(self.n)]
        share, before = ("1.0" if stage == 3 else "0.5"), STAGES[stage - 1]
        return [f"            z_{i} = x_{i} + {share} * step * {before}_{i}" for i in range(self.n)]

    def _slopes(self, stage: int) -> list[str]:
        name = STAGES[stage]
        return [f"            {name}_{i} = {code(rate, self.at_z)}" for i, rate in enumerate(self.rates)]

    def _advance(self) -> list[str]:
        return [
            f"            x_{i} += step / 6.0 * (a_{i} + 2.0 * b_{i} + 2.0 * c_{i} + d_{i})"
            for i in range(self.n)
        ]

    def _stage_sensitivity(self, stage: int) -> list[str]:
        if stage == 0:
            line = "Z[{i}, c] = S[{i}, c]"
        else:
            share = "1.0" if stage == 3 else "0.5"
            line = f"Z[{{i}}, c] = S[{{i}}, c] + {share} * step * K[{stage - 1}, {{i}}, c]"
        columns = len(self.parameters) + self.n
        return [
            f"            for c in range({columns}):",
            *(f"                {line.format(i=i)}" for i in range(self.n)),
        ]

    def _sensitivity_slopes(self, stage: int) -> list[str]:
        columns = len(self.parameters) + self.n
        return [
            *self._chain(
                "            ", f"K[{stage}, {{row}}, {{column}}]", "Z", self.rates, self.at_z, columns
            ),
            *self._by_input("            ", f"K[{stage}, {{row}}, c]", self.rates, self.at_z),
        ]

    def _output_slopes(self) -> list[str]:
        columns = len(self.parameters) + self.n
        return [
            *self._chain("        ", "J[k, {row}, {column}]", "S", self.outputs, self.at_x, columns),
            *self._by_input("        ", "J[k, {row}, c]", self.outputs, self.at_x),
        ]

    def _chain(
        self,
        indent: str,
        target: str,
        inner: str,
        expressions: Sequence[Expression],
        names: Mapping[str, str],
        columns: int,
    ) -> list[str]:
        """Write target = (derivative by the state) inner + (derivative by the parameters)."""
        setting, summing, direct = [], [], []
        for row, expression in enumerate(expressions):
            parts = []
            for i, state in enumerate(self.states):
                slope = derivative(expression, state)
                if slope != ZERO:
                    setting.append(f"{indent}g_{row}_{i} = {code(slope, names)}")
                    parts.append(f"g_{row}_{i} * {inner}[{i}, c]")
            summing.append(f"{indent}    {target.format(row=row, column='c')} = {' + '.join(parts) or '0.0'}")
            for j, parameter in enumerate(self.parameters):
                slope = derivative(expression, parameter)
                if slope != ZERO:
                    direct.append(f"{indent}{target.format(row=row, column=j)} += {code(slope, names)}")
        return [*setting, f"{indent}for c in range({columns}):", *summing, *direct]

    def _by_input(
        self, indent: str, target: str, expressions: Sequence[Expression], names: Mapping[str, str]
    ) -> list[str]:
        """Write the part that comes through a delayed input."""
        lines = []
        for row, expression in enumerate(expressions):
            for j, name in enumerate(self.inputs):
                slope = derivative(expression, name)
                if slope != ZERO:
                    lines.append(f"{indent}f_{row}_{j} = {code(slope, names)}")
                    lines.append(f"{indent}for c in range(du.shape[0]):")
                    lines.append(f"{indent}    {target.format(row=row)} += f_{row}_{j} * du[c, k, {j}]")
        return lines


@lru_cache(maxsize=256)
def compiled_kernels(source: str) -> tuple[Simulate, Sensitivities]:
    """Return the kernels of a source made by `Writer`, compiled once and kept on disk where possible."""
    import numba

    from sysid._compile import compiled

    functions, kept = functions_of(source, __name__, "simulate", "sensitivities")
    simulate, sensitivities = map(compiled if kept else numba.njit(nogil=True), functions)
    return cast(Simulate, simulate), cast(Sensitivities, sensitivities)


def functions_of(source: str, module: str, *names: str) -> tuple[list[Any], bool]:
    r"""Return functions of a source that was written here, and whether their compiled code can be kept.

    numba finds the code that it kept by module, file and name, and the module must be one that can be
    imported.  The environments of functions that it loads it tells apart by module and name alone: so the
    name has the source's hash in it, or a function would be run in the environment of another.

    Examples
    --------
    >>> (double,), _ = functions_of("def law(x):\n    return 2.0 * x\n", __name__, "law")
    >>> double(3.0), double.__name__[:4], len(double.__name__)
    (6.0, 'law_', 20)
    """
    import numpy as np

    digest, path = hashlib.sha256(source.encode()).hexdigest()[:16], stored(source)
    file = str(path) if path else f"<written {digest}>"
    namespace: dict[str, Any] = {"__name__": module, "np": np}
    exec(compile(source, file, "exec"), namespace)
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)
    functions = [namespace[name] for name in names]
    for function in functions:
        function.__name__ = function.__qualname__ = f"{function.__name__}_{digest}"
    return functions, path is not None


def stored(source: str) -> Path | None:
    """Store the source under its hash; None where no folder can be written."""
    place = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    try:
        folder = (Path(place) if place else Path.home() / ".cache") / "sysid-models"
        path = folder / f"model_{hashlib.sha256(source.encode()).hexdigest()[:32]}.py"
        if path.exists() and path.read_text(encoding="utf-8") == source:
            return path
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=folder, delete=False, encoding="utf-8") as file:
            file.write(source)
        Path(file.name).replace(path)
    except (OSError, RuntimeError):
        return None
    return path
