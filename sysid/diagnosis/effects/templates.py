"""An effect of the user's own at each port, as a file to be edited."""

MEANS = {
    "input": "s is the input; the expression is what reaches the model.",
    "output": "s is the model's output; the expression is what the sensor shows.",
    "force": "x is the position, v the speed; the expression is the force that opposes the input.",
    "gain": "y is the model's output; the expression is the factor of the input.",
}
_STRENGTH = "# without a grid: a strength; at zero the effect is gone, and the search starts there"
_SHAPE = "# with a grid: a shape, tried at multiples of"
_EXAMPLES = {
    "input": (
        "soft_limit",
        "The amplifier saturates softly.",
        (
            'expression = "limit*tanh(s/limit)"',
            "[soft_limit.parameters]",
            'limit = { unit = "[u]", minimum = 0, grid = { scale = "input deviation", points = [1, 2] } }',
            f"{_SHAPE} the input's standard deviation",
        ),
    ),
    "output": (
        "bent_sensor",
        "The sensor's characteristic is bent.",
        (
            'expression = "s + c3*s**3"',
            "[bent_sensor.parameters]",
            'c3 = { unit = "1/[y]^2", meaning = "bend" }',
            _STRENGTH,
        ),
    ),
    "force": (
        "soft_stop",
        "A soft stop beyond a gap.",
        (
            'expression = "k*(max(x - gap, 0) + min(x + gap, 0))"',
            "[soft_stop.parameters]",
            'k = { unit = "[F]/[x]", minimum = 0 }',
            _STRENGTH,
            'gap = { unit = "[x]", minimum = 0, grid = { scale = "output deviation", points = [0.5, 1] } }',
            f"{_SHAPE} the output's standard deviation",
        ),
    ),
    "gain": (
        "fading_gain",
        "The drive gets weaker away from zero.",
        (
            'expression = "exp(-(y/width)**2)"',
            "[fading_gain.parameters]",
            'width = { unit = "[y]", minimum = 0, grid = { scale = "output deviation", points = [2, 4] } }',
            f"{_SHAPE} the output's standard deviation",
        ),
    ),
}


def template(port: str) -> str:
    """Return a TOML file with an effect at a port, as an example to be edited.

    Examples
    --------
    >>> from sysid.diagnosis.effects.catalogue import effects_in
    >>> effects_in(template("gain"), "the template")[0].name
    'fading_gain'
    """
    name, mechanism, lines = _EXAMPLES[port]
    return "\n".join(
        [
            f"# {MEANS[port]}",
            "# In expressions: + - * / **, abs, sign, sqrt, exp, log, sin, cos, tanh, min, max,",
            "# where(condition, a, b), and the parameters below.",
            f"[{name}]",
            f'port = "{port}"',
            f'mechanism = "{mechanism}"',
            *lines,
            "",
        ]
    )
