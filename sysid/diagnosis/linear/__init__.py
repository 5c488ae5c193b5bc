"""Linear difference equations with effects.

In the order of the algorithm: ``chain`` is the equation with its effects (``kernels`` run it,
``direct_path`` where forces act at once, ``tangents`` follow small changes, ``rows`` say which residuals
count, ``differences`` give slopes without a formula), ``starts`` and ``search`` find its parameters
(``levenberg`` the last steps by the ``triangles`` of the slopes, ``sign_retrieval`` where the output is
rectified), ``restarts`` ask whether another start ends elsewhere,
``parameters`` gives them with standard errors (``cells`` behind a quantiser, ``modes`` for the aliases of a
delay, ``profile`` what its likelihood is where slopes do not tell), ``directions`` and
``probes`` serve the score screen, ``free_run`` predicts, and ``structure`` shows all of it to the search.
"""
