"""Physical models with effects.

In the order of the algorithm: ``setting`` is what is known, ``laws`` turn effects into terms of the
equations of motion, ``problem`` is the least-squares problem they make (``hold``: the input between
samples; ``evaluation``: as a search asks for it; ``budget``: how much simulation that may take),
``starts``, ``points``, ``scatter``, ``search`` and ``descents`` find its parameters, ``steps`` says how
fine its simulation must be, ``parameters`` gives them with standard errors (``cells`` behind a
quantiser, ``profile`` what their likelihood is where slopes do not tell), ``directions`` serve the score
screen, ``free_run`` predicts, and ``structure`` shows all of it to the search.
"""
