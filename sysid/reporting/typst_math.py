"""MathML to Typst's mathematics markup, so that PDF and HTML show the same reading of one LaTeX source."""

from __future__ import annotations

import re
from xml.etree.ElementTree import Element, fromstring

from sysid.errors import ReportError

_OPENING = set("([{|‖⌈⌊⟨∣∥")
_CLOSING = set(")]}|‖⌉⌋⟩∣∥")
_NOTHING = "\N{INVISIBLE SEPARATOR}"
_INVISIBLE = {"\N{FUNCTION APPLICATION}", "\N{INVISIBLE TIMES}", "\N{INVISIBLE PLUS}", _NOTHING}
_PRIMES = {"′": "'", "″": "''", "‴": "'''"}
_BIG_OPERATORS = set("∑∏∐⋃⋂⨁⨂∫∬∭∮")
_ACCENTS = {
    "ˆ": "hat", "^": "hat", "̂": "hat",
    "¯": "macron", "‾": "overline", "̄": "macron", "̅": "overline", "―": "overline", "_": "overline",
    "˜": "tilde", "~": "tilde", "̃": "tilde",
    "˙": "dot", "̇": "dot", "¨": "dot.double", "̈": "dot.double",
    "→": "arrow", "⃗": "arrow", "ˇ": "caron", "˘": "breve", "´": "acute", "`": "grave",
    "̲": "overline", "⏞": "overbrace",
}  # fmt: skip
_BELOW = {"⏟": "underbrace", "_": "underline", "̲": "underline", "‾": "underline", "―": "underline"}


def typst_math(element: str) -> str:
    """Translate one ``<math>`` element into Typst math markup (without the dollar signs).

    Parameters
    ----------
    element : str
        Well-formed MathML, as from ``sysid.reporting.mathematics.mathml``.

    Returns
    -------
    str
        Markup for Typst's ``eval(..., mode: "math")``; every letter of the source is escaped.

    Raises
    ------
    ReportError
        If the MathML holds a construct without a translation.

    Examples
    --------
    >>> typst_math("<math><mfrac><mi>a</mi><mn>2</mn></mfrac></math>")
    'frac(a,2)'
    """
    root = fromstring(element)
    children = list(root)
    if len(children) == 1 and children[0].tag == "mtable" and _is_aligned(children[0]):
        return " \\ ".join(_aligned_row(row) for row in children[0])
    return _row(children)


def _row(elements: list[Element]) -> str:
    parts: list[str] = []
    place = 0
    while place < len(elements):
        dots = _ellipsis(elements[place : place + 3])
        parts.append(dots or _translate(elements[place]))
        if len(elements) > place + 1 and _is_matrix(elements[place]) and _is_matrix(elements[place + 1]):
            parts.append("#h(0.17em)")  # or their parentheses touch
        place += 3 if dots else 1
    return _join(parts)


def _is_matrix(element: Element) -> bool:
    return element.tag == "mrow" and any(child.tag == "mtable" for child in element)


def _ellipsis(three: list[Element]) -> str:
    """Give the one sign for three dots in a row, which Typst would space like operators."""
    signs = "".join((element.text or "") if element.tag == "mo" else " " for element in three)
    return {"...": "…", "···": "⋯", "⋅⋅⋅": "⋯"}.get(signs, "")


def _join(parts: list[str]) -> str:
    """Set markup side by side; a space only where two words would run together.

    Typst shows the space beside quoted text, so none is written there.
    """
    line = ""
    for part in parts:
        if line and part and line[-1].isalnum() and part[0].isalnum():
            line += " "
        line += part
    return line


def _translate(element: Element) -> str:
    match element.tag:
        case "mi":
            return _identifier(element)
        case "mn":
            digits = element.text or ""
            return digits if re.fullmatch(r"[0-9]+(\.[0-9]+)?", digits) else _quoted(digits)
        case "mo":
            return _operator(element)
        case "mtext" | "ms":
            return _quoted(element.text or "")
        case "mspace":
            return _space(element.get("width"))
        case "mrow" | "mstyle" | "mpadded":
            return _group(list(element))
        case "mfrac":
            return _fraction(element)
        case "msqrt":
            return f"sqrt({_row(list(element))})"
        case "mroot":
            return f"root({_translate(element[1])},{_translate(element[0])})"
        case "msub" | "msup" | "msubsup":
            return _scripts(element)
        case "munder" | "mover" | "munderover":
            return _under_over(element)
        case "mtable":
            return _table(element)
    raise ReportError(
        f"the PDF cannot show the MathML construct <{element.tag}>; write the formula in other LaTeX"
    )


