"""Work that a kill interrupts is finished, and what was done before is not done again; the result is the same bits."""

import json
import os
import subprocess
import sys
import time
from base64 import b64encode
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from importlib import import_module
from types import MappingProxyType

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.checkers.strict import a_table
from sampling_design.cli.options import workforce
from sampling_design.errors import ArgumentError, FileFormatError, MissingExtraError, SolverError
from sampling_design.records import sweeps
from sampling_design.records import workers as workforces
from sampling_design.records.sweeps import Journal, digest_of, sweep
from sampling_design.validation import monte_carlo
from tests.cases import few

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], time_unit="s")
SCHEDULES = {f"{h}": sd.PeriodicSchedule([h, 0.7], time_unit="s") for h in (0.5, 0.9, 1.4)}
QUESTION = partial(sd.window_sigma, PLANT, window=5.0)


class Breaking(ThreadPoolExecutor):
    """An executor that breaks after so many jobs, as a pool of processes does when one is killed."""

    def __init__(self, whole):
        super().__init__(1)
        self.whole = whole

    def submit(self, function, /, *args):
        self.whole -= 1
        if self.whole == -1:
            raise BrokenProcessPool("killed")
        if self.whole < 0:
            lost = Future()
            lost.set_exception(BrokenProcessPool("killed"))
            return lost
        return super().submit(function, *args)


class Cluster(Executor):
    """A Dask client and its executor: jobs whose number stands in `fate` end as that says, later ones never."""

    def __init__(self, fate, workers=1, status="running"):
        self.fate, self.workers, self.status, self.given = fate, workers, status, 0
        self._client = self

    def get_executor(self):
        return self

    def close(self):
        self.status = "closed"

    def nthreads(self):
        if self.workers is None:
            raise OSError("gone")
        return {f"tcp://{k}": 1 for k in range(self.workers)}

    def submit(self, function, /, *args):
        fate, future = self.fate[self.given], Future()
        self.given += 1
        if fate == "closed":
            self.status = "closed"
            raise RuntimeError("cannot schedule new futures")
        if fate == "cancelled":
            future.cancel()
            future.set_running_or_notify_cancel()
        elif fate == "killed":
            future.set_exception(import_module("distributed").KilledWorker("job", None, 3))
        elif isinstance(fate, Exception):
            future.set_exception(fate)
        elif fate == "done":
            future.set_result(function(*args))
        return future


@pytest.mark.parametrize(
    ("fate", "workers", "told"),
    [
        (
            ["done", "cancelled", "cancelled"],
            1,
            "the Dask scheduler was lost, with 2 of 3 jobs left. What was finished is kept",
        ),
        (
            ["done", "closed", "done"],
            1,
            "the Dask scheduler was lost, with 3 of 3 jobs left. What was finished is kept",
        ),
        (
            ["done", "lasting", "lasting"],
            None,
            "the Dask scheduler was lost, with 2 of 3 jobs left. What was finished is kept",
        ),
        (
            ["done", "lasting", "done"],
            0,
            "the Dask cluster has had no worker for 0.1 s, with 1 of 3 jobs left. What was finished is kept",
        ),
        (
            ["killed", "done", "done"],
            1,
            "the jobs that are left killed every worker .* with 1 of 3 jobs left. What was finished is kept",
        ),
    ],
)
def test_a_cluster_that_dies_leaves_what_it_did(fate, workers, told, tmp_path, monkeypatch):
    monkeypatch.setattr(workforces, "PATIENCE", 0.01)
    monkeypatch.setattr(workforces, "LONGEST_WITHOUT", 0.1)
    path = tmp_path / "sweep.journal"
    with pytest.raises(SolverError, match=told):
        sweep(QUESTION, SCHEDULES, workers=Cluster(fate, workers), resume=path)
    done = 0 if "closed" in fate else fate.count("done")
    again = Cluster(["done"] * (3 - done))
    assert sweep(QUESTION, SCHEDULES, workers=again, resume=path).to_dict() == sweep(QUESTION, SCHEDULES).to_dict()
    assert again.given == 3 - done


def test_an_error_of_a_job_on_a_cluster_is_its_own():
    with pytest.raises(ZeroDivisionError, match="its own"):
        list(workforces.numbered(eval, ["1"], Cluster([ZeroDivisionError("its own")])))
    with pytest.raises(IndexError, match="list index out of range"):  # it cannot be sent
        list(workforces.numbered(eval, ["1"], Cluster([])))


