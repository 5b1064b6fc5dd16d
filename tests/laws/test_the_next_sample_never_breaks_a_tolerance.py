"""Whoever samples when `next_sample` says so never breaks a tolerance, where watching the present radius does.

A run begins anywhere in a plan, after a look that the plan did not ask for where there is room for one. Three times
the adversary takes the next sample at the latest time, or with one sensor alone at its latest, or earlier; then the
plan goes on. What nobody can know is then sought and flown by another program: a disturbance within its bounds under
which every sample reads zero while a goal moves as far as it can. The naive rule waits for as long as the radius now
stays within the tolerance.

    python -m tests.laws.test_the_next_sample_never_breaks_a_tolerance 1000 [PLAN] [FIRST-END]

Each run is drawn by its number, so that they can be shared out.
"""

from __future__ import annotations

import sys

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan
from tests.oracles import planning as oracle

BARE = {"certificate": False, "robustness": False, "from_start": False}
DECISIONS = 3
CALENDAR = {
    "start": "2026-03-23",
    "zone": "Europe/Berlin",
    "hours": {"Mon-Thu": [["08:00", "16:00"]], "Sat": [["09:00", "12:00"]]},
}


BODY = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]], states=["place", "speed"], outputs=["y"])


def platform():
    """A swinging platform, looked at no more often than every 1.2 s, whose place is always known."""
    wanted = sd.PlanRequirement(
        {"place": 0.477}, period=6.4, grid=0.4, spacing=1.2, w_bound=[0.15], sensors={"y": {"noise_bound": 0.1}}
    )
    problem = pose_plan(BODY, wanted)
    chosen = np.zeros_like(problem.allowed)
    chosen[[0, 5, 8, 13]] = True  # one of the best; even times are as good, and forgive the naive rule
    return proven_plan(problem, chosen, PlanBound((), None, None), "budget")


def asked():
    """Its place known at given times and its speed after each look."""
    goals = {"place": {"tolerance": 0.45, "at": [1.6, 4.8]}, "speed": {"tolerance": 0.6, "at": "after each sample"}}
    wanted = sd.PlanRequirement(
        goals, period=6.4, grid=0.4, spacing=0.8, w_bound=[0.02], sensors={"y": {"noise_bound": 0.2}}
    )
    return sd.plan_samples(BODY, wanted, **BARE)


def tank():
    """A level and an inflow that nobody meters by night, on Fridays and on Sundays."""
    plant = sd.Plant(
        [[0.0, 1.0], [0.0, -0.02]],
        [[1.0, 0.0], [0.0, 1.0]],
        time_unit="h",
        states=["level", "inflow"],
        outputs=["gauge", "meter"],
    )
    sensors = {"gauge": {"noise_bound": 0.5, "price": 1.0}, "meter": {"noise_bound": 0.05, "price": 3.0}}
    wanted = sd.PlanRequirement(
        {"level": 14.0}, grid="2 h", w_bound=[0.02, 0.002], sensors=sensors, visit_price=1.0, calendar=CALENDAR
    )
    return sd.plan_samples(plant, wanted, **BARE)


PLANS = {"platform": platform, "asked": asked, "tank": tank}


class Watch:
    """The samples of one run, and what an independent program says of them."""

    def __init__(self, plan, begin, look=None):
        self.plan, self.begin = plan, begin
        plant, sensors = plan.plant, plan.requirement.sensors
        self.w = np.array(plan.requirement.w_bound)
        self.v = np.array([sensors[name].noise_bound for name in plant.outputs.names])
        self.system = plant.A, plant.C, plant.G
        times, seen = self.planned(begin - 8 * plan.schedule.period, begin + 1e-9)
        around = self.planned(begin - 8 * plan.schedule.period, begin + plan.schedule.period)[0]
        room = plan.problem.spacing * plan.problem.step - 1e-6
        if look is not None and np.min(np.abs(around - look)) >= room:  # beyond the plan, pushing out none of its own
            place = int(np.searchsorted(times, look))
            times, seen = np.insert(times, place, look), np.insert(seen, place, plan.chosen.any(axis=0), axis=0)
        self.times, self.seen, self.first = list(times), list(seen), len(times) - 1

    def planned(self, start, stop):
        """Samples of the plan in [start, stop)."""
        schedule = self.plan.schedule
        periods = np.arange(np.floor(start / schedule.period), np.ceil(stop / schedule.period) + 1) * schedule.period
        times = (periods[:, None] + schedule.times).ravel()
        seen = np.tile(self.plan.chosen[self.plan.chosen.any(axis=1)], (periods.size, 1))
        keep = (times >= start) & (times < stop)
        return times[keep], seen[keep]

    def take(self, t, mask):
        self.times.append(t)
        self.seen.append(np.asarray(mask))

    def ratio(self, end, upto):
        """The largest goal at `end` over its tolerance, with the samples before number `upto`; flown, and scaled."""
        A, C, G = self.system
        worst, times, seen = 0.0, np.array(self.times[:upto]), np.array(self.seen[:upto])
        for goal in self.plan.goals:
            if not self.asked(goal, end, times[-1]):
                continue
            _, nodes, _, u = oracle.hidden(A, C, G, times, seen, goal.row, end, self.w, self.v)
            x = oracle.flown(A, G, nodes, u)
            excess = np.max(np.abs(u / self.w), initial=1.0)
            y = np.abs(x[: len(times)] @ C.T / self.v)[seen]
            worst = max(worst, float(goal.row @ x[-1]) / max(excess, float(y.max(initial=0.0))) / goal.tolerance)
        return worst

    def asked(self, goal, end, last):
        """Whether a goal says anything of a time."""
        step = self.plan.problem.step
        if goal.at == "given times":
            return bool(
                np.any(
                    np.isclose(
                        (goal.steps - end / step) % self.plan.problem.steps % self.plan.problem.steps, 0, atol=1e-6
                    )
                )
            )
        return goal.at == "all times" or abs(end - last) < 1e-9

    def follow(self):
        """The plan's samples from now on, for another period and a half."""
        spacing = self.plan.problem.spacing * self.plan.problem.step
        last = self.times[-1]
        for t, mask in zip(*self.planned(last + spacing - 1e-6, last + 1.5 * self.plan.schedule.period), strict=True):
            self.take(t, mask)

    def worst(self):
        """The worst of every gap since the run began: after its sample, in its middle, before the next, when asked."""
        found, step = 0.0, self.plan.problem.step
        asked = {float(s) for g in self.plan.goals if g.at == "given times" for s in g.steps}
        for k in range(self.first, len(self.times) - 1):
            a, b = self.times[k], self.times[k + 1]
            looks = [
                i * step for i in range(round(a / step), round(b / step) + 1) if i % self.plan.problem.steps in asked
            ]
            for end in [a, (a + b) / 2, b, *looks]:
                found = max(found, self.ratio(end, k + 1))
        return found

    def allowed(self):
        """Times of the grid after the last sample at which something may be measured, for a period, and what."""
        problem = self.plan.problem
        first = round(self.times[-1] / problem.step) + problem.spacing
        for i in range(max(first, round(self.begin / problem.step)), first + problem.steps):
            mask = problem.allowed[i % problem.steps] & self.plan.chosen.any(axis=0)
            if mask.any():
                yield i * problem.step, mask


