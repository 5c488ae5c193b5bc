import json
import os
import signal
import socket
import subprocess
import sys
import time
import tracemalloc
import zlib
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from montecarlo_tasks import (
    AlwaysFails,
    BlasThreads,
    Changing,
    Dies,
    Logged,
    Named,
    Noise,
    Troubled,
)

from sysid.errors import SysidError, UsageError
from sysid.montecarlo import Runner, Study, Task
from sysid.montecarlo.checkpoints import CaseFiles, Identity
from sysid.montecarlo.runs import Chunk

HERE = Path(__file__).parent
CASE = "example-2/m4"


def table_bytes(runner: Runner, task: Task, n_runs: int = 150, case: str = CASE) -> bytes:
    study = runner.run(case, task, n_runs, seed=7)  # a temporary table lives as long as this name
    return study.path.read_bytes()


def direct(task, n_runs, seed=7, case=CASE):
    """Compute the runs with nothing but NumPy's documented way to spawn streams."""
    parent = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(case.encode()),))
    children = parent.spawn(n_runs)
    return pd.DataFrame([task(np.random.Generator(np.random.PCG64(child))) for child in children])


def free_port() -> int:
    with closing(socket.socket()) as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


# --- the numbers ----------------------------------------------------------------------------------------


def test_runs_draw_from_spawned_streams():
    study = Runner(jobs=1).run(CASE, Noise(), 50, seed=7)
    expected = direct(Noise(), 50)
    for name in study.columns:
        assert study.column(name).tobytes() == expected[name].to_numpy().tobytes()


@pytest.fixture(scope="module")
def reference() -> bytes:
    return table_bytes(Runner(jobs=1), Noise())


@pytest.mark.parametrize("backend", ["loky", "threading"])
@pytest.mark.parametrize(("jobs", "chunk"), [(1, 1), (1, 64), (2, None), (2, 13), (3, 150)])
def test_bits_do_not_depend_on_workers_or_chunks(reference, backend, jobs, chunk):
    assert table_bytes(Runner(jobs=jobs, backend=backend, chunk=chunk), Noise()) == reference


def test_bits_do_not_depend_on_the_order_of_cases(tmp_path):
    cases = ["a", "a/b", "b", CASE]
    runner = Runner(jobs=1, folder=tmp_path)
    forward = {case: table_bytes(runner, Noise(), 20, case) for case in cases}
    backward = {case: table_bytes(runner, Noise(), 20, case) for case in reversed(cases)}
    assert forward == backward
    assert len(set(forward.values())) == len(cases)


def test_a_run_can_be_replayed():
    study = Runner(jobs=1).run(CASE, Noise(), 20, seed=7)
    replayed = Runner().replay(CASE, Noise(), 13, seed=7)
    assert replayed == {name: study.column(name)[13] for name in study.columns}


def test_blas_has_one_thread_here_and_in_workers():
    for runner in (Runner(jobs=1), Runner(jobs=2, chunk=2), Runner(jobs=2, backend="threading", chunk=2)):
        study = runner.run("blas", BlasThreads(), 8, seed=1)
        assert study.column("libraries").min() >= 2  # NumPy's own and SciPy's own
        assert set(study.column("threads")) == {1.0}


# --- failures -------------------------------------------------------------------------------------------


def expected_failures(n_runs):
    failed = {}
    for run in range(n_runs):
        try:
            values = Runner().replay("troubled", Troubled(), run, seed=3)
        except (ValueError, ArithmeticError) as error:
            failed[run] = " ".join(f"{type(error).__name__}: {error}".split())
        else:
            assert np.isfinite(values["a"])
    return failed


