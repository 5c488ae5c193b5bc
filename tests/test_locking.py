"""One writer a folder."""

import os
import subprocess
import sys

import pytest

from sysid.errors import UsageError
from sysid.locking import only_writer

HOLD = """
import sys
from pathlib import Path
from sysid.locking import only_writer
with only_writer(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_writer_is_refused_until_the_first_ends_even_when_killed(tmp_path):
    pytest.importorskip("fcntl", reason="folders cannot be locked on this platform")
    folder = tmp_path / "new" / "out"
    command = [sys.executable, "-c", HOLD, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout.readline() == "held\n"
        with pytest.raises(UsageError, match="another process writes into the folder"), only_writer(folder):
            pass
        first.kill()
    with only_writer(folder):
        pass
    assert list(folder.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    with (
        pytest.raises(UsageError, match=r"file/out cannot be written \(Not a directory\): name a folder"),
        only_writer(tmp_path / "file" / "out"),
    ):
        pass
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(UsageError, match=r"cannot be written \(no permission\)"), only_writer(tmp_path):
        pass
