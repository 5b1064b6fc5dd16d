"""docs/journeys.md and docs/first_hour.md: what their own commands and lines say."""

import contextlib
import io
import json
import os
import re
import shlex
import sys
import tempfile
from functools import cache
from pathlib import Path
from unittest import mock

import pytest

from sampling_design.cli import main
from tests.docs.figures import NUMBER, Figure

DOCS = Path(__file__).parents[3] / "docs"


@contextlib.contextmanager
def elsewhere():
    """A folder of its own, and what is printed."""
    before, printed = Path.cwd(), io.StringIO()
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(printed),
    ):
        os.chdir(folder)
        try:
            yield printed
        finally:
            os.chdir(before)


@cache
def typed(page, *verbs):
    """Run the first command of a page for each verb; what they print, and the files of numbers that they leave."""
    blocks = re.findall(r"```sh\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)
    lines = [shlex.split(line) for block in blocks for line in block.splitlines()]
    with elsewhere() as printed:
        for verb in verbs:
            with mock.patch.object(sys, "argv", next(words for words in lines if words[1:2] == [verb])):
                with pytest.raises(SystemExit) as ended:
                    main()
                assert not ended.value.code
        left = {path.name: json.loads(path.read_text()) for path in Path().rglob("*.json")}
    return one_line(printed.getvalue()), left


@cache
def run_of_a_researcher():
    """What the lines of the page print."""
    code = re.search(r"```python\n(.*?)```", (DOCS / "journeys.md").read_text(), re.DOTALL)[1]
    with elsewhere() as printed:
        exec(compile(code, "journeys.md", "exec"), {})
    return one_line(printed.getvalue())


def one_line(text):
    return " ".join(text.split())


def engineer(pattern):
    return lambda: numbers(pattern, typed("journeys.md", "new", "plan", "next", "validate")[0])


def researcher(pattern):
    return lambda: numbers(pattern, run_of_a_researcher())


def numbers(pattern, said):
    found = re.search(pattern, said)
    assert found, said
    return tuple(map(float, found.groups()))


def first_hour():
    """The hours of the samples, sigma and its bound."""
    design = typed("first_hour.md", "new", "design")[1]["design.json"]
    return *(round(t) for t in design["schedule"]["times"]), design["sigma"], design["upper_bound"]


PAGE, HOUR, PROMISES = "journeys.md", "first_hour.md", r"All (\d+) promises held"
ROWS = (
    (
        r"\| (\d+) readings a week at a cost of (\d+) a week",
        engineer(r"(\d+) samples every 7 d, at a cost of (\d+),"),
    ),
    (r"Next sample at Thu (\d+):00 \(strip\)", engineer(r"Next sample at Thu (\d+):00 \(strip\)")),
    (r"as table and picture \|\n\| `validate` \| (\d+) proven bounds", engineer(PROMISES)),
    (r"any (\d+) distinct times in 3 s .*; fewer than (\d+)", researcher(r"Any (\d+) distinct .*? than (\d+) never")),
    (
        rf"\\ge{NUMBER}\$ is proven, and no schedule has more than {NUMBER}: the gap is at most {NUMBER} %",
        researcher(rf"sigma >= {NUMBER}; no .*? exceed {NUMBER}, an optimality gap of {NUMBER} %"),
    ),
    (
        rf"rate {NUMBER} per s, horizon {NUMBER} s",
        researcher(rf"discounted at rate {NUMBER} .*? longer than {NUMBER} s"),
    ),
    (
        rf"position can be known within {NUMBER}, and no estimator can guarantee less than {NUMBER}",
        researcher(rf"guarantees x1 within {NUMBER} \(none less than {NUMBER}\)"),
    ),
    (r"no estimator can guarantee less than .*\n\| `validate` \| (\d+) proven bounds", researcher(PROMISES)),
)
FIGURES = (
    *(Figure(PAGE, pattern, made, slow=True) for pattern, made in ROWS),
    Figure(
        HOUR,
        rf"at (\d+), (\d+) and (\d+) o'clock and just before (\d+)\.(?:.|\n)*sigma\\ge{NUMBER}\$ [^.]* than {NUMBER}\.",
        first_hour,
        slow=True,
    ),
)
