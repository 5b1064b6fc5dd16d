"""Found by the kernels of the pages instead of the real one: sliders that work on a page.

Where no kernel is, `interact` has run its function at a few values when the page was built, and kept what it prints and
draws: a slider chooses between these, in any browser and from the disk. Behind a page that runs (`_static/live.js`),
`interact_live` takes its place, and the slider takes any value.
"""

import base64
import io
from contextlib import redirect_stdout
from html import escape
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import HTML, display
from IPython.utils.capture import capture_output

STEPS = 5
CHOOSE = "this.closest('.steps').querySelectorAll('.step').forEach((step, k) =&gt; { step.hidden = k != this.value; })"


class FloatSlider:
    """What the lectures ask of a slider: its ends, its step, and where it begins."""

    def __init__(self, value, min, max, step, continuous_update=True):
        self.value, self.min, self.max, self.step = value, min, max, step

    def values(self):
        """A few values of the slider, evenly over its range, and the one at which it begins."""
        marks = self.min + self.step * np.round(np.linspace(0.0, (self.max - self.min) / self.step, STEPS))
        marks[np.argmin(np.abs(marks - self.value))] = self.value
        return [float(f"{mark:.6g}") for mark in marks]

    def observe(self, draw, name):
        """Nothing: what a slider of a page chooses between was drawn before."""


def interact(show, **slider):
    """Run `show` at a few values of its slider and display them as one figure with a slider."""
    ((name, asked),) = slider.items()
    values = asked.values()
    begin = values.index(asked.value)
    steps = [
        f'<div class="step"{" hidden" * (k != begin)}><code>{name} = {value:g}</code>{shown(show, name, value)}</div>'
        for k, value in enumerate(values)
    ]
    control = (
        f'<input type="range" min="0" max="{len(values) - 1}" value="{begin}" aria-label="{name}" oninput="{CHOOSE}">'
    )
    display(HTML(f'<div class="steps">{control}{"".join(steps)}</div>'))
    show.widget = SimpleNamespace(update=None)


interact.options = lambda **_: interact  # a lecture draws when its slider is moved; a page has drawn before

LIVE = []


def interact_live(show, **slider):
    """Display a slider whose values, and those typed beside it, the page sends to `draw`."""
    ((name, asked),) = slider.items()
    ends = f'min="{asked.min:g}" max="{asked.max:g}" value="{asked.value:g}" aria-label="{name}"'
    drawn = f'<input type="range" step="{asked.step:g}" {ends}>'
    typed = f'<label>{name} = <input type="number" step="any" {ends}></label>'
    display(HTML(f'<div class="steps" data-slider="{len(LIVE)}">{drawn}{typed}</div>'))
    LIVE.append((show, name))
    show.widget = SimpleNamespace(update=None)


interact_live.options = lambda **_: interact_live


def draw(number, value):
    """What the function of a slider returns at a value; what it prints and draws is displayed by itself."""
    show, name = LIVE[number]
    return show(**{name: value})


def shown(show, name, value):
    """What `show` prints and draws, as HTML."""
    printed, before = io.StringIO(), plt.get_fignums()
    with redirect_stdout(printed), capture_output(stdout=False, stderr=False) as captured:
        found = show(**{name: value})
    pictures = [found._repr_png_()] if hasattr(found, "_repr_png_") else []
    pictures += [base64.b64decode(each.data["image/png"]) for each in captured.outputs if "image/png" in each.data]
    for number in set(plt.get_fignums()).difference(before):
        stream = io.BytesIO()
        plt.figure(number).savefig(stream, format="png", dpi=72)
        pictures.append(stream.getvalue())
        plt.close(number)
    alt = escape(f"the picture of this cell at {name} = {value:g}")
    images = [f'<img alt="{alt}" src="data:image/png;base64,{base64.b64encode(p).decode()}">' for p in pictures]
    text = f"<pre>{escape(printed.getvalue())}</pre>" if printed.getvalue() else ""
    return text + "".join(images)
