"""A static map between two linear blocks that both have poles, fitted by the simulation error.

``estimate`` fits with given orders and knots, ``choice`` chooses them on validation rows; both search by
``multistart``: ``starts`` share the poles of a linear approximation between the blocks, ``search`` follows
the best ones by the ``reduction`` (the map eliminated) of the ``model``'s rows (``columns``, ``kernels``).
``initial_state`` begins a run on measured rows, ``uncertainty`` is the covariance, ``result`` what the user
gets, ``files`` how it is kept, ``checks`` what is refused.
"""
