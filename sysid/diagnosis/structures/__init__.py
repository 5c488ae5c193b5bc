"""What a model with effects is, whatever its kind.

``structure`` is the face that `sysid.diagnosis.decide` knows; the rest is used by both kinds of model:
``memory`` of fits that were made and the ``work`` that these were, ``whitening`` and ``noise_filter`` of
residuals under coloured noise,
``profile`` of the likelihood where slopes do not tell how far a valley of the error reaches,
``cells`` for readings behind a quantiser, ``sides`` for effects that get more freedom, ``probe_functions``
for the score screen, ``pointwise`` for effects that act on one row at a time.
"""
