"""Satellite, tide and weekly blood plan for samples that come on time, 1 % and 10 % of the least time between two off.

python -m tests.benchmarks.late_samples [ROW ...] writes docs/late_samples.md, or those rows in it.
"""

import sys
import time
from pathlib import Path

import numpy as np

import sampling_design as sd
from tests.benchmarks.pages import MeasuredPage, Table
from tests.laws import test_no_search_over_real_times_finds_less_than_is_proven as law
from tests.laws import test_no_truth_breaks_a_plan_whose_samples_are_late_or_lost as plans
from tests.oracles.design import window_sigma_scan

EXAMPLES = Path(__file__).parents[2] / "examples"
SHARES = {"on time": 0.0, "1 %": 0.01, "10 %": 0.1}
ORBIT = 5554.0
GAP = ORBIT / 12
"""Twelve fixes an orbit: what the satellite's shares are of. Those of the tide are of its 5 h, of the blood of 20 h."""
TIGHT = {"T4": 1.65, "T3": 0.12}
"""What one visit a week just reaches, in nmol/l, if it is on time, and not if it is two hours off."""
EVEN = sd.PeriodicSchedule.from_times((np.arange(12) + 0.5) * GAP, ORBIT, time_unit="s")


def designed(name, late, window, **more):
    """A design in windows so much longer that no sample planned in the shorter one is lost."""
    plant = sd.read_plant(EXAMPLES / "plants" / f"{name}.toml")
    asked = sd.read_requirement(EXAMPLES / "requirements" / f"{name}.toml")
    before = time.process_time()
    found = sd.design_schedule(plant, asked.replace(window=window + 2 * late, timing_tolerance=late, **more))
    taken = time.process_time() - before
    attained = f" ({found.sigma_attained:.4f} attained)" if late else ""
    return (
        f"{late:.3g} {plant.time_unit}", f"sigma {found.sigma:.4f}{attained}", f"{found.upper_bound:.4f}",
        f"{100 * found.gap:.2f} %", f"{len(found.schedule)} samples", f"{taken:.0f}",
    )  # fmt: skip


BY_OUTPUT = "weekly blood plan, TSH 1 %, T4 and T3 10 %"


def planned(late, quick=None, goals=None):
    """A week of the thyroid patient's month; TSH, which that plan reads, may have a tolerance of its own."""
    asked, plant = sd.planning.requirement_file.requirement_and_plant(EXAMPLES / "plans" / "thyroid_month.toml")
    said = f"{late * 60:g} min" if late else None
    if quick is not None:
        said = {"T4": said, "T3": said, "TSH": f"{quick * 60:g} min"}
    asked = asked.replace(period="1 wk", timing_tolerance=said, accuracy=asked.accuracy if goals is None else goals)
    before = time.process_time()
    found = sd.plan_samples(plant, asked, search_seconds=20.0, certificate=False, robustness=False)
    taken = time.process_time() - before
    least = found.bound.cost.value
    known = ", ".join(f"{goal.name} {value:.3g}" for goal, value in zip(found.goals, found.reached, strict=True))
    said = f"{late:.3g} h" if quick is None else f"{quick:.3g} h, {late:.3g} h"
    return (
        said, f"{known} nmol/l", f"cost at least {least:.4g}",
        f"{100 * (1 - least / found.cost):.1f} %", f"{found.cost:.4g}", f"{taken:.0f}",
    )  # fmt: skip


def cells(name):
    what, _, share = name.rpartition(", ")
    if what == "satellite":
        return designed("satellite", SHARES[share] * GAP, ORBIT, spacing=100.0)
    if what == "tide":
        return designed("tidal_gauge", SHARES[share] * 5.0, 720.0)
    if name == BY_OUTPUT:
        return planned(2.0, 0.2)
    return planned(SHARES[share] * 20.0, goals=TIGHT if what == "tight weekly plan" else None)


def modulus(name):
    """What is proven to be lost in windows T + 2d beside what is attained, and where a window may lose a sample."""
    late = float(name.removesuffix(" of a gap")) * GAP
    plant = sd.read_plant(EXAMPLES / "plants" / "satellite.toml")
    exact = sd.window_sigma(plant, EVEN, ORBIT, 1e-7)
    wider = sd.window_sigma(plant, EVEN, ORBIT + 2 * late, 1e-7, timing_tolerance=late)
    same = sd.window_sigma(plant, EVEN, ORBIT, 1e-4, timing_tolerance=late)
    proven, attained = exact.lower - wider.lower, exact.upper - wider.upper
    return f"{proven:.3g}", f"{attained:.3g}", f"{proven / attained:.3f}", f"{same.lower:.4f}", f"{same.upper:.4f}"


def searched(name):
    """How often 500 searches over real times fall below what is proven, and how near they come."""
    if name == "tolerance of 0.1, 1 or 5 % of the least gap":
        pairs = [law.judged(seed) for seed in range(500)]
    else:
        left = [list(law.deviating(seed)) for seed in range(500)]
        pairs = [each[name == "any one sample lost"] for each in left if each]
    count, below, unseen, near, median = law.shares(pairs)
    return str(count), str(below), str(unseen), f"{near} ({100 * near / (count - unseen):.0f} %)", f"{median:.4f}"


