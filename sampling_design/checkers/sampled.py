"""Claim "assumption-7": the weights hold on one schedule, for every real window start and every later time.

It proves Pi = Y^-1 >= target from Y(start) = P2^-1 on, that is Y <= I in the coordinates of `frame.py`:
1. Between samples Y' = F Y'(0) F', Y'' likewise: on a step of length d, Y <= its end + d N where N >= -Y' all along,
   and Y <= chord + (d^2/8) N where N >= -Y''. So it is along the starts: where Y rises, the end of a cell covers it.
   Far below I a norm is enough: with |e^{As}| <= e^{mu s}, Y(s) <= e^{2 mu d} (|Y(0)| + d |S|) I.
2. With one window's gains, Y of another start is at most affine in its first value: two ends cover a cell of starts.
3. The recursion is monotone: a window below a family B_i that it maps below itself need not be followed any further,
   and none at all where the flow alone takes a multiple of I below itself, since samples only lower Y.
"""

from functools import cached_property

import numpy as np

from .frame import Flows, Frame, dominating, largest, least, size, turned
from .numbers import EPS, RESOLUTION, Problem, problem, targets
from .outcome import Refused, Undecided, Verdict, WorkLimit, holds
from .parts import Claim
from .schedule_file import NEAR, SAMPLED, Sampled, Times, Witness, of_schedule
from .strict import Array, Index, Mask

LOW = 0.75  # what the norm alone shows to stay below this is not looked at closer: it leaves as much slack
REPLAY = 1e-6  # what a witness may miss of its ratio
CELLS = 4  # start cells per gap at first
ROUNDS = 60  # halvings of a cell or of a time step: below the resolution of a double
MAX_OPEN = 100_000  # open cells or steps at once
PERIODS = 1000  # along one window
ALONE = 20  # along one that has no family to fall below: it proves nothing, but may fail
SETTLING = 200  # until a family has settled: jumps bring it there, or nothing does
SUSPECTS = 200  # windows at once in which a violation is looked for: those of the largest Y
JUMP = 3  # periods that are followed until it is asked where their gains would settle: slow plants take no longer
LOST = 1e6  # where the target is I: what comes here with more noise does not come back
INFLATION = 1e-2  # noise added per sample, where the target is I, to find the family B_i; then less and less


def prove(c: Sampled, work: WorkLimit | None = None) -> Verdict:
    """Prove P1 and lam over all real starts, lam_samples over sample starts, and the witness."""
    numbers, w = problem(c.plant, c.weights), c.weights
    stated = targets(numbers, w.margin, numbers.P1, w.lam)
    inequality = " and ".join(name for _, name in stated)
    if not numbers.n:
        return holds(inequality, 1.0, c.schedule.windows)
    for k in (0, 1):  # a target that lies below the other is proven with it
        if len(stated) == 2 and least(stated[1 - k][0] - stated[k][0]) >= 0:
            stated.pop(k)
    slack = min(Windows(numbers, c.schedule, target, name, work).prove() for target, name in stated)
    if w.lam_samples < w.lam:  # else it is proven with lam
        name = "(1 - 1e-3) P2 <= lam_samples Pi(t), sample starts"
        Windows(numbers, c.schedule, (1 - RESOLUTION) * numbers.P2 / w.lam_samples, name, work).prove(samples=True)
    replay(c, work)
    return holds(inequality, slack, c.schedule.windows)


def replay(c: Sampled, work: WorkLimit | None = None) -> None:
    """Raise Refused unless the witness, if there is one, reaches its ratio."""
    if c.witness is not None:
        numbers = problem(c.plant, c.weights)
        Windows(numbers, c.schedule, numbers.P2, "witness", work).attained(c.witness)


def settled(whole: Array, added: Array, Y: Array) -> Array:
    """The sum of whole^k added whole'^k, where Y -> whole Y whole' + added settles; Y where it does not."""
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(ROUNDS):
            more = whole @ added @ whole.T
            added, whole = added + more, whole @ whole
            if not np.isfinite(added).all():
                return Y
            if np.all(np.abs(more) <= EPS * np.abs(added)):
                return (added + added.T) / 2
    return Y


