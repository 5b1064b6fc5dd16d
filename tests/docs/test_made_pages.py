"""Pages that are made from the package say everything that the package has."""

import importlib.util
import re
from pathlib import Path

import pytest

import sampling_design

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def pages():
    spec = importlib.util.spec_from_file_location("make_pages", DOCS / "make_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_item_has_a_row_with_its_theory(pages):
    items = pages.read_items(DOCS)
    page = pages.items_page(items)
    assert all(f"[{i['label']}](#{i['theory']})" in page for i in items)
    assert page.count("**(printed formula)**") >= 34


def test_every_public_class_and_function_has_its_place(pages):
    text = "\n".join(pages.room_page(room) for room in pages.ROOMS)
    callables = [n for n in sampling_design.__all__ if callable(getattr(sampling_design, n))]
    missing = [n for n in callables if not re.search(rf"auto\w+:: sampling_design\.{n}$", text, re.MULTILINE)]
    assert [n for n in missing if getattr(sampling_design, n).__module__ != "sampling_design.errors"] == []


@pytest.mark.long
def test_what_pages_refer_to_has_its_place(pages):
    text = "\n".join(pages.room_page(room) for room in pages.ROOMS)
    places = set(re.findall(r"^\.\. auto\w+:: ([\w.]+)$", text, re.MULTILINE))
    meant = {
        (path.name, target)
        for path in [*DOCS.glob("*.md"), *DOCS.glob("theory/*.md")]
        for target in re.findall(r"\{py:obj\}`~?([\w.]+)`", path.read_text())
    }
    assert len(meant) > 40
    assert {(page, target) for page, target in meant if not {target, target.rpartition(".")[0]} & places} == set()


@pytest.mark.long
def test_every_constant_that_tunes_says_what_it_trades(pages):
    """They stand together on one page, room by room; none is without its line (a checker says it once, at its head)."""
    package = ROOT / "sampling_design"
    own = [path for path in package.rglob("*.py") if path.relative_to(package).parts[0] != "checkers"]
    told = {
        (str(path.relative_to(package)), name): why for path in own for name, _, why in pages.tuning_constants(path)
    }
    assert len(told) > 800
    assert [place for place, why in told.items() if not why] == []
    assert "DIFFUSE = 1000000.0: Covariance of what is free at the start" in pages.constants_page(package)


def test_a_constant_without_a_line_is_found(pages, tmp_path):
    text = 'A, B = 3, 4.0\nC = 2**40\n"""Why."""\nD = 1e-3  # share\nE = 5\n\n\ndef f():\n    """No."""\n'
    (tmp_path / "x.py").write_text(text)
    found = [(name, value, why) for name, value, why in pages.tuning_constants(tmp_path / "x.py")]
    assert found == [("A, B", "3, 4.0", "Why."), ("C", "2 ** 40", "Why."), ("D", "0.001", "share"), ("E", "5", "")]


def test_every_command_is_explained(pages):
    from sampling_design.cli.app import COMMANDS, loaded

    page = pages.command_page()
    for name in COMMANDS:
        section = page.split(f"## `sampling-design {name}`", 1)[1].split("\n## ", 1)[0]
        assert all(max(p.opts, key=len) in section for p in loaded(name).params if p.param_type_name == "option")
        arguments = [p for p in loaded(name).params if p.param_type_name == "argument"]
        assert all(f"| `{p.metavar}` |" in section for p in arguments)  # as `--help` calls them


@pytest.mark.long
def test_imports_are_counted_and_go_down(pages):
    level = {room: k for k, rooms in enumerate(pages.FLOORS) for room in rooms}
    found = pages.imports_between(ROOT / "sampling_design")
    assert found["observability", "plants"] > 3
    assert all(level[here] > level[other] for here, other in found)
    assert pages.floors_picture(ROOT / "sampling_design").count("<path") == len(found) + 1  # and the arrow's tip


def test_a_page_is_written_once(pages, tmp_path):
    path = tmp_path / "deep" / "page.md"
    pages.write(path, "a")
    before = path.stat().st_mtime_ns
    pages.write(path, "a")
    assert path.stat().st_mtime_ns == before
    pages.write(path, "b")
    assert path.read_text() == "b"


def test_examples_to_copy_stand_in_their_own_block(pages):
    lines = pages.command_help("Do it.\n\nExample: sampling-design\ninfo x.toml")
    assert lines == ["Do it.", "", "```sh", "sampling-design info x.toml", "```", ""]


def test_every_page_is_in_a_table_of_contents():
    listed = re.findall(r"^([\w/-]+)$", (DOCS / "index.md").read_text(), re.MULTILINE)
    listed += [f"theory/{n}" for n in re.findall(r"^(\w+)$", (DOCS / "theory" / "index.md").read_text(), re.MULTILINE)]
    written = {str(p.relative_to(DOCS).with_suffix("")) for p in [*DOCS.glob("*.md"), *DOCS.glob("theory/*.md")]}
    spec = importlib.util.spec_from_file_location("make_pages", DOCS / "make_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    by_people = {p for p in written if "/" in p or p in module.WRITTEN}
    assert sorted(by_people - set(listed) - {"index"}) == []


@pytest.mark.long
def test_the_rooms_inside_are_drawn_without_a_circle(pages):
    package = ROOT / "sampling_design"
    below = pages.arrows_inside(package, "certificates")
    floor = pages.levels(below)
    assert floor["form"] < floor["exact"] < floor["families"] < floor["compare"]
    assert all(floor[other] < floor[here] for here, others in below.items() for other in others & set(below))
    drawn = pages.rooms_picture(package)
    assert all(f">{name}<" in drawn for name in ("gap_flows", "bounds", "worst_case", "certification.py"))


@pytest.mark.long
def test_what_stands_in_a_box_fits_into_it(pages):
    drawn = pages.floors_picture(ROOT / "sampling_design") + pages.rooms_picture(ROOT / "sampling_design")
    boxes = re.findall(r'<rect[^>]* width="(\d+)" [^>]*rx=.*font-size="(\d+)"[^>]*>([^<]+)</text>', drawn)
    assert len(boxes) > 40
    assert [text for wide, size, text in boxes if 0.5 * len(text) * int(size) > int(wide) - 4] == []
