"""Write a model with effects as Python source that needs NumPy alone."""

import json

from sysid.diagnosis.export.saved_linear import SavedModel
from sysid.diagnosis.structures.structure import Choice
from sysid.errors import ModelError

# Bodies of maps, by effect and form; p is the list of parameters, s the sequence, T the sampling period.
_MAPS = {
    ("in_saturation", "symmetric"): "np.clip(s, -p[0], p[0])",
    ("in_saturation", "two-sided"): "np.clip(s, -p[0], p[1])",
    ("in_deadzone", "symmetric"): "s - np.clip(s, -p[0], p[0])",
    ("in_deadzone", "two-sided"): "s - np.clip(s, -p[0], p[1])",
    ("in_preload", "symmetric"): "s + p[0] * np.sign(s)",
    ("in_preload", "two-sided"): "s + np.where(s > 0, p[1], np.where(s < 0, -p[0], 0.0))",
    ("in_relay", "symmetric"): "np.where(s > p[0], 1.0, np.where(s < -p[0], -1.0, 0.0))",
    ("in_relay", "two-sided"): "np.where(s > p[1], 1.0, np.where(s < -p[0], -1.0 - p[2], 0.0))",
    ("in_backlash", "symmetric"): "play(s, p[0], p[0])",
    ("in_backlash", "two-sided"): "play(s, p[0], p[1])",
    ("in_delay", "delay"): "delay(s, p[0] / T, 0.0)",
    ("in_delay", "delay in motion"): "delay(s, p[0] / T, s[0])",
    ("in_rate_limit", "symmetric"): "rate_limit(s, p[0] * T, p[0] * T, s[0])",
    ("in_rate_limit", "symmetric from rest"): "rate_limit(s, p[0] * T, p[0] * T, 0.0)",
    ("in_rate_limit", "two-sided"): "rate_limit(s, p[0] * T, p[1] * T, s[0])",
    ("in_rate_limit", "two-sided from rest"): "rate_limit(s, p[0] * T, p[1] * T, 0.0)",
    ("in_hysteresis", "symmetric"): "hysteresis(s, p[0], p[0])",
    ("in_hysteresis", "two-sided"): "hysteresis(s, p[0], p[1])",
    ("in_hysteresis", "left as it was"): "hysteresis(s, p[0], p[1], p[2])",
    ("time_variation", "ramp"): "s * (1.0 + p[0] * T * np.arange(s.size))",
    ("time_variation", "step"): "s * (1.0 + p[0] * np.clip(T * np.arange(s.size) - p[1] + T, 0.0, T) / T)",
    ("out_saturation", "symmetric"): "np.clip(s, -p[0], p[0])",
    ("out_saturation", "two-sided"): "np.clip(s, -p[0], p[1])",
    ("out_offset", "offset"): "s + p[0]",
    ("out_drift", "linear"): "s + p[0] * T * np.arange(s.size)",
    ("out_quantisation", "round"): "p[0] * np.round(s / p[0])",
    ("out_rectify", "full-wave"): "np.abs(s)",
    ("out_rectify", "half-wave"): "np.maximum(s, 0.0)",
    ("out_quadratic", "quadratic"): "s + p[0] * s**2",
    ("out_delay", "delay"): "delay(s, p[0] / T, 0.0)",
    ("out_delay", "delay in motion"): "delay(s, p[0] / T, s[0])",
    ("out_lowpass", "first order"): "low_pass(s, np.exp(-T / p[0]), 0.0)",
    ("out_lowpass", "first order in motion"): "low_pass(s, np.exp(-T / p[0]), s[0])",
    ("out_lowpass", "straight between samples"): "low_pass_straight(s, T / p[0], 0.0)",
    ("out_lowpass", "straight between samples in motion"): "low_pass_straight(s, T / p[0], s[0])",
    ("feedthrough", "direct"): "p[0] * s",
    ("feedthrough", "behind"): "p[0] * s",
    ("extra_mode", "second order"): "mode(s, p, T)",
    ("extra_mode", "second order behind"): "mode(s, p, T)",
}

_HELPERS = {
    "play": """def play(s, lower, upper):
    x, out = 0.0, []
    for value in s:
        x = min(max(x, value - upper), value + lower)
        out.append(x)
    return np.array(out)
""",
    "delay": """def delay(s, samples, before):
    whole = int(samples)
    part = samples - whole
    padded = np.concatenate([np.full(whole + 1, before), s])
    return (1.0 - part) * padded[1 : s.size + 1] + part * padded[: s.size]
""",
    "rate_limit": """def rate_limit(s, fall, rise, x):
    out = []
    for value in s:
        x += min(max(value - x, -fall), rise)
        out.append(x)
    return np.array(out)
""",
    "hysteresis": """def hysteresis(s, lower, upper, before=None):
    x, out = (1.0 if s[0] > 0 else -1.0) if before is None else before, []
    for value in s:
        x = 1.0 if value > upper else (-1.0 if value < -lower else x)
        out.append(x)
    return np.array(out)
""",
    "low_pass": """def low_pass(s, pole, x):
    out = []
    for value in s:
        x = pole * x + (1.0 - pole) * value
        out.append(x)
    return np.array(out)
""",
    "low_pass_straight": """def low_pass_straight(s, ratio, x):
    pole, before, out = np.exp(-ratio), x, []
    past = (1.0 - pole) / ratio - pole
    for value in s:
        x = pole * x + past * before + (1.0 - pole - past) * value
        before = value
        out.append(x)
    return np.array(out)
""",
    "mode": """def mode(s, p, T):
    radius = np.exp(-p[1] * p[0] * T)
    angle = min(p[0] * T * np.sqrt(1.0 - p[1] ** 2), np.pi)
    out = np.zeros(s.size)
    for k in range(1, s.size):
        out[k] = p[2] * s[k - 1] + 2.0 * radius * np.cos(angle) * out[k - 1]
        if k > 1:
            out[k] += p[3] * s[k - 2] - radius**2 * out[k - 2]
    return out
""",
}


