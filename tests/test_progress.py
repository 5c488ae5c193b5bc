import io
import os
import subprocess
import sys
import threading
import time

import pytest

from sysid.progress import progress

WORK = """
import sys, time
from sysid.progress import progress
with progress(delay=0.2) as bars, bars.task("relay", total=4) as task:
    for _ in range(int(sys.argv[1])):
        time.sleep(0.2)
        task.advance()
print("done")
"""


def test_off_a_terminal_nothing_is_written():
    stream = io.StringIO()
    with progress(stream=stream, delay=0.0) as bars, bars.task("runs", total=2) as task:
        task.advance(2)
        time.sleep(0.05)
    assert stream.getvalue() == ""


def test_short_work_does_not_flicker():
    stream = io.StringIO()
    with progress(True, stream=stream, delay=60.0) as bars, bars.task("runs", total=2) as task:
        task.advance(2)
    assert "runs" not in stream.getvalue()


def wait_for(stream, text):
    deadline = time.monotonic() + 20.0
    while text not in stream.getvalue():
        assert time.monotonic() < deadline, stream.getvalue()
        time.sleep(0.02)


def test_longer_work_shows_count_share_and_remaining_time_from_several_threads():
    stream = io.StringIO()
    with progress(True, stream=stream, delay=0.05) as bars, bars.task("saturation", total=200) as task:
        threads = [threading.Thread(target=lambda: [task.advance() for _ in range(25)]) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        wait_for(stream, "100/200")
    shown = stream.getvalue()
    assert "saturation" in shown
    assert "50%" in shown


def test_a_failure_inside_the_block_closes_the_bars():
    stream = io.StringIO()

    def fail():
        with progress(True, stream=stream, delay=0.0) as bars, bars.task("runs", total=2):
            wait_for(stream, "0/2")
            raise KeyError("lost")

    with pytest.raises(KeyError):
        fail()
    written = stream.getvalue()
    time.sleep(0.4)
    assert stream.getvalue() == written  # nothing draws any more
    assert not [t for t in threading.enumerate() if isinstance(t, threading.Timer) and t.is_alive()]


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
@pytest.mark.parametrize(("steps", "expected"), [("4", True), ("0", False)])
def test_on_a_terminal_the_bars_go_to_standard_error(steps, expected):
    import pty

    parent, child = pty.openpty()
    command = [sys.executable, "-c", WORK, steps]
    environment = dict(os.environ, TERM="xterm")
    process = subprocess.run(command, stdout=subprocess.PIPE, stderr=child, env=environment, check=True)
    os.close(child)
    written = b""
    try:
        while block := os.read(parent, 65536):
            written += block
    except OSError:  # the end of a pseudo-terminal's output on Linux
        pass
    os.close(parent)
    assert process.stdout == b"done\n"
    assert (b"relay" in written) is expected