def test_failed_runs_are_counted_kept_and_left_out(capsys):
    study = Runner(jobs=2, chunk=9).run("troubled", Troubled(), 80, seed=3)
    failed = expected_failures(80)
    assert 10 < len(failed) < 70
    assert study.failed == len(failed)
    failures = list(study.failures())
    assert {failure.run: failure.message for failure in failures} == failed
    assert failures[0].seed == 3
    assert failures[0].spawn_key == (zlib.crc32(b"troubled"), failures[0].run)

    a, b = study.column("a"), study.column("b")
    assert len(a) == len(b) == 80 - study.failed
    assert study.undefined() == {"a": 0, "b": int(np.isnan(b).sum())}
    assert study.mean() == pytest.approx({"a": a.mean(), "b": np.nanmean(b)}, rel=1e-13)
    assert study.std() == pytest.approx({"a": a.std(ddof=1), "b": np.nanstd(b, ddof=1)}, rel=1e-13)
    np.testing.assert_array_equal(study.quantile("b", [0.1, 0.9]), np.nanquantile(b, [0.1, 0.9]))


def test_workers_print_nothing(capfd):
    Runner(jobs=2, chunk=9).run("troubled", Troubled(), 80, seed=3)
    lines = capfd.readouterr()
    # The first run or two are computed in this process, the other 78 in workers.
    assert lines.out.count("printed") <= 2
    assert lines.err.count("other stream") <= 2


def test_replay_raises_the_original_exception():
    runs = expected_failures(40)
    run = next(run for run, message in runs.items() if message.startswith("ValueError"))
    with pytest.raises(ValueError, match="no root\nnear"):
        Runner().replay("troubled", Troubled(), run, seed=3)
    run = next(run for run, message in runs.items() if message.startswith("ArithmeticError"))
    with pytest.raises(ArithmeticError, match="the value 'b' is inf"):
        Runner().replay("troubled", Troubled(), run, seed=3)


def test_a_study_in_which_every_run_fails_has_no_columns():
    study = Runner(jobs=1).run("hopeless", AlwaysFails(), 12, seed=0)
    assert (study.failed, study.columns, study.mean()) == (12, (), {})
    with pytest.raises(UsageError, match="every run failed"):
        study.column("a")


def test_a_task_must_return_the_same_columns_in_every_run():
    for chunk in (1, 200):
        with pytest.raises(UsageError, match=r"run \d+ of case 'c' returned the columns"):
            Runner(jobs=1, chunk=chunk).run("c", Changing(), 200, seed=1)


def test_a_dying_worker_ends_in_a_clear_error(tmp_path):
    with pytest.raises(SysidError, match="a worker process died in case 'dies'"):
        Runner(jobs=2, chunk=1, folder=tmp_path).run("dies", Dies(os.getpid()), 20, seed=1)


# --- checkpoints ----------------------------------------------------------------------------------------

CHILD = """
import sys
from pathlib import Path
from montecarlo_tasks import Logged
from sysid.montecarlo import Runner
if __name__ == "__main__":
    folder, log, jobs = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    Runner(jobs=jobs, folder=folder, chunk=5).run("killed/half-way", Logged(log, 0.01), 200, seed=5)
"""


