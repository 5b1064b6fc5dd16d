"""Found by the kernels of the documentation instead of the real one: sliders that work on a page, where no kernel is.

`interact` runs its function at a few values when the page is built, and keeps what it prints and draws. On the page a
slider chooses between these, in any browser and from the disk.
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
