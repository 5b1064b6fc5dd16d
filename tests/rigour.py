"""Every certificate that a test run makes is decided in ball arithmetic, and the test that made it fails otherwise.

After each test the plugin `Rigour` decides the certificates that are new in the folder (`tests/kept_certificates.py`).
One that is not proven fails the test, unless the test says so: `@pytest.mark.unproven("undecided", "why")`, which must
then be true.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

from tests.kept_certificates import BUDGET, FOLDER, watch

LEAST = 300
"""A run of the whole suite that makes fewer distinct certificates has lost its collector."""


class Rigour:
    """The pytest plugin: decides after each test what it made, and counts over the whole run."""

    def __init__(self, root: Path, worker: str, distributed: bool = False) -> None:
        self.root, self.folder, self.distributed = root, root / worker, distributed
        self.decided = root / "decided"
        self.decided.mkdir(parents=True, exist_ok=True)
        self.deselected = self.lost = False

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Any:
        """Judge once all fixtures are gone, patched modules among them."""
        try:
            return (yield)
        finally:
            mark = item.get_closest_marker("unproven")
            complaint = self.judge(item.nodeid, *(mark.args if mark else ()))
            if complaint:
                pytest.fail(complaint, pytrace=False)

    def judge(self, test: str, expected: str = "proven", reason: str = "") -> str:
        """Decide the certificates that are new, and say which of them are not as expected ("": none)."""
        found = [verdict for verdict in map(self.decide, self._new(test)) if verdict["verdict"] != "proven"]
        if expected == "proven":
            return "\n".join(f"{v['file']} is {v['verdict']}: {v['reason']}" for v in found)
        if not reason or expected not in ("undecided", "refuted"):
            return f'mark it as unproven("undecided" or "refuted", "why"), not as ({expected!r}, {reason!r})'
        others = [
            f"{v['file']} is {v['verdict']}, not {expected}: {v['reason']}" for v in found if v["verdict"] != expected
        ]
        return "\n".join(others) if found else f"no certificate of this test is {expected}: take the mark away"

    def _new(self, test: str) -> list[tuple[Path, str]]:
        try:  # asked after every test, and most have made none
            names = sorted(name for name in os.listdir(self.folder) if name.endswith(".json"))
        except FileNotFoundError:
            return []
        again = {name for name in names if (self.decided / name).exists()}
        for name in again:  # or all tests after it would ask for it once more
            (self.folder / name).unlink(missing_ok=True)
        return [(self.folder / name, test) for name in names if name not in again]

    def decide(self, made: tuple[Path, str]) -> dict[str, Any]:
        """Decide one file; a proven one need not be decided again in this run."""
        from sampling_design.certificates.rigorous.decide import verify_rigorously

        path, test = made
        data, began = json.loads(path.read_text()), time.process_time()
        found = verify_rigorously(data, BUDGET)
        verdict = {"verdict": found.verdict, "reason": found.reason, "test": test, "claim": data["claim"]}
        verdict |= {"seconds": time.process_time() - began, "file": str(path)}
        if found.verdict == "proven":
            (self.decided / path.name).write_text(json.dumps(verdict))
            path.unlink()
        else:
            (self.root / f"not-{path.name}").write_text(json.dumps(verdict))
            path.rename(path.with_suffix(".unproven"))
        return verdict

    def verdicts(self) -> list[dict[str, Any]]:
        """All verdicts so far, of all workers."""
        return [json.loads(p.read_text()) for p in (*self.decided.glob("*.json"), *self.root.glob("not-*.json"))]

    def pytest_deselected(self) -> None:
        """Note that this is no run of the whole suite."""
        self.deselected = True

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail a whole run that has made too few."""
        config = session.config
        whole = config.args_source == config.ArgsSource.TESTPATHS and not (self.deselected or self.distributed)
        if whole and not session.exitstatus and len(self.verdicts()) < LEAST:
            self.lost, session.exitstatus = True, pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Say how many there were, and which of them are not proven."""
        found = self.verdicts()
        if self.lost:
            terminalreporter.line(
                f"FAILED: only {len(found)} certificates were collected, {LEAST} at least are made", red=True
            )
        if not found:
            return
        open_ones = [v for v in found if v["verdict"] != "proven"]
        slowest = max(found, key=lambda v: v["seconds"])
        terminalreporter.section("certificates in ball arithmetic")
        terminalreporter.line(
            f"{len(found)} distinct ({LEAST} or more in a whole run), {len(found) - len(open_ones)} proven, "
            f"{sum(v['seconds'] for v in found):.0f} s in all, slowest {slowest['seconds']:.1f} s ({slowest['test']})"
        )
        for verdict in open_ones:
            terminalreporter.line(f"{verdict['verdict']}: {verdict['test']}: {verdict['reason']}")

    def pytest_unconfigure(self) -> None:
        """Remove the files, unless some are not proven."""
        if not self.distributed and not list(self.root.glob("not-*.json")):
            shutil.rmtree(self.root, ignore_errors=True)


def register(config: pytest.Config, runs_tests: bool = True) -> None:
    """Start collecting in this process, a worker of pytest-xdist or the only one, and judging after each test."""
    worker = getattr(config, "workerinput", {}).get("workerid")
    root = Path(os.environ[FOLDER]).parent if worker else Path(tempfile.mkdtemp(prefix="certificates-"))
    os.environ[FOLDER] = str(root / (worker or "main"))
    config.addinivalue_line("markers", "unproven(verdict, why): a certificate of this test is known not to be proven")
    plugin = Rigour(root, worker or "main", bool(worker))
    plugin.deselected = config.getoption("--long")  # of what takes long alone: no run of everything
    config.pluginmanager.register(plugin, "rigour")
    if runs_tests:
        watch()
