"""After a lost sample `next_sample` finds one that keeps the tolerances wherever there is one, else what helps soonest.

Every allowed time of a period is tried in turn by a plain program of its own, and the plan's samples after it.
"""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan
from tests.cases import few
from tests.oracles import planning as oracle

LEVEL = sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["y"])
BODY = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]], states=["place", "speed"], outputs=["y"])
SWING = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]], states=["place", "speed"], outputs=["y"])
DECAY = sd.Plant([[-0.2]], [[1.0]], states=["level"], outputs=["y"])
BEFORE = 3
"""Periods of the plan before the record."""

# plant, tolerance, period, grid, spacing, bound on w, the plan's steps, those that are lost, and now in steps
CASES = {
    "level": (LEVEL, 0.65, 8.0, 1.0, None, 0.1, (0, 4), (4,), 4.0),
    "level, too late": (LEVEL, 0.65, 8.0, 1.0, None, 0.1, (0, 4), (4,), 6.5),
    "level, spaced": (LEVEL, 0.65, 8.0, 1.0, 3.0, 0.1, (0, 4), (4,), 4.0),
    "body": (BODY, 1.5, 10.0, 1.0, None, 0.1, (0, 3, 6, 7), (6, 7), 7.0),
}
LONG = {**CASES, "swing": (SWING, 0.477, 6.4, 0.4, 1.2, 0.15, (0, 5, 8, 13), (5,), 5.0)}
MORE = {
    f"{name}, {lost} lost at {now}": (plant, tolerance, period, step, spacing, w, at, (lost,), now)
    for name, (plant, tolerance, period, step, spacing, w, at, _, _) in {
        **{name: LONG[name] for name in ("level", "level, spaced", "body", "swing")},
        "decay": (DECAY, 0.45, 8.0, 1.0, 2.0, 0.1, (0, 3, 6), (), 0.0),
        "turning": (SWING, 0.6, 6.4, 0.4, None, 0.15, (0, 5, 8, 13), (), 0.0),
    }.items()
    for lost in at
    for now in (lost, lost + 1.0, lost + 2.5)
}


def planned(plant, tolerance, period, step, spacing, w, at):
    """The plan of these steps, proven."""
    terms = {"sensors": {"y": {"noise_bound": 0.1}}, "w_bound": [w] * plant.n_disturbances}
    problem = pose_plan(
        plant,
        sd.PlanRequirement({plant.states.names[0]: tolerance}, period=period, grid=step, spacing=spacing, **terms),
    )
    chosen = np.zeros_like(problem.allowed)
    chosen[list(at)] = True
    return proven_plan(problem, chosen, PlanBound((), None, None), "budget")


def judged(plan, taken, t, now, w):
    """Times from now on and the ratios there, if the next sample is at t and the plan follows."""
    step, period = plan.problem.step, plan.schedule.period
    every = np.concatenate([k * period + plan.schedule.times for k in range(-BEFORE, 6)])
    apart = max(plan.problem.spacing, 1e-6) * step
    after = every[(every >= t + apart - 1e-6 * step) & (every <= t + 1.5 * period)]
    times = np.concatenate([taken, [t], after])
    plant, goal = plan.plant, plan.goals[0]
    system, seen = (plant.A, plant.C, plant.G), np.ones((times.size, 1), dtype=bool)
    rows = goal.row[None] / goal.tolerance
    bounds = np.full(plant.n_disturbances, w), np.array([0.1])
    return np.array(oracle.from_now(system, times, seen, rows, now, after[-1], step, *bounds))


def kept_from(found, level, now):
    """The first time from which on every ratio is at most so high."""
    above = np.flatnonzero(found[:, 1] > level)
    return now if not above.size else found[min(above[-1] + 1, len(found) - 1), 0]


def tried(case):
    """The plan, what was taken, now, and for every time of a period what comes of a sample there."""
    plant, tolerance, period, step, spacing, w, at, lost, now = case
    plan = planned(plant, tolerance, period, step, spacing, w, at)
    every = np.array([k * period + i * step for k in range(-BEFORE, 2) for i in at if k or i not in lost])
    now *= step
    taken = every[every <= now + 1e-9]
    first = int(np.floor(now / step + 1e-6)) + 1
    times = np.arange(first, first + plan.problem.steps) * step
    times = times[times >= taken[-1] + plan.problem.spacing * step - 1e-6]
    return plan, taken, now, {float(t): judged(plan, taken, t, now, w) for t in times}


def check(case):
    plan, taken, now, options = tried(case)
    found = sd.next_sample(
        plan, [(float(t), [0.0], None) for t in taken[taken >= -plan.schedule.period - 1e-6]], now=now
    )
    sure = {t: kept_from(looks, 0.985, now) for t, looks in options.items()}
    if any(kept <= now for kept in sure.values()):  # a sample helps
        assert found.keeps
    assert found.kept_from <= min(sure.values()) + 1e-9
    assert (
        kept_from(options[min(options, key=lambda t: abs(t - found.latest))], 1 + 1e-6, now) <= found.kept_from + 1e-9
    )
    own = next(t for t in options if any(abs(t / plan.problem.step - i) % plan.problem.steps < 1e-6 for i in case[6]))
    if not found.keeps and sure[own] <= found.kept_from + 1e-9:  # nothing more is asked for
        assert found.latest == pytest.approx(own)
    return found


@pytest.mark.parametrize("name", few(CASES, 2))
def test_what_helps_is_found(name):
    assert check(CASES[name]).proven


@pytest.mark.long
@pytest.mark.parametrize("name", MORE)
def test_what_helps_is_found_whatever_is_lost(name):
    assert check(MORE[name]).proven
