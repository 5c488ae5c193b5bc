"""Take a model elsewhere.

``saved`` writes it as JSON or TOML, reads it back, and leads to the other forms.  A model apart from its
record is ``saved_linear`` or ``saved_physics`` with ``saved_effects``; ``control_linear`` and
``control_physics`` make it a `control.NonlinearIOSystem`, ``standalone`` and ``standalone_physics`` a Python
file that needs NumPy alone.
"""
