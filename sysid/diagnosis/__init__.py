"""From measurement and model to what the model lacks.

Each file holds one idea.

Compare: ``models`` and its adapters (``adapters``, ``black_boxes``, ``lft_model``, ...) fit what is asked
for, behind the face of ``fitted_model``; ``judge`` gathers ``set_scores``, ``noise``, ``where`` (with
``series``, ``regions``, ``surrogates``, ``bands``, ``reversal_force``) and the tests into a ``comparison``;
``summary`` says it in words.

Decide: ``residual_evidence`` reads residuals, ``trials`` fits candidates, ``acceptance`` holds the evidence
against them, ``growth`` adds them one after the other, ``revision`` looks at earlier ones again, ``verdict``
judges what is left, and ``decide`` leads the search.  All it knows of a model is ``structures.Structure``.

Structures: ``linear_structure`` and ``physics_structure`` fit a model with ``effects``; their parts, from
the equation to the search, are the files of the same beginning.

Show: ``ladder``, ``advice`` and ``report_words`` for a diagnosis, ``content`` for a comparison; ``drawing``
and the ``figures``, ``page``, ``document``; ``export`` takes a model elsewhere.
"""
