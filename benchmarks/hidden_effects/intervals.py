"""True values of the parameters that the diagnosis reports, under its names and in its units."""

from collections.abc import Mapping

from sysid.demonstration import Case

Values = Mapping[str, float]

_SIDED = {
    "in_saturation": "level",
    "in_deadzone": "width",
    "in_preload": "jump",
    "in_backlash": "width",
    "out_saturation": "level",
}
_RENAMED = {
    "out_offset": {"offset": "offset"},
    "out_quantisation": {"step": "step"},
    "out_quadratic": {"c": "c"},
    "coulomb": {"Fc": "friction"},
    "quad_drag": {"c": "drag"},
    "cubic_stiffness": {"k3": "stiffness"},
    "feedthrough": {"d": "d"},
    "op_gain": {"g": "gain", "scale": "scale"},
}


def true_values(effect: str, parameters: Values, period: float, reported: list[str]) -> dict[str, float]:
    """Return the true value of each reported parameter that has one.

    Parameters
    ----------
    effect : str
    parameters : mapping
        As drawn.
    period : float
        Sampling period [s].
    reported : list of str
        Names in the diagnosis.

    Examples
    --------
    >>> true_values("in_delay", {"delay": 2.5}, 0.1, ["delay"])
    {'delay': 0.25}
    """
    if effect in _SIDED:
        return _sided(_SIDED[effect], parameters, reported)
    if effect in ("in_delay", "out_delay"):
        values = {"delay": parameters["delay"] * period}
    elif effect == "out_drift":
        values = {"rate": parameters["rate"] / period}
    elif effect == "time_variation":
        ramp = parameters["change"] / (parameters["n"] * period)
        values = {"size": parameters["change"]} if parameters["step"] else {"rate": ramp}
    else:
        values = {name: parameters[ours] for name, ours in _RENAMED.get(effect, {}).items()}
    return {name: value for name, value in values.items() if name in reported}


def plant_values(case: Case) -> dict[str, float]:
    """Return the true values of the plant's parameters that a record can tell.

    The level of a relay is one with the gain of a difference equation, and a rectifier hides its sign.
    """
    names = case.plant.parameters
    if case.plant.family == "difference-equation" and {"in_relay", "out_rectify"} & set(case.names):
        names = {name: value for name, value in names.items() if not name.startswith("b")}
    return {name: value for name, value in names.items() if name not in case.known}


def _sided(name: str, parameters: Values, reported: list[str]) -> dict[str, float]:
    upper, lower = parameters["upper"], parameters["lower"]
    if f"{name}_positive" in reported:
        return {f"{name}_negative": lower, f"{name}_positive": upper}
    return {name: upper} if name in reported and upper == lower else {}