class Windows(Frame):
    """Proof of Y <= I along one schedule, for one target."""

    def __init__(
        self, numbers: Problem, schedule: Times, target: Array, inequality: str, work: WorkLimit | None = None
    ) -> None:
        super().__init__(numbers, target, inequality, schedule.measured, work)
        self.schedule, self.N, self.gaps = schedule, schedule.gaps.size, schedule.gaps
        self.times, self.reach = schedule.times, schedule.reach
        self.longer = self.gaps * (1 + 4 * EPS)  # a difference of two times is rounded
        self.reached = 0.0

    @cached_property
    def once(self) -> Flows:
        """The flows of the gaps."""
        return self.flow(self.gaps)

    def stretch(self, U: Array, duration: Array) -> Mask:
        """For each U: is F U F' + W <= I proven all along `duration`? Halves the time steps that are not yet."""
        good, owner, step = np.ones(len(U), bool), np.arange(len(U)), np.array(duration, float)
        left = largest(U, 0.5)
        good[~(left <= self.one)] = False
        for _ in range(ROUNDS):
            low = self.risen_to(left, step)
            self.reached = max(self.reached, low[low <= LOW].max(initial=0.0))
            kept = good[owner] & ~(low <= LOW)
            U, owner, step, left = U[kept], owner[kept], step[kept], left[kept]
            if not owner.size or owner.size > MAX_OPEN:
                break
            self.spend(2 * owner.size)
            later = self.moved(U, step)
            right = largest(later, 0.5)
            bound = np.maximum(left, right) + self.curvature(U, step)
            close = ~(bound <= self.one) & (right <= self.one)
            if close.any():
                self.spend(4 * int(close.sum()))
                bound[close] = self.covered(U[close], later[close], step[close], self.one)
            self.reached = max(self.reached, bound[bound <= self.one].max(initial=0.0))
            good[owner[~(right <= self.one)]] = False
            kept = ~(bound <= self.one)
            U, owner, step, left = U[kept], owner[kept], step[kept], left[kept]
            U = np.concatenate([U, self.moved(U, step / 2)])
            middle = largest(U[len(left) :], 0.5)
            good[owner[~(middle <= self.one)]] = False
            owner, step, left = np.tile(owner, 2), np.tile(step / 2, 2), np.append(left, middle)
        good[owner] = False
        return good

    def prove(self, samples: bool = False) -> float:
        """Prove Y <= I from all real starts (or from sample starts only) to all later times; return the slack."""
        if (bound := self.invariant_bound()) is not None:
            return float(self.one - bound)
        schedule, Y, E = self.schedule, self.start[None], self.start_band[None]
        last = np.array([self.reach.argmax()])
        if not (before := self.stretch(Y, self.reach[last])[0]):
            self.violated(Y, E, self.reach[last], self.times[last] - self.reach[last], np.zeros(1))
        family, index = self.family(), np.repeat(np.arange(self.N), CELLS)
        low, high = (self.reach[index] * ((np.arange(index.size) % CELLS + k) / CELLS) for k in (0, 1))
        if samples:
            index = np.append(np.arange(self.N), 0)
            low = high = np.append(self.gaps, schedule.first)
        for _ in range(ROUNDS if before else 0):
            left = ~self.windows(index, high, low, family)
            if not left.any():
                return float(self.one - self.reached)
            # without B_i no period closes
            if samples or index.size > MAX_OPEN or (family is None and schedule.periodic):
                break
            index, low, high = np.tile(index[left], 2), low[left], high[left]
            low, high = np.append(low, (low + high) / 2), np.append((low + high) / 2, high)
        raise self.undecided("it is tight or nearly so")

    def windows(self, index: Index, high: Array, low: Array, family: Array | None) -> Mask:
        """For each cell of starts: is Y <= I proven from sample `index` on? Refused if the start `high` violates it."""
        m, flows = index.size, self.flow(np.concatenate([high, low]))
        (Y, other), lost = np.split(self.along(self.start, flows)[0], 2), self.along(self.start, flows)[1][:m]
        E = flows.F[:m] @ self.start_band @ turned(flows.F[:m]) + 2 * lost
        U, at, good, alive = (
            self.starts(Y, other, low, high, flows[np.arange(m, 2 * m)]),
            index,
            high >= low,
            np.arange(m),
        )
        start, since = self.times[index] - high, high.copy()
        for _ in range((PERIODS if family is not None else ALONE) * self.N):
            self.spend(3 * at.size)
            K, both = self.gain(Y, at), self.gain(U.mean(axis=0), at)
            U, (Y, left, lost), before = self.after(U, at, both)[0], self.after(Y, at, K), Y
            E = self.band_after(E, before, at, K, left, lost)
            going = np.ones(at.size, bool) if self.schedule.periodic else at + 1 < self.N
            if family is not None:
                going &= least(family[at] - U).min(axis=0) < 0
            Y, E, U, alive, since = Y[going], E[going], U[:, going], alive[going], since[going]
            at = (at[going] + 1) % self.N
            ends = U.reshape(-1, self.n, self.n)
            closed = self.stretch(ends, np.tile(self.longer[at], 2)).reshape(2, -1).all(axis=0)
            open_ones = ~closed
            if open_ones.any():
                begun = start[alive[open_ones]]
                self.violated(Y[open_ones], E[open_ones], self.gaps[at[open_ones]], begun, since[open_ones])
                good[alive[open_ones]] = False
            if not closed.any():
                return good
            at, alive, since = at[closed], alive[closed], since[closed] + self.gaps[at[closed]]
            flows = self.once[at]
            U, (Y, lost) = self.along(U[:, closed], flows)[0], self.along(Y[closed], flows)
            E = flows.F @ E[closed] @ turned(flows.F) + 2 * lost
        good[alive] = False
        return good

    def starts(self, Y: Array, other: Array, low: Array, high: Array, flows: Flows) -> Array:
        """Two ends for each cell of starts: whatever is affine below I at both is so all over the cell.

        Y is where the window from `high` before the sample comes to, `other` that from `low`, `flows` over `low`.
        """
        length = high - low
        if not length.any():
            return np.stack([Y, other])
        d = length[:, None, None] * (1 + 1e-9)
        bulge = d**2 / 8 * self.carried(self.bending(other), length)
        # Y(r) <= Y(high) + int_low^high e^{As} N e^{A's} ds, N >= -Y'(0): nothing where Y rises from the start on
        falling, none = self.slope(self.start), np.zeros_like(self.start)
        fallen = self.doubled(length, (falling, none))
        whole = fallen.W + dominating((fallen.wrong_W + turned(fallen.wrong_W)) / 2)
        moved = self.along(whole, Flows(flows.F, np.zeros_like(whole), flows.wrong_F, np.zeros_like(whole)))[0]
        one = (np.einsum("kii->k", moved) <= np.einsum("kii->k", bulge))[:, None, None]
        return np.stack([Y + np.where(one, moved, bulge), np.where(one, Y + moved, other + bulge)])

    def violated(self, Y: Array, E: Array, duration: Array, start: Array, since: Array) -> None:
        """Refused if some true Y exceeds I along `duration`, which begins `since` after its window's start."""
        if len(Y) > SUSPECTS:
            worst = np.argsort(-np.einsum("kii->k", Y), kind="stable")[:SUSPECTS]
            Y, E, duration, start, since = Y[worst], E[worst], duration[worst], start[worst], since[worst]
        self.spend(33 * len(Y))
        flows = self.flow(np.outer(duration, np.arange(33) / 32))
        moved, lost = self.along(np.repeat(Y, 33, axis=0), flows)
        values = np.linalg.eigvalsh(moved)[:, -1]
        band = size(flows.F @ np.repeat(E, 33, axis=0) @ turned(flows.F) + 2 * lost) + 8 * self.n * EPS * size(moved)
        sure = np.where(values - band > 2 - self.one, values, 0.0).reshape(-1, 33)
        if not np.any(sure > 1):
            if np.any(values > self.one):  # no finer cell of starts is without this window
                raise self.undecided("it is tight or nearly so, or rounding hides one window")
            return
        row, column = divmod(int(np.argmax(sure)), 33)
        begin = float(start[row] + (self.schedule.period if start[row] < 0 and self.schedule.periodic else 0.0))
        time = float(begin + since[row] + duration[row] * column / 32)
        amount, where = float(1 / sure.max() - 1), f"at time {time:.6g} in the window from {begin:.6g}"
        reason = f"{self.inequality} fails by {-amount:.3g} {where}"
        raise Refused(self.inequality, reason, amount, time, begin)

    def family(self) -> Array | None:
        """B_i after each sample, which the recursion maps below itself and which stays below I; None if not found."""
        N, after, worst, inflation = self.N, (np.arange(self.N) + 1) % self.N, np.float64(3.0), 10 * INFLATION
        once = self.once
        while inflation > 1e-12:
            inflation *= min(0.1, 0.3 / worst)
            Z, Y = np.zeros((N, self.n, self.n)), self.start
            for turn in range(1, (SETTLING if self.schedule.periodic else 1) + 1):
                before, whole, added = Y, self.I, np.zeros_like(self.I)
                self.spend(N * 8)
                for i in range(N):
                    moved = once.F[i] @ Y @ once.F[i].T + once.W[i]
                    # after the sample: what an exact output leaves could not hide the rounding of its own proof
                    after_it, left, _ = self.after(moved, i, self.gain(moved, i))
                    M, later = left @ once.F[i], after_it + inflation * self.I
                    whole, added = M @ whole, M @ added @ M.T + (later - M @ Y @ M.T)
                    Z[i] = Y = later
                if not np.linalg.norm(Y) < LOST:
                    break
                if np.linalg.norm(Y - before) <= inflation / 2:  # then one period maps Z below itself
                    break
                if turn % JUMP == 0:
                    Y = settled(whole, added, Y)
            if not np.linalg.norm(Y) < LOST:  # less noise may still be borne
                worst = np.float64(3.0)
                continue
            worst = max(largest(Z).max(), largest(self.along(Z, once[after])[0]).max())
            for scale in (1 / worst) ** np.array([0.95, 0.8, 0.5, 0.2, 0.0]) if worst < 1 else ():
                B = scale * Z
                moved = self.along(B, once[after])[0]
                below = least(B[after] - self.after(moved, after, self.gain(moved, after))[0]) >= 0
                closed = below & self.stretch(B, self.longer[after])
                if closed[: None if self.schedule.periodic else -1].all():
                    return np.asarray(B)
        return None

    def attained(self, witness: Witness) -> None:
        """Replay the witness: x'P2x / x'Pi(t)x at its start, time and direction must reach the stated ratio."""
        schedule, x = self.schedule, self.L.T @ (witness.direction / self.problem.units)
        now, t, stated = witness.start, witness.t, witness.ratio
        first = int(now / schedule.period) if schedule.periodic else 0
        turns = np.arange(first, int(t / schedule.period) + 2) if schedule.periodic else np.zeros(1)
        times, Y, E = (self.times + schedule.period * turns[:, None]).ravel(), self.start, self.start_band
        begin, end = now + NEAR * t, t - NEAR * t
        for k in np.flatnonzero((times > now) & (times < t)):
            self.spend(4)
            if times[k] <= begin:  # by rounding alone it is in the window, which begins after it
                now = float(times[k])
                continue
            if times[k] >= end:
                t = float(times[k])
                break
            Y, E = self.later(Y, E, times[k] - now)
            K = self.gain(Y, k % self.N)
            (Y, left, lost), before = self.after(Y, k % self.N, K), Y
            E, now = self.band_after(E, before, k % self.N, K, left, lost), times[k]
        Y, E = self.later(Y, E, t - now)
        ratio, doubt = self.ratio(Y, E, x)
        if not doubt < REPLAY / 2:
            raise Undecided("witness", f"the witness reaches {ratio:.6g}, but rounding leaves {doubt:.1g} of it open")
        if not ratio >= stated * (1 - REPLAY):
            raise Refused("witness", f"the witness reaches {ratio:.6g}, not {stated:.6g}", ratio / stated - 1, t)

    def later(self, Y: Array, E: Array, duration: float) -> tuple[Array, Array]:
        """Y and its band after that time."""
        flows = self.flow([duration])[0]
        (Y, lost), F = self.along(Y, flows), flows.F
        return Y, F @ E @ F.T + 2 * lost

    def ratio(self, Y: Array, E: Array, x: Array) -> tuple[float, float]:
        """x'x / x'Y^-1 x for the true Y within its band, and what rounding leaves open of it, relative."""
        if not np.isfinite(E).all():
            raise self.undecided("the rounding along the witness is beyond doubles")
        z = np.linalg.solve(Y, x)
        rest = x - Y @ z
        lowest = float(least(Y - E))
        if not lowest > 0:
            raise self.undecided("the information along the witness is beyond doubles")
        wrong = float(z @ E @ z + np.abs(z @ rest) + 2 * rest @ rest / lowest)
        wrong += 4 * self.n * EPS * float(np.abs(z) @ (np.abs(Y) @ np.abs(z) + np.abs(x)))
        return float(x @ x / (x @ z)), wrong / float(x @ z)


CLAIM = Claim(SAMPLED, of_schedule, prove)