@pytest.mark.long
@pytest.mark.parametrize("dies", ["scheduler", "workers"])
def test_a_real_cluster_that_dies_leaves_what_it_did(dies, monkeypatch, tmp_path):
    import distributed.cli.dask_scheduler
    import distributed.cli.dask_worker

    file = tmp_path / "scheduler.json"
    command = [sys.executable, "-m", distributed.cli.dask_scheduler.__name__, "--host", "127.0.0.1", "--port", "0"]
    started = [subprocess.Popen([*command, "--no-dashboard", "--scheduler-file", file], stderr=subprocess.DEVNULL)]
    command = [sys.executable, "-m", distributed.cli.dask_worker.__name__, "--no-nanny", "--nthreads", "1"]
    started.append(subprocess.Popen([*command, "--scheduler-file", file, "--no-dashboard"], stderr=subprocess.DEVNULL))
    try:
        client = distributed.Client(scheduler_file=str(file), timeout=60)
        while not client.nthreads():
            time.sleep(0.1)
        monkeypatch.setattr(workforces, "PATIENCE", 0.2)
        monkeypatch.setattr(workforces, "LONGEST_WITHOUT", 1.0)
        jobs, found = [f"(__import__('time').sleep(0.3), {k})[1]" for k in range(9)], []

        def keep(result):
            found.append(result)
            started[dies == "workers"].kill()

        with pytest.raises(SolverError, match=r"`workers`: the Dask (scheduler was lost|cluster has had no worker)"):
            list(map(keep, workforces.numbered(eval, jobs, client)))
        assert dict(found) == {k: k for k in range(len(found))}
        assert 0 < len(found) < 9
        client.close()
    finally:
        for process in started:
            process.kill()
            process.wait()


def test_processes_are_renewed(tmp_path):
    """Jobs are texts that `eval` does: new processes import nothing for them. The fourth kills its process once."""
    mark = str(tmp_path / "killed")
    lethal = f"9 if __import__('os').path.exists({mark!r}) else (open({mark!r}, 'w'), __import__('os')._exit(1))"
    jobs = ["0", "1", "2**2", lethal, "4**2", "5**2"]
    assert dict(workforces.numbered(eval, jobs, 2)) == {k: k**2 for k in range(6)}
    assert os.path.exists(mark)


def test_jobs_that_kill_every_process_are_an_error(monkeypatch):
    monkeypatch.setattr(workforces, "MOST_KILLED", 1)
    with pytest.raises(
        SolverError, match="processes were killed 1 times before they finished anything, with 2 jobs left"
    ):
        list(workforces.numbered(os._exit, [1, 2], 1))


@pytest.mark.parametrize("whole", few([0, 1, 2], 0, 2))
def test_a_broken_executor_is_stood_in_for(whole):
    alone = sweep(QUESTION, SCHEDULES)
    with Breaking(whole) as pool:
        assert sweep(QUESTION, SCHEDULES, workers=pool).to_dict() == alone.to_dict()


def test_a_function_that_cannot_travel_is_refused():
    with ProcessPoolExecutor(1) as pool, pytest.raises(ArgumentError, match="only be told of functions that its proc"):
        sweep(lambda schedule: QUESTION(schedule), SCHEDULES, workers=pool)
    with ThreadPoolExecutor(1) as pool:
        assert len(sweep(lambda schedule: QUESTION(schedule), SCHEDULES, workers=pool)) == len(SCHEDULES)


def test_a_sweep_goes_on_where_it_was_killed(tmp_path):
    alone, path = sweep(QUESTION, SCHEDULES), tmp_path / "sweep.journal"
    calls = []

    def interrupted(fraction, message):
        calls.append(message)
        if len(calls) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(QUESTION, SCHEDULES, resume=path, progress=interrupted)
    path.write_text(path.read_text() + '{"name": "1.4", "resu')  # killed in the middle of a line
    calls.clear()
    again = sweep(QUESTION, SCHEDULES, resume=path, progress=lambda fraction, message: calls.append(message))
    assert calls == ["1.4: answered"]
    assert again.to_dict() == alone.to_dict()
    with ThreadPoolExecutor(3) as pool:
        assert sweep(QUESTION, SCHEDULES, workers=pool).to_dict() == alone.to_dict()
    with pytest.raises(FileFormatError, match="belongs to other data, options or versions"):
        sweep(partial(sd.window_sigma, PLANT, window=4.0), SCHEDULES, resume=path)
    path.write_text('{"format": "x"}\n')
    with pytest.raises(FileFormatError, match="`format` must be 'sampling-design/journal/2', got 'x'"):
        sweep(QUESTION, SCHEDULES, resume=path)


