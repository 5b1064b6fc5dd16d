"""The build of the documentation notices a page that draws and shows nothing."""

import importlib.util
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def room():
    spec = importlib.util.spec_from_file_location("lost_pictures", ROOT / "docs" / "lost_pictures.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_page_that_draws_and_shows_nothing_is_found(room, tmp_path):
    cells = [
        {"cell_type": "code", "source": [line]}
        for line in ("plt.close(plt.figure())\\ndef f():\\n    plt.show()", "record.plot()", "x = 1")
    ]
    (tmp_path / "a.ipynb").write_text(json.dumps({"cells": cells}))
    (tmp_path / "b.md").write_text("text\n```{code-cell} python\nplt.show()\n```\n")
    pages = {"a": tmp_path / "a.ipynb", "b": tmp_path / "b.md"}
    logo = "<img src=logo>"
    for page in pages:
        (tmp_path / f"{page}.html").write_text(f"{logo}<article><img src=x.png></article>")
    assert room.lost_pictures(pages, tmp_path) == {}
    (tmp_path / "a.html").write_text(f"{logo}<article>nothing</article>")
    assert room.lost_pictures(pages, tmp_path) == {"a": (1, 0)}


def test_a_cell_that_prints_and_shows_nothing_is_found(room):
    cell = '<div class="cell docutils container"><pre><span>for</span> x in y: print(x)</pre>{}</div>'
    shown = cell.format('<div class="cell_output">1</div>')
    assert room.silent_cells(shown + cell.format("") + shown) == ["for x in y: print(x)"]


def test_a_picture_that_is_shown_twice_is_found(room):
    assert room.doubled_pictures('<img alt="a" src="1.png"><img src="2.png"><img src="1.png">') == ["1.png"]


def test_the_lecture_notebooks_draw(room):
    drawn = {p.stem: room.drawing_cells(p) for p in (ROOT / "examples" / "notebooks").glob("*.ipynb")}
    assert len(drawn) == 8
    assert min(drawn.values()) >= 1


def test_no_backend_of_the_shell_reaches_the_notebooks():
    assert 'os.environ.pop("MPLBACKEND", None)' in (ROOT / "docs" / "conf.py").read_text()
