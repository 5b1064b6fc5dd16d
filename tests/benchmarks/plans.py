"""How good plans are: the examples' own, how far from the best others can be, and what rivals find.

python -m tests.benchmarks.plans [ROW ...] writes docs/plans.md, or those rows in it
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import sampling_design as sd
from sampling_design.planning.requirement_file import requirement_and_plant
from tests.benchmarks import plan_gaps, plan_search
from tests.benchmarks.pages import MeasuredPage, Table
from tests.oracles.planning import deviations, remeasured

PLANS = Path(__file__).parents[2] / "examples" / "plans"
COUNTS, WORK, MANY = range(2, 9), 60.0, 8


def example(name):
    """A plan of the examples, and its goals by the other program."""
    requirement, plant = requirement_and_plant(PLANS / f"{name}.toml")
    began = time.process_time()
    found = sd.plan_samples(plant, requirement)
    spent = time.process_time() - began
    cheapest = "-" if found.bound.cost is None else f"{found.bound.cost.value:g}"
    level = "-" if found.bound.ratio is None else f"{found.bound.ratio.level:.3f}"
    of_cost = f"{found.cost:g}", cheapest, f"{found.ratio:.3f}", level
    return str(len(found.schedule.gaps)), *of_cost, measured_anew(found) or "-", f"{spent:.0f}"


def measured_anew(found):
    """What the other program finds of each goal; it knows no disturbances that share a ball."""
    with tempfile.TemporaryDirectory() as folder:
        data = json.loads(found.save(Path(folder) / "plan.json").read_text())
    if "w_intensity" in data["requirement"]:
        goals = deviations(data)
    elif np.ndim(data["requirement"]["w_bound"]) == 0 and found.plant.G.shape[1] > 1:
        return ""
    else:
        looks = 3 if found.plant.n_states < MANY else 1
        goals = remeasured(data, looks=looks, pasts=(True,))
    assert all(below <= told * (1 + 1e-6) for _, told, below in goals)
    return ", ".join(f"{goal} {below:.5g} of {told:.5g}" for goal, told, below in goals)


def gaps(name):
    """Gaps of one plant, for each number of samples."""
    found, began = [], time.process_time()
    for samples in COUNTS:
        posed = plan_gaps.posed(name, samples)
        plan = sd.plan_samples(*posed, search_seconds=WORK, certificate=False, robustness=False)
        assert plan.verify()
        found.append(f"{100 * plan.gap:.1f}")
    return *found, f"{time.process_time() - began:.0f}"


def rivals(name):
    """Ratios of one case."""
    *ratios, spent = plan_search.contest(name)
    return *(f"{ratio:.4f}" for ratio in ratios), f"{spent:.1f}"


EXAMPLES = Table(
    ("plan", "samples", "cost", "none below", "reached", "none of this cost below", "measured anew", "CPU s"),
    [path.stem for path in sorted(PLANS.glob("*.toml"))],
    example,
    """**Plans of `examples/plans`**: their cost and what no plan costs less than, the share of the tolerances that they
reach, and what another program finds of the same samples: linear programs on a few looks and cells, so a little less;
for standard deviations the plain filter (`python -m tests.oracles.planning plan.json`).""",
)
GAPS = Table(
    ("gap with samples", *map(str, COUNTS), "CPU s"),
    list(plan_gaps.CASES),
    gaps,
    """**Proven gaps** in percent of the most accurate plans on 48 steps: the first state, in the disturbance and noise
of the plant's scales. A search ends at 1 %, so that the gaps are what is left of that.""",
)
RIVALS = Table(
    ("ratio", "plan", "none below", "even spacing", *plan_search.RIVALS, "CPU s"),
    list(plan_search.CASES),
    rivals,
    """**Rivals** with ten times the plan's CPU time each, proven like the plan; the program ends where one reaches what
is out of reach, or is better than the plan by more than its gap.""",
    clocked=frozenset({"CPU s", *plan_search.RIVALS}),
)
PAGE = MeasuredPage(
    "plans.md",
    "How good plans are",
    __doc__.split("\n\n")[0],
    "python -m tests.benchmarks.plans",
    "CPU seconds of one run. Rows that a run does not name stay as an earlier run left them.",
    [EXAMPLES, GAPS, RIVALS],
)

if __name__ == "__main__":
    PAGE.run(sys.argv[1:])
