"""What the effects of a diagnosed model do in its record: laws and courses, as a figure shows them."""

from sysid.diagnosis.effect_views.free_curve import with_free_curve
from sysid.diagnosis.effect_views.laws import effect_views
from sysid.diagnosis.effect_views.view import EffectView

__all__ = ["EffectView", "effect_views", "with_free_curve"]
