"""What the decision logic needs of a family of models, and nothing else."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Effect, Floats, Form
from sysid.diagnosis.structures.rows import runs_of
from sysid.diagnosis.structures.whitening import opening

Complexes = NDArray[np.complex128]
# D(q) of noise without a memory: what is fitted is the plain free-run error.
WHITE = np.ones(1)


class Effort(IntEnum):
    """How far a fit searches."""

    REFIT = 0
    """Only go on from the start, which has all effects: on more rows, or with other noise."""
    COARSE = 1
    """Search the new effects over their grids, for a ranking."""
    FINE = 2
    """Search them finely, from several starts."""


@dataclass(frozen=True)
class Choice:
    """An effect in one of its forms."""

    effect: Effect
    form: Form

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def written(self) -> Effect:
        """The effect with the equation of this form."""
        return replace(self.effect, equation=self.form.equation) if self.form.equation else self.effect


@dataclass(frozen=True)
class FittedParameter:
    """A parameter with its standard error.

    Attributes
    ----------
    name, unit : str
    value, std_error : float
    owner : str
        Name of the effect it belongs to, empty for the model's own.
    """

    name: str
    value: float
    std_error: float
    unit: str
    owner: str = ""


@dataclass(frozen=True, eq=False)
class StructureFit:
    """A model with effects, fitted by its free run.

    Attributes
    ----------
    choices : tuple of Choice
        The effects in it, in the order they were asked for.
    point : ndarray
        Where the search ended, in the structure's own coordinates.
    parameters : tuple of FittedParameter
        The model's own parameters first.  Their standard errors need not be filled in (NaN) unless
        ``finish`` was called.
    output : ndarray, shape (n_samples,)
        Free run over every row of the record, one continuous run in each experiment; the initial state
        of an experiment without rows of the fit is estimated on its first rows.
    rows : ndarray of bool, shape (n_samples,)
        Rows of the fit.
    cost : float
        Sum of squares of the filtered residual on these rows.
    n_parameters : int
        Number of free parameters, initial states included.
    converged : bool
    restarts_agree : bool
        Whether searches from different starts ended at equal cost and output.
    status : str
        One sentence.
    """

    choices: tuple[Choice, ...]
    point: Floats
    parameters: tuple[FittedParameter, ...]
    output: Floats
    rows: Mask
    cost: float
    n_parameters: int
    converged: bool
    restarts_agree: bool
    status: str

    @property
    def usable(self) -> bool:
        """Whether the free run diverges under no input of the record."""
        return bool(np.isfinite(self.cost) and np.isfinite(self.output).all())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(choice.name for choice in self.choices)

    def parameters_of(self, effect: str) -> tuple[FittedParameter, ...]:
        """Return the parameters that belong to an effect."""
        return tuple(parameter for parameter in self.parameters if parameter.owner == effect)

    @property
    def laws(self) -> list[tuple[Effect, dict[str, float]]]:
        """Effects with the values of their parameters, as an equation shows them."""
        return [
            (choice.written, {p.name: p.value for p in self.parameters_of(choice.name)})
            for choice in self.choices
        ]


class Structure(Protocol):
    """A family of models that can be fitted with effects to one record.

    ``noise`` is the polynomial D(q) of an autoregression, leading 1 included: a fit minimises the sum
    of squares of D(q) (y - output) on its rows; `WHITE` gives the plain free-run error.
    Runs of rows that do not touch are filtered each for itself (see `filtered`).

    A structure must be deterministic: the same arguments give the same bits.
    """

    record: Record
    name: str

    def offered(self, effects: Sequence[Effect]) -> tuple[Effect, ...]:
        """Return the effects that make sense for this model, in the given order."""
        ...

    def baseline(self, rows: Mask) -> StructureFit:
        """Fit the model without effects, from several starts."""
        ...

    def directions(self, fit: StructureFit, effect: Effect) -> list[Floats]:
        """Return how an effect, added to a fit, would change its free run.

        One array of shape (n_samples, n_columns) for each point of a coarse grid of the effect's own
        shape parameters, the fit's parameters held: the change itself for an effect without a
        strength, the derivative by each strength otherwise.  For the cheap screen and its null
        distribution; scale does not matter.
        """
        ...

    def tangent(self, fit: StructureFit) -> Floats:
        """Return the derivative of the free run by all parameters, shape (n_samples, n_parameters)."""
        ...

    def fit(
        self, choices: Sequence[Choice], rows: Mask, noise: Floats, start: StructureFit, *, effort: Effort
    ) -> StructureFit:
        """Fit the model with these effects, from a fit with fewer (or other, or the same) effects.

        Parameters
        ----------
        choices : sequence of Choice
        rows : ndarray of bool, shape (n_samples,)
        noise : ndarray
        start : StructureFit
            Effects of ``choices`` that are in it start where it left them; new ones are searched
            over their grid.  Where none is new all are refitted or, by more effort, the last one is searched.
        effort : Effort
        """
        ...

    def finish(
        self, fit: StructureFit, noise: Floats, *, plain: bool = False, closely: bool = False
    ) -> StructureFit:
        """Return a fit with standard errors of its parameters filled in.

        ``plain`` says that the fit did not weigh the errors by the colour of the noise; ``closely`` asks for
        more than slopes tell, for a fit that is a minimum under this noise.
        """
        ...

    def probes(self, fit: StructureFit) -> Floats:
        """Return directions in which an effect that is not in any list would show.

        Shape (n_samples, n_probes): smooth functions of input and modelled states, as they are and
        through the model's dynamics.  For the question whether anything is left to explain.
        """
        ...

    def equation(self, fit: StructureFit) -> str:
        """Return the model's equation with its effects, for a reader."""
        ...


