"""An effect in a form with more freedom, its values those of the form that was fitted before."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.diagnosis.effects.base import Floats, Form
from sysid.diagnosis.structures.structure import Choice, StructureFit


def freer_forms(choice: Choice) -> tuple[Form, ...]:
    """Return the other forms of an effect, looked for like this one, in which it can be just the same.

    Examples
    --------
    >>> from sysid.diagnosis.effects.catalogue import find_effects
    >>> (effect,) = find_effects(["in_saturation"])
    >>> [form.name for form in freer_forms(Choice(effect, effect.form("symmetric")))]
    ['two-sided']
    >>> freer_forms(Choice(effect, effect.form("two-sided")))
    ()
    """
    size = len(choice.form.parameters)
    larger = (form for form in choice.effect.found_by if len(form.parameters) > size)
    return tuple(form for form in larger if _sources(choice.form, form) is not None)


def sibling_forms(choice: Choice) -> tuple[Form, ...]:
    """Return the other forms of an effect, looked for like this one, with the same parameters.

    Examples
    --------
    >>> from sysid.diagnosis.effects.catalogue import find_effects
    >>> (effect,) = find_effects(["in_rate_limit"])
    >>> [form.name for form in sibling_forms(Choice(effect, effect.form("symmetric")))]
    ['symmetric from rest']
    """
    own = choice.form
    return tuple(f for f in choice.effect.found_by if f != own and f.parameters == own.parameters)


def with_forms_of(choices: Sequence[Choice], start: StructureFit, places: Sequence[slice]) -> StructureFit:
    """Return a fit whose effects are in the wanted forms where these can be just the same.

    What takes the place of an effect at its port, and has its parameters or some of them, has its values.

    Parameters
    ----------
    choices : sequence of Choice
        Wanted; others than the fit's effects, or one in the place of one of these, say nothing.
    start : StructureFit
    places : sequence of slice
        Of each effect's parameters in the point of the fit.
    """
    wanted = {choice.name: choice for choice in choices}
    instead = [choice for choice in choices if choice.name not in start.names]
    found: list[Choice] = []
    point: Floats = start.point
    for choice, place in zip(reversed(start.choices), reversed(places), strict=True):
        other = wanted.get(choice.name, choice)
        if choice.name not in wanted and len(instead) == 1 and instead[0].effect.port == choice.effect.port:
            sources = _by_name(choice.form, instead[0].form)
            other = choice if sources is None else instead[0]
        else:
            sources = _sources(choice.form, other.form)
        if sources is not None:
            point = np.concatenate([point[: place.start], point[place][sources], point[place.stop :]])
        found.insert(0, choice if sources is None else other)
    return start if tuple(found) == start.choices else replace(start, choices=tuple(found), point=point)


def _by_name(form: Form, other: Form) -> list[int] | None:
    """Return which parameter of a form has the name of each of another, None where some has none."""
    places = {p.name: i for i, p in enumerate(form.parameters)}
    names = [p.name for p in other.parameters]
    return [places[name] for name in names] if set(names) <= set(places) else None


def _sources(form: Form, other: Form) -> list[int] | None:
    """Return which parameter of a form gives the value of each of another, None where they are not alike.

    A parameter with two sides is named after the one with the same value on both: ``width_positive``.
    """
    if other != form and other.parameters == form.parameters:
        return list(range(len(form.parameters)))
    if len(other.parameters) <= len(form.parameters):
        return None
    places = []
    for p in other.parameters:
        same = [
            i for i, q in enumerate(form.parameters) if p.name.startswith(f"{q.name}_") or p.name == q.name
        ]
        if len(same) != 1:
            return None
        places += same
    return places if set(places) == set(range(len(form.parameters))) else None
