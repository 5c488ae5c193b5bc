"""A sealed truth: not to be read by accident, not to be changed unseen."""

import base64
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sysid.errors import DataError

_HEADING = "sealed"


def seal(truth: Mapping[str, Any], path: Path) -> str:
    """Write a truth so that it cannot be read at a glance.

    This keeps a secret from the eye, not from an attacker: the key is in the file.

    Parameters
    ----------
    truth : mapping
        Plain values.
    path : Path

    Returns
    -------
    str
        Fingerprint: the first 16 digits of the SHA-256 of the truth, known before it is revealed.
    """
    plain = json.dumps(truth, sort_keys=True).encode()
    digest = hashlib.sha256(plain).hexdigest()
    hidden = base64.b64encode(_masked(plain, digest)).decode()
    path.write_text(f"{_HEADING} {digest}\n{hidden}\n", encoding="ascii")
    return digest[:16]


def reveal(path: Path) -> tuple[dict[str, Any], str]:
    """Read a sealed truth.

    Parameters
    ----------
    path : Path

    Returns
    -------
    truth : dict
    fingerprint : str
        As it was when the truth was sealed.

    Raises
    ------
    DataError
        If the file is missing, is none of `seal`'s, or was changed.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     mark = seal({"effect": "backlash"}, Path(folder) / "truth.sealed")
    ...     reveal(Path(folder) / "truth.sealed") == ({"effect": "backlash"}, mark)
    True
    """
    try:
        heading, hidden = path.read_text(encoding="ascii").split("\n")[:2]
        word, digest = heading.split()
        plain = _masked(base64.b64decode(hidden, validate=True), digest)
    except FileNotFoundError:
        raise DataError(f"{path} is not there; `sysid demo --out {path.parent}` makes one.") from None
    except (ValueError, OSError):
        raise DataError(f"{path} is not a sealed truth; `sysid demo` makes one.") from None
    if word != _HEADING or hashlib.sha256(plain).hexdigest() != digest:
        raise DataError(f"{path} was changed after it was sealed; make a new record by `sysid demo`.")
    return json.loads(plain), digest[:16]


def _masked(content: bytes, key: str) -> bytes:
    """Combine the content with a stream of hashes of the key; twice gives the content back."""
    blocks = -(-len(content) // 32)
    stream = b"".join(hashlib.sha256(f"{key} {block}".encode()).digest() for block in range(blocks))
    return bytes(a ^ b for a, b in zip(content, stream, strict=False))
