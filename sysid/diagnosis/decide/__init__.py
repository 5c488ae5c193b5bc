"""Find what is missing: which effects, and how sure.

``search`` leads, one ``attempt`` for each choice of rows; a ``decision`` is where it stands, and ``settling``
its last look at the leaders. ``residual_evidence`` reads residuals
(``evidence``: its rules and numbers, ``noise_colour``), ``trials`` fits candidates, ``acceptance`` holds
the evidence against them, ``growth`` adds them one after the other, ``revision`` looks at earlier ones
again, ``refinement`` tries finer forms, ``verdict`` judges what is left (``modes``: whether a pole rings),
``ranking`` and ``rungs`` tell how it went, and an ``allowance`` how far it may go.
"""
