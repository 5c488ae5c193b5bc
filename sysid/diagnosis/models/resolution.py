"""Which models can be compared, and how they are fitted."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.data import Record
from sysid.diagnosis.models.block_models import block_model_names, find_block_model
from sysid.diagnosis.models.fitted_model import LINEAR, FittedModel
from sysid.errors import UsageError

if TYPE_CHECKING:
    from sysid.diagnosis.export.saved import Saved
    from sysid.diagnosis.models.known_model import KnownModel
    from sysid.physics import Model, Starts


def resolve_model(
    model: "str | Path | Model | Saved",
    order: int | None = None,
    start: "Starts | None" = None,
    fixed: Mapping[str, float] | None = None,
) -> "Model | KnownModel | str | None":
    """Return a physical model with start and known values, a saved one, None for linear, or another's name.

    Parameters
    ----------
    model : str, Path, Model, SavedModel or SavedPhysicalModel
        ``"linear"``, ``"state-space"``, ``"hammerstein-..."`` with the name of a map,
        ``"hammerstein"``, ``"wiener"``, ``"wiener-hammerstein"``, ``"lft"``, ``"piecewise-affine"``,
        ``"local-linear"``, the name of a physical model, a TOML file, a saved model, or a model.
    order : int, optional
    start, fixed : mapping of str to float, optional

    Raises
    ------
    UsageError, ModelError
        If there is no such model or parameter, or an option does not belong to the model.

    Examples
    --------
    >>> resolve_model("two-tanks", fixed={"b": 0.5}).parameter("b").status
    'fixed'
    """
    from sysid.physics import Model, all_model_names, is_known, is_model_class, load_model

    if isinstance(model, str) and (model == LINEAR or model in _black_boxes(model)):
        if given := [*(start or {}), *(fixed or {})]:
            raise UsageError(
                f"the {model} model has no parameter {given[0]!r} to start from or to fix: its coefficients "
                "are found without start values, so leave it out or choose a physical model"
            )
        return None if model == LINEAR else model
    if (taken := known_model(model)) is not None:
        if given := [*(start or {}), *(fixed or {}), *(["order"] if order is not None else [])]:
            raise UsageError(f"{taken.name} is a saved model with values of its own: leave {given[0]!r} out")
        return taken
    if isinstance(model, Model):
        found = model
    else:
        if not isinstance(model, str | Path) and not is_model_class(model):
            raise UsageError(f"model is of type {type(model).__name__}: give a name, a TOML file or a Model")
        if isinstance(model, str | Path) and not is_known(model):
            known = ", ".join((LINEAR, *all_model_names(), *_black_boxes(model)))
            raise UsageError(
                f"model {str(model)!r} is not known: choose one of {known}, or give a .toml file, a class "
                "as module:Class, or a model saved as .json or .toml"
            )
        found = load_model(model)
    if order is not None and order != found.order:
        raise UsageError(
            f"order is {order} and model {found.name!r} has {found.order} states: leave the order out"
        )
    return found.with_parameters(start, fixed)


def known_model(model: object) -> "KnownModel | None":
    """Return a saved model, if a file or an object is one."""
    if isinstance(model, str | Path) and Path(model).suffix not in (".json", ".toml"):
        return None
    from sysid.diagnosis.export.saved import Saved, is_saved, load
    from sysid.diagnosis.models.known_model import KnownModel

    if isinstance(model, Saved):
        return KnownModel(model, "in memory")
    if isinstance(model, str | Path) and is_saved(model):
        return KnownModel(load(model), Path(model).name)
    return None


def _black_boxes(model: str | Path) -> tuple[str, ...]:
    """Return the names of models without physics but the linear one, without loading them for others."""
    if str(model).startswith("local-linear"):
        from sysid.diagnosis.models.local_linear import LOCAL_LINEAR, is_local_linear

        return (str(model) if is_local_linear(str(model)) else LOCAL_LINEAR,)
    if not str(model).startswith(("state", "hammerstein-")):
        return ("state-space", "hammerstein-<map>", *block_model_names(), "local-linear")
    from sysid.diagnosis.models.black_boxes import black_box_names

    return black_box_names()


def fit_model(
    record: Record,
    model: "Model | KnownModel | str | None",
    order: int | None = None,
    *,
    delay: int | None = None,
    constant: bool | None = None,
    initial_state: str = "estimate",
    progress: Callable[[int, int], None] | None = None,
) -> FittedModel:
    """Fit a physical model, choose and fit a linear one (None), or take a saved one as it is.

    A physical model is searched on the estimation rows from many starts; the refit with the
    validation rows goes on from there.
    """
    from sysid.diagnosis.models.adapters import LinearModel
    from sysid.diagnosis.models.known_model import KnownModel
    from sysid.diagnosis.models.physical_fit import fit_physical

    if isinstance(model, KnownModel):
        if delay is not None or constant is not None:
            raise UsageError(f"{model.name} is a saved model: it takes neither a delay nor a constant")
        return replace(model, initial_state=initial_state)
    if model is None:
        from sysid.linear.selection import choose_output_error

        choice = choose_output_error(
            record,
            order=order,
            delay=delay,
            constant=constant,
            initial_state=initial_state,
            progress=progress,
        )
        return LinearModel(choice, dict(record.units))
    if isinstance(model, str) and (block := find_block_model(model)) is not None:
        if constant is not None:
            raise UsageError(f"constant belongs to the linear model: the map of a {model} model has its own")
        return block.fit(record, order, delay, initial_state, progress)
    if isinstance(model, str):
        from sysid.diagnosis.models.black_boxes import fit_black_box
        from sysid.diagnosis.models.local_linear import fit_local_models, is_local_linear

        fit_named = fit_local_models if is_local_linear(model) else fit_black_box
        return fit_named(
            record,
            model,
            order,
            delay=delay,
            constant=constant,
            initial_state=initial_state,
            progress=progress,
        )
    if delay is not None:
        raise UsageError(f"delay belongs to the linear model: {model.name!r} has parameters instead")
    return fit_physical(record, model, initial_state, constant, progress)
