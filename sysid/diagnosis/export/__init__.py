"""Take a model elsewhere.

``saved`` and ``saved_physics`` write it as JSON or TOML and read it back, ``saved_effects`` its effects;
``control_system`` makes it a `control.NonlinearIOSystem`, ``standalone`` and ``standalone_physics`` a Python
file that needs NumPy alone.
"""
