"""Block-structured models of the papers as models to compare; a new one is an entry of `BLOCK_MODELS`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from sysid.errors import IdentifiabilityError, ModelError, UsageError

if TYPE_CHECKING:
    from sysid.data import Record
    from sysid.diagnosis.models.fitted_model import FittedModel
    from sysid.diagnosis.models.piecewise import PiecewiseJudged

Progress = Callable[[int, int], None] | None

PIECEWISE_ORDERS = (1, 2, 3)
# A higher order is taken if it lowers the validation error by more than this share.
WORTH_AN_ORDER = 0.05


@dataclass(frozen=True)
class BlockModel:
    """A block-structured model that finds its structure itself.

    Attributes
    ----------
    name, summary : str
    fitter : str
        ``module:function``, called as ``fit(record, options, initial_state=..., progress=...)``.
    options : callable
        Returns the fitter's options for an order, None where it is to be chosen.
    delayed : bool
        Whether the options may have a delay.
    """

    name: str
    summary: str
    fitter: str
    options: Callable[[int | None], Mapping[str, Any]]
    delayed: bool = False

    def fit(
        self, record: "Record", order: int | None, delay: int | None, initial_state: str, progress: Progress
    ) -> "FittedModel":
        """Fit the model; UsageError if it has no such option."""
        if delay is not None and not self.delayed:
            raise UsageError(f"the {self.name} model chooses its own delay: leave the delay out")
        module, _, function = self.fitter.partition(":")
        options = {**self.options(order), **({} if delay is None else {"delay": delay})}
        fit_structure: Callable[..., FittedModel] = getattr(import_module(module), function)
        return fit_structure(record, options, initial_state=initial_state, progress=progress)


def fit_piecewise(
    record: "Record", options: Mapping[str, Any], *, initial_state: str, progress: Progress
) -> "PiecewiseJudged":
    """Fit y(k) = f(past outputs and inputs), f piecewise affine; validation rows choose how many of each."""
    from sysid.diagnosis.models.piecewise import fit_piecewise_structure

    orders: tuple[int, ...] = (options["order"],) if "order" in options else PIECEWISE_ORDERS
    best: PiecewiseJudged | None = None
    problem: ModelError | IdentifiabilityError | None = None
    for place, order in enumerate(orders):
        lags = tuple((signal, lag) for signal in "yu" for lag in range(1, order + 1))

        def part(done: int, total: int, place: int = place) -> None:
            if progress is not None:
                progress(place * total + done, len(orders) * total)

        try:
            found = fit_piecewise_structure(
                record, {"z_lags": lags, "n_a": 0, "n_g": 0}, initial_state=initial_state, progress=part
            )
        except (ModelError, IdentifiabilityError) as reason:
            problem = reason
            continue
        if best is None or found.validation_error < (1.0 - WORTH_AN_ORDER) * best.validation_error:
            best = found
    if best is None:
        assert problem is not None
        raise problem
    return best


def _cascade(shape: str) -> Callable[[int | None], Mapping[str, Any]]:
    """Return the options of a cascade whose blocks have poles in front of the map, behind it, or both."""

    def options(order: int | None) -> Mapping[str, Any]:
        if order is None:
            return {"shape": shape}
        return {"shape": shape, "orders": (order * (shape != "hammerstein"), order * (shape != "wiener"))}

    return options


_CASCADE = "sysid.diagnosis.models.wiener_hammerstein:fit_wiener_hammerstein_structure"
BLOCK_MODELS = (
    BlockModel(
        "hammerstein", "spline map of the input, then poles", _CASCADE, _cascade("hammerstein"), delayed=True
    ),
    BlockModel("wiener", "poles, then a spline map", _CASCADE, _cascade("wiener"), delayed=True),
    BlockModel(
        "wiener-hammerstein",
        "poles, a spline map, poles",
        _CASCADE,
        _cascade("wiener-hammerstein"),
        delayed=True,
    ),
    BlockModel(
        "lft",
        "a spline map of lagged inputs and outputs in a loop with a linear part",
        "sysid.diagnosis.models.lft:fit_lft_structure",
        lambda order: {} if order is None else {"n_a": order},
    ),
    BlockModel(
        "piecewise-affine",
        "an affine map of lagged inputs and outputs in each of several regions",
        "sysid.diagnosis.models.block_models:fit_piecewise",
        lambda order: {} if order is None else {"order": order},
    ),
)


def block_model_names() -> tuple[str, ...]:
    """Return the names of the block-structured models."""
    return tuple(model.name for model in BLOCK_MODELS)


def find_block_model(name: str) -> BlockModel | None:
    """Return the block-structured model of that name, None if there is none."""
    return next((model for model in BLOCK_MODELS if model.name == name), None)
