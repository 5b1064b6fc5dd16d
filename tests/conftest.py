"""Deterministic tests: one thread for BLAS, one Hypothesis profile, no display."""

import contextlib
import functools
import gc
import importlib
import os
import signal
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts jobs in the background deaf to interrupts, and what they start inherits it.
    signal.signal(signal.SIGINT, signal.default_int_handler)

import pytest
from _pytest.doctest import DoctestModule
from hypothesis import HealthCheck, settings

from tests import raised, rigour

settings.register_profile(
    "house", derandomize=True, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("house")
# What is drawn would depend on the numbers in all modules that were imported before; to read them takes a second.
with contextlib.suppress(ImportError):  # an earlier Hypothesis draws none of them
    importlib.import_module("hypothesis.internal.conjecture.providers").is_local_module_file = lambda path: False
FEWER: dict[str, dict[str, Any]] = {
    "design.search.local_search": {"KICKS": 0, "LED": 1, "FEW": 1, "DRAWS": 20},
    "design.search.costs": {"_TRIED": 2, "_DRAWN": 4},
    "design.bounds.weak_duality": {"CELLS": 300, "CELLS_PER_RATE": 12.0},
    "design.bounds.zone_bound": {"_POINTS": 24},
    "design.bounds.relaxation": {"_ENTRIES": 800},
    "accuracy.search": {"FILLED": 8, "PROFILE": 1.2},
    "certificates.exact.weight_choice": {
        "STARTS": (1, 1),
        "MAX_ITERATIONS": (10, 10),
        "RESTARTS": (1, 1),
        "BELOW": ((1.5,), (1.5,)),
    },
    "certificates.families.certify_family": {"LAM_RTOL": 0.03},
}
"""What a search or a bound spends where only what it finds is judged: starts, cells of time, descents, programs."""
WHOLE = (
    "tests/design/test_search.py",
    "tests/design/test_bound.py",
    "tests/design/test_repeating_hours.py",
    "tests/accuracy",
    "tests/explorer",
    "tests/laws/test_a_late_or_lost_result",
    "tests/laws/test_every_accuracy",
    "tests/laws/test_no_schedule_beats",
    "tests/laws/test_no_truth_breaks",
    "tests/laws/test_units_change_nothing_of_the_accuracy",
    "tests/laws/test_what_nothing_drives",
    "tests/certificates/test_certificate.py",
    "tests/docs",
    "tests/benchmarks",
    "tests/browser",
    "sampling_design",
)
"""Where searches are whole: where they are judged, and where figures of the documentation are."""
SHARED = (
    ("tests/planning/",),
    (
        "tests/laws/test_no_raw_exception",
        "tests/laws/test_a_budget_binds",
        "tests/laws/test_every_result",
        "tests/records/test_signatures",
        "tests/records/test_frames",
    ),
)
"""Files that one process runs: the week's plan of one room, and one object of each kind, take seconds to be made."""
gc.set_threshold(1_000_000, 10, 10)  # what is imported for thousands of tests stays: to search it all took a tenth


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--long`: what is marked so, and nothing else; `--long-cases N`: at most so many of each that has no other."""
    parser.addoption("--long", action="store_true", help="run the tests that take long, and no others")
    parser.addoption(
        "--long-cases", type=int, metavar="N", help="with --long: at most N cases of each test without a short one"
    )


class Examples:
    """The plugin that looks for examples in documentation where some are: a file is not even imported without."""

    @pytest.hookimpl(wrapper=True)
    def pytest_collect_file(self, file_path: Path) -> Any:
        """Leave out the collector of examples of a file that has none."""
        found = yield
        if file_path.suffix != ".py" or ">>>" in file_path.read_text():
            return found
        return [each for each in found if not isinstance(each, DoctestModule)]


def pytest_configure(config: pytest.Config) -> None:
    """Let every certificate that the tests make be decided in ball arithmetic."""
    config.pluginmanager.register(Examples(), "examples")
    alone = getattr(config.option, "dist", "no") == "no"
    worker = getattr(config, "workerinput", {})
    for plugin in config.pluginmanager.get_plugins() if worker else ():
        if hasattr(plugin, "sendevent"):
            plugin.sendevent = functools.partial(sent, plugin.sendevent)
    if worker.get("everything") and int(worker["workerid"].removeprefix("gw")) % 2:
        # from the other end: what one process has compiled the other need not, 6 s on a fresh clone
        config.args[:1] = sorted(map(str, Path(__file__).parent.glob("[!._]*/")), reverse=True)
    rigour.register(config, runs_tests=alone)
    raised.register(config, runs_tests=alone)
    config.addinivalue_line("markers", "long: left out of a run of everything, and run by `--long`, as .ci/run does")


def sent(send: Callable[..., None], name: str, **event: Any) -> None:
    """Send what happened, but no report of a preparation that went well: two of three, which nobody counts."""
    report = event.get("data", {})
    if name != "testreport" or report["when"] == "call" or report["outcome"] != "passed":
        send(name, **event)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Tell the processes of a distributed run what somebody named, or whether nobody did: they cannot see it."""
    node.workerinput["named"] = named(node.config)
    node.workerinput["everything"] = node.config.pluginmanager.has_plugin("raised")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each file to one process, the largest first: what its tests share is made once, not once in each."""
    if config.getoption("dist") != "load":
        return None
    scheduling = importlib.import_module("xdist.scheduler").LoadFileScheduling(config, log)
    scheduling._split_scope, scheduling._pending_of = unit_of, pending_of
    return scheduling


def unit_of(nodeid: str) -> str:
    """What goes to one process: a file, or several that share what they make."""
    return next((files[0] for files in SHARED if nodeid.startswith(files)), nodeid.split("::")[0])


def pending_of(given: dict[str, dict[str, bool]]) -> int:
    """How many tests a process still has; asked after each test, it forgets the files that are done."""
    for unit in [unit for unit, done in given.items() if all(done.values())]:
        del given[unit]
    return sum(list(done.values()).count(False) for done in given.values())


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not even read, for long tests, a file that marks none."""
    if not config.getoption("--long") or collection_path.suffix != ".py":
        return None
    text = collection_path.read_text()
    return not ("pytest.mark.long" in text or "few(" in text) or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave long tests out of a run of everything or of a folder; whoever names a file or a test gets it."""
    long, asked = config.getoption("--long"), named(config)
    short = {kind_of(item) for item in items if item.get_closest_marker("long") is None}
    items[:] = [
        item
        for item in items
        if (item.get_closest_marker("long") is not None) == long or (not long and str(item.path) in asked)
    ]
    if getattr(config, "workerinput", {}).get("everything"):
        items.sort(key=lambda item: (item.nodeid.startswith("sampling_design"), str(item.path)))
    if long and (most := config.getoption("--long-cases")) is not None:
        items[:] = spread(items, kind_of, most, short)


def kind_of(item: pytest.Item) -> tuple[Path, str]:
    """The test function of which an item is a case."""
    return item.path, item.nodeid.split("[")[0]


def spread(items: list[Any], kind: Callable[[Any], object], most: int, but: Collection[Any] = ()) -> list[Any]:
    """At most so many items of each kind but some, in their order, far apart: the middle ones of equal shares."""
    kinds: dict[object, list[int]] = {}
    for place, item in enumerate(items):
        kinds.setdefault(kind(item), []).append(place)
    kept = set()
    for places in (places for each, places in kinds.items() if each not in but):
        count = min(most, len(places))
        kept |= {places[(2 * k + 1) * len(places) // (2 * count)] for k in range(count)}
    return [item for place, item in enumerate(items) if place in kept]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> None:
    """Let searches spend little: of designs, others and kicks are most of it, and few tests are about them."""
    long = item.get_closest_marker("long") is not None and not item.nodeid.startswith("tests/cli")
    whole = long or item.nodeid.startswith(WHOLE)
    for tuned, spent, fewer in efforts():
        tuned.update(spent if whole else fewer)


@functools.cache
def efforts() -> list[tuple[dict[str, Any], dict[str, Any], dict[str, Any]]]:
    """The modules of `FEWER` as tables of names, with what a search spends there and what it does here.

    Opened by the first test: a process that hands tests to others runs none, and they wait while it starts.
    """
    tables = [(vars(importlib.import_module(f"sampling_design.{name}")), fewer) for name, fewer in FEWER.items()]
    return [(tuned, {name: tuned[name] for name in fewer}, fewer) for tuned, fewer in tables]


def pytest_collection_finish() -> None:
    """Leave all that was collected out of every search for garbage."""
    gc.freeze()
    gc.set_threshold(100_000, 10, 10)


def named(config: pytest.Config) -> list[str]:
    """The files that the command names, alone or with a test in them."""
    told = getattr(config, "workerinput", None)
    if told is not None:
        return list(told["named"])
    paths = [config.invocation_params.dir / argument.split("::")[0] for argument in config.args]
    return sorted({str(path.resolve()) for path in paths if path.is_file()})
