"""The worst time of each row over the schedule: where the highest bound stands, its program is solved."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from sampling_design.accuracy.adversary_program import Adversary, ConeWindow, boxed
from sampling_design.accuracy.between_samples import NEGLIGIBLE, KnownIntegrals, RowBetweenSamples, RowSearch, open_row
from sampling_design.accuracy.bounded_directions import BoundedDirections, combined
from sampling_design.accuracy.bounds import InitialSet
from sampling_design.accuracy.gains import Gains, centre_offset, evaluated, filtered, filtered_along, transferred_gains
from sampling_design.accuracy.sampled_system import CELL_LOSS, SampledSystem
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget

FINEST = 1e-5  # least share that a disturbance constant on cells may lose by the curvature of e^{As}G

COARSE = 2e-2  # the same where only gains are wanted: what they prove is second order in it, whatever the cells
SHARE = 0.75  # of the tolerance, within which both sides of one target must meet; the rest is for times between targets
PROFILE = 1.05  # ratio of the two bounds at which a gap's profile counts as known
APART = 20.0  # ratio of the two bounds from which on one adversary of its own is sought for a row, whatever is left
FILLED = 24  # offsets solved for the profile of one row, though two for each gap at least
ADVERSARIES = (8, 32)  # sought for the profile of one row, where one of them is a large program and a small one
ADVERSARIES_LONG = 3  # adversaries and targets solved, where windows are as long as the filter's memory
SMALL = 20000  # states times states and entries of w, all along the window, of a small program
TAIL = 64  # samples back to which gains that are put together go on as the filter's, at most
PROGRAM, FITTED = (1e-3, 8e-6), (1e-3, 2e-8)
"""Counted: a cone program, and each unknown of it; a gap's offsets for known directions, and each of both and state."""

POSED, EVALUATED, OPENED = (6e-4, 1.5e-5), (3e-4, 1.6e-5), 6e-4
"""The same: a window, and each sample of it; what gains prove, and each sample that they go back; a row on a gap."""

STRETCH = 32  # panels of a gap at the highest of which gains are put together at once
FOLLOWED = 8  # states from which on that costs less than the programs that it saves
TOLERANCE, ROUGH = 1e-7, 1e-5  # asked of the solver: what both sides prove is second order in it; for gains alone
DIGITS, LARGEST = 0.02, 1e-4  # share of a bracket's width that a large program's two sides may part by, and the most
LASTING = 32  # a filter's memory, in samples, from which on the search begins with windows as long as it
LONGEST = 4096  # samples back beyond which the past is not followed
LARGEST_WINDOW = 2**19  # entries of flows and cells of w along a window beyond which it is not, either: a GB
FADING = 256  # the same where nothing is attained: a drift is known twice as well from twice as many samples, for ever

CLOSER = 0.1
"""Share of what parts two sides that longer gains must take away where nothing drives a mode: all directions that it
turns through are then solved anew, and what is attained may be as far below for ever."""


