"""Names that may stand in an equation."""

import re

from sysid.errors import ModelError
from sysid.physics.expressions import FUNCTIONS

LONGEST = 40
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def checked_name(name: str, kind: str) -> str:
    """Return a name that may stand in an equation; ModelError if it may not."""
    if not _NAME.fullmatch(name) or len(name) > LONGEST:
        raise ModelError(
            f"{kind}.{name}: a name is a letter followed by letters, digits and _, at most {LONGEST}"
        )
    if name in FUNCTIONS:
        raise ModelError(f"{kind}.{name}: is the name of a function: rename it")
    return name
