"""A slider of a lecture works on the built page: it chooses between what was computed when the page was built."""

import importlib.util
import re
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

SLIDERS = Path(__file__).parents[2] / "docs" / "on_paper" / "ipywidgets.py"


@pytest.fixture
def sliders():
    pytest.importorskip("IPython")
    spec = importlib.util.spec_from_file_location("page_sliders", SLIDERS)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def page_of(sliders, monkeypatch, show, **ends):
    made = []
    monkeypatch.setattr(sliders, "display", lambda shown: made.append(shown.data))
    slider = sliders.FloatSlider(**ends)
    sliders.interact.options(manual=True)(show, gap=slider)
    slider.observe(show.widget.update, "value")
    return made[0]


def test_every_value_has_its_picture_and_its_text(sliders, monkeypatch):
    def show(gap):
        print("a < b at", gap)
        plt.figure(figsize=(1, 1)).add_subplot().plot([0, gap])

    page = page_of(sliders, monkeypatch, show, value=0.3, min=0.0, max=1.0, step=0.05)
    steps = re.findall(r'<div class="step"( hidden)?><code>gap = ([\d.]+)</code><pre>a &lt; b at ([\d.]+)', page)
    assert [float(value) for _, value, _ in steps] == [float(said) for *_, said in steps]
    assert [value for hidden, value, _ in steps if not hidden] == ["0.3"]
    assert len(steps) == sliders.STEPS == page.count("<img alt=")
    assert plt.get_fignums() == []


def test_the_values_are_steps_of_the_slider_within_its_ends(sliders):
    values = sliders.FloatSlider(value=3.14, min=0.3, max=7.0, step=0.01).values()
    assert values[0] == 0.3
    assert values[-1] == 7.0
    assert 3.14 in values
    assert values == sorted(values)
    assert all(abs(round((value - 0.3) / 0.01) * 0.01 + 0.3 - value) < 1e-9 for value in values)


def test_a_picture_that_is_returned_is_shown(sliders, monkeypatch):
    class Drawn:
        def _repr_png_(self):
            return b"png"

    page = page_of(sliders, monkeypatch, lambda gap: Drawn(), value=0.0, min=0.0, max=6.0, step=1.0)
    assert page.count("data:image/png;base64,cG5n") == sliders.STEPS


def test_behind_a_kernel_a_slider_asks_the_function_of_the_notebook_at_any_value(sliders, monkeypatch):
    shown = []
    monkeypatch.setattr(sliders, "display", lambda node: shown.append(node.data))
    for factor in (2.0, 3.0):
        slider = sliders.FloatSlider(value=0.3, min=0.0, max=1.0, step=0.05, continuous_update=False)
        sliders.interact_live.options(manual=True)(lambda gap, factor=factor: factor * gap, gap=slider)
    assert [sliders.draw(number, 0.1234) for number in (0, 1)] == [2.0 * 0.1234, 3.0 * 0.1234]
    drawn, typed = re.findall(r"<input [^>]*>", shown[1])
    assert 'type="range" step="0.05" min="0" max="1" value="0.3"' in drawn
    assert 'type="number" step="any" min="0" max="1" value="0.3"' in typed
    assert 'data-slider="1"' in shown[1]