def test_a_journal_is_of_what_it_was_written_for(tmp_path, monkeypatch):
    """What prints alike may differ, and a line that was edited is nobody's answer."""
    heavy = [np.eye(4) + np.diag([0.0, 0.0, 0.0, change]) for change in (0.0, 1e-9, 1.0)]
    boxes = [sd.Constraints(x=(np.zeros(12), np.linspace(1.0, last, 12))) for last in (2.0, 3.0)]
    seeds = [np.random.default_rng(k) for k in (1, 1, 2)]
    told = [digest_of(each) for each in (*[sd.CostFunction(P2=P2) for P2 in heavy], *boxes, *seeds)]
    assert [told.count(each) for each in told] == [1, 1, 1, 1, 1, 2, 2, 1]
    assert digest_of(SCHEDULES["0.5"].between) != digest_of(SCHEDULES["0.9"].between)
    assert digest_of({"x": MappingProxyType({"a": 1.0})}) != digest_of({"x": MappingProxyType({"a": 2.0})})
    path = tmp_path / "sweep.journal"
    with pytest.raises(ArgumentError, match="`resume` needs a function of a module"):
        sweep(lambda schedule: QUESTION(schedule), SCHEDULES, resume=path)
    sweep(QUESTION, SCHEDULES, resume=path)
    whole = path.read_text()
    for k, (was, then) in enumerate(((": true", ": false"), ('"s"', '"h"')), 1):
        lines = whole.splitlines(keepends=True)
        lines[k] = lines[k].replace(was, then, 1)
        assert "".join(lines) != whole
        path.write_text("".join(lines))
        with pytest.raises(FileFormatError, match=f"line {k + 1}` was changed since it was written"):
            sweep(QUESTION, SCHEDULES, resume=path)
    path.write_text(whole)
    monkeypatch.setattr(sweeps, "__version__", "0")
    with pytest.raises(FileFormatError, match="belongs to other data, options or versions"):
        sweep(QUESTION, SCHEDULES, resume=path)


def test_requirements_families_and_schedules_are_swept():
    asked = {str(k): sd.Requirement(samples=k, period=6.0, window=6.0, spacing=0.5) for k in (1, 3, 40)}
    designs = sweep(partial(sd.design_schedule, PLANT, starts=1, branches=0), asked)
    assert designs["3"]["sigma"] > 0
    assert designs.obstacles[2]
    with pytest.raises(ArgumentError, match="`name` = '40' has no answer: "):
        designs["40"]
    with pytest.raises(ArgumentError, match="`name` must be one of 1, 3, 40, got '5'"):
        designs["5"]
    families = {"calm": sd.GapRange(0.8, 1.0, time_unit="s"), "blind": sd.GapRange(3.0, 3.3, time_unit="s")}
    found = sweep(partial(sd.certify, PLANT, eta=0.3, P2=np.eye(2)), families)
    assert found.answers[0] is not None
    assert found.answers[1] is None
    assert found.explain() == "1 of 2 were answered."
    accuracy = sweep(partial(sd.guaranteed_accuracy, PLANT, w_bound=0.01, v_bound=0.1), {"0.9": SCHEDULES["0.9"]})
    assert accuracy.answers[0] is not None


def test_what_is_no_sweep_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match="`items` must hold at least one thing"):
        sweep(QUESTION, [])
    with pytest.raises(ArgumentError, match="`question` must be a function of 1 argument"):
        sweep("sigma", [1])
    with pytest.raises(ArgumentError, match="`question` must return a record with to_dict"):
        sweep(abs, [1])
    gone = Journal(tmp_path / "gone", "k", a_table)
    gone.path.unlink()
    gone.path.mkdir()
    with pytest.raises(FileFormatError, match="cannot be written"):
        gone.add("a", {})


