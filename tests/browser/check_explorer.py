"""A person at the explorer: drags a sample, sees the curve change, designs, saves, comes back; also on a phone."""

import re
import statistics
import subprocess
import sys
import threading
import time

import pytest

import sampling_design as sd
from sampling_design.explorer import ScheduleExplorer, scene
from sampling_design.explorer.server import Server

TURN = 6.283185307179586


@pytest.fixture
def explorer():
    """Return open(bench): a page that shows it, at its address."""
    running = []

    def start(bench):
        server = Server(bench)
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        running.append((server, thread))
        return server.address

    yield start
    for server, thread in running:
        server.shutdown()
        thread.join()
        server.server_close()


def visit(page, address):
    page.goto(address)
    page.wait_for_selector(".sigma .lower")


def until(page, holds, seconds=60.0):
    """Wait for an expression; the page's own rules forbid what playwright's waiting would evaluate in it."""
    end = time.monotonic() + seconds
    while not page.evaluate(holds):
        assert time.monotonic() < end, f"never: {holds}"
        page.wait_for_timeout(30)


def proven(page):
    return float(re.search(r"≥ ([\d.e+-]+)", page.locator(".sigma .lower").text_content())[1])


def drag(page, mark, by, steps=12):
    box = page.locator(".mark").nth(mark).locator("circle").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for k in range(steps):
        page.mouse.move(x + by * (k + 1) / steps, y)
        yield
    page.mouse.up()


def test_a_drag_changes_the_curve_and_says_what_broke(explorer, page, shot):
    visit(page, explorer(scene("pathological")))
    assert "alias the modes" in page.locator(".messages").text_content()
    until(page, "document.querySelector('.repair').textContent.includes('Move the sample at')")
    assert proven(page) == pytest.approx(0.0, abs=1e-9)
    shot(page, "explorer-broken")
    curves = []
    for _ in drag(page, 1, -90):
        page.wait_for_timeout(60)
        curves.append(page.locator(".sigma .curve").get_attribute("d"))
    assert len(set(curves)) > 6, "the curve does not follow while the sample moves"
    assert page.locator(".accuracy.stale, .accuracy:empty").count() == 1, (
        "what is no longer true is shown as if it were"
    )
    until(page, "document.querySelector('.accuracy path') && !document.querySelector('.stale')")
    until(page, "document.querySelector('.messages').textContent === ''")
    assert proven(page) > 0.1
    page.wait_for_selector(".accuracy path")
    assert "guaranteed within" in page.locator(".accuracy").text_content()
    shot(page, "explorer-repaired")
    assert page.away == []
    assert page.broken == []


def test_the_move_that_is_proposed_repairs(explorer, page, shot):
    visit(page, explorer(scene("pathological")))
    page.locator(".repair .move").click()
    until(page, "document.querySelector('.messages').textContent === '' && !document.querySelector('.repair button')")
    assert proven(page) > 0.1
    shot(page, "explorer-moved")


def test_a_plan_on_its_button(explorer, page, shot):
    visit(page, explorer(scene("plan")))
    until(page, "document.querySelector('.unknown').textContent.includes('not kept from')")
    before = page.locator(".mark").evaluate_all("marks => marks.map((m) => m.getAttribute('aria-valuenow'))")
    assert len(before) == 3
    shot(page, "explorer-tolerance-broken")
    page.get_by_role("button", name="Plan").click()
    until(page, "document.querySelector('.said').textContent.includes('No admissible plan')", 120)
    until(page, "document.querySelector('.unknown').textContent === '' && !document.querySelector('.stale')")
    # the error falls at each sample, right below its mark
    edges = page.locator(".accuracy path").get_attribute("d")
    for mark in page.locator(".mark circle").all():
        assert f"L{float(mark.get_attribute('cx')):.2f} " in edges
    after = page.locator(".mark").evaluate_all("marks => marks.map((m) => m.getAttribute('aria-valuenow'))")
    assert len(after) == 3
    assert after != before
    shot(page, "explorer-planned")
    visit(page, explorer(scene("even")))
    assert page.get_by_role("button", name="Plan").count() == 0


