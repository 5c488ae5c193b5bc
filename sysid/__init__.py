"""Block-structured nonlinear system identification: replicate, compare, diagnose.

The public names below are loaded when first used, so that importing the package costs little.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "LftStructure": "sysid.lft",
    "NONLINEARITIES": "sysid.nonlinearities",
    "PhysicsModel": "sysid.physics",
    "Record": "sysid.data",
    "Recursive": "sysid.recursive",
    "RecursiveLeastSquares": "sysid.recursive",
    "Runner": "sysid.montecarlo",
    "SeparableFit": "sysid.separable",
    "compare": "sysid.diagnosis.compare",
    "compare_outputs": "sysid.diagnosis.compare",
    "correlation_method": "sysid.hammerstein",
    "diagnose": "sysid.diagnosis.diagnose",
    "fit_hammerstein": "sysid.linear",
    "fit_lft": "sysid.lft",
    "fit_local_linear": "sysid.local_linear",
    "fit_output_error": "sysid.linear",
    "fit_physics": "sysid.physics",
    "identify_levels": "sysid.recursive",
    "fit_state_space": "sysid.linear",
    "fit_wiener_hammerstein": "sysid.lft",
    "identify_wiener": "sysid.wiener",
    "load": "sysid.diagnosis.export.saved",
    "load_model": "sysid.physics",
    "make_record": "sysid.data",
    "read_record": "sysid.data",
    "resample": "sysid.data",
    "save": "sysid.diagnosis.export.saved",
    "search_method": "sysid.hammerstein",
    "to_control": "sysid.diagnosis.export.saved",
    "to_python": "sysid.diagnosis.export.saved",
    "two_sided_search_method": "sysid.hammerstein",
}

__all__ = ["__version__", *sorted(_PUBLIC)]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *globals()])
