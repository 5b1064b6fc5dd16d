"""The search for a plan: choices that see every trajectory so far, others against those choices, until none is left.

One question, asked at levels: is there an admissible choice whose accuracy is at most `level` times each tolerance? The
cheapest choice that sees every trajectory found is judged; if it fails, its own trajectories join. If no choice sees
them all, there is none. Nothing here is a claim: the plan is proven afterwards, and so is the bound.
"""

from __future__ import annotations

import numpy as np

from sampling_design.planning.accuracy_oracle import SETTLED, AccuracyOracle, narrowed
from sampling_design.planning.bounds import BELOW, separated
from sampling_design.planning.covering import NODES, CoveringRows, Key, cheapest
from sampling_design.planning.discrete_plant import UndetectedModes
from sampling_design.planning.evidence import EASED, open_choices
from sampling_design.planning.hidden_trajectories import MOST_ENDS, HiddenTrajectories, HiddenTrajectory, weighed
from sampling_design.planning.hitting_set import HittingSet, smallest_hitting_set
from sampling_design.planning.problem import SAME_PRICE, PlanProblem
from sampling_design.planning.search_progress import MEETING, WEIGHED, PlanProgress
from sampling_design.records.arrays import Array, Mask

GRID = 120  # steps at which a weakly observable trajectory is kept small, about
SPREAD_ENDS = 4  # ends of one trajectory that join the program at a time
TIE = 1e-3  # share of the least price by which choices that see more trajectories are preferred
THINNED = 2  # measurements that are left out in turn, the least missed ones, before the others are moved
FEW_NODES = 60  # nodes of a program of tangents, whose rows are dense
TANGENTS = 40  # tangents at fractions of measurements, at most
WHOLE = 1e-6  # an entry counts as 0 or 1 within this
FRUITLESS = 5  # repairs in a row that come to nothing, after which only the cheapest choices are judged
FLAT = 1e-5  # a tangent that raises the least cost by no more than this share is the last
MOST_SWAPS = 200  # places of one measurement that are tried, at most
NARROW = 0.01  # relative distance between the best choice and the level shown to be out of reach at which a search ends
STEP = 0.03  # how much better than the best so far is asked for next