def test_the_set_shrinks_sample_by_sample(explorer, page, shot):
    visit(page, explorer(scene("set")))
    page.wait_for_selector(".projection polygon")
    assert page.locator(".projection polygon").count() == 4
    areas = [float(text.split("area ")[1]) for text in page.locator(".projection .after").all_text_contents()]
    assert areas == sorted(areas, reverse=True)
    shot(page, "explorer-set")
    before = page.locator(".projection polygon").nth(1).get_attribute("points")
    for _ in drag(page, 1, 150):
        page.wait_for_timeout(30)
    until(page, f"document.querySelectorAll('.projection polygon')[1].getAttribute('points') !== '{before}'")
    assert page.broken == []


def test_closed_hours_are_grey_and_a_sample_in_them_is_told(explorer, page, shot):
    visit(page, explorer(scene("laboratory")))
    assert page.locator('rect[fill="#c9c9c9"]').count() == 4
    page.wait_for_selector('.accuracy line[stroke-dasharray="3 3"]', state="attached")
    shot(page, "explorer-laboratory")
    for _ in drag(page, 0, -160):
        page.wait_for_timeout(30)
    until(page, "document.querySelector('.messages').textContent.includes('cannot be read at')")
    shot(page, "explorer-closed")


def test_the_newest_position_wins_and_one_question_is_under_way(explorer, page):
    """The first question of a drag is held back until the drag is over: only the last position follows it."""
    visit(page, explorer(scene("pathological")))
    page.wait_for_selector(".repair .move")
    until(page, "document.querySelector('.unknown').textContent !== ''")
    page.evaluate(
        """() => { const real = WebSocket.prototype.send; window.sent = []; window.answered = 0; window.most = 0;
        WebSocket.prototype.send = function (text) {
          if (!window.sent.length) {
            const heard = this.onmessage;
            this.onmessage = (message) => { window.answered++; heard(message); };
          }
          window.sent.push(JSON.parse(text));
          window.most = Math.max(window.most, window.sent.length - window.answered);
          if (window.sent.length === 1) window.release = () => real.call(this, text);
          else real.call(this, text); }; }"""
    )
    for _ in drag(page, 1, -120, steps=40):
        pass
    assert len(page.evaluate("window.sent")) == 1
    page.evaluate("window.release()")
    until(
        page,
        "window.answered === window.sent.length && window.sent.length > 2 && "
        "document.querySelector('.messages').textContent === ''",
    )
    assert page.evaluate("window.most") == 1
    first, last, *later = page.evaluate("window.sent")
    at = float(page.locator(".mark").nth(1).get_attribute("aria-valuenow"))
    assert [first["ask"], last["ask"]] == ["moving", "sigma"]
    assert first["marks"][1]["t"] > at + 0.5
    assert last["marks"][1]["t"] == pytest.approx(at, rel=1e-3)
    assert [each["ask"] for each in later] == ["accuracy"]


def test_without_a_socket_questions_are_posted(explorer, page):
    """A browser, or what stands before it, may refuse sockets; one that breaks is opened anew."""
    page.add_init_script("window.WebSocket = class { static OPEN = 1; readyState = 3; };")
    visit(page, explorer(scene("pathological")))
    for _ in drag(page, 1, -90):
        page.wait_for_timeout(60)
    until(page, "document.querySelector('.messages').textContent === ''")
    assert proven(page) > 0.1
    assert page.broken == []


def test_a_socket_that_breaks_is_opened_anew(explorer, page):
    page.add_init_script(
        """window.opened = []; const Real = window.WebSocket;
        window.WebSocket = class extends Real { constructor(...a) { super(...a); window.opened.push(this); } };"""
    )
    visit(page, explorer(scene("even")))
    until(page, "window.opened.length === 1 && window.opened[0].readyState === 1")
    page.evaluate("window.opened[0].close()")
    until(page, "window.opened[0].readyState === 3")
    before = proven(page)
    for _ in drag(page, 1, -40):
        page.wait_for_timeout(60)
    until(page, "window.opened.length === 2 && window.opened[1].readyState === 1")
    assert proven(page) != before
    assert page.broken == []