def source(model: SavedModel) -> str:
    """Return the source of ``simulate(u)``."""
    ports: dict[str, list[str]] = {"input": [], "parallel": [], "output": [], "drive": []}
    choices = [effect.choice for effect in model.effects]
    forced = any(choice.effect.port in ("force", "gain") for choice in choices)
    direct = None
    for saved, choice in zip(model.effects, choices, strict=True):
        port = choice.effect.port
        if forced and choice.form.inside:
            (direct,) = saved.values
        elif port in ("force", "gain"):
            sign = "-=" if port == "force" else "*="
            law = _law(choice.form.expression, saved.parameters)
            ports["drive"].append(f"        acting {sign} {law}\n")
        else:
            begins = f"    s = {'x' if choice.form.behind else 'u'}\n" if port == "parallel" else ""
            ports[port].append(f"{begins}    p = {saved.values!r}\n    s = {map_source(choice)}\n")
    adds = [part + "    y = y + s\n" for part in ports["parallel"]]
    maps = "".join([*ports["input"], *ports["parallel"], *ports["output"]])
    functions = helpers_for(maps)
    return (
        '"""Simulation of an identified model; NumPy is all it needs."""\n\nimport numpy as np\n\n'
        f"T = {model.period!r}\nA = {list(model.a)!r}\nB = {list(model.b)!r}\n"
        f"CONSTANT = {model.constant!r}\n\n\n"
        + "\n\n".join([*functions, ""])
        + 'def simulate(u):\n    """Return the output for an input, from rest."""\n'
        + "    u = np.asarray(u, dtype=float)\n    s = u\n"
        + "".join(ports["input"])
        + "    x, z, v = s, np.zeros(u.size), np.zeros(u.size)\n"
        + "    for k in range(u.size):\n        z[k] = CONSTANT\n"
        + "        for i in range(1, min(len(A), k) + 1):\n"
        + "            z[k] += B[i - 1] * v[k - i] - A[i - 1] * z[k - i]\n"
        + _acting("".join(ports["drive"]), direct)
        + "".join(adds)
        + "    s = y\n"
        + "".join(ports["output"])
        + "    return s\n"
    )


def _acting(drive: str, direct: float | None) -> str:
    """Return what fills ``v[k]`` from ``z[k]``, and the output before its maps after the last row."""
    if direct is None:
        return (
            "        position, speed, acting = z[k], (z[k] - z[k - 1] if k else 0.0), x[k]\n"
            f"{drive}        v[k] = acting\n    y = z\n"
        )
    inner = drive.replace("        acting", "            acting")
    return (
        "        # The output holds D v(k), and v(k) follows it: a root by the secant method.\n"
        f"        position, step, error = z[k] + {direct!r} * x[k], None, None\n"
        "        for _ in range(50):\n"
        f"            speed, acting = (position - z[k - 1] - {direct!r} * v[k - 1] if k else 0.0), x[k]\n"
        f"{inner}"
        f"            before, error = error, z[k] + {direct!r} * acting - position\n"
        f"            if error == before or abs(error) <= 1e-14 * (abs(z[k]) + abs({direct!r} * x[k])):\n"
        "                break\n"
        "            step = error if before is None else step * error / (before - error)\n"
        "            position += step\n"
        f"        v[k] = acting\n    y = z + {direct!r} * v\n"
    )


def map_source(choice: Choice) -> str:
    """Return what an effect makes of a sequence ``s``, with parameters ``p`` and sampling period ``T``."""
    if choice.effect.definition:
        return _own_map(choice)
    if (choice.name, choice.form.name) not in _MAPS:
        raise ModelError(
            f"effect {choice.name!r} is not one of the built-in ones: save the model as JSON instead"
        )
    return _MAPS[choice.name, choice.form.name]


def _own_map(choice: Choice) -> str:
    """Return the map of an effect that was read from TOML, sample by sample."""
    from sysid.physics.expressions import code
    from sysid.physics.grammar import parse

    expression = json.loads(choice.effect.definition)["expression"]
    inside = {"s": "value"} | {p.name: f"p[{i}]" for i, p in enumerate(choice.form.parameters)}
    return f"np.array([{code(parse(expression, set(inside)), inside)} for value in s])"


def helpers_for(maps: str) -> list[str]:
    """Return the functions that a text of maps calls."""
    return [text for name, text in _HELPERS.items() if f"{name}(" in maps]


def _law(expression: str, values: dict[str, float]) -> str:
    """Return a force or gain as source, numbers in place of its parameters."""
    from sysid.physics.expressions import Number, code, substitute
    from sysid.physics.grammar import parse

    tree = parse(expression, {"x", "y", "v", *values})
    filled = substitute(tree, {name: Number(value) for name, value in values.items()})
    return code(filled, {"x": "position", "y": "position", "v": "speed"})
