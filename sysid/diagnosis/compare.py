"""Compare a model with a measured record on held-out rows."""

import operator
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.diagnosis.compared import Comparison
from sysid.diagnosis.comparison.judge import FITTING_SHARE, check_output, judge
from sysid.diagnosis.models.fitted_model import LINEAR, Known
from sysid.diagnosis.models.resolution import fit_model, resolve_model
from sysid.diagnosis.models.unit_check import in_units_of_model
from sysid.errors import UsageError
from sysid.progress import Callback, part_of

if TYPE_CHECKING:
    from sysid.diagnosis.export.saved import Saved
    from sysid.physics import Model, Starts


def compare(
    record: Record,
    model: "str | Path | Model | Saved" = LINEAR,
    order: int | None = None,
    *,
    delay: int | None = None,
    constant: bool | None = None,
    start: "Starts | None" = None,
    fixed: Mapping[str, float] | None = None,
    initial_state: str = "estimate",
    ports: bool = True,
    progress: Callback | None = None,
) -> Comparison:
    """Fit a model to a record and judge it on the rows it has not seen.

    A saved model (`sysid.save`) is judged as it is, on all rows if none is marked as test; of the record it
    learns initial states.  Of any other the structure is chosen on validation rows, the accepted model
    refitted on estimation and validation rows, and only then run over the test rows.

    Parameters
    ----------
    record : Record
    model : str, Path, Model, SavedModel or SavedPhysicalModel
        ``"linear"``, the name of a physical model (`sysid models` lists them), a TOML file, a model,
        or a saved one.
    order, delay : int, optional
        Of the linear model; chosen from the data if not given.
    constant : bool, optional
        Whether the linear model has one, or the sensor of a physical one a zero of its own; chosen from the
        data if not given, and at rest (``initial_state``) then none.
    start, fixed : mapping of str to float, optional
        Parameters of a physical model known within some 20 %, and those known for good.
    initial_state : {"estimate", "rest"}
    ports : bool
        Whether to fit a free-form curve at each port of a linear or physical model.
    progress : callable, optional
        Called with the number of steps done and to do.

    Returns
    -------
    Comparison

    Raises
    ------
    UsageError, ModelError
        If the model or a parameter is not known or an argument is of the wrong kind.
    DataError, IdentifiabilityError
        If the record cannot be fitted.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(600)
    >>> y = np.zeros(600)
    >>> for k in range(1, 600):
    ...     y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1]
    >>> y += 0.05 * rng.standard_normal(600)
    >>> split = np.repeat(["train", "test"], [400, 200])
    >>> comparison = compare(make_record(u, y, period=0.1, split=split), order=1, delay=1)
    >>> comparison.score_of("test").free_run.nrmse < 0.1
    True
    """
    if not isinstance(record, Record):
        raise UsageError(
            f"record is of type {type(record).__name__}: make one with sysid.data.make_record(u, y, period)"
        )
    order, delay = _whole("order", order), _whole("delay", delay)
    if constant is not None and not isinstance(constant, bool | np.bool_):
        raise UsageError(f"constant is {constant!r}: give True, False or None (chosen from the data)")
    check_output(record)
    resolved = resolve_model(model, order, start, fixed)
    if isinstance(resolved, Known) and not record.test_sets:
        record = record.as_test_set()
    fitted = fit_model(
        record,
        resolved,
        order,
        delay=delay,
        constant=constant,
        initial_state=initial_state,
        progress=part_of(progress, 0, FITTING_SHARE),
    )
    return Comparison.of(judge(in_units_of_model(record, fitted), fitted, ports=ports, progress=progress))


def compare_outputs(
    record: Record,
    model: "str | Path | Model | Saved" = LINEAR,
    order: int | None = None,
    *,
    constant: bool | None = None,
    start: "Starts | None" = None,
    fixed: Mapping[str, float] | None = None,
    initial_state: str = "estimate",
    ports: bool = True,
    progress: Callback | None = None,
) -> tuple[Comparison, ...]:
    """Compare every output of a record with a model.

    A physical model that has these outputs, by their names, is fitted to all of them together: they share
    parameters and initial states.  Any other model is fitted to each output by itself.

    Parameters
    ----------
    record : Record
    model, order, constant, start, fixed, initial_state, ports, progress
        As in `compare`.

    Returns
    -------
    tuple of Comparison
        One for each output.

    Raises
    ------
    UsageError, ModelError, DataError, IdentifiabilityError
        As in `compare`.
    """
    from sysid.diagnosis.models.physical_fit import fit_jointly
    from sysid.physics import Model

    resolved = resolve_model(model, order, start, fixed)
    each = [record.of_output(name) for name in record.outputs]
    count = len(each)
    if count > 1 and isinstance(resolved, Model) and len(resolved.outputs) > 1:
        models = fit_jointly(record, resolved, initial_state, constant, part_of(progress, 0, 50))
        return tuple(
            Comparison.of(
                judge(
                    in_units_of_model(one, fitted),
                    fitted,
                    ports=ports,
                    progress=part_of(progress, 50 + 50 * i // count, 50 + 50 * (i + 1) // count),
                )
            )
            for i, (one, fitted) in enumerate(zip(each, models, strict=True))
        )
    return tuple(
        compare(
            one,
            model,
            order,
            constant=constant,
            start=start,
            fixed=fixed,
            initial_state=initial_state,
            ports=ports,
            progress=part_of(progress, 100 * i // count, 100 * (i + 1) // count),
        )
        for i, one in enumerate(each)
    )


def _whole(name: str, value: int | None) -> int | None:
    if value is None:
        return None
    try:
        return operator.index(value)
    except TypeError:
        raise UsageError(f"{name} is {value!r}: give a whole number, or None to have it chosen") from None