class PlanSearch:
    """A search over choices of one problem, with its pool of trajectories."""

    def __init__(self, problem: PlanProblem, oracle: AccuracyOracle, progress: PlanProgress | None = None):
        self.problem, self.oracle = problem, oracle
        self.progress = progress or PlanProgress(None, problem, oracle.work)
        self.free = problem.is_free
        self.covering = CoveringRows(problem, fixed=self.free)
        self.pool = HiddenTrajectories(problem.steps, [problem.ends(g) for g in range(len(problem.goals))])
        self.chosen: Mask | None = None
        """The best choice so far, and what it was judged to be."""
        self.worst = np.inf
        self.out_of_reach = 0.0
        """The highest level that no choice was found to keep, and the rows that say so."""
        self.keys: list[Key] = []
        self.complete = False
        self.stochastic = all(goal.stochastic for goal in problem.goals)
        self.incumbents: list[tuple[Mask, float]] = []
        """Every choice that was the best so far, and what it was judged to be: none is forgotten."""
        self.counted = True
        """Whether choices are sought by their number of samples alone, until that was given up."""
        self.share = np.inf
        self.starts: list[Mask] = []
        """Choices that are judged before any other."""
        self.undetected_at: list[Mask] = []
        """Where a choice must measure once at least, or it hides a trajectory that never decays."""
        self.too_many = np.inf, np.inf
        """A level and a cost below which more choices are open than can be judged: so are they of larger ones."""
        self.refused: list[Mask] = []
        """Choices that were judged to keep a level and are not proven to: neither they nor parts of them are sought."""

    @property
    def late(self) -> bool:
        """Whether the work is spent; where something is held, its share of it."""
        work = self.oracle.work
        return work.over or (bool(self.incumbents) and work.spent > self.share * work.seconds)

    def add(self, trajectories: list[HiddenTrajectory], level: float) -> None:
        """Keep trajectories that reach a level."""
        for trajectory in trajectories:
            if trajectory.reach > level:
                self.pool.add(trajectory)

    def seed(self, level: float) -> None:
        """Hidden trajectories that reach a level and are seen as little as can be, whatever is measured."""
        nothing = np.zeros(self.problem.allowed.shape, dtype=bool)
        for g, goal in enumerate(self.problem.goals):
            if goal.at == "after each sample":
                continue
            if not goal.stochastic and not self.late:
                for end in self._typical_ends(g):
                    self.add_weakly_observable(g, end, level, nothing)
        self.sharpen(level)

    def sharpen(self, level: float, below: float = np.inf) -> None:
        """Tangents at fractions of measurements, as few as keep all tangents before, until one keeps the level.

        Among choices below a cost, which leave larger gaps.
        """
        stochastic = [g for g, goal in enumerate(self.problem.goals) if goal.stochastic]
        z = np.where(self.problem.allowed, 1.0 / max(1, int(self.problem.allowed.sum())), 0.0)
        keys, least = list(self.keys), 0.0
        for _ in range(TANGENTS if stochastic else 0):
            found = [self.oracle.tangent(z, g) for g in stochastic]
            fresh = [t for t in found if t is not None and weighed(t, np.array(np.sum(t.peaks * t.touches))) > level]
            if not fresh or self.late:
                return
            self.add(fresh, level)
            keys, x = separated(self.covering, self.pool, level, keys, self.oracle.work, below)
            cost = float(self.covering.cost @ x)
            if cost <= least * (1 + FLAT):
                return
            least = cost
            z = self.covering.measured(x)

    def find(self, x: Array, level: float) -> None:
        """Hidden trajectories at a level against a point of the program, or tangents at fractions of measurements."""
        if self.late:
            return
        if float(np.minimum(x, 1 - x).max(initial=0.0)) <= WHOLE:
            chosen = self.covering.choice(x)
            if not chosen.any():  # no sample that anything could hide from, or be asked after
                return
            if (undetected := self.oracle.hidden(chosen)) is not None:
                self.require_detection(undetected, level)
                return
            trajectories = [
                trajectory for trajectory in self.oracle.judge(chosen, above=level)[1] if trajectory.reach > level
            ]
            self.add(trajectories, level)
            if trajectories and self.oracle.few:
                self._add_less_observable(max(trajectories, key=lambda a: a.reach), level, chosen)
            return
        z = self.covering.measured(x)
        found = [self.oracle.tangent(z, g) for g, goal in enumerate(self.problem.goals) if goal.stochastic]
        self.add([t for t in found if t is not None], level)

    def require_detection(self, undetected: UndetectedModes, level: float) -> None:
        """Ask for a measurement that shows what never decays, by a trajectory that reaches a level if there is one."""
        self.undetected_at.append(undetected.where)
        trajectory = self.oracle.drifting_trajectory(undetected, level) if self.oracle.few else None
        if trajectory is not None:
            self.add([trajectory], level)

    def _typical_ends(self, g: int) -> list[int]:
        steps = self.problem.steps
        ends = np.flatnonzero(self.pool.ends[g])
        if self.free or ends.size <= 1:
            return [int(ends[0]) + steps] if ends.size else []
        open_again = np.flatnonzero(self.problem.allowed.any(axis=1) & ~np.roll(self.problem.allowed.any(axis=1), 1))
        wanted = np.unique(np.concatenate([open_again, ends[:: max(1, ends.size // 4)]]))
        return [int(e) + steps for e in wanted[np.isin(wanted, ends)][:8]]

    def add_weakly_observable(self, g: int, end: int, level: float, known: Mask) -> HiddenTrajectory | None:
        """Find and keep one, hidden from `known`; none against a standard deviation, or a level of 0."""
        if self.problem.goals[g].stochastic or level <= 0:
            return None
        back = self.oracle.back
        weights = np.where(self.problem.allowed, 1.0, 0.05 if self.free else 0.0)
        every = max(1, back // GRID)
        trajectory = self.oracle.weakly_observable(g, end, level, weights, known, every, back)
        if trajectory is not None and trajectory.reach >= level:
            self.pool.add(trajectory)
            return trajectory
        return None

    def decide(self, level: float, rounds: int) -> bool | None:
        """Whether a choice keeps a level: True with `found` set, False if none sees all trajectories, else None."""
        keys: list[Key] = []
        for _ in range(rounds):
            self.progress.say(f"{len(self.pool.trajectories)} trajectories")
            if self.late:
                return None
            few = self._few(level)
            chosen, none = (
                (few.chosen, few.none)
                if few is not None
                else self._one_by_one(level, self.covering.dearest) or self._candidate(keys, level, within_limits=True)
            )
            if none:
                self.out_of_reach = max(self.out_of_reach, level)
                self.keys = keys
                return False
            if chosen is None:
                return None
            if self.judged(chosen, level):
                return True
        return None

    def _few(self, level: float) -> HittingSet | None:
        """A choice within the limits that sees every trajectory of the pool, or that none does; None if given up."""
        while self.counted:
            found = smallest_hitting_set(
                self.covering, self.pool, level, self.covering.dearest, self.oracle.work, self.undetected_at
            )
            self.counted = found is not None and (found.chosen is not None or found.none)
            if found is None or found.chosen is None or (undetected := self.oracle.hidden(found.chosen)) is None:
                return found if self.counted else None
            self.require_detection(undetected, level)
        return None

    def _candidate(
        self, keys: list[Key], level: float, below: float = np.inf, *, within_limits: bool = False
    ) -> tuple[Mask | None, bool]:
        """The cheapest choice that sees every trajectory of the pool; only those below a cost are of use.

        `within_limits`: any choice that the limits admit.
        """
        if self.oracle.few:  # all rows at once: a program that lacks some is solved anew for each few that it breaks
            rows = self.covering.trajectory_rows(self.pool, level)
            self.oracle.work.add(MEETING, rows.shows.size)
            tangents = [key for key in keys if self.pool.trajectories[key[0]].response is None]
            keys[:] = tangents + rows.undominated()
        while True:
            measured_at = [*self.undetected_at, *self._beyond_refused()]
            model = self.covering.model(self.pool.trajectories, keys, level, measured_at)
            asked = slice(first := self.covering.frame[0].shape[0], first + len(keys) + len(measured_at))
            more = np.asarray(model.A[asked].sum(axis=0)).ravel()
            least = self.covering.grain or float(np.max(model.c, initial=model.unit))
            tie = -(1.0 if within_limits else TIE) * least * more / max(1.0, float(more.max(initial=0.0)))
            chosen, none = cheapest(
                self.covering,
                model,
                tie,
                self.oracle.work,
                below,
                FEW_NODES if self.stochastic else NODES,
                within_limits,
            )
            if chosen is None:
                return None, none
            if (undetected := self.oracle.hidden(chosen)) is not None:
                self.require_detection(undetected, level)
                continue
            fresh = self._undetected_ends(chosen, level, keys)
            if not fresh or self.late:
                return chosen, False
            keys += fresh

    def _beyond_refused(self) -> list[Mask]:
        """What each choice that was refused leaves out, and each turn of it: one of that must be measured."""
        turns = range(0, self.problem.steps, self.covering.repeats_after)
        return [self.problem.allowed & ~np.roll(each, turn, axis=0) for each in self.refused for turn in turns]

    def _undetected_ends(self, chosen: Mask, level: float, keys: list[Key]) -> list[Key]:
        """Hidden trajectories and ends that a choice does not see, spread out."""
        known, fresh = set(keys), []
        at, sensor = np.nonzero(chosen)
        for a, trajectory in enumerate(self.pool.trajectories):
            if trajectory.reach < level:
                continue
            ends = np.flatnonzero(self.pool.proven(trajectory, at, sensor) >= level)
            if self.oracle.few:
                size = self.covering.sizes(trajectory, ends, level)
                ends = ends[size == size.min(initial=self.problem.allowed.size)]
            ends = ends[np.round(np.linspace(0, ends.size - 1, min(SPREAD_ENDS, ends.size))).astype(np.intp)]
            fresh += [(a, int(e)) for e in ends if (a, int(e)) not in known]
        return fresh

    def judged(self, chosen: Mask, level: float) -> bool:
        """Polish a choice, judge it, and keep what trajectories it, or it."""
        for trial in (chosen, self.polished(chosen)):
            worst, trajectories = self.oracle.judge(trial, above=max(level, self.worst))
            self.add(trajectories, level)
            if worst <= level:
                worst = self.deepened(trial, worst, level)
            better = worst < self.worst if self.worst > 1 or self.chosen is None else worst <= level
            if better and worst < np.inf:
                self.keep(trial, worst)
            if worst <= level:
                return True
        if trajectories:
            self._add_less_observable(max(trajectories, key=lambda a: a.reach), level, trial)
        return False

    def _add_less_observable(self, trajectory: HiddenTrajectory, level: float, known: Mask) -> None:
        """Keep a trajectory like one that `known` does not see, which less of what may be measured sees."""
        if not self.oracle.few:
            self.add_weakly_observable(trajectory.goal, trajectory.end + self.problem.steps, level, known)
        else:
            for each in (trajectory, *self.oracle.in_other_gaps(known, trajectory, level)):
                self.pool.add(narrowed(self.oracle, each, level))

    def deepened(self, chosen: Mask, worst: float, enough: float, patience: int = 1) -> float:
        """How bad a choice is if one looks farther back, and so for all others from then on.

        The past is doubled until that adds nothing, so many times in a row, or the choice is as bad as `enough`.
        """
        idle, kept = 0, self.oracle.back
        while idle < patience and worst < enough and not self.late and self.oracle.lengthen_past(chosen):
            now, trajectories = self.oracle.judge(chosen)
            idle, kept = (idle + 1, kept) if now <= worst * (1 + SETTLED) else (0, self.oracle.back)
            worst = max(now, worst)
            self.add(trajectories, 0.0)
        self.oracle.back = kept
        return worst

    def keep(self, chosen: Mask, worst: float) -> None:
        """Remember the best choice."""
        self.chosen, self.worst = chosen, worst
        self.incumbents.append((chosen, worst))
        self.progress.found(chosen, worst)

    def polished(self, chosen: Mask) -> Mask:
        """Move one measurement at a time to where the trajectories so far prove least, while that gains."""
        at, sensor = np.nonzero(self.problem.allowed)
        options = list(zip(at.tolist(), sensor.tolist(), strict=True))
        if self.stochastic:
            return self._exchanged(chosen, options)
        best = self.pool.against(chosen)[0]
        if not options or not self.pool.trajectories:
            return chosen
        for _ in range(2):
            before = best
            for i, j in zip(*np.nonzero(chosen), strict=True):
                rest = chosen.copy()
                rest[i, j] = False
                values = self._swapped(rest, options)
                for o in np.argsort(values, kind="stable")[:20].tolist():
                    if values[o] >= best * (1 - 1e-6):
                        break
                    trial = rest.copy()
                    trial[options[o]] = True
                    if self.problem.is_admissible(trial):
                        chosen, best = trial, float(values[o])
                        break
            if best >= before * (1 - 1e-3):
                break
        return chosen

    def _thinned(self, chosen: Mask, worst: float, level: float) -> tuple[Mask, float]:
        """A choice that keeps standard deviations, without what it can do without once the others are moved."""
        if not self.stochastic:
            return chosen, worst
        assert self.oracle.grid_filter is not None
        options = [(int(i), int(j)) for i, j in zip(*np.nonzero(self.problem.allowed), strict=True)]
        while chosen.any(axis=1).sum() > 1 and not self.late:
            fewer = np.repeat(chosen[None], int(chosen.sum()), axis=0)
            fewer[np.arange(len(fewer)), *np.nonzero(chosen)] = False
            left = self.oracle.grid_filter.worst(fewer).max(axis=1)
            even = self._even(int(chosen.any(axis=1).sum()) - 1)
            below = self.problem.cost(chosen) * (1 - SAME_PRICE)
            tries = [fewer[k] for k in np.argsort(left, kind="stable")[:THINNED].tolist()] + even
            for trial in tries:
                if self.problem.cost(trial) >= below:
                    continue
                trial = self._exchanged(trial, options, below)
                value = float(self.oracle.grid_filter.worst(trial[None]).max())
                if value <= level and self.oracle.hidden(trial) is None and self.problem.is_admissible(trial):
                    chosen, worst = trial, value
                    break
            else:
                break
        return chosen, worst

    def _even(self, count: int) -> list[Mask]:
        """So many samples as even as can be, where all is allowed."""
        if not self.free or count < 1:
            return []
        chosen = np.zeros(self.problem.allowed.shape, dtype=bool)
        chosen[np.round(np.arange(count) * self.problem.steps / count).astype(int)] = True
        return [chosen] if self.problem.is_admissible(chosen) else []

    def _swapped(self, rest: Mask, options: list[tuple[int, int]]) -> Array:
        """What the trajectories so far prove of a choice with each option added, counted."""
        ends = min(self.problem.steps, MOST_ENDS)
        trajectories = len(self.pool.trajectories)
        self.oracle.work.add((trajectories * WEIGHED[0], trajectories * WEIGHED[1]), ends * len(options))
        return self.pool.swaps(rest, options)

    def _exchanged(self, chosen: Mask, options: list[tuple[int, int]], below: float = np.inf) -> Mask:
        """Move one measurement at a time to where the standard deviations are least, for less than a cost."""
        assert self.oracle.grid_filter is not None
        best = float(self.oracle.grid_filter.worst(chosen[None]).max())
        for _ in range(2):
            before = best
            for i, j in zip(*np.nonzero(chosen), strict=True):
                rest = chosen.copy()
                rest[i, j] = False
                trials = []
                for o in options:
                    trial = rest.copy()
                    trial[o] = True
                    if not rest[o] and self.problem.is_admissible(trial) and self.problem.cost(trial) < below:
                        trials.append(trial)
                few = trials[:: max(1, -(-len(trials) // MOST_SWAPS))]
                if not few or self.late:
                    break
                values = self.oracle.grid_filter.worst(np.array(few)).max(axis=1)
                if values.min() < best * (1 - 1e-6):
                    chosen, best = few[int(np.argmin(values))], float(values.min())
            if best >= before * (1 - 1e-3):
                break
        return chosen

    def cheapest(self, level: float, rounds: int, below: float = np.inf) -> None:
        """The least cost at a level: the cheapest choices that see every trajectory, until one of them holds.

        Where a choice of the cost `below` is held already, only what is cheaper.
        """
        keys = self.keys
        best, fruitless = self._started(level) if below == np.inf else below, 0
        for _ in range(rounds):
            self.progress.say(f"{len(self.pool.trajectories)} trajectories")
            if self.late:
                return
            chosen, none = self._one_by_one(level, best) or self._candidate(keys, level, best)
            if chosen is None or self.problem.cost(chosen) >= best * (1 - 1e-9):
                self.complete = best < np.inf and (none or chosen is not None)
                self.out_of_reach = max(self.out_of_reach, level if none and best == np.inf else 0.0)
                return
            if self.late and self.chosen is not None:  # cut short: what a longer search would never look at
                return
            more = self.repaired(chosen, level, best) if fruitless < FRUITLESS or not self.oracle.few else None
            fruitless = 0 if more is not None else fruitless + 1
            for trial in (chosen, more):
                if trial is None or self.problem.cost(trial) >= best:
                    continue
                worst, trajectories = self._judged(trial, level)
                if worst <= level:
                    self.incumbents.append((trial, worst))
                    trial, worst = self._thinned(trial, worst, level)
                    best = self.problem.cost(trial)
                    self.keep(trial, worst)
                elif trajectories:
                    trajectory = max(trajectories, key=lambda a: a.reach)
                    self._add_less_observable(
                        trajectory, 1 / EASED**2 if trajectory.reach > 1 + level * 1e-3 else level, trial
                    )

    def _one_by_one(self, level: float, below: float) -> tuple[Mask | None, bool] | None:
        """The best choice below a cost that keeps a level, or that there is none: each judged by the filter.

        None where they are too many, or those that keep it are not admissible. No tangent refutes what nothing drives
        and what grows; its filter, which begins with nothing known, does.
        """
        grid_filter = self.oracle.grid_filter
        if grid_filter is None or not self.stochastic or below == np.inf:
            return None
        if level >= self.too_many[0] and below >= self.too_many[1]:
            return None
        trials = open_choices(self.covering, grid_filter, level, below)
        if trials is None and not self.oracle.work.over:
            self.too_many = level, below
        if not trials:
            return None if trials is None else (None, True)
        worst = grid_filter.worst(np.array(trials)).max(axis=1)
        for k in np.argsort(worst, kind="stable").tolist():
            if worst[k] <= level and self.problem.is_admissible(trials[k]) and self.oracle.hidden(trials[k]) is None:
                return trials[k], False
        return (None, True) if worst.min() > level else None

    def _started(self, level: float) -> float:
        """The least cost of the choices to start with that keep a level; infinite if none does."""
        best = np.inf
        for trial in self.starts:
            if self.problem.cost(trial) >= best:
                continue
            worst, _ = self._judged(trial, level)
            if worst <= level:
                best = self.problem.cost(trial)
                self.keep(trial, worst)
        return best

    def _judged(self, trial: Mask, level: float) -> tuple[float, list[HiddenTrajectory]]:
        """How far the worst one reaches, looked at closely where that keeps a level, and all that were found."""
        worst, trajectories = self.oracle.judge(trial, above=level)
        self.add(trajectories, level)
        return (self.deepened(trial, worst, level) if worst <= level else worst), trajectories

    def repaired(self, chosen: Mask, level: float, dearest: float) -> Mask | None:
        """Add the measurement that hides least of what is left open, until the trajectories so far are seen."""
        options = [(int(i), int(j)) for i, j in zip(*np.nonzero(self.problem.allowed), strict=True)]
        trial = chosen.copy()
        for _ in range(self.problem.steps):
            worst, trajectories = self.oracle.judge(trial, above=level)
            self.add(trajectories, level)
            if worst <= level:
                return trial
            values = self._swapped(trial, options)
            for o in np.argsort(values, kind="stable").tolist():
                more = trial.copy()
                more[options[o]] = True
                if not trial[options[o]] and self.problem.is_admissible(more):
                    break
            else:
                return None
            if self.problem.cost(more) >= dearest:
                return None
            trial = self._exchanged(more, options, dearest) if self.stochastic else more
        return None

    def improve(self, rounds: int) -> None:
        """Most accurate: ask for a little less than the best so far until that is out of reach."""
        least = self.pool.against(self.problem.allowed)[0]
        while not self.late:
            lowest = max(self.out_of_reach, least * BELOW)
            if self.worst <= lowest * (1 + NARROW):  # both are 0 where nothing drives what is wanted
                self.complete = lowest > 0
                return
            level = max(self.worst * (1 - STEP), (self.worst + lowest) / 2 if lowest else 0.0)
            answer = self.decide(level, rounds)
            if answer is None:
                return