def kept_and_new(
    choices: Sequence[Choice], start: StructureFit, effort: Effort
) -> tuple[tuple[Choice, ...], tuple[Choice, ...]]:
    """Return which effects begin where a fit left them, and which are searched; see `Structure.fit`."""
    new = tuple(choice for choice in choices if choice not in start.choices)
    if not new and effort is not Effort.REFIT:
        new = tuple(choices[-1:])
    return tuple(choice for choice in choices if choice not in new), new


def filtered(columns: Floats, rows: Mask, noise: Floats) -> Floats:
    """Filter the chosen rows by D(q), each run of rows that follow one another for itself.

    Parameters
    ----------
    columns : ndarray, shape (n_samples,) or (n_samples, n_columns)
    rows : ndarray of bool, shape (n_samples,)
    noise : ndarray, shape (n_noise + 1,)
        D(q), leading 1 included.

    Returns
    -------
    ndarray, shape (n_rows,) or (n_rows, n_columns)
        The first rows of each run have the weights of `opening`.

    Examples
    --------
    >>> import numpy as np
    >>> filtered(np.array([1.0, 2.0, 3.0]), np.array([True, True, True]), np.array([1.0, -0.6]))
    array([0.8, 1.4, 1.8])
    """
    chosen = columns[rows]
    if noise.size == 1:
        return chosen
    out, first = chosen.copy(), opening(noise)
    for lag in range(1, noise.size):
        out[lag:] += noise[lag] * chosen[:-lag]
    for run in runs_of(rows):
        start = run.start
        rows_without_past = min(noise.size - 1, run.stop - start)
        W = first[:rows_without_past, :rows_without_past]
        out[start : start + rows_without_past] = W @ chosen[start : start + rows_without_past]
    return out


@runtime_checkable
class Stepped(Protocol):
    """A structure whose simulation goes in steps, coarser ones while it searches."""

    def with_fine_steps(self, fit: StructureFit, noise: Floats) -> StructureFit:
        """Return a fit moved to where it is best with steps as fine as the noise asks."""
        ...


@runtime_checkable
class Oscillating(Protocol):
    """A structure whose models have poles."""

    def poles(self, fit: StructureFit) -> Complexes:
        """Return the poles [1/s] of the model without effects, of one that is not linear at rest."""
        ...


def with_fine_steps(structure: Structure, fit: StructureFit, noise: Floats) -> StructureFit:
    """Return a fit moved to where it is best once its simulation is as good as exact."""
    moved = structure.with_fine_steps(fit, noise) if isinstance(structure, Stepped) else fit
    return moved if moved.usable else fit
