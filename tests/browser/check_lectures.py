"""A student at a lecture: changes a number, runs the cell, is told what failed; behind a local Jupyter server."""

import functools
import http.server
import os
import re
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest

from tests.browser.check_pages import HTML, QuietHandler

FIRST = "01_counting_is_not_enough.html"
LECTURES = sorted(path.name for path in (HTML / "made" / "notebooks").glob("0*.html"))
IN_PASSING = ("01", "05")
"""Lectures that run as a whole each time, the cheapest and one that needs CasADi; all eight take a minute."""
QUIET = "document.querySelector('.live-bar:not(.live-busy)') !== null"


@contextmanager
def serving(folder, *options):
    """The command of the pages: its process, the address of a lecture below it, and its token."""
    command = [sys.executable, "-m", "jupyter_server", "--config", str(HTML / "run_lectures.py"), "--no-browser"]
    more = ["--allow-root", "--ServerApp.port=0", *options]
    alone = {**os.environ, "JUPYTER_RUNTIME_DIR": str(folder), "JUPYTER_CONFIG_DIR": str(folder)}
    log, told = folder / "log", None
    with log.open("w") as stream:
        server = subprocess.Popen([*command, *more], stderr=stream, cwd=folder, env=alone)
    try:
        while not (told := re.search(r"(http://localhost:\S+/)index\.html\?token=(\w+)", log.read_text())):
            assert server.poll() is None, log.read_text()
            time.sleep(0.05)
        yield server, *told.groups()
    finally:
        server.terminate()
        server.wait()


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("server"), "--ServerApp.base_url=/course/") as started:
        yield started


def visit(page, running, name=FIRST):
    _, address, token = running
    page.goto(f"{address}{name}?token={token}")
    page.wait_for_selector(".live-tools")
    assert token not in page.url


def said(page, seconds=120):
    """What the bar says once nothing runs any more."""
    end = time.monotonic() + seconds
    page.wait_for_timeout(100)
    while not page.evaluate(QUIET):
        assert time.monotonic() < end, page.locator(".live-bar").inner_text()
        page.wait_for_timeout(50)
    return page.locator(".live-bar [role=status]").inner_text()


def cell_with(page, words):
    return next(c for c in page.locator("div.cell").all() if words in c.locator("textarea").input_value())


def own(page, code):
    """Run code in the cell that is left for exercises; return what the bar says and what the cell shows."""
    area = page.locator("div.cell textarea").last
    area.fill(code)
    area.press("Shift+Enter")
    return said(page), page.locator("div.cell").last.locator(".cell_output").inner_text()


def test_a_number_is_changed_and_the_cell_runs(page, running, shot):
    visit(page, running)
    cell = cell_with(page, "for count in (2, 5, 50, 500)")
    code, shown = cell.locator("textarea"), cell.locator(".cell_output")
    picture = cell_with(page, "def show(gap=1.2)").locator("img")
    before = picture.get_attribute("src")
    stale = page.locator(".live-stale")
    assert stale.count() == 0
    code.fill(code.input_value().replace("(2, 5, 50, 500)", "(3,)"))
    older = stale.count()
    assert older > 0, "what is shown below is not marked as older than the change"
    code.press("Shift+Enter")
    assert re.fullmatch(r"\d+ of \d+ cells have run\.", said(page))
    assert stale.count() == older
    assert shown.inner_text().startswith("   3 samples at multiples of pi: sigma = ")
    assert len(shown.inner_text().splitlines()) == 1
    assert picture.get_attribute("src") != before, "the cells above have not run"
    cell.get_by_role("button", name="Undo changes").click()
    assert "500" in code.input_value()
    assert own(page, "a = 5\n1 / 0") == (
        "Stopped: your own cell has failed.",
        "ZeroDivisionError in line 2: division by zero\n\nTraceback",
    )
    shot(page, "lecture-error")
    assert own(page, "print(a)")[1].strip() == "5"
    assert "write the value into the cell" in own(page, "input('gap?')")[1]
    assert "The rest is not shown" in own(page, "for k in range(100_000):\n    print('line', k)")[1]
    assert own(page, "from IPython.display import HTML\nHTML('<script>document.title = 1</script>so')")[1] == "so"
    assert page.title() != "1"
    page.reload()
    page.wait_for_selector(".live-tools")
    assert "document.title" in page.locator("div.cell textarea").last.input_value(), "what was written is lost"
    assert page.away == page.broken == []