def start_child(folder: Path, log: Path, jobs: int) -> "subprocess.Popen[bytes]":
    script = folder.parent / "study.py"
    script.write_text(CHILD)
    return subprocess.Popen(
        [sys.executable, str(script), str(folder), str(log), str(jobs)],
        env=dict(os.environ, PYTHONPATH=str(HERE)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        # Where the tests run in the background of a shell, Ctrl-C is ignored and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def wait_for_chunks(folder: Path, number: int) -> None:
    deadline = time.monotonic() + 60.0
    while len(list(folder.glob("*/chunk-*.parquet"))) < number:
        assert time.monotonic() < deadline
        time.sleep(0.005)


def finished_values(folder: Path) -> list[float]:
    tables = [pd.read_parquet(path) for path in folder.glob("*/chunk-*.parquet")]
    return [value for table in tables for value in table["value"]]


@pytest.mark.skipif(os.name == "nt", reason="needs POSIX signals")
@pytest.mark.parametrize("how", ["kill", "interrupt"])
def test_an_interrupted_study_resumes_with_the_same_bits(tmp_path, how):
    folder, log = tmp_path / "out", tmp_path / "log"
    child = start_child(folder, log, jobs=2)
    wait_for_chunks(folder, 8)
    if how == "kill":
        os.kill(child.pid, signal.SIGKILL)
    else:
        os.killpg(child.pid, signal.SIGINT)  # as the terminal does: to the parent and to its workers
    out, err = child.communicate(timeout=30)
    assert child.returncode != 0
    assert out == b""
    if how == "interrupt":
        assert err.count(b"Traceback") == 1  # the parent's own, as nothing caught it
        assert b"KeyboardInterrupt" in err
    time.sleep(0.2)  # orphaned workers finish the chunk they are at
    finished = finished_values(folder)
    assert 30 <= len(finished) < 200

    log.write_text("")
    study = Runner(jobs=2, folder=folder, resume=True, chunk=7).run(
        "killed/half-way", Logged(log, 0.01), 200, 5
    )
    recomputed = {float(line) for line in log.read_text().split()}
    assert len(recomputed) == 200 - len(finished)
    assert recomputed.isdisjoint(finished)
    fresh = Runner(jobs=1, folder=tmp_path / "fresh").run("killed/half-way", Logged(log, 0.0), 200, 5)
    np.testing.assert_array_equal(study.column("value"), fresh.column("value"))
    assert not list(folder.glob("*/"))  # only the table is left
    assert [path.name for path in folder.iterdir()] == ["killed~2fhalf-way.parquet"]


def interrupted(folder: Path, n_chunks: int, task: Task = Noise(), n_runs: int = 60) -> Runner:  # noqa: B008
    """Leave the first chunks of a study behind, as if it had been stopped."""

    class StopError(Exception):
        pass

    class StoppingRunner(Runner):
        def _chunks(self, *arguments):
            for index, chunk in enumerate(super()._chunks(*arguments)):
                if index == n_chunks:
                    raise StopError
                yield chunk

    with pytest.raises(StopError):
        StoppingRunner(jobs=1, folder=folder, chunk=10).run(CASE, task, n_runs, seed=7)
    return Runner(jobs=1, folder=folder, resume=True, chunk=8)


@pytest.fixture(scope="module")
def sixty() -> bytes:
    return table_bytes(Runner(jobs=1), Noise(), 60)


def test_resuming_writes_the_same_file(tmp_path, sixty):
    assert table_bytes(interrupted(tmp_path, 3), Noise(), 60) == sixty


@pytest.mark.parametrize("damage", ["truncate", "empty", "flip", "foreign"])
def test_a_damaged_chunk_is_computed_again(tmp_path, sixty, damage):
    runner = interrupted(tmp_path, 4)
    victim = sorted((tmp_path / "example-2~2fm4").iterdir())[2]
    content = bytearray(victim.read_bytes())
    if damage == "truncate":
        content = content[: len(content) // 2]
    elif damage == "empty":
        content = bytearray()
    elif damage == "flip":
        content[len(content) // 3] ^= 1
    else:
        content = bytearray(b"not a Parquet file")
    victim.write_bytes(content)
    (victim.parent / "123.tmp").write_bytes(b"half a chu")
    assert table_bytes(runner, Noise(), 60) == sixty
    assert not victim.parent.exists()


def test_a_damaged_table_is_computed_again(tmp_path, sixty):
    runner = Runner(jobs=1, folder=tmp_path, resume=True)
    path = runner.run(CASE, Noise(), 60, seed=7).path
    content = bytearray(path.read_bytes())
    content[200] ^= 1
    path.write_bytes(content)
    assert table_bytes(runner, Noise(), 60) == sixty


def test_a_finished_case_is_loaded_and_can_be_extended(tmp_path):
    log = tmp_path / "log"
    runner = Runner(jobs=1, folder=tmp_path / "out", resume=True)

    def computed(n_runs):
        log.write_text("")
        study = runner.run("c", Logged(log, 0.0), n_runs, seed=1)
        return study, len(log.read_text().split())

    first, number = computed(30)
    assert number == 30
    again, number = computed(30)
    assert number == 0
    assert again.mean() == first.mean()
    longer, number = computed(50)
    assert number == 20
    np.testing.assert_array_equal(longer.column("value")[:30], first.column("value"))
    shorter, number = computed(10)
    assert number == 0
    assert shorter.n_runs == len(shorter.column("value")) == 10
    np.testing.assert_array_equal(shorter.column("value"), first.column("value")[:10])
    assert shorter.quantile("value", [1.0])[0] == shorter.column("value").max()
    # The table still holds the fifty runs, and is what one longer study would have written.
    fresh = Runner(jobs=1, folder=tmp_path / "fresh").run("c", Logged(log, 0.0), 50, seed=1)
    assert longer.path.read_bytes() == fresh.path.read_bytes()


def test_fewer_runs_than_were_begun_keep_the_rest(tmp_path, sixty):
    runner = interrupted(tmp_path, 4)
    assert runner.run(CASE, Noise(), 5, seed=7).n_runs == 5
    assert table_bytes(runner, Noise(), 60) == sixty


@pytest.mark.parametrize("finished", [False, True])
@pytest.mark.parametrize(
    ("task", "seed", "named"),
    [
        (Noise(), 8, r"different seed \(7 then, 8 now\)"),
        (Noise(size=41), 7, "different settings or code of montecarlo_tasks.Noise"),
        (Troubled(), 7, "different task"),
    ],
)
def test_another_study_is_not_continued_but_replaced(tmp_path, finished, task, seed, named):
    runner = interrupted(tmp_path, 4)
    if finished:
        runner.run(CASE, Noise(), 60, seed=7)
    with pytest.raises(UsageError, match=named):
        runner.run(CASE, task, 60, seed=seed)
    replaced = Runner(jobs=1, folder=tmp_path).run(CASE, task, 60, seed=seed)
    fresh = Runner(jobs=1, folder=tmp_path / "fresh").run(CASE, task, 60, seed=seed)
    assert replaced.path.read_bytes() == fresh.path.read_bytes()
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["example-2~2fm4.parquet"]


def test_another_version_is_not_continued(tmp_path, monkeypatch):
    runner = interrupted(tmp_path, 4)
    monkeypatch.setattr("sysid.montecarlo.checkpoints.versions", lambda: "sysid 99")
    with pytest.raises(UsageError, match=r"different versions .*'sysid 99' now"):
        runner.run(CASE, Noise(), 60, seed=7)


def test_the_table_tells_its_origin(tmp_path):
    study = Runner(jobs=1, folder=tmp_path).run(CASE, Noise(), 10, seed=7)
    table = pd.read_parquet(study.path)
    assert list(table.columns) == ["run", "failed", "message", "mean", "std", "slope"]
    assert table["run"].tolist() == list(range(10))
    assert (table.dtypes[["mean", "std", "slope"]] == np.float64).all()
    import pyarrow.parquet as pq

    origin = json.loads(pq.read_schema(study.path).metadata[b"sysid.study"])
    assert (origin["case"], origin["seed"], origin["task"]) == (CASE, 7, "montecarlo_tasks.Noise")
    assert "numpy" in origin["versions"]
    loaded = Study.load(study.path)
    assert (loaded.case, loaded.seed, loaded.mean()) == (study.case, study.seed, study.mean())


def test_a_temporary_folder_ends_with_its_study(tmp_path, monkeypatch):
    import tempfile

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    study = Runner(jobs=1).run(CASE, Noise(), 10, seed=7)
    assert study.path.exists()
    del study
    assert not list(tmp_path.glob("sysid-*"))
    with pytest.raises(UsageError):
        Runner(jobs=1).run(CASE, Named(), 10, seed=7)
    assert not list(tmp_path.glob("sysid-*"))


# --- the summary ----------------------------------------------------------------------------------------


def test_summary_agrees_with_numpy():
    study = Runner(jobs=1).run(CASE, Noise(), 300, seed=7)
    values = study.column("std")
    row = study.summary({"std": 1.0}, {"std": 0.1})["std"]
    expected = {
        "true": 1.0,
        "mean": values.mean(),
        "bias": values.mean() - 1.0,
        "bias_std_error": values.std(ddof=1) / np.sqrt(300),
        "std": values.std(ddof=1),
        "rmse": np.sqrt(np.mean((values - 1.0) ** 2)),
        "q025": np.quantile(values, 0.025),
        "q975": np.quantile(values, 0.975),
        "crlb_std": 0.1,
        "efficiency": 0.01 / values.var(ddof=1),
    }
    assert row == pytest.approx(expected, rel=1e-12)
    assert list(row) == list(expected)
    both = np.cov(study.column("std"), study.column("mean"))
    np.testing.assert_allclose(study.covariance(["std", "mean"]), both, rtol=1e-12)
    assert study.covariance().shape == (3, 3)
    assert study.standard_error()["std"] == row["bias_std_error"]


def test_summary_has_none_where_a_figure_is_not_defined():
    study = Runner(jobs=1).run(CASE, Noise(), 1, seed=7)
    row = study.summary({"mean": 0.0}, {"mean": 0.1})["mean"]
    assert row["std"] is row["bias_std_error"] is row["efficiency"] is None
    assert row["rmse"] == abs(row["bias"])
    assert row["crlb_std"] == 0.1
    json.dumps(row, allow_nan=False)
    with pytest.raises(UsageError, match=r"no column 'alpha'; its columns are: mean, std, slope"):
        study.summary({"alpha": 1.0})


# --- options, memory, compiled kernels ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"jobs": 0}, "number of jobs is 0"),
        ({"backend": "ray"}, "no backend 'ray'; choose one of loky, threading, dask"),
        ({"scheduler": "tcp://127.0.0.1:1"}, "goes with the backend 'dask', not 'loky'"),
        ({"chunk": 0}, "chunk is 0 runs"),
        ({"resume": True}, "name the folder"),
    ],
)
def test_options_are_checked(options, message):
    with pytest.raises(UsageError, match=message):
        Runner(**options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("c", Noise(), 0, 1), "case 'c' has 0 runs"),
        (("c", Noise(), 5, -1), "seed -1 of case 'c' is negative"),
        (("", Noise(), 5, 1), "id of a case is empty"),
        (("c", Named(), 5, 1), "column 'run', a name that the table of runs needs"),
    ],
)
def test_arguments_are_checked(arguments, message):
    with pytest.raises(UsageError, match=message):
        Runner(jobs=1).run(*arguments)
    with pytest.raises(UsageError, match="the run -1"):
        Runner().replay("c", Noise(), -1, seed=1)


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"the folder .*file cannot hold the runs of case 'c'"):
        Runner(jobs=1, folder=tmp_path / "file").run("c", Noise(), 5, seed=1)