def _identifier(element: Element) -> str:
    name = (element.text or "").rstrip("\ufe00\ufe01")
    if len(name) > 1:
        return f"op({_quoted(name)})"
    if element.get("mathvariant") == "normal":
        return f"upright({_escaped(name)})"
    return _escaped(name)


def _operator(element: Element) -> str:
    sign = element.text or ""
    if sign in _INVISIBLE:
        return ""
    if sign in _PRIMES:
        return _escaped(sign)
    if len(sign) > 1:
        return f"op({_quoted(sign)})"
    if element.get("minsize"):
        return f"lr(size:#{element.get('minsize')},{_escaped(sign)})"
    if sign in "|‖∥" and element.get("form") in ("prefix", "postfix"):
        return f'class("{"opening" if element.get("form") == "prefix" else "closing"}",{_escaped(sign)})'
    if sign in "|‖∥":
        return f'class("normal",{_escaped(sign)})'
    return _escaped(sign)


def _space(width: str | None) -> str:
    found = re.fullmatch(r"(-?[0-9.]+)em", width or "")
    return f"#h({found[1]}em)" if found else ""


def _group(children: list[Element]) -> str:
    if len(children) < 2 or not (_fence(children[0]) and _fence(children[-1])):
        return _row(children)
    left, right = (child.text or "" for child in (children[0], children[-1]))
    if left not in _OPENING | {_NOTHING} or right not in _CLOSING | {_NOTHING}:
        return _row(children)
    ends = ["" if sign == _NOTHING else _escaped(sign) for sign in (left, right)]
    return f"lr({ends[0]}{_row(children[1:-1])}{ends[1]})"


def _fence(element: Element) -> bool:
    r"""Tell whether the sign grows with what it encloses (``\left``, ``\right``)."""
    return element.tag == "mo" and element.get("stretchy") != "false" and element.get("minsize") is None


def _fraction(element: Element) -> str:
    above, below = (_translate(child) for child in element)
    if element.get("linethickness") in ("0", "0px", "0pt"):
        return f"mat(delim:#none,{above};{below})"
    return f"frac({above},{below})"


def _scripts(element: Element) -> str:
    base = _base(element[0])
    below = _translate(element[1]) if element.tag != "msup" else ""
    above = element[-1] if element.tag != "msub" else None
    primes = _PRIMES.get(above.text or "") if above is not None and above.tag == "mo" else None
    options = [f"b:{below}"] if below else []
    if above is not None and primes is None:
        options.append(f"t:{_translate(above)}")
    attached = f"attach({','.join([base, *options])})" if options else base
    return attached + (primes or "")


def _base(element: Element) -> str:
    translated = _translate(element)
    if element.tag == "mo" and (element.text or "") in _BIG_OPERATORS:
        return f"scripts({translated})"
    return translated or '""'


def _under_over(element: Element) -> str:
    base, marks = element[0], list(element)[1:]
    sign = (marks[0].text or "") if marks[0].tag == "mo" else ""
    if element.tag == "mover" and sign in _ACCENTS:
        return f"{_ACCENTS[sign]}({_translate(base)})"
    if element.tag == "munder" and sign in _BELOW:
        return f"{_BELOW[sign]}({_translate(base)})"
    if base.tag in ("munder", "mover") and len(base) == 2 and base[1].text in ("⏟", "⏞"):
        return f"{_translate(base)[:-1]},{_translate(marks[0])})"
    options = []
    if element.tag != "mover":
        options.append(f"b:{_translate(marks[0])}")
    if element.tag != "munder":
        options.append(f"t:{_translate(marks[-1])}")
    return f"attach(limits({_translate(base)}),{','.join(options)})"


def _is_aligned(table: Element) -> bool:
    return table.get("displaystyle") == "true"


def _aligned_row(row: Element) -> str:
    return "&".join(_row(list(cell)) for cell in row)


def _table(table: Element) -> str:
    if _is_aligned(table):  # equations aligned inside another formula
        rows = ["&".join(f"display({_row(list(cell))})" for cell in row) for row in table]
        return f"mat(delim:#none,{';'.join(rows)})"
    styles = [cell.get("style", "") for row in table for cell in row]
    align = "align:#left," if styles and all("text-align: left" in style for style in styles) else ""
    rows = [",".join(_row(list(cell)) for cell in row) for row in table]
    return f"mat(delim:#none,{align}{';'.join(rows)})"


def _quoted(words: str) -> str:
    escaped = words.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _escaped(sign: str) -> str:
    return "".join(f"\\{char}" if char.isascii() and not char.isalnum() else char for char in sign)
