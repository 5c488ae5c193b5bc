"""Sentences of the diagnosis that must hold for the rows they are said of."""

from types import SimpleNamespace

from sysid.diagnosis.pages.report_words import _headline, _loose, _rung, _with_spread
from sysid.diagnosis.structures.structure import FittedParameter


def rung(step: int, rmse: float, removed: float) -> SimpleNamespace:
    scores = {"test": {"rmse": rmse, "nrmse": rmse / 10.0}}
    return SimpleNamespace(step=step, effect="op_gain" if step else "", scores=scores, removed=removed)


def test_a_step_that_helps_on_validation_rows_alone_says_so():
    words = _rung(rung(1, 4.3, 0.99), rung(0, 1.9, 0.0), "test", "V")
    assert words.endswith("99.00 % of the explainable error removed on the validation rows, none on test.")


def test_a_step_that_helps_on_test_needs_no_more_words():
    words = _rung(rung(1, 0.2, 0.99), rung(0, 1.9, 0.0), "test", "V")
    assert words.endswith("99.00 % of the explainable error removed.")


def test_several_effects_are_listed_as_a_sentence_lists_them():
    decision = SimpleNamespace(trials=(), given=())
    accepted = ("in_deadzone", "out_offset", "quad_drag")
    found = SimpleNamespace(accepted=accepted, decision=decision, verdict="unexplained")
    assert _headline(found).startswith(
        "Missing in the model: in_deadzone, out_offset and quad_drag, or what resembles them, and"
    )


def test_an_interval_in_percent_is_no_share_of_its_value():
    width = FittedParameter("width", 26.1, 0.56, "%")
    assert _with_spread(width) == "width = (26.1 ± 1.1) %"


def test_a_force_that_was_found_shares_the_scale_of_the_model():
    """Inertia, gain and friction are known only together; a force that was given may just not be there."""
    vague = [FittedParameter(name, 1.0, 2.0, "") for name in ("J", "K")]
    friction = FittedParameter("Fc", 0.3, 0.4, "N m", "coulomb")
    choice = SimpleNamespace(effect=SimpleNamespace(name="coulomb", port="force"))
    final = SimpleNamespace(parameters=(*vague, friction), fitted=SimpleNamespace(choices=(choice,)))
    structure = SimpleNamespace(plant=object())

    def said(given):
        decision = SimpleNamespace(given=given)
        return _loose(SimpleNamespace(structure=structure, final=final, decision=decision))[0]

    assert said(()).startswith("The record determines J, K and Fc only together")
    assert said(("coulomb",)).startswith("The record determines J and K only together")