SWING = [[0.0, 1.0], [-1.0, 0.0]]
OPEN = [[0.0, 1.0], [3.0, 6.0]]
TURNAROUND = {
    "gauge at once, laboratory 1.5 of 4 s": (0.0, 1.5, {"window": 4.0, "period": 2.0, "spacing": 0.2}, None),
    "gauge at once, laboratory 1 of 7 s, closed hours": (
        -0.1,
        1.0,
        {"window": 7.0, "period": 6.0, "spacing": 1.0},
        OPEN,
    ),
}
"""Damping, delay of the laboratory and requirement of an oscillator whose place and speed are read."""


def turnaround(name):
    """A design whose sensors have result delays of their own, and what its schedule shows each by its own."""
    damping, out, given, hours = TURNAROUND[name]
    plant = sd.Plant([SWING[0], [SWING[1][0], damping]], np.eye(2), outputs=["gauge", "lab"])

    def designed(delays):
        each = {"gauge": {"available": hours, "result_delay": delays[0]}, "lab": {"result_delay": delays[1]}}
        return sd.design_schedule(plant, sd.Requirement(samples=3, decay_rate=0.5, sensors=each, **given))

    found, most = designed((0.0, out)), designed((0.0, 0.0)).upper_bound
    times, mask = found.schedule.times, found.schedule.outputs
    period, window = given["period"], given["window"]
    shown = window_sigma_scan(plant.A, plant.C, times, period, window, 31, mask, delays=(0.0, out))
    return (
        f"{found.requirement.window:.3g} s", f"{found.sigma:.4f}", f"{found.upper_bound:.4f}", f"{shown:.4f}",
        f"{most:.4f}",
    )  # fmt: skip


def flown(name):
    """How often truths go beyond what small random plans claim, and how near they come."""
    count, broken, near, median = plans.shares(range(120), name)
    return str(count), str(broken), f"{near} ({100 * near / count:.0f} %)", f"{median:.4f}"


PAGE = MeasuredPage(
    "late_samples.md",
    "What late samples cost",
    """Three examples for samples that come on time, and up to 1 % and 10 % of the least time between two early or late
(of the satellite, whose fixes are at least 100 s apart here, of the mean time). Windows are early and late together
longer ([why](theory/sigma.md#late-samples)); a plan keeps its tolerances at all such times. Sigma, accuracy and bounds
are proven; the bound is what no schedule under the same tolerance exceeds, or undercuts in cost. A plan holds
for each output's own tolerance, each side by its own length: samples that are up to 2 d late count as those that are
up to d early or late about a time d later.""",
    "python -m tests.benchmarks.late_samples",
    "Rows that a run does not name stay as an earlier run left them. What is attained is sigma at real times that "
    "a search found: the truth of that schedule lies between.",
    [
        Table(
            ("example", "early or late", "proven", "bound", "gap", "cost", "CPU s"),
            [f"{what}, {share}" for what in ("satellite", "tide", "weekly blood plan") for share in SHARES]
            + [BY_OUTPUT, *(f"tight weekly plan, {share}" for share in SHARES)],
            cells,
        ),
        Table(
            ("early or late", "loss proven", "loss attained", "ratio", "windows T: proven", "attained"),
            [f"{share:g} of a gap" for share in (1e-4, 1e-3, 1e-2, 1e-1)],
            modulus,
            "The modulus: what twelve even fixes of the satellite lose in windows of T + 2d, as proven and as attained "
            "at real times that were found. In windows of T itself a sample may be lost however small d is.",
        ),
        Table(
            ("random plants and schedules", "searched", "below the claim", "nothing seen", "within 5 %", "median"),
            [
                "tolerance of 0.1, 1 or 5 % of the least gap",
                "up to a hundredth of the least gap off",
                "any one sample lost",
            ],
            searched,
            "Searches over the real times, the starts of the windows and the lost sample: a grid, then local steps, "
            "for plants of one to four states. The median is of sigma as proven over sigma as found. Where a window "
            "sees nothing, 0 is proven. Left out is what has no sigma that could be less.",
        ),
        Table(
            ("sensors with delays of their own", "window", "proven", "bound", "its schedule shows", "none shows more"),
            list(TURNAROUND),
            turnaround,
            "A design of three samples a period ends its windows with the results of the slowest sensor. What its "
            "schedule shows where the results of each sensor count as they come is sigma of a fine scan; what no "
            "schedule shows more than is the bound of a design in which all results come as soon as the quickest.",
        ),
        Table(
            ("claims of small random plans", "simulated", "broken", "within 5 %", "median"),
            ["followed", "one late", "one lost", "one lost, attained", "one lost, bound", "two lost"],
            flown,
            "Truths of 120 plans (one to three states, one or two outputs, results at once, later or within a range, "
            "samples up to a fifth of the grid early or late) by a linear program, results at the latest and real "
            "times that a search finds worst. The median is of the largest error over the claim. What is claimed "
            "within the tolerance (one late, one lost, two lost) is bounded no closer than that asks; the loss of a "
            "sample that breaks it is attained.",
        ),
    ],
)

if __name__ == "__main__":
    PAGE.run(sys.argv[1:])
