"""A validation report is the same to the last bit, with one worker, several, or a Dask cluster."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

import numpy as np
import pytest

from sampling_design import validate
from sampling_design.records.file_io import to_json
from tests.validation.plants import PLANTS, SCHEDULES, certificate


@contextmanager
def dask_client():
    """A local cluster with two workers, without dashboard and without time limits that a busy machine breaks."""
    import dask
    from distributed import Client, LocalCluster

    quiet = {"distributed.comm.timeouts.connect": "60s", "distributed.admin.system-monitor.gil.enabled": False}
    shape = {"n_workers": 2, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with dask.config.set(quiet), LocalCluster(**shape) as cluster, Client(cluster) as client:
        yield client


@contextmanager
def processes():
    with ProcessPoolExecutor(2, mp_context=get_context("forkserver")) as pool:
        yield pool


def report(workers):
    name = "oscillator"
    found = validate(
        PLANTS[name],
        SCHEDULES[name],
        certificate(name),
        runs=150,
        duration=15.0,
        scenarios=["random", "paper"],
        rng=np.random.default_rng(11),
        workers=workers,
    )
    assert found.passed
    return to_json(found.to_dict())


@pytest.fixture(scope="module")
def alone():
    return report(None)


def test_threads(alone):
    with ThreadPoolExecutor(3) as pool:
        assert report(pool) == alone


@pytest.mark.long
def test_processes(alone):
    with processes() as pool:
        assert report(pool) == alone


@pytest.mark.long
def test_joblib_backends(alone):
    assert report("threading") == alone
    assert report(1) == alone


def test_a_dask_cluster(alone):
    with dask_client() as client:
        assert report(client) == report(client.get_executor()) == alone