def choices(plan, begin, look, taken, known):
    """What the adversary may take next, once these were taken; `known` keeps answers."""
    key = begin, look, tuple(taken)
    if key not in known:
        watch = Watch(plan, begin, look)
        names, record = plan.plant.outputs.names, None
        if taken or look is not None:  # all that was measured so far, since it is no longer the plan
            every = [*zip(watch.times, watch.seen, strict=True), *((t, np.isin(names, who)) for t, who in taken)]
            record = [(t, np.where(mask, 0.0, np.nan), None) for t, mask in every]
        found = sd.next_sample(plan, record, now=taken[-1][0] if taken else begin)
        assert found.proven
        assert found.ratio <= 1
        options = [(found.latest, found.outputs)]
        options += [(t, (name,)) for name, t in found.alone.items() if np.isfinite(t)]
        if plan.problem.spacing == 1 or found.best == found.latest:
            options.append((found.best, found.best_outputs))
        known[key] = sorted(set(options))
    return known[key]


def guided(plan, begin, rng, known, look=None):
    """The worst ratio of a run that asks `next_sample` three times; `known` keeps answers and runs."""
    taken = []
    for _ in range(DECISIONS):
        options = choices(plan, begin, look, taken, known)
        taken.append(options[rng.integers(len(options))])
    key = begin, look, tuple(taken), "worst"
    if key not in known:
        watch = Watch(plan, begin, look)
        for t, outputs in taken:
            watch.take(t, np.isin(plan.plant.outputs.names, outputs))
        watch.follow()
        known[key] = watch.worst()
    return known[key]


def naive(plan, begin):
    """The worst ratio of a run that samples at the last allowed time before the radius reaches the tolerance."""
    watch = Watch(plan, begin)
    for _ in range(DECISIONS):
        options = list(watch.allowed())
        taken = options[0]
        for option in options:
            if watch.ratio(option[0], len(watch.times)) > 1:
                break
            taken = option
        watch.take(*taken)
    watch.take(*next(watch.allowed()))  # the earliest at which it could do better
    return watch.worst()


@pytest.fixture(scope="module")
def swinging():
    return platform()


@pytest.mark.long
def test_no_run_breaks_a_tolerance(swinging):
    known = {}
    for begin, look in ((0.0, None), (2.8, 2.0)):
        assert guided(swinging, begin, np.random.default_rng(5), known, look) <= 1


def test_watching_the_present_radius_breaks_it(swinging):
    assert naive(swinging, 0.0) > 1.3


def main(runs, told=()):
    """Many runs, shared out among the plans, or some of a plan's; prints the worst of each rule."""
    each = -(-runs // len(PLANS))
    some = next((range(*map(int, piece.split("-"))) for piece in told if "-" in piece), range(each))
    for name in [n for n in PLANS if n in told] or list(PLANS):
        plan, known, worst = PLANS[name](), {}, 0.0
        for number in some:
            rng = np.random.default_rng(number)
            begin, look = (rng.integers(plan.problem.steps, size=2) * plan.problem.step).tolist()
            worst = max(worst, guided(plan, begin, rng, known, begin - look))
            assert worst <= 1, (name, number)
        different = sum(key[-1] == "worst" for key in known)
        print(f"{name}: {len(some)} runs ({different} different), worst {worst:.4f} of the tolerance", flush=True)
        if some[0] == 0:
            rest = [naive(plan, plan.problem.step * k) for k in range(plan.problem.steps)]
            print(f"naive {max(rest):.4f}, above 1 in {sum(r > 1 for r in rest)} of {len(rest)}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