def sealed(line, path):
    """A line of a journal with the digest that it would have, had it been written like that."""
    entry = json.loads(line)
    if not isinstance(entry, dict):
        return line
    key = json.loads(path.read_text().splitlines()[0])["key"]
    return json.dumps(entry | {"digest": digest_of(key, entry["name"], entry.get("result"))})


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("3", "must hold one JSON object, got int"),
        ('{"name": "0.5"}', "`result` is missing in `line 2`"),
        ('{"name": 5, "result": {"answer": null, "obstacle": "no"}}', "`line 2.name` must be a string, got 5"),
        ('{"name": "0.5", "result": {"answer": null}}', "`obstacle` is missing in `line 2.result`"),
        ('{"name": "0.5", "result": {"answer": 3, "obstacle": ""}}', "`line 2.result.answer` must be a table"),
        ('{"name": "0.5", "result": {"answer": {}, "obstacle": "", "x": 1}}', "unknown key 'x' in `line 2.result`"),
        (
            '{"name": "0.5", "result": {"answer": null, "obstacle": ""}}',
            "`line 2.result` must hold an answer or an obstacle",
        ),
    ],
)
def test_a_line_that_is_no_result_is_refused(line, said, tmp_path):
    path = tmp_path / "j"
    Journal(path, digest_of(QUESTION, SCHEDULES), a_table)
    path.write_text(path.read_text() + sealed(line, path) + "\n")
    with pytest.raises(FileFormatError, match=said):
        sweep(QUESTION, SCHEDULES, resume=path)


def test_a_validation_goes_on_where_it_was_killed(tmp_path, monkeypatch):
    schedule = sd.PeriodicSchedule([1.0], time_unit="s")
    certificate = sd.certify(PLANT, schedule, eta=0.4, P2=np.eye(2))
    path, ran = tmp_path / "validation.journal", []
    monkeypatch.setattr(monte_carlo, "BLOCK", 4)
    asked = {"runs": 12, "duration": 8.0, "scenarios": ["random", "paper"]}

    def report(**more):
        found = sd.validate(PLANT, schedule, certificate, rng=np.random.default_rng(5), **asked, **more)
        return found.to_dict()

    alone = report()

    def interrupted(fraction, message):
        if message.endswith("8 of 12 runs"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        report(resume=path, progress=interrupted)
    block = monte_carlo.run_block
    monkeypatch.setattr(monte_carlo, "run_block", lambda *job: ran.append(1) or block(*job))
    assert report(resume=path) == alone
    assert len(ran) == 1 + 3
    certificate = sd.certify(PLANT, schedule, eta=0.4, P2=np.eye(2))  # a second start makes it anew
    assert report(resume=path) == alone
    assert len(ran) == 1 + 3
    lines = path.read_text().splitlines()
    for change, said in (
        (lambda held: held.update(size=1), "`line 2.result.size` must be a table"),
        (lambda held: held.pop("plain"), "`plain` is missing in `line 2.result`"),
        (
            lambda held: held["plain"].update(shape=[1, 10**6]),
            r"plain` must hold the numbers of an array of shape \(1, 1",
        ),
        (lambda held: held["promised"].update(shape=[1, 4]), r"`promised` must be of shape \(4,\), got \(1, 4\)"),
        (lambda held: held["promised"].update(bytes=b64encode(np.full(4, -1.0))), "must hold no negative number"),
    ):
        entry = json.loads(lines[1])
        change(entry["result"])
        path.write_text(lines[0] + "\n" + sealed(json.dumps(entry, default=bytes.decode), path) + "\n")
        with pytest.raises(FileFormatError, match=said):
            report(resume=path)
    asked["runs"] = 13
    with pytest.raises(FileFormatError, match="belongs to other data, options or versions"):
        report(resume=path)


def test_the_command_line_says_who_works():
    with workforce(1, None) as hands:
        assert hands is None
    with workforce(2, None) as hands:
        assert hands == 2
    with (
        pytest.raises(ArgumentError, match="`--workers` and `--scheduler` exclude each other"),
        workforce(2, "tcp://x"),
    ):
        pass


def test_where_no_scheduler_answers_is_said(monkeypatch):
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "distributed", None)
        with pytest.raises(MissingExtraError, match="distributed"):
            workforces.cluster("tcp://127.0.0.1:9")
    monkeypatch.setattr(workforces, "PATIENCE", 0.2)
    with (
        pytest.raises(ArgumentError, match="`scheduler` must be the address of a running Dask scheduler"),
        workforce(1, "tcp://127.0.0.1:9"),
    ):
        pass