@pytest.mark.parametrize("case", ["../up", "..", "a b", "ä", "~2f", "a/b", "a~2fb"])
def test_case_ids_make_safe_and_different_file_names(tmp_path, case):
    study = Runner(jobs=1, folder=tmp_path).run(case, Noise(), 2, seed=1)
    assert study.path.parent == tmp_path
    assert study.path.name.isascii()
    assert not study.path.name.startswith(".")
    assert case == "a/b" or study.path.stem != "a~2fb"


def test_memory_does_not_grow_with_the_runs(tmp_path, monkeypatch):
    import pyarrow as pa

    pool = pa.proxy_memory_pool(pa.default_memory_pool())  # counts what Arrow holds, which tracemalloc misses
    usual = pa.default_memory_pool()
    identity = Identity("many", 1, "task", "fingerprint", "versions")
    files = CaseFiles(tmp_path, identity, durable=False)
    rng = np.random.default_rng(1)
    tracemalloc.start()
    pa.set_memory_pool(pool)
    try:
        for start in range(0, 200_000, 1000):
            files.save(Chunk(start, ("a", "b", "c", "d"), rng.normal(size=(1000, 4)), (None,) * 1000))
        files.assemble(200_000)
        study = Study.load(files.table)
        row = study.summary({"a": 0.0})["a"]
        ours, arrows = tracemalloc.get_traced_memory()[1], pool.max_memory()
    finally:
        pa.set_memory_pool(usual)
        tracemalloc.stop()
    # The runs take 8 MB as numbers, and far more as Python objects. A row group has 0.8 MB, held a few
    # times over while it is put together; the quantiles have histograms of 0.5 MB.
    assert study.n_runs == 200_000
    assert ours < 5e6
    assert arrows < 5e6
    assert row["q975"] == np.quantile(study.column("a"), 0.975)


