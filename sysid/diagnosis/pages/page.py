"""The comparison as one self-contained HTML page."""

import base64
import re
from importlib.resources import files
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from markupsafe import Markup

    from sysid.diagnosis.pages.content import Content

OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


def render(content: "Content") -> str:
    """Return the page.

    It holds its style sheet and its figures, needs no script, and loads nothing from elsewhere.

    Parameters
    ----------
    content : Content

    Returns
    -------
    str
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("sysid.diagnosis.pages", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(tied=_tied, breakable=_breakable, embedded=_embedded)
    return environment.get_template("compare.html").render(
        css=files("sysid.reporting").joinpath("page.css").read_text(encoding="utf-8"), content=content
    )


def _tied(text: str) -> "Markup":
    """Keep numbers beside their % and ±, and an option of the command line in one piece."""
    from markupsafe import Markup, escape

    escaped = str(escape(text)).replace(" %", "\N{NO-BREAK SPACE}%").replace("± ", "±\N{NO-BREAK SPACE}")
    return Markup(OPTION.sub(r'<code class="option">\g<0></code>', escaped))  # every other mark is escaped


def _breakable(text: str) -> "Markup":
    """Let a name of a table's cell go on in the next line after its underscore, so that a phone has room."""
    from markupsafe import Markup

    return Markup(str(_tied(text)).replace("_", "_<wbr>"))


def _embedded(svg: str) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(svg.encode("utf-8")).decode("ascii")
