"""A Dask cluster does all jobs, whatever becomes of its workers, and leaves what others would."""

import os
from types import SimpleNamespace
from typing import Any

import fake_worker
import pytest
from batches import contents, jobs_file, without_times
from command_line import refused, run
from jobs_files import chunks_of
from shots import pull

from defocus_core import InputError
from defocus_core.batch.workers import dask_pool

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster():
    """The address of a cluster of processes that listens on this machine alone."""
    settings = {"distributed.scheduler.allowed-failures": 1, "distributed.comm.retry.count": 0}
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with (
        pytest.importorskip("dask").config.set(settings),
        distributed.LocalCluster(host="127.0.0.1", silence_logs=50, **options) as started,
    ):
        yield started.scheduler_address


def results_of(address, folder, *names, size=1, stopped=lambda: False):
    results: dict[int, Any] = {}

    def done(number, result):
        assert number not in results, "told twice"
        results[number] = result

    execute = dask_pool.execute_at(address, threads=None)
    execute(chunks_of(folder, *names, size=size), done, stopped)
    return results


def test_jobs_of_a_worker_that_was_killed_are_done_by_another(cluster, tmp_path, monkeypatch):
    assert cluster.startswith("tcp://127.0.0.1:")
    monkeypatch.setattr(dask_pool, "do", fake_worker.do)
    names = [*"abcde", "once", *(f"slow{i}" for i in range(8))]
    results = results_of(cluster, tmp_path, *names)
    assert [results[i].name for i in range(len(names))] == names


def test_a_job_that_kills_its_workers_has_failed_and_no_other_has(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_pool, "do", fake_worker.do)
    results = results_of(cluster, tmp_path, "a", "deadly", "b", size=3)
    assert [results[i].status for i in range(3)] == ["ok", "failed", "ok"]
    assert results[1].reason == "worker-died"


@pytest.mark.parametrize(
    ("work", "words"),
    [
        (
            fake_worker.do_in_another_version,
            r"its workers have defocus 0\.0\.1, renderer 1, but here is",
        ),
        (fake_worker.cannot_do, "cannot do jobs: ModuleNotFoundError: No module named 'torch'"),
    ],
)
def test_workers_that_are_not_alike_are_refused(work, words, cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_pool, "do", work)
    with pytest.raises(InputError, match=words):
        results_of(cluster, tmp_path, "a")


def test_nothing_new_is_begun_when_stopped(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_pool, "do", fake_worker.do)
    assert results_of(cluster, tmp_path, "a", "b", stopped=lambda: True) == {}


def test_nobody_waits_for_workers_without_knowing(tmp_path, caplog):
    scheduler = SimpleNamespace(address="tcp://head:8786")
    client: Any = SimpleNamespace(
        scheduler=scheduler,
        scheduler_info=lambda n_workers: {"workers": {}},
        submit=lambda *_, key, **__: key,
    )
    cluster = dask_pool._Cluster(client, set(), None)
    for chunk in chunks_of(tmp_path, "a", "b", "c"):
        if cluster.has_room():
            cluster.submit(chunk)
    assert len(cluster.futures) == dask_pool.AT_ONCE
    own = [each.getMessage() for each in caplog.records if each.name.startswith("defocus")]
    assert own == ["tcp://head:8786: has no workers; waiting for some"]


def test_a_scheduler_that_does_not_answer_is_told_of(tmp_path, out, monkeypatch):
    monkeypatch.setattr(dask_pool, "CONNECT", "0.2s")
    ran = run("batch", jobs_file(tmp_path), "-o", out, "--scheduler", "tcp://127.0.0.1:9")
    refused(ran, 3, "unreachable", "127.0.0.1:9")


@pytest.mark.parametrize("made", [jobs_file, pull], ids=["pictures", "shot"])
def test_dask_makes_the_same_bytes_and_the_same_journal(made, tmp_path, out):
    path = made(tmp_path)
    for file in tmp_path.glob("*.exr"):
        os.utime(file, (0, 0))  # a time that is relied on
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(
        host="127.0.0.1", protocol="tcp", processes=False, silence_logs=50, **options
    ) as threads:
        ran = run("batch", path, "-o", out, "--scheduler", threads.scheduler_address)
    assert ran.code == 0, ran.err
    run("batch", path, "-o", tmp_path / "here")
    assert contents(out) == contents(tmp_path / "here")
    assert without_times(out) == without_times(tmp_path / "here")


@pytest.mark.parametrize("work", [fake_worker.do_elsewhere, fake_worker.do_elsewhere_beside_a_copy])
def test_workers_that_have_another_out_are_refused(work, cluster, tmp_path, out, monkeypatch):
    monkeypatch.setattr(dask_pool, "do", work)
    monkeypatch.setattr(dask_pool, "SEEN", 0.3)
    ran = run("batch", jobs_file(tmp_path), "-o", out, "--scheduler", cluster)
    refused(ran, 3, "not-found", out)
    assert "is another folder on the Dask worker tcp://127.0.0.1" in ran.err
    assert not (out / "metadata.jsonl").exists()