KERNEL = """
import os, sys
from montecarlo_tasks import Compiled
from sysid.montecarlo import Runner
if __name__ == "__main__":
    study = Runner(jobs=2, chunk=2).run("kernel", Compiled(os.getpid()), 12, seed=1)
    here = study.column("in_parent") == 1.0
    print(int(here.sum()), int((~here).sum()), int(study.column("cache_hits")[~here].min()))
"""


def test_workers_load_compiled_kernels_from_the_cache(tmp_path):
    script = tmp_path / "study.py"
    script.write_text(KERNEL)
    environment = dict(os.environ, PYTHONPATH=str(HERE), NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    process = subprocess.run(
        [sys.executable, str(script)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    here, in_workers, fewest_hits = map(int, process.stdout.split())
    assert (here, in_workers) == (2, 10)
    assert fewest_hits == 1  # no worker compiled
    assert len(list((tmp_path / "cache").rglob("*.nbc"))) == 1


def test_progress_counts_runs():
    import io

    from sysid.progress import progress

    stream = io.StringIO()
    with progress(True, stream=stream, delay=0.1) as bars:
        Runner(jobs=1, chunk=5, progress=bars).run("saturation", Noise(seconds=0.01), 60, seed=1)
    assert "saturation" in stream.getvalue()
    assert "/60" in stream.getvalue()


# --- Dask -----------------------------------------------------------------------------------------------


def start_dask(module: str, *arguments: str, folder: Path) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.{module}", *arguments],
        env=dict(os.environ, PYTHONPATH=str(HERE)),
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def start_worker(address: str, folder: Path) -> "subprocess.Popen[bytes]":
    options = ["--no-nanny", "--nthreads", "1", "--host", "127.0.0.1", "--no-dashboard"]
    return start_dask("dask_worker", address, *options, "--local-directory", str(folder), folder=folder)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler and two workers, each a process of its own."""
    folder = tmp_path_factory.mktemp("dask")
    port = str(free_port())
    address = f"tcp://127.0.0.1:{port}"
    options = ["--host", "127.0.0.1", "--port", port, "--dashboard-address", "127.0.0.1:0", "--no-show"]
    processes = [start_dask("dask_scheduler", *options, folder=folder)]
    processes += [start_worker(address, folder) for _ in range(2)]
    wait_for_workers(address, 2)
    yield address, processes, folder
    for process in reversed(processes):
        process.kill()
        process.wait(timeout=20)


def wait_for_workers(address: str, number: int) -> None:
    from distributed import Client

    deadline = time.monotonic() + 60.0
    while True:
        try:
            with Client(address, timeout=2.0, set_as_default=False) as client:
                client.wait_for_workers(number, timeout=30)
            return
        except OSError:
            assert time.monotonic() < deadline
            time.sleep(0.2)


def test_dask_gives_the_same_bits(cluster, reference):
    with Runner(backend="dask", scheduler=cluster[0], chunk=13) as runner:
        assert table_bytes(runner, Noise()) == reference
        assert table_bytes(runner, Noise()) == reference  # over the same connection


def test_blas_has_one_thread_in_dask_workers(cluster):
    with Runner(backend="dask", scheduler=cluster[0], chunk=2) as runner:
        study = runner.run("blas", BlasThreads(), 12, seed=1)
    assert study.column("libraries").min() >= 2
    assert set(study.column("threads")) == {1.0}


def test_a_lost_dask_worker_loses_nothing(cluster):
    address, processes, folder = cluster
    killed = []

    class KillingRunner(Runner):
        def _chunks(self, *arguments):
            for index, chunk in enumerate(super()._chunks(*arguments)):
                if index == 6:
                    processes[-1].kill()
                    killed.append(processes[-1].wait(timeout=10))
                yield chunk

    with KillingRunner(backend="dask", scheduler=address, chunk=5) as runner:
        study = runner.run(CASE, Noise(seconds=0.01), 150, seed=7)
    assert killed == [-signal.SIGKILL]
    expected = direct(Noise(), 150)
    for name in study.columns:
        assert study.column(name).tobytes() == expected[name].to_numpy().tobytes()
    processes[-1] = start_worker(address, folder)
    wait_for_workers(address, 2)


def test_a_task_that_dask_workers_cannot_import_is_named(cluster, tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text("def task(rng):\n    return {'a': 1.0}\n")
    monkeypatch.syspath_prepend(tmp_path)
    import only_here

    with (
        Runner(backend="dask", scheduler=cluster[0]) as runner,
        pytest.raises(SysidError, match=r"only_here.*install the task's module"),
    ):
        runner.run("c", only_here.task, 20, seed=1)


def test_dask_workers_of_another_version_are_refused(cluster, monkeypatch):
    monkeypatch.setattr("importlib.metadata.version", lambda name: "99")  # here, not in the workers
    with pytest.raises(UsageError, match=r"the Dask worker tcp://.* where this process has sysid 99"):
        Runner(backend="dask", scheduler=cluster[0]).run("c", Noise(), 20, seed=1)


def test_a_lost_scheduler_ends_in_a_clear_error(cluster, tmp_path):
    """The last test of this cluster."""
    address, processes, _ = cluster

    class KillingRunner(Runner):
        def _chunks(self, *arguments):
            for index, chunk in enumerate(super()._chunks(*arguments)):
                if index == 6:
                    processes[0].kill()
                yield chunk

    with (
        KillingRunner(backend="dask", scheduler=address, chunk=5, folder=tmp_path) as runner,
        pytest.raises(SysidError, match=r"cannot compute case .* the finished runs are kept"),
    ):
        runner.run(CASE, Noise(seconds=0.01), 500, seed=7)
    assert len(list(tmp_path.glob("*/chunk-*"))) >= 6


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:{port}", "127.0.0.1:{port}"])
def test_a_scheduler_that_does_not_answer_is_named(address, monkeypatch, caplog):
    monkeypatch.setattr("sysid.montecarlo.backends.CONNECT_SECONDS", 0.5)
    address = address.format(port=free_port())
    with pytest.raises(UsageError, match=f"no Dask scheduler answers at '{address}'"):
        Runner(backend="dask", scheduler=address).run("c", Noise(), 20, seed=1)


def test_missing_dask_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"needs the package dask\[distributed\]"):
        Runner(backend="dask").run("c", Noise(), 20, seed=1)


@pytest.mark.slow
def test_without_an_address_a_local_dask_cluster_is_used(reference):
    with Runner(jobs=1, backend="dask") as runner:
        assert table_bytes(runner, Noise()) == reference
