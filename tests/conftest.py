"""Settings shared by all tests."""

import os

import pytest
from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "agg")
# Examples are found anew on a developer's machine; in CI they are the same in every run.
settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("developer", deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "developer")


@pytest.fixture
def records():
    """Folder of the measured records; tests that need it skip where there is none."""
    folder = os.environ.get("SYSID_DATA")
    if not folder:
        pytest.skip("SYSID_DATA names no folder of measured records")
    from pathlib import Path

    return Path(folder)
