"""LaTeX mathematics, read once into MathML: browsers show it, Typst markup is made from it."""

from __future__ import annotations

import base64
import html
import importlib.util
import io
import re
import unicodedata
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from sysid.errors import ReportError

_ENTITY = re.compile(r"&(?!lt;|gt;|amp;|quot;|#)(\w+);")
_SINGLE_IDENTIFIER = re.compile(r"<mi>(.)</mi>")


@cache
def _converter() -> Any:
    from math_core import LatexToMathML

    return LatexToMathML(fancy_error=False)


def mathml(tex: str, *, display: bool = False) -> str:
    r"""Convert LaTeX to a MathML element.

    Parameters
    ----------
    tex : str
        The formula without dollar signs.
    display : bool
        Displayed rather than in the line.

    Returns
    -------
    str
        A ``<math>`` element, well-formed XML.

    Raises
    ------
    ReportError
        If the LaTeX is not understood, an unknown command included.

    Examples
    --------
    >>> mathml(r"\alpha")
    '<math><mi>α</mi></math>'
    """
    from math_core import LatexError

    try:
        element: str = _converter().convert_with_local_state(tex, displaystyle=display)
    except LatexError as error:
        reason = " ".join(str(error).split())
        raise ReportError(f"the formula {tex!r} is not understood: {reason}") from None
    return _ENTITY.sub(lambda found: html.unescape(found.group()), element)


def math_font_file() -> Path:
    """Find the STIX Two Math font that the ``ziamath`` package ships."""
    spec = importlib.util.find_spec("ziamath")
    if spec is None or spec.origin is None:
        raise ReportError(
            "the package ziamath, whose mathematics font the reports use, is missing; install it"
        )
    return Path(spec.origin).parent / "fonts" / "STIXTwoMath-Regular.ttf"


def embedded_math_font(elements: Iterable[str]) -> str:
    """Make the ``@font-face`` rule with the glyphs that some MathML needs, and no more.

    Parameters
    ----------
    elements : iterable of str
        The MathML elements of the page.

    Returns
    -------
    str
        A CSS rule for the family "Report Math" with the font inside; the same text gives the same bytes.
    """
    return _font_rule("".join(sorted(_characters(elements))))


def _characters(elements: Iterable[str]) -> set[str]:
    used = set("0123456789()[]{}|.,+−=<> ")
    for element in elements:
        used.update(html.unescape(re.sub(r"<[^>]*>", "", element)))
        if "<msqrt" in element or "<mroot" in element:
            used.add("√")
        used.update(_italic(letter) for letter in _SINGLE_IDENTIFIER.findall(element))
    return used


def _italic(letter: str) -> str:
    """Give the mathematical italic letter in which a browser shows a lone ``<mi>``."""
    if letter == "h":
        return "\N{PLANCK CONSTANT}"
    try:
        name = unicodedata.name(letter)
        if "LATIN" in name and letter.isascii():
            case = "CAPITAL" if letter.isupper() else "SMALL"
            return unicodedata.lookup(f"MATHEMATICAL ITALIC {case} {letter.upper()}")
        return unicodedata.lookup("MATHEMATICAL ITALIC " + name.replace("GREEK ", "").replace("LETTER ", ""))
    except (KeyError, ValueError):
        return letter


@cache
def _font_rule(characters: str) -> str:
    from fontTools import subset
    from fontTools.ttLib import TTFont

    options = subset.Options()
    options.flavor = "woff"
    options.layout_features = ["ssty", "dtls", "kern", "flac"]
    options.notdef_outline = True
    options.recalc_timestamp = False
    options.drop_tables += ["DSIG"]
    font = TTFont(math_font_file(), recalcTimestamp=False)
    cutter = subset.Subsetter(options)
    cutter.populate(text=characters)
    cutter.subset(font)
    font.flavor = "woff"
    packed = io.BytesIO()
    font.save(packed)
    data = base64.b64encode(packed.getvalue()).decode("ascii")
    source = f'url("data:font/woff;base64,{data}") format("woff")'
    return f'@font-face {{ font-family: "Report Math"; src: {source}; }}'