class GainSearch:
    """Windows of a system, made once for each phase; after each sample the directions and adversaries found so far."""

    def __init__(
        self,
        system: SampledSystem,
        directions: Sequence[BoundedDirections],
        solved: Callable[[], None] = lambda: None,
        budget: Budget = ENDLESS,
    ):
        self.system, self._tell, self.budget = system, solved, budget
        self._windows: dict[tuple[int, int, bool, bool, bool, bool], ConeWindow] = {}
        self.back = self.deep = 8
        self.cell_loss = CELL_LOSS
        self._few_digits: float | None = None  # tolerance of large programs
        self.solves = 0
        self._repeats = False  # whether what has gone on for ever may change within a period of the samples
        self._enough: set[int] = set()  # depths that twice as many samples did not improve on
        self.directions = directions
        self.adversaries: list[list[Adversary]] = [[] for _ in range(len(system.samples))]
        self._forgets = system.start is None and not system.undriven
        self.follows = self._forgets and system.D.size >= FOLLOWED
        self._tail = min(system.memory, TAIL) if self.follows else 1
        self._long = self._forgets and system.memory > LASTING and boxed(system, list(range(len(system))))
        if self._long:
            self.deep, self.back = system.memory, system.memory // 2

    @cached_property
    def _coarse(self) -> SampledSystem:
        return self.system.refined(COARSE)

    def idle(self, j: int) -> Adversary:
        """An adversary that does nothing up to sample j."""
        return Adversary(0.0, (), np.zeros((1, self.system.D.size)), j, self.system)

    def offset(self, found: RowSearch, j: int, place: int) -> float:
        """What the estimate of a row at an offset adds since bounds are not centred at 0."""
        return centre_offset(
            self.system, found.row, j, float(found.opened[j].d[place]), self._gains_at(found, j, place)
        )

    def _gains_at(self, found: RowSearch, j: int, place: int) -> tuple[Array, ...]:
        bounds, mu = self.system.bounds, found.opened[j].mu[place]
        if bounds.w_centre is None and bounds.v_centre is None:
            return ()
        known = self.directions[j]
        at = known.find(mu)
        if at is None:
            return self.window(j, self.back, False).gains(mu).gains
        size = float(mu @ known.mu[at] / (known.mu[at] @ known.mu[at]))
        return tuple(size * lam for lam in known.gains[at].gains)

    def past(self, j: int, count: int, from_zero: bool) -> tuple[list[int], InitialSet]:
        """The last samples up to j, and what is known before the first of them."""
        nodes = self.system.nodes(j, count)
        if self.system.start is not None:
            if self.system.sample_of(nodes[0]) and not from_zero and not self.directions[nodes[0]].whole:
                nodes = self.system.nodes(j, len(self.system))
            if not self.system.sample_of(nodes[0]):
                return nodes, self.system.start
        if from_zero:
            return nodes, InitialSet.box(np.zeros(self.system.D.size))
        known = self.system.reach[nodes[0]] if self.system.start is None else self.directions[nodes[0]].reach
        return nodes, InitialSet.box(known)

    def window(self, j: int, count: int, from_zero: bool, rough: bool = True, lasting: bool = False) -> ConeWindow:
        """The window of `count` samples, or the most, that ends with sample j."""
        repeats, system = lasting and self._repeats and not rough, self._coarse if rough else self.system
        each = max((gap.F.size + gap.cells.size for gap in system.gaps), default=1)
        count = min(count, max(LARGEST_WINDOW // each, 1))
        key = (j, count, from_zero, rough, lasting, repeats)
        if key not in self._windows:
            nodes, start = self.past(j, count, from_zero)
            begun = (system.repeating(nodes[0]) if repeats else system.lasting) if lasting else None
            tolerance = ROUGH if rough and self.follows and not from_zero else TOLERANCE
            self.budget.add(POSED, len(nodes))
            self._windows[key] = ConeWindow(system, nodes, start, tolerance, begun, self._few_digits)
        return self._windows[key]

    def gains(self, j: int, mu: Array, enough: float = 0.0) -> Gains:
        """Gains for mu'z_j over `back` samples, kept with the direction; good ones, if they prove `enough`."""
        window = self._solving(self.window(j, self.back, False))
        gains = window.gains(mu, enough)
        if self._tail > self.back:
            gains = min(gains, self.followed(j, mu, gains.gains), key=lambda one: one.value)
        self.directions[j].add(mu, gains)
        return gains

    def _solving(self, window: ConeWindow) -> ConeWindow:
        """A window about to be solved, counted."""
        self.solves += 1
        self._tell()
        self.budget.add(PROGRAM, window.entries / self.system.D.size)
        return window

    def sketch(self, j: int, mu: Array) -> None:
        """Keep the filter's gains for rows of mu (m, n), where no others prove more; no solver."""
        nodes = self.system.nodes(j, TAIL)
        found = filtered(self.system, nodes, lambda k: self._bounded(nodes[k]), mu.T)
        self.directions[j].extend(mu, self.evaluate(j, mu[: len(found)], [each.gains for each in found]))

    def sketch_rows(self, rows: Collection[RowSearch]) -> None:
        """Once the budget is spent: the same for rows far from what is attained, at the ends and tops of gaps."""
        wanted = dict[int, Array]()
        for j in self.system.judged if self.budget.over else ():
            mu = []
            for found in rows:
                nodes = np.where(np.isfinite(found.nodes[j]), found.nodes[j], 0.0)
                if nodes.max() > PROFILE * found.lower:
                    mu.append(found.opened[j].mu[[0, int(np.argmax(nodes)), -1]])
            if mu and (self.system.start is None or j >= TAIL) and j < len(self.system):
                wanted[j] = np.vstack(mu)
            elif mu:
                self.sketch(j, np.vstack(mu))
        self.budget.spend(sum(EVALUATED) * len(wanted))
        for j, gains in filtered_along(self.system, TAIL, self._bounded, wanted):
            self.directions[j].extend(wanted[j], gains)

    def _bounded(self, node: int) -> Array | None:
        """Bounds on |z| after a node, if all of it is known."""
        if self.system.start is None and node < len(self.system):
            return np.asarray(self.system.reach[node])
        return self.directions[node].reach if self.directions[node].whole else None

    def both_sides(self, j: int, mu: Array, rough: bool = False) -> tuple[Gains, Adversary]:
        """An adversary against mu'z_j over `deep` samples, and the gains that come with it; both are kept."""
        found, adversary = self.oppose(j, mu, rough)
        self.directions[j].add(mu, gains := self.followed(j, mu, found.gains))  # when the past is endless
        return gains, adversary

    def oppose(self, j: int, mu: Array, rough: bool = False) -> tuple[Gains, Adversary]:
        """The same, of which only the adversary is kept: what the gains prove is for its own window.

        From rest, or where that leads nowhere or w does not reach all modes, from what has gone on for ever.
        """
        system, lasting = self.system, self.system.lasting
        from_rest = lasting is None or (bool(system.G.any()) and not system.undriven)
        gains, adversary = self._solving(self.window(j, self.deep, from_rest, rough, not from_rest)).both(mu)
        if from_rest and lasting is not None and adversary.value <= 0:
            from_rest = False
            gains, begun = self.window(j, self.deep, False, rough, True).both(mu)
            adversary = max(adversary, begun, key=lambda one: one.value)
        if not from_rest and lasting is not None:
            for_ever = self.window(j, 1, False, rough, True).both(mu)[1]  # as modes do, whenever samples come
            adversary = max(adversary, for_ever, key=lambda one: one.value)
        self._keep(j, adversary)
        return gains, adversary

    def _keep(self, j: int, adversary: Adversary) -> None:
        """Keep an adversary, and what it is at the samples of the last period on its way."""
        count = len(adversary.z)
        rests = self.system.start is None and not adversary.z[0].any()
        nodes = self.system.latest(j, count)
        for k in range(max(int(rests), count - len(self.system)), count):
            part = replace(adversary, value=0.0, w=adversary.w[:k], z=adversary.z[: k + 1], sample=nodes[k])
            self.adversaries[nodes[k]].append(part)

    def evaluate(self, j: int, mu: Array, gains: Sequence[tuple[Array, ...]]) -> list[Gains]:
        """What any gains, each for its row of mu'z_j, mu (m, n), prove; no solver."""
        branch = len(self.system.nodes(j, 0))  # samples of which some results are out, which are beside the count
        found = dict[int, Gains]()
        for count in dict.fromkeys(map(len, gains)):
            nodes, start = self.past(j, max(count - branch, 1), False)
            missing = [np.zeros(len(self.system.samples[node].H)) for node in nodes[: len(nodes) - count]]
            own = [k for k, each in enumerate(gains) if len(each) == count]
            self.budget.add(EVALUATED, len(nodes))
            filled = [[*missing, *gains[k]] for k in own]
            found |= zip(own, evaluated(self.system, nodes, start, mu[own], filled), strict=True)
        return [found[k] for k in range(len(gains))]

    def followed(self, j: int, mu: Array, gains: tuple[Array, ...], after: int | None = None) -> Gains:
        """The same, with the filter's gains for the past beyond theirs; of those of another direction after a node."""
        system, k = self.system, j if after is None else after
        nodes, start = self.past(j, max(len(gains) - len(system.nodes(j, 0)), self._tail), False)
        if (k == j and len(nodes) <= len(gains)) or not start.whole:
            return self.evaluate(j, mu[None], [gains])[0]
        self.budget.add(EVALUATED, 2 * len(nodes))
        gains = transferred_gains(system, nodes, mu, system.latest(k, len(gains)), gains)
        return evaluated(system, nodes, start, mu[None], [gains])[0]

    def improve(self, j: int, mu: Array, best: float, below: float, rtol: float) -> bool:
        """Whether longer windows, or finer cells, bring the two sides of one target closer; if so they stay."""
        steps = [self._repeated, self._deeper, self._longer, self._finer]
        if self._long:  # windows are as long as the filter's memory already
            steps.reverse()
        return any(step(j, mu, best, below, rtol) for step in steps)

    def _repeated(self, j: int, mu: Array, best: float, below: float, rtol: float) -> bool:
        """Whether what has gone on for ever does that changes within a period of the samples."""
        if self._repeats or not self.system.undriven:
            return False
        self._repeats = True
        return self.oppose(j, mu)[1].value > below * (1 + rtol / 8)

    def _deeper(self, j: int, mu: Array, best: float, below: float, rtol: float) -> bool:
        """Whether adversaries that start earlier do."""
        if 2 * self.deep > (LONGEST if below > 0 else FADING) or self.deep in self._enough:
            return False
        self.deep *= 2
        gains, adversary = self.both_sides(j, mu)
        if adversary.value > below * (1 + rtol / 8) or gains.value < best * (1 - rtol / 8):
            return True
        self.deep //= 2
        self._enough.add(self.deep)
        return False

    def _longer(self, j: int, mu: Array, best: float, below: float, rtol: float) -> bool:
        """Whether gains of more samples do; what nothing drives may need all that its filter remembers."""
        back, undriven = self.back, self.system.undriven
        most = (LONGEST if below > 0 else FADING) if undriven else self.deep
        worth = max(best * rtol / 8, (best - below) * CLOSER * undriven)
        for longer in sorted({2 * back, min(self.system.memory, FADING)} if undriven else {2 * back}):
            if back < longer <= most:
                self.back = longer
                if self.gains(j, mu).value < best - worth:
                    return True
        self.back = back
        return False

    def _finer(self, j: int, mu: Array, best: float, below: float, rtol: float) -> bool:
        """Whether finer cells do."""
        if self.cell_loss <= FINEST:
            return False
        self.cell_loss /= 4
        self.system = self.system.refined(self.cell_loss)
        self._windows.clear()
        gains, adversary = self.both_sides(j, mu)
        target = min(best * (1 - rtol), below * (1 + rtol / 8))
        return adversary.value >= target or gains.value < best * (1 - rtol / 8)

    def opened(self, row: Array, gaps: dict[int, RowBetweenSamples] | None = None) -> RowSearch:
        """A row over the schedule, as far as directions and adversaries against other rows tell; `gaps` if known.

        Once the budget is spent directions wait until all rows are known, which is when `gaps` are.
        """
        known: KnownIntegrals = {}
        rushed = gaps is None and self.budget.over
        self.budget.spend(OPENED * len(self.system.judged))
        gaps = gaps or {j: open_row(self.system, j, row, known=known) for j in self.system.judged}
        bounds = {j: gap.bound(self.directions[j].bare if rushed else self.directions[j]) for j, gap in gaps.items()}
        nodes, panels = ({j: both[side] for j, both in bounds.items()} for side in (0, 1))
        found = RowSearch(row, gaps, nodes, panels, {j: {} for j in gaps})
        found.lower = max(self._reached(found, j) for j in gaps)
        return found

    def below(self, found: RowSearch, j: int) -> Array:
        """The same, infinite where the row is not known."""
        return np.where(np.isfinite(found.nodes[j]), self.attained(found, j), np.inf)

    def _reached(self, found: RowSearch, j: int) -> float:
        return float(np.max(self.attained(found, j)[np.isfinite(found.nodes[j])], initial=0.0))

    def attained(self, found: RowSearch, j: int) -> Array:
        """What adversaries attain against a row at the offsets of gap j."""
        opened = found.opened[j]
        ends = np.array([adversary.end for adversary in self.adversaries[j]]).reshape(-1, self.system.D.size)
        return np.asarray(opened.below + np.max(np.abs(ends @ opened.mu.T), axis=0, initial=0.0))

    def row(self, row: Array, rtol: float, most: int) -> RowSearch:
        """Bracket the worst time of one row to `rtol`, with at most so many solves."""
        found = self.opened(row)
        self._few_digits = min(LARGEST, rtol * DIGITS)
        limit = self.solves + most
        found.size = float(np.abs(row * self.system.D).sum())
        while True:
            top, j, panel = self.top(found)
            found.upper, found.worst = top, (j, panel)
            if top <= (NEGLIGIBLE * found.size if found.idle else found.lower * (1 + rtol)):
                found.closed = True
                return found
            if self.solves >= limit:
                return found
            if self.budget.over:
                if found.lower > (0.0 if found.tried else top / APART):
                    return found
                self._both_sides_at(found, j, panel, rough=True)  # one, so that the bracket says something
                limit = self.solves
                continue
            ends = np.where(np.isfinite(found.nodes[j]), found.nodes[j], 0.0)[panel : panel + 2]
            offset = panel + int(ends[1] > ends[0])
            high, at, peak = self._highest(found)
            enough = max(high, found.lower * (1 + rtol * SHARE))
            shallow = high > 0 and found.solved[at][peak] < self.back
            if shallow and high > found.lower * (1 + rtol * SHARE):
                self._node(found, at, peak)
            elif top > high * (1 + 0.9 * rtol * (1 - SHARE)) and self._promising(found, j, offset, enough):
                if self._combined(found, j, offset, enough) > enough:
                    self._node(found, j, offset, enough)
            elif shallow:
                self._node(found, at, peak)
            elif not self._close(found, *((high, at, peak) if high > 0 else (top, j, offset)), rtol):
                return found

    def top(self, found: RowSearch) -> tuple[float, int, int]:
        """The highest bound, its gap and panel; what is not known at all does not count."""
        tops = ((high, j, k) for j in found.panels for high, k in [found.top(j)])
        return max(tops, default=(0.0, 0, 0))

    def _highest(self, found: RowSearch) -> tuple[float, int, int]:
        """The largest bound at a solved offset, its sample and the offset."""
        return max(
            ((float(found.nodes[j][offset]), j, offset) for j, solved in found.solved.items() for offset in solved),
            default=(0.0, 0, 0),
        )

    def _close(self, found: RowSearch, high: float, j: int, offset: int, rtol: float) -> bool:
        """Whether an adversary at an offset, or better windows, brought its two sides closer.

        Where they are close already and one was sought there before, what is left is the panels' own width.
        """
        again, lower = (j, offset) in found.tried, found.lower
        below, above = self._both_sides_at(found, j, offset)
        if below * (1 + rtol * SHARE) >= high:
            return not again or found.lower > lower
        if above < high * (1 - rtol / 8):  # a longer past says more
            self.back = min(2 * self.back, self.deep)
            return True
        rest = float(found.opened[j].below[offset])
        best = above - float(found.opened[j].above[offset])
        done = self.improve(j, found.opened[j].mu[offset], best, 0.0 if found.idle else below - rest, rtol)
        self._refresh(found, j)
        return done

    def _promising(self, found: RowSearch, j: int, offset: int, enough: float) -> bool:
        """Whether gains at an offset may lower a bound there, which is not the width of its panel alone."""
        any_solved = self.follows and any(map(bool, found.solved.values()))
        untried = (j, offset) not in found.combined and (bool(self.directions[j].gains) or any_solved)
        return offset not in found.solved[j] and (untried or float(found.nodes[j][offset]) > enough)

    def _combined(self, found: RowSearch, j: int, offset: int, enough: float = np.inf) -> float:
        """What the gains of the nearest directions prove together at an offset; no solver.

        Also at the highest offset above `enough` of each of `STRETCH` panels: they are all bounded anew after it.
        """
        if (j, offset) not in found.combined:
            nodes = found.nodes[j]
            parts = np.array_split(np.arange(nodes.size), max(1, nodes.size // STRETCH)) if enough < np.inf else []
            tops = [int(part[np.argmax(nodes[part])]) for part in parts]
            tops = [o for o in tops if enough < nodes[o] < np.inf and o != offset and (j, o) not in found.combined]
            found.combined.update((j, o) for o in [offset, *tops])
            self.directions[j].extend(*self._guessed(found, j, [offset, *tops]))
            self._refresh(found, j)
        return float(found.nodes[j][offset])

    def _guessed(self, found: RowSearch, j: int, offsets: list[int]) -> tuple[Array, list[Gains]]:
        """Gains at offsets of gap j, from those of its own directions and of the gap where one is solved nearest.

        With the rows of mu'z_j, mu (m, n), that they are for.
        """
        own, directions = found.opened[j], self.directions[j]
        mu = own.mu[offsets]
        made = combined(self.system, j, mu, directions) if directions.gains else []
        if not self.follows:
            return mu[: len(made)], self.evaluate(j, mu[: len(made)], made)
        guessed = [(row, self.followed(j, row, gains)) for row, gains in zip(mu, made, strict=False)]
        others = {k: solved for k, solved in found.solved.items() if solved and k != j and self.directions[k].gains}
        for row, d in zip(mu, own.d[offsets], strict=True):
            apart = {k: min(abs(found.opened[k].d[o] - d) for o in solved) for k, solved in others.items()}
            for k in sorted(apart, key=apart.__getitem__)[:1]:
                opened = found.opened[k]
                target = opened.mu[[int(np.argmin(np.abs(opened.d - d)))]]
                gains = combined(self.system, k, target, self.directions[k])[0]
                guessed.append((row, self.followed(j, row, gains, k)))
        return np.array([row for row, _ in guessed]).reshape(-1, mu.shape[1]), [gains for _, gains in guessed]

    def _node(self, found: RowSearch, j: int, offset: int, enough: float = 0.0) -> None:
        opened = found.opened[j]
        self.gains(j, opened.mu[offset], enough - float(opened.above[offset]))
        found.solved[j][offset] = self.back
        self._refresh(found, j)

    def _refresh(self, found: RowSearch, j: int) -> None:
        self.budget.add(FITTED, len(found.opened[j].d) * len(self.directions[j].gains) * self.system.D.size)
        found.nodes[j], found.panels[j] = found.opened[j].bound(self.directions[j])
        found.lower = max(found.lower, self._reached(found, j))

    def _both_sides_at(self, found: RowSearch, j: int, offset: int, rough: bool = False) -> tuple[float, float]:
        """Seek an adversary at an offset; what is attained there, and what gains prove there now."""
        self.both_sides(j, found.opened[j].mu[offset], rough)
        found.tried.add((j, offset))
        found.solved[j].setdefault(offset, self.back)
        self._refresh(found, j)
        return float(self.attained(found, j)[offset]), float(found.nodes[j][offset])

    def profile(self, found: RowSearch) -> None:
        """Smooth the upper curve, then seek an adversary in every gap where the two bounds are furthest apart."""
        if found.idle:
            return
        gaps, n, cells = list(found.opened), self.system.D.size, [gap.cells for gap in self._coarse.gaps]
        small = self.deep * n * (n + float(np.mean([len(own) * own.shape[2] for own in cells] or [0]))) < SMALL
        for j in gaps:
            if self.budget.over:
                return
            known = PROFILE * float(self.attained(found, j)[0]) if self._long else 0.0
            if 0 in found.solved[j] or not known < found.nodes[j][0] < np.inf:
                continue
            if small or not any(found.solved.values()):
                self._node(found, j, 0, known)
            else:
                self._combined(found, j, 0)
        if self._long:
            self._rough_profile(found)
            return
        slack = {j: found.slack(j) for j in gaps}  # a solve on one gap changes that of no other
        for _ in range(max(FILLED, 2 * len(gaps))):
            ratio, j, offset = max((r, j, o) for j, (r, o) in slack.items())
            if ratio <= PROFILE or self.budget.over:
                break
            if (j, offset) in found.combined or not self.directions[j].gains:
                self._node(found, j, offset)
            else:
                self._combined(found, j, offset)
            slack[j] = found.slack(j)
        for _ in range(ADVERSARIES[small]):
            ratio, j, offset = max((r, j, o) for j in gaps for r, o in [self._apart(found, j)])
            if ratio <= PROFILE or self.budget.over:
                break
            deep = self.deep
            self.deep = deep if small else min(deep, self.back)
            self._both_sides_at(found, j, offset, rough=True)
            self.deep = deep

    def _rough_profile(self, found: RowSearch) -> None:
        """Seek adversaries and gains where the two bounds are furthest apart, a few times each."""
        deep, self.deep = self.deep, self.back
        for both in [True] * ADVERSARIES_LONG + [False] * ADVERSARIES_LONG:
            ratio, j, offset = max((r, k, o) for k in found.opened for r, o in [self._apart(found, k)])
            if ratio <= PROFILE or self.budget.over:
                break
            found.tried.add((j, offset))
            if both:
                self._both_sides_at(found, j, offset, rough=True)
            elif self._combined(found, j, offset) > PROFILE * float(self.attained(found, j)[offset]):
                self._node(found, j, offset, PROFILE * float(self.attained(found, j)[offset]))
        self.deep = deep

    def _apart(self, found: RowSearch, j: int) -> tuple[float, int]:
        """The largest ratio of the two bounds on gap j where no adversary was sought, and its offset."""
        best, top = self.attained(found, j), np.where(np.isfinite(found.nodes[j]), found.nodes[j], 0.0)
        ratio = np.divide(top, best, out=np.full_like(top, np.inf), where=best > 0)
        ratio[top == 0] = 0.0
        ratio[[o for at, o in found.tried if at == j]] = 0.0
        offset = int(np.argmax(ratio))
        return float(ratio[offset]), offset
