"""From measurement and model to what the model lacks.

Two commands lead: ``compare`` (where does the model fail?) and ``diagnose`` (what is missing?).  Behind them
are rooms, each with a guide of its own:

- ``models`` fit the model that is asked for; ``comparison`` judges it and says where it fails;
- ``effects`` is the catalogue of what can be missing, ``ports`` the free-form curves where no name fits;
- ``structures`` says what a model with effects is, ``linear`` and ``physics`` are the two kinds of it;
- ``decide`` is the search for what is missing, knowing no more of a model than ``structures`` tells;
- ``pages`` shows, ``export`` takes a model elsewhere.

What they hand on is in ``compared`` and ``diagnosis``: data (a ``judgement``, an ``outcome``) in words and on
pages.  What only ``diagnose`` needs lies beside it: ``long_records`` (a search on part of the rows),
``ladder`` (the falling error), ``advice`` and ``experiment`` (what to measure next), ``shortfall`` (where
what is left lies), ``drafts`` (a curve as an effect to edit, by the
simplest of the ``curve_laws``).
"""