def test_design_save_and_reload(explorer, page, shot, tmp_path):
    wish = sd.Requirement(window=8.0, period=8.0, samples=6, spacing=0.2)
    bench = ScheduleExplorer(scene("even").plant, wish, folder=tmp_path)
    address = explorer(bench)
    visit(page, address)
    before = proven(page)
    page.get_by_role("button", name="Design").click()
    until(page, "document.querySelector('.said').textContent.includes('sigma')")
    until(page, f"!document.querySelector('.lower').textContent.includes('≥ {before:.4g}')")
    assert proven(page) > 1.05 * before
    # what late and lost samples leave: a line each, below what is proven, and a sentence
    until(page, "document.querySelectorAll('.sigma line.left').length === 2")
    late, lost = page.locator(".sigma line.left").all()
    assert late.text_content().startswith("late or early: sigma ≥ ")
    assert lost.text_content().startswith("one lost: sigma ≥ ")
    said = [float(number) for number in re.findall(r"\d[\d.e-]*\d", page.locator("p.left").text_content())]
    for line in (late, lost):
        left = float(line.text_content().split("≥ ")[1])
        assert left < proven(page)
        assert pytest.approx(left, rel=1e-3) in said
    assert float(late.get_attribute("y1")) < float(lost.get_attribute("y1"))
    shot(page, "explorer-designed")
    stale = "document.querySelector('.said').classList.contains('stale')"
    assert not page.evaluate(stale)
    designed = proven(page)
    page.locator(".mark").first.focus()
    page.keyboard.press("ArrowRight")
    until(page, stale)  # what was designed is no longer what is shown
    page.keyboard.press("ArrowLeft")
    page.get_by_role("button", name="Save").click()
    until(page, "document.querySelector('.said').textContent.includes('Saved')")
    assert not page.evaluate(stale)
    saved = sd.read_schedule(tmp_path / "schedule.csv")
    assert saved.times == pytest.approx(bench.schedule.times)
    page.reload()
    page.wait_for_selector(".sigma .lower")
    assert proven(page) == pytest.approx(designed, rel=1e-3)
    assert page.locator(".mark").count() == 6


def test_samples_are_added_removed_and_moved_by_the_keyboard(explorer, page):
    visit(page, explorer(scene("laboratory")))
    count = page.locator(".mark").count()
    row = page.locator(".row").first.bounding_box()
    page.mouse.click(row["x"] + 0.6 * row["width"], row["y"] + 10)
    until(page, f"document.querySelectorAll('.mark').length === {count + 1}")
    page.locator(".mark").last.dblclick()
    until(page, f"document.querySelectorAll('.mark').length === {count}")
    first = page.locator(".mark").first
    at = first.get_attribute("aria-valuenow")
    first.focus()
    page.keyboard.press("ArrowRight")
    until(page, f"document.querySelector('.mark').getAttribute('aria-valuenow') !== '{at}'")
    assert page.evaluate("document.activeElement.classList.contains('mark')")
    page.keyboard.press("Delete")
    until(page, f"document.querySelectorAll('.mark').length < {count}")


def test_a_phone_shows_all_of_it(explorer, page, shot):
    page.set_viewport_size({"width": 390, "height": 844})
    visit(page, explorer(scene("laboratory")))
    page.wait_for_selector(".accuracy path")
    wide = (
        "[...document.querySelectorAll('.sd *')].every((n) => n.getBoundingClientRect().right <= window.innerWidth + 1)"
    )
    assert page.evaluate(wide)
    shot(page, "phone-explorer")


