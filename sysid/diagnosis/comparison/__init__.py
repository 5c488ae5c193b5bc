"""Judge a fitted model on a record and say where it fails.

``judge`` gathers everything into a ``judgement``: ``scores`` of each set (``set_scores``), the ``noise``
floor (from ``periods`` where the input repeats), ``where`` the error lies, and tests of the residual
(``nonlinear_tests``, beside the linear ones of `sysid.diagnosis.residuals`).
``where`` cuts the rows (``series``) into ``regions`` and holds the error of each against its
``surrogates``; ``bands`` does the same over frequency, ``reversal_force`` where a velocity changes sign.
``summary`` puts the whole into sentences.
"""
