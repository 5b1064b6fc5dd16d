"""Family certificates in ball arithmetic: every edge and node of the graph, all gaps of its interval included.

Edge u -> v: with any gain K, (I - KC) Y(h) (I - KC)' + K V K' <= P_v^-1 proves Phi_h(P_u) + C'R~C >= P_v; with one K
per cell of h the left side lies below its chord plus |I - KC|^2 times the bulge of Y. A node: the same without sample.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from sampling_design.certificates.rigorous.ball_problem import (
    BallFrame,
    BallWeights,
    StatedInequality,
    positive_definite,
)
from sampling_design.checkers.cover import judge
from sampling_design.checkers.families import SUBJECT
from sampling_design.checkers.family_file import OfFamily
from sampling_design.checkers.outcome import Refused, Undecided, Verdict, holds
from sampling_design.numerics import balls
from sampling_design.numerics.balls import HALVINGS, Ball, Matrix, ball
from sampling_design.numerics.branch_and_bound import all_proven
from sampling_design.records.budget import Budget

Pattern = tuple[bool, ...]

Stretch = tuple[Matrix, Ball, Ball, int]


class BallIntervals:
    """Proofs of Y <= I after a sample of some outputs, or without one, for all times of an interval."""

    def __init__(
        self, weights: BallWeights, target: Matrix, patterns: list[tuple[bool, ...]], name: str, clock: Budget
    ) -> None:
        masks = [np.array(pattern, dtype=bool) for pattern in patterns]
        self.frame = BallFrame(weights, masks, target, name)
        self.patterns, self.name, self.clock, self.reached = patterns, name, clock, 0.0

    def prove(self, P: Matrix, pattern: Pattern | None, low: Fraction, high: Fraction) -> None:
        """Raise Refused unless it holds from information P for all times in [low, high]."""
        frame, flow = self.frame, self.frame.flow
        which = None if pattern is None or not any(pattern) else self.patterns.index(pattern)
        start = frame.L.transpose() * P.solve(frame.L)
        first, length = balls.rational(low), balls.rational(high - low)

        def parts_of(stretch: Stretch) -> list[Stretch]:
            Y, at, length, depth = stretch
            bound = self._bound(Y, length, which)
            if bound <= 1:
                self.reached = max(self.reached, float(bound))
                return []
            middle = flow.step(Y, length / 2)
            self._refute(Y, at, which)
            self._refute(middle, at + length / 2, which)
            if depth >= HALVINGS or not length > 0:
                raise Undecided(self.name, f"{self.name} could not be decided: it is tight or nearly so")
            return [(middle, at + length / 2, length / 2, depth + 1), (Y, at, length / 2, depth + 1)]

        all_proven([(flow.step(start, first), first, length, 0)], parts_of, self.clock, 150 + frame.n**3)

    def _bound(self, Y: Matrix, length: Ball, which: int | None) -> Ball:
        """A number that Y (after the sample) stays below along `length`."""
        frame, flow = self.frame, self.frame.flow
        end, slope = flow.step(Y, length), ball(1.0)
        bulge = flow.reach(length) * balls.positive_part(balls.largest(-flow.second(Y)))
        ends = [Y, end]
        if which is not None:
            K = frame.gain((Y + end) / 2, which)
            ends = [frame.with_gain(part, which, K) for part in ends]
            slope = balls.spectral(frame.identity - K * frame.rows[which]) ** 2
        return (balls.largest(ends[0]).max(balls.largest(ends[1])) + slope * bulge).upper()

    def _refute(self, Y: Matrix, at: Ball, which: int | None) -> None:
        """Raise Refused if it certainly fails at one time."""
        left = Y if which is None else self.frame.sampled(Y, which)
        if left is not None and balls.definite(self.frame.identity - left) is False:
            amount = 1 / float(np.linalg.eigvalsh(balls.floats(left))[-1]) - 1
            reason = f"{self.name} fails by {-amount:.3g} at gap {float(at):.6g}"
            raise Refused(self.name, reason, amount=amount, time=float(at))


def family(c: OfFamily, stated: list[StatedInequality], clock: Budget) -> Verdict:
    """Prove that the graph holds the family, and every edge and node."""
    graph = c.graph
    judge(c.family, graph)
    weights = BallWeights(c.plant, c.weights)
    P = [weights.P2, *(balls.symmetric(node) for node in graph.P[1:])]
    for u, node in enumerate(P):
        positive_definite(f"P_{u}", node)
    slack = 1.0
    patterns = sorted({edge.outputs for edge in graph.edges if any(edge.outputs)})
    for v in sorted({edge.target for edge in graph.edges}) if weights.n else ():
        into = BallIntervals(weights, P[v], patterns, f"Phi_h(P_u) + C'R~C >= P_{v}", clock)
        for edge in graph.edges:
            if edge.target == v:
                into.prove(P[edge.source], edge.outputs, Fraction(edge.low), Fraction(edge.high))
        slack = min(slack, 1.0 - into.reached)
    for target, name, _ in stated:
        along = BallIntervals(weights, target, [], name, clock)
        for u, node in enumerate(P):
            along.prove(node, None, Fraction(0), Fraction(graph.top(u)))
        slack = min(slack, 1.0 - along.reached)
    names = " and ".join(each.name for each in stated) or "(1 + margin) P1 <= Pi(t)"
    return holds(names, slack, SUBJECT)
