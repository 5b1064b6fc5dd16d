"""How well a choice of samples does: the worst ratio of accuracy to tolerance, and the trajectories that show it."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.bounds import InitialSet
from sampling_design.accuracy.finite import NO_ERROR
from sampling_design.accuracy.results_out import ResultsIn, results_in
from sampling_design.accuracy.sampled_system import GapDynamics
from sampling_design.planning.adversary_program import DisturbedTrajectory, GridWindow, extended, in_stages
from sampling_design.planning.discrete_plant import DiscretePlant, UndetectedModes, hidden_at
from sampling_design.planning.filter_deviation import GridFilter
from sampling_design.planning.hidden_trajectories import HiddenTrajectory, peaks_of
from sampling_design.planning.problem import WHOLE, PlanProblem, RowGoal, on_finer
from sampling_design.planning.search_progress import EXCESS, SIMULATED, WINDOW
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import Budget

SETTLED = 2e-3  # a longer past is looked at until it adds less than this share
LONGEST = 8  # gaps that are looked at where only the longest are, or the work is spent
QUARTERS, OFFSETS = 4, 8  # parts of a gap at whose ends it is judged at first, and offsets, at most
FAR = 0.5  # what is below this share of a level at every quarter of a gap is not looked at elsewhere
MOST_KNOTS = 400  # samples of the past that one program looks at: its size grows with them
FEW = 60  # measurements that may be taken, up to which each of them can be looked at by itself
REMEMBERED = 8  # choices of which it is remembered what they came to
WINDOWS = 256  # windows of sequences that are kept with what was solved in them
SHALLOW = (16, 4)  # shares of the past that refute a choice first, where all of it makes a large program
FARTHEST = 200  # periods beyond which the past is not followed
MOST_FAILURES = 4  # measurements in a row that no trajectory can do without, after which it is left at that
PARTS = 4  # steps in one of the grid, in which a choice is looked at that may keep a level by chance of the grid
MISSED = 0.02  # share of a level below which the grid is not thought to miss it
SCALED = 1 + 1e-9  # a trajectory is divided by the largest ratio of its w to the bound times this


class GridSpan(NamedTuple):
    """A stretch of the grid in which no result comes in, after the latest sample of which something is in."""

    last: int  # the step of that sample; in a sequence, its number
    begin: int  # begin, length: offsets from it that are looked at
    length: float
    arrived: Mask | None = None  # (k, p): what is in of the last samples, of some of which not all is
    end: float = np.inf  # when it is over, in a sequence

    def known(self, measured: Mask) -> Mask:
        """What is in of samples that measure so much (K, p), the latest last."""
        if self.arrived is None:
            return measured
        count = min(len(self.arrived), len(measured))
        return np.concatenate([measured[: len(measured) - count], self.arrived[len(self.arrived) - count :]])


class AccuracyOracle:
    """Judges choices of samples of one problem; how far back it looks is found once and kept."""

    def __init__(self, problem: PlanProblem, discrete: DiscretePlant, work: Budget | None = None):
        self.problem, self.discrete = problem, discrete
        self.back = 0
        self.work = work or Budget(counted=True)
        self.rows = discrete.rows(np.array([goal.row for goal in problem.goals]).reshape(-1, len(discrete.T)))
        self.few = int(problem.allowed.sum()) <= FEW
        """Whether so little may be measured that it can be gone through one by one."""
        stochastic = any(goal.stochastic for goal in problem.goals)
        self.grid_filter = GridFilter(problem, discrete, self.work) if stochastic else None
        self._kept: dict[object, tuple[float, list[HiddenTrajectory]]] = {}
        """What the last choices that were judged came to."""
        self.windows: dict[object, GridWindow] = {}
        """Windows of sequences: most are those of another, later."""
        self.gaps: dict[object, GapDynamics] = {}
        """Gaps of sequences, by their length and the coordinates at both ends."""
        self.ratios: dict[object, float] = {}
        """The ratio in each stretch of a sequence that was looked at."""
        self._broken_last = 0
        """The goal that was broken last."""
        self._open: list[list[tuple[Array, float]]] = [[(row, 0.0)] for row in self.rows]

    def count(self, work: Budget) -> None:
        """Count what was done, once, and what is done from now on as part of some other work."""
        if work is not self.work:
            work.spend(self.work.spent)
        self.work = work
        if self.grid_filter is not None:
            self.grid_filter.work = work

    @cached_property
    def initial_set(self) -> InitialSet:
        """What is known of the error when the plan starts."""
        T = self.discrete.T
        return self.problem.initial.scaled(T, np.linalg.norm(T, axis=1), NO_ERROR)

    def judge(
        self, chosen: Mask, above: float = np.inf, *, longest: bool = False
    ) -> tuple[float, list[HiddenTrajectory]]:
        """Worst ratio and the strongest trajectory of each goal and gap; stops once a gap is worse than `above`.

        `longest`: only the longest gaps are looked at, where the worst is found as a rule, unless goals name times.
        Infinite, without a trajectory, where the choice hides a trajectory that never decays.
        """
        key = chosen.tobytes(), self.back, above, longest
        if key not in self._kept:
            hidden = self.hidden(chosen) is not None
            self._kept[key] = (np.inf, []) if hidden else self._judged(chosen, above, longest)
            if 1 <= above < np.inf and above * (1 - MISSED) < self._kept[key][0] <= above:
                self._kept[key] = self._closely(chosen, above, *self._kept[key])
            while len(self._kept) > REMEMBERED:
                del self._kept[next(iter(self._kept))]
        return self._kept[key]

    def _judged(self, chosen: Mask, above: float, longest: bool) -> tuple[float, list[HiddenTrajectory]]:
        """The same, worked out."""
        goals = self.problem.guaranteed
        turns = all(goal.at != "given times" for goal in self.problem.goals)
        worst, found = self._deviations(chosen)
        spans = self.spans(chosen)
        order = sorted(spans, key=lambda span: -span.length)[: LONGEST if longest and turns else None] if goals else []
        depths = [self.back] if order else []  # a shorter past refutes, too, and is all that most choices need
        if depths and above < np.inf and self.back:
            large = in_stages(self.discrete, self._knots(chosen, order[0].last, self.back))
            depths = [self.back // share for share in SHALLOW if large] + depths
        for back in depths:
            known: set[bytes] = set()
            for count, span in enumerate(order):
                if count >= LONGEST and found and self.work.over:
                    break
                if turns:  # a gap like another one, and all that came before it: its trajectories are the same, turned
                    like = np.roll(chosen, -span.last, axis=0).tobytes() + bytes(
                        str((span.begin, span.length)), "ascii"
                    )
                    if like in known:
                        continue
                    known.add(like)
                trajectories = self._gap(chosen, span, goals, above, back)
                found += [trajectory for trajectory in trajectories if back == depths[-1] or trajectory.reach > above]
                worst = max([worst, *(trajectory.reach for trajectory in trajectories)])
                if worst > above:
                    return worst, found
        return worst, found

    def _closely(
        self, chosen: Mask, above: float, worst: float, found: list[HiddenTrajectory]
    ) -> tuple[float, list[HiddenTrajectory]]:
        """What is judged to keep a level, but not by much, looked at between the steps of the grid, too."""
        finer = self.finer
        finer.back, finer.work = self.back * PARTS, self.work
        more, between = finer._judged(on_finer(chosen, PARTS), above, False)
        return max(worst, more), [*found, *(trajectory.on_grid(PARTS) for trajectory in between)]

    @cached_property
    def finer(self) -> AccuracyOracle:
        """The same for trajectories that turn, and end, between steps of the grid; of no standard deviations."""
        finer = AccuracyOracle(self.problem.finer(PARTS), self.discrete.finer(PARTS))
        finer.grid_filter = None
        return finer

    def spans(self, chosen: Mask) -> list[GridSpan]:
        """The gaps of a choice; where results are out for a while, from one result to the next."""
        steps, at = self.problem.steps, np.flatnonzero(chosen.any(axis=1))
        if self.problem.result_delay is None:
            gaps = np.diff(np.append(at, at[0] + steps))
            return [GridSpan(t, 0, h) for t, h in zip(at.tolist(), gaps.tolist(), strict=True)]
        delays = np.where(chosen[at], self.problem.result_delay / self.problem.step, np.inf)
        found = results_in((at - at[0]).astype(float), delays, period=float(steps))
        return [span for each in found if (span := self.span_of(each, int(at[0]))) is not None]

    def span_of(self, each: ResultsIn, first: int) -> GridSpan | None:
        """A stretch in which the same results are in, on the grid; None if it holds no step but its beginning."""
        last = round(float(each.times[-1]))
        begin = int(np.floor(each.begin - last + WHOLE)) + 1  # what comes in at a step is looked at after it
        length = int(np.floor(each.end - last + WHOLE))
        if begin > length:
            return None
        return GridSpan(first + last, begin, length, each.arrived)

    def in_other_gaps(self, chosen: Mask, trajectory: HiddenTrajectory, level: float) -> list[HiddenTrajectory]:
        """The strongest one against a goal that is broken in a gap, for each gap but that in which a known one ends."""
        goals = self.problem.guaranteed
        found = list[HiddenTrajectory]()
        for span in self.spans(chosen):
            if not self._holds(span, trajectory.end):
                found += self._gap(chosen, span, goals, level, self.back)
        return [other for other in found if other.reach > level]

    def _holds(self, span: GridSpan, end: int) -> bool:
        """Whether a step lies in a stretch, up to whole periods."""
        return (end - span.last - span.begin) % self.problem.steps <= span.length - span.begin

    def _deviations(self, chosen: Mask) -> tuple[float, list[HiddenTrajectory]]:
        """Worst ratio of the goals that are standard deviations, and tangents there."""
        worst, found = 0.0, []
        for g, ratio in enumerate(self.grid_filter.worst(chosen[None])[0] if self.grid_filter else []):
            if ratio > 0:
                worst = max(worst, float(ratio))
                trajectory = self.tangent(chosen.astype(float), g)
                if trajectory is not None:
                    found.append(trajectory.at_touch if self.few else trajectory)
        return worst, found

    def tangent(self, z: Array, g: int) -> HiddenTrajectory | None:
        """A tangent of a goal's variance at a point (M, p), fractions of measurements too."""
        return None if self.grid_filter is None else self.grid_filter.tangent(z, g)

    def hidden(self, chosen: Mask) -> UndetectedModes | None:
        """What a choice does not see and what never decays; None if it sees all of that."""
        goals = self.problem.goals
        for kind, outputs in ((False, self.discrete.H), (True, self.discrete.S)):
            mine = np.array([goal.stochastic == kind for goal in goals], dtype=bool)
            if mine.any():
                always = np.array([goal.at == "all times" for goal in goals], dtype=bool)[mine]
                found = hidden_at(self.discrete, chosen, self.rows[mine], always, outputs)
                if found is not None:
                    return found
        return None

    def _gap(self, chosen: Mask, span: GridSpan, goals: list[int], above: float, back: int) -> list[HiddenTrajectory]:
        """The strongest ones that end in a gap; of few measurements, up to one beyond `above`."""
        if not self.back:
            self._look_back(chosen, span, goals)
        window = self._window(chosen, span, back or self.back)
        last, length = span.last, span.length
        best: list[HiddenTrajectory] = []
        for g in sorted(goals, key=lambda g: g != self._broken_last):
            ratios = self.ratios_at(window, g, last, length, above, begin=span.begin)
            trajectory = (
                self._trajectory(window, last, max(ratios, key=lambda o: (ratios[o], o)), g) if ratios else None
            )
            best += [trajectory] if trajectory is not None else []
            if self.few and trajectory is not None and trajectory.reach > above:
                self._broken_last = g
                break
        return best

    def ending_with(self, chosen: Mask, trajectory: HiddenTrajectory, level: float) -> HiddenTrajectory | None:
        """The strongest trajectory that ends where another one does and that a choice hides; None up to a level."""
        if trajectory.response is None:
            assert self.grid_filter is not None
            found = self.grid_filter.tangent_at(chosen.astype(float), trajectory.goal, trajectory.end)
            return found.at_touch if found is not None and found.at_touch.reach > level else None
        if trajectory.parts > 1:
            own = self.finer.ending_with(on_finer(chosen, PARTS), trajectory.in_parts(), level)
            return None if own is None else own.on_grid(PARTS)
        if self.problem.unread_steps is None:
            at = np.flatnonzero(chosen.any(axis=1))
            since = (trajectory.end - at - (not trajectory.at_sample)) % self.problem.steps + (not trajectory.at_sample)
            length = int(since.min(initial=self.problem.steps + 1))
            if length > (0 if trajectory.at_sample else self.discrete.longest):
                return None
            span = GridSpan(int(at[np.argmin(since)]), 0, length)
        else:
            if not chosen.any():
                return None
            whole = next((span for span in self.spans(chosen) if self._holds(span, trajectory.end)), None)
            if whole is None:
                return None
            length = whole.begin + (trajectory.end - whole.last - whole.begin) % self.problem.steps
            if length > self.discrete.longest:
                return None
            span = whole._replace(length=length)
        window = self._window(chosen, span, self.back)
        if self.reach(window, length, trajectory.goal) <= level:
            return None
        return self._trajectory(window, span.last, length, trajectory.goal)

    def drifting_trajectory(self, undetected: UndetectedModes, level: float) -> HiddenTrajectory | None:
        """A trajectory that reaches a level since nothing outside `undetected.where` shows it, however long it drifts.

        None where w does not drive it, or only slowly.
        """
        hidden = self.problem.allowed & ~undetected.where
        goals = self.problem.guaranteed
        if not goals or not hidden.any():
            return None
        span = max(self.spans(hidden), key=lambda each: each.length)
        last, length = span.last, span.length
        back, knots = self.back or 2 * length, 0
        while back <= FARTHEST * self.problem.steps and knots < MOST_KNOTS:
            window = self._window(hidden, span, back)
            for g in goals:
                ratios = self.ratios_at(window, g, last, length, level, begin=span.begin)
                if max(ratios.values(), default=0.0) > level:
                    trajectory = self._trajectory(window, last, max(ratios, key=lambda o: (ratios[o], o)), g)
                    if trajectory is not None and trajectory.reach > level:
                        return trajectory
            if len(window.knots) == knots:
                break
            back, knots = 2 * back, len(window.knots)
        return None

    def ratios_at(
        self,
        window: GridWindow,
        g: int,
        last: float,
        length: float,
        above: float = np.inf,
        *,
        begin: float = 0,
        closely: bool = True,
        known: float = -np.inf,
    ) -> dict[float, float]:
        """How far a goal can be driven in the gap after a sample, by offsets: the worst is found among them, as a rule.

        Where it holds at all times: at every quarter, then wherever the responses found so far, each of which can end
        at any offset, go farthest, until that is an offset that was looked at; not if all is far below `above`. Unless
        `closely`, only at the end. Offsets below `begin` are left out, and those of which it is clear that they are no
        worse than what is `known`.
        """
        goal, length = self.problem.goals[g], min(length, self.discrete.longest)
        begin = min(begin, length)
        if goal.at == "after each sample":
            return {} if begin else {0: self.reach(window, 0, g)}
        if goal.at == "given times":
            steps = self.problem.steps
            first = begin + (goal.steps - last - begin) % steps
            given = np.unique([o for each in first for o in np.arange(each, length + WHOLE, steps)]).tolist()
            return {offset: self.reach(window, offset, g) for offset in given}
        ends = [length, begin] if closely else [length]
        parts = (begin + round((length - begin) * i / QUARTERS) for i in range(1, QUARTERS) if closely)
        within = {min(part, length) for part in parts}
        found, looks = dict[float, float](), [*range(int(np.ceil(begin)), int(np.ceil(length))), length]
        for offset in [*dict.fromkeys(ends), *sorted(within - {*ends})]:
            row, added = self._opened(offset, g)
            if known == -np.inf or float(window.at_most(row[None])[0] + added) > known * goal.tolerance:
                found[offset] = self.reach(window, offset, g)
        while closely and found and len(found) < OFFSETS and not (above < np.inf and max(found.values()) < FAR * above):
            rows, more = (np.array(each) for each in zip(*(self._opened(o, g) for o in looks), strict=True))
            attained = np.abs(rows @ window.ends().T).max(axis=1, initial=0.0) + more
            farthest = looks[int(np.argmax(attained))]
            if farthest in found or attained.max() <= known * goal.tolerance:
                break
            found[farthest] = self.reach(window, farthest, g)
        return found

    def _window(self, chosen: Mask, span: GridSpan, back: float) -> GridWindow:
        """The window of samples of an endless schedule up to a step, without what is out."""
        knots = self._knots(chosen, span.last, back)
        self.work.add(WINDOW, len(knots))
        return GridWindow(self.discrete, knots, span.known(chosen[knots % self.problem.steps]))

    def _knots(self, chosen: Mask, last: int, back: float) -> Index:
        """The steps of its samples."""
        steps = self.problem.steps
        at = np.flatnonzero(chosen.any(axis=1))
        periods = np.arange((last - back) // steps, last // steps + 1)  # what is out may be of periods before this one
        knots = (at + periods[:, None] * steps).ravel()
        knots = knots[(knots <= last) & (knots >= last - back)][-MOST_KNOTS:]
        long = np.flatnonzero(np.diff(knots) > self.discrete.longest)
        return knots[long[-1] + 1 :] if long.size else knots

    def look_back(self, chosen: Mask) -> None:
        """Find how far back matters of a choice, from its longest gap; nothing where it hides what never decays."""
        goals = self.problem.guaranteed
        if goals and self.hidden(chosen) is None and (spans := self.spans(chosen)):
            self._look_back(chosen, max(spans, key=lambda span: span.length), goals)

    def _look_back(self, chosen: Mask, span: GridSpan, goals: list[int]) -> None:
        """Find how far back matters."""
        before, back = np.zeros(len(goals)), 2 * int(span.length)
        while True:
            window = self._window(chosen, span, back)
            now = np.array([self.reach(window, span.length, g) for g in goals])
            if np.all((now <= before * (1 + SETTLED)) & (now > 0)) or len(window.knots) >= MOST_KNOTS:
                break
            before, back = now, 2 * back
        self.back = back

    def lengthen_past(self, chosen: Mask) -> bool:
        """Look twice as far back, and over two gaps of a choice at least, unless that is as far as can be."""
        if not self.back or self.back >= FARTHEST * self.problem.steps:
            return False
        at = np.flatnonzero(chosen.any(axis=1))
        self.back = max(2 * self.back, 2 * int(np.max(np.diff(np.append(at, at[0] + self.problem.steps)))))
        return True

    def _opened(self, offset: float, g: int) -> tuple[Array, float]:
        """The goal's row, so many steps after a sample, as a row there, and what the disturbance adds since."""
        known, whole = self._open[g], int(offset)
        while len(known) <= whole:
            known.append(self._earlier(*known[-1], 1))
        return known[whole] if whole == offset else self._earlier(*known[whole], offset - whole)

    def _earlier(self, row: Array, total: float, steps: float) -> tuple[Array, float]:
        """The same a step, or a part of one, before."""
        n, flow = self.discrete.n, self.discrete.flow(steps)
        along = row @ flow[:, n:]
        size = float(np.linalg.norm(along) if self.discrete.ball else np.abs(along).sum())
        return row @ flow[:, :n], total + size

    def reach(self, window: GridWindow, offset: float, g: int) -> float:
        """About how far a goal can be driven so many steps after the last sample, over its tolerance."""
        self.work.add(window.price, window.entries)
        row, added = self._opened(offset, g)
        value = window.reach(row) + added
        return value / self.problem.goals[g].tolerance

    def _trajectory(self, window: GridWindow, last: int, after: float, g: int) -> HiddenTrajectory | None:
        """The strongest trajectory against a goal, so many steps after the last sample of a window."""
        offset = int(after)  # choices are on the grid
        first, each, step = SIMULATED
        self.work.spend(first + each * len(window.knots) + step * float(window.knots[-1] - window.knots[0]))
        response = window.strongest(self._opened(offset, g)[0])
        if response is None:
            return None
        response = extended(self.discrete, response, self.rows[g], offset)
        return self.scaled(response, g, last + offset, offset == 0 and self.problem.unread_steps is None, window)

    def scaled(
        self, response: DisturbedTrajectory, g: int, end: int, at_sample: bool, window: GridWindow | None = None
    ) -> HiddenTrajectory | None:
        """A trajectory made admissible, with what would be seen of it."""
        goal: RowGoal = self.problem.goals[g]
        outputs = response.path @ self.discrete.H.T
        factor = response.size(self.discrete.ball)
        if window is not None:
            sampled = np.abs(outputs[window.knots - window.knots[0]])[window.measured]
            factor = max(factor, float(np.max(sampled, initial=0.0)))
        factor *= SCALED
        if factor <= 0:
            return None
        response = DisturbedTrajectory(
            response.w / factor, response.knots, response.states / factor, response.path / factor
        )
        reach = float(self.rows[g] @ response.path[-1]) / goal.tolerance
        if reach <= 0:
            return None
        steps = self.problem.steps
        return HiddenTrajectory(
            g, reach, end, at_sample, peaks_of(outputs / factor, steps, at_sample, self.problem.unread_steps), response
        )

    def weakly_observable(
        self, g: int, end: int, level: float, weights: Array, known: Mask, every: int, back: int
    ) -> HiddenTrajectory | None:
        """A trajectory that reaches `level` at `end` and is seen as little as can be; hidden where `known` measures.

        Looks at every so many steps, and at those of `known`; `weights` (M, p) are the prices of being seen.
        """
        steps = self.problem.steps
        sampled = np.flatnonzero(known.any(axis=1))
        grid = np.arange(end - back, end + 1)
        keep = (np.arange(back, -1, -1) % every == 0) | np.isin(grid % steps, sampled)
        keep[0] = True
        knots = grid[keep]
        measured, excess = known[knots % steps].copy(), weights[knots % steps].copy()
        out = (end - knots)[:, None] <= (
            np.zeros(measured.shape[1]) if self.problem.unread_steps is None else self.problem.unread_steps
        )
        measured[out] = False
        excess[measured | out] = 0.0
        window = GridWindow(self.discrete, knots, measured, excess)
        self.work.add(EXCESS, window.entries)
        response = window.least_observable(self.rows[g], level * self.problem.goals[g].tolerance)
        if response is None:
            return None
        return self.scaled(response, g, end, False, window)


def narrowed(oracle: AccuracyOracle, trajectory: HiddenTrajectory, level: float) -> HiddenTrajectory:
    """A trajectory that ends where this one does, reaches a level as it does, and that fewer measurements show.

        A  hidden from S, reaching a level   ->   A'  hidden from S and x, for as many x as leave one that reaches it

    A choice without any of what still shows it fails. Those that show it least are taken first, many at once while
    that succeeds.
    """
    needed = np.zeros_like(oracle.problem.allowed)
    count = max(1, int(detecting_measurements(oracle, trajectory, level).sum()) // 4)
    failed = 0
    while failed < MOST_FAILURES:
        row = detecting_measurements(oracle, trajectory, level)
        left = np.argwhere(row & ~needed)
        if not len(left) or oracle.work.over:
            break
        count = max(1, min(count, len(left)))
        peaks = trajectory.peaks[(trajectory.end - left[:, 0]) % oracle.problem.steps, left[:, 1]]
        taken = left[np.argsort(peaks, kind="stable")[:count]]
        hidden = oracle.problem.allowed & ~row
        hidden[taken[:, 0], taken[:, 1]] = True
        other = oracle.ending_with(hidden, trajectory, level)
        if other is not None and other.reach > level:
            trajectory, count, failed = other, 2 * count, 0
        else:
            needed[taken[:, 0], taken[:, 1]] |= count == 1
            failed += count == 1
            count //= 2
    return trajectory


def detecting_measurements(oracle: AccuracyOracle, trajectory: HiddenTrajectory, level: float) -> Mask:
    """Which of all that may be measured shows a trajectory that is scaled to reach just a level (M, p)."""
    steps = oracle.problem.steps
    back = (trajectory.end - np.arange(steps)) % steps
    return np.asarray(oracle.problem.allowed & (trajectory.weights(level)[back] > 0))