def test_a_slider_takes_any_value(page, running, shot):
    visit(page, running)
    cell_with(page, "FloatSlider").locator("textarea").press("Shift+Enter")
    said(page)
    picture = page.locator("[data-slider] img")
    before = picture.get_attribute("src")
    page.locator("[data-slider] input[type=number]").fill("3.1415")
    page.keyboard.press("Enter")
    page.wait_for_function("(old) => document.querySelector('[data-slider] img').src !== old", arg=before)
    assert picture.count() == 1
    shot(page, "lecture-slider")
    assert page.broken == []


def test_what_never_ends_is_interrupted_and_what_dies_is_told(page, running):
    visit(page, running)
    area = page.locator("div.cell textarea").last
    area.fill("import time\nwhile True:\n    time.sleep(0.01)")
    area.press("Shift+Enter")
    page.wait_for_function("document.querySelector('[role=status]').textContent === 'Running your own cell …'")
    page.wait_for_timeout(300)
    page.get_by_role("button", name="Interrupt").click()
    assert said(page) == "Stopped: your own cell was interrupted."
    assert "KeyboardInterrupt" in page.locator(".live-error").inner_text()
    assert own(page, "import os\nos._exit(1)")[0] == "Python has ended in the middle: its names are gone."
    assert own(page, "print(len(times))")[1].strip() == "7"  # the cells above have run again
    assert page.broken == []


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name[:2] in IN_PASSING else [pytest.mark.long]) for name in LECTURES]
)
def test_a_whole_lecture_runs(page, running, name):
    visit(page, running, name)
    cells = page.locator("div.cell")
    before = [c.locator(".cell_output").inner_text() != "" for c in cells.all()]
    page.get_by_role("button", name="Run all").click()
    assert said(page, 600) == f"{cells.count()} of {cells.count()} cells have run."
    assert page.locator(".live-error").count() == 0
    assert [c.locator(".cell_output").inner_text() != "" for c in cells.all()] == before
    assert page.evaluate("[...document.images].every((i) => i.complete && i.naturalWidth > 0)")
    assert page.away == page.broken == []


def test_a_kernel_is_gone_with_its_page_and_a_page_is_told_when_its_server_is(page, tmp_path):
    with serving(tmp_path) as (server, address, token):
        visit(page, (server, address, token))
        area = page.locator("div.cell textarea").first
        area.press("Shift+Enter")
        said(page)
        kernels = f"fetch('/api/kernels?token={token}').then((a) => a.json()).then((k) => k.length)"
        assert page.evaluate(kernels) == 1
        page.goto(f"{address}index.html")
        assert "Open a lecture" in page.locator(".live-bar").inner_text()
        page.wait_for_function(f"{kernels}.then((n) => n === 0)")
        page.goto(f"{address}{FIRST}")
        area.press("Shift+Enter")
        said(page)
        server.terminate()
        server.wait()
        page.wait_for_function("document.querySelector('[role=status]').textContent.startsWith('The server does not')")
        area.press("Shift+Enter")
        assert said(page).startswith("The server does not answer: it was stopped. Start it again by jupyter server")
    assert page.broken == []


def test_who_does_not_know_the_token_changes_nothing(page, running):
    _, address, _ = running
    page.goto(f"{address}{FIRST}?token=wrong")
    page.wait_for_selector(".live-bar a")
    assert page.locator("textarea").count() == 0
    assert "this server does not know you" in page.locator(".live-bar").inner_text()
    assert page.evaluate("fetch('/course/api/kernels', {method: 'POST'}).then((a) => a.status)") == 403


def test_on_any_other_server_a_page_is_as_it_was_built(page):
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(QuietHandler, directory=HTML)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        page.goto(f"http://127.0.0.1:{server.server_port}/made/notebooks/{FIRST}", wait_until="load")
        page.wait_for_timeout(200)
        server.shutdown()
    assert page.locator("textarea, .live-bar").count() == 0
    assert "jupyter server --config run_lectures.py" in page.locator(".until-live").inner_text()
    assert [url for url in asked if "/api/" in url] == []
    assert page.broken == []
