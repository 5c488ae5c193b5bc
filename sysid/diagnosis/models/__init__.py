"""The models that can be compared with a record, behind the face of `fitted_model`.

``resolution`` turns a name or a file into one of them; ``adapters`` dress the fits of the estimator core
(linear, physical), ``black_boxes`` the state-space and linear models whose order is chosen,
``block_models`` is the registry of ``wiener_hammerstein``, ``lft``, ``piecewise`` and their kin,
``local_linear`` the models that change with the operating point, ``known_model`` what was saved and is not
fitted.  ``fitted_map`` is a static curve as the pages show it.
"""
