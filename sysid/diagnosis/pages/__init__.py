"""Show a comparison or a diagnosis as pictures and pages.

``content`` and ``report_words`` say it in words, ``figures`` and the files of that beginning draw it
(``drawing``: the common hand), ``page`` writes HTML, ``document`` PDF.  ``diagnose_page`` is
the content of a diagnosis.
"""