def test_a_finger_drags_a_sample_and_scrolls_by_all_else(explorer, chromium):
    """Where charts fill a small page, one that took every touch for its own would hold the page still."""
    context = chromium.new_context(viewport={"width": 390, "height": 600}, has_touch=True, is_mobile=True)
    page = context.new_page()
    visit(page, explorer(scene("laboratory")))
    page.wait_for_selector(".accuracy path")
    hand = context.new_cdp_session(page)

    def swipe(x, y, right, down):
        def touch(kind, *at):
            hand.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [*at]})

        touch("touchStart", {"x": x, "y": y})
        for k in range(1, 11):
            touch("touchMove", {"x": x + right * k / 10, "y": y + down * k / 10})
            page.wait_for_timeout(30)
        touch("touchEnd")
        page.wait_for_timeout(300)

    def place():
        return page.locator(".mark").first.get_attribute("aria-valuenow")

    before, box = place(), page.locator(".mark circle").first.bounding_box()
    swipe(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, 40, 0)
    assert place() != before
    moved = page.locator(".mark circle").first.bounding_box()["x"] - box["x"]
    assert moved == pytest.approx(40, abs=3)  # all the way, and not until the page takes the finger for its own
    assert page.evaluate("window.scrollY") == 0
    box, before = page.locator(".sigma").bounding_box(), place()
    swipe(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, 0, -200)
    assert page.evaluate("window.scrollY") > 100
    assert place() == before
    context.close()


def test_a_page_whose_command_has_ended_says_so(page):
    words = [sys.executable, "-m", "sampling_design", "explore", "--scene", "pathological", "--no-browser"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as command:
        visit(page, re.search(r"http://\S+", command.stdout.readline())[0])
        command.terminate()
    for _ in range(2):  # by the socket that has just closed, then by post
        page.get_by_role("button", name="Certify").click()
        until(page, "document.querySelector('.said').textContent.includes('has ended; start the command again')")


def test_the_page_is_ready_and_follows_quickly(explorer, page):
    """Printed, and judged only by far: from an opened address to its curve, from a move of the hand to its curve."""
    page.add_init_script(
        """window.took = []; window.moved = 0;
        window.addEventListener("pointermove", () => { window.moved = performance.now(); }, true);
        new MutationObserver(() => {
          const curve = document.querySelector(".sigma .curve");
          if (!curve || curve === window.seen) return;
          window.seen = curve;
          window.ready ??= performance.now();
          if (window.moved) { window.took.push(performance.now() - window.moved); window.moved = 0; }
        }).observe(document, { childList: true, subtree: true });"""
    )
    address, opened = explorer(scene("pathological")), []
    for _ in range(5):
        visit(page, address)
        opened.append(page.evaluate("window.ready"))
    page.wait_for_selector(".repair .move")
    until(page, "document.querySelector('.unknown').textContent !== ''")
    page.evaluate("window.took = []")
    for _ in drag(page, 1, -100, steps=40):
        page.wait_for_timeout(60)
    took = page.evaluate("window.took")
    assert len(took) >= 10
    ready, follows = statistics.median(opened), statistics.median(took)
    print(f"ready after {ready:.0f} ms, a move is drawn after {follows:.1f} ms (medians of {len(opened)}, {len(took)})")
    assert ready < 5000
    assert follows < 1000


@pytest.mark.parametrize(
    ("unit", "ticks", "place"), [("s", {"6", "12", "18", "24"}, "at 3.429 h"), ("d", {"20000", "80000"}, "at 12345 d")]
)
def test_times_are_told_in_units_that_people_read_and_in_whole_numbers(explorer, page, unit, ticks, place):
    """A day of seconds in hours; where the unit is the largest there is, no power of ten."""
    plant = sd.Plant([[0.0, 1e-4], [-1e-4, 0.0]], [[1.0, 0.0]], time_unit=unit)
    schedule = sd.PeriodicSchedule.from_times([12345.0, 61234.0], 86400.0, time_unit=unit)
    visit(page, explorer(ScheduleExplorer(plant, sd.Requirement(window=86400.0, period=86400.0), schedule)))
    texts = page.locator("svg text").all_text_contents()
    assert ticks <= set(texts)
    assert not [text for text in texts if "e+" in text]
    assert page.locator(".mark title").first.text_content().endswith(place)
