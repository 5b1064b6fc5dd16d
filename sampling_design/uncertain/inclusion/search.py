"""The programs of one plant that is not exactly known: members that bind, short decimals, and the proof.

Programs of a stiff plant: rates from below one to millions per gap.

What a fast state may weigh falls with its rate, so that the entries of P differ by as many decades as the rates do. Two
things bring the numbers back to about 1. The flow condition F > 0 is posed in the coordinates of its own size, as
N^-1/2 F N^-1/2 with N the size of A + A' (a congruence: nothing is changed but what a solver sees). And the coordinates
of P are found in turns: the slackest P under a bound, then the coordinates in which it is about I, then again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from sampling_design.certificates.exact.proof import as_proven
from sampling_design.certificates.families.certify_family import LONGEST_PROOF
from sampling_design.certificates.form.claims import INCLUSION_CLAIM
from sampling_design.certificates.form.verdict import Verification
from sampling_design.certificates.rigorous.decide import judged_while_sought
from sampling_design.errors import ArgumentError
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Budget
from sampling_design.records.record import Plain, SolverRecord
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate
from sampling_design.uncertain.inclusion.members import INFLATED, InclusionPlants, layout_of
from sampling_design.uncertain.inclusion.program import (
    SMALLEST,
    InclusionData,
    InclusionProgram,
    InclusionSolution,
    flow_scale,
    flow_slacks,
    in_coordinates,
    jump_slacks,
    worst_violated,
)

Posing = Callable[[Array], tuple[InclusionData, Array]]
Solver = Callable[[InclusionProgram], tuple[Array | None, float, SolverRecord]]

TURNS = 6  # turns in which coordinates are found
SLACK_ENOUGH = 0.2  # slack, relative to the terms of the flow condition, from which on another turn gains little
STIFF_ROUNDS = 12
STIFF_JOINING = 8
"""Members that join at once, and how often."""
STAGES = ((0.0, False), (0.3, False), (1.0, False), (1.0, True))
"""Coordinates are found first for members near their middle, then for those that begin, then for all that join."""
DRAWN, LEAST_DRAWN = 0.6, 0.92
"""Power of lambda that is asked for in the next turn; where that is not there, its root, up to the last one."""
LEAST_SLACK = 0.05
"""A P(tau) of less slack is not drawn together further: its proof would need cells that are too small."""


def fitted(
    search: InclusionPlants, posing: Posing, T: Array, solve: Solver, share: float, join: bool
) -> tuple[InclusionSolution, float, Array] | None:
    """Solve for the members chosen, drawn to their mean; those that the solution violates join until none does.

    The solution, in coordinates where its bound W, with W <= P <= lambda W, is I; its slack; and the coordinates where
    the mean of its P is I.
    """
    for _ in range(STIFF_ROUNDS):
        if search.budget.over:
            return None
        posed, _T = posing(T)
        posed = drawn(search, posed, share)
        some = replace(posed, dynamics=posed.dynamics[search.chosen] if share else posed.dynamics[:1],
                       outputs=posed.outputs[:, search.chosen_outputs])  # fmt: skip
        program = search.program(some)
        x, slack, record = solve(program)
        if x is None:
            return None
        P, W = program.matrices(x), program.bound(x)
        if not np.all(np.linalg.eigvalsh(P if W is None else [*P, W])[:, 0] > 0):
            return None
        if join:
            bad = worst_violated(flow_slacks(posed, P), search.chosen, STIFF_JOINING)
            hidden = worst_violated(jump_slacks(posed, P, program.gains(x)), search.chosen_outputs, STIFF_JOINING)
            added = adversaries(search, posed, P, T)
            if len(added):
                count = len(search.members.dynamics)
                everyone = np.concatenate([search.members.dynamics, added])
                search.members = search.members._replace(dynamics=everyone)
                bad += range(count, len(everyone))
            search.chosen, search.chosen_outputs = (
                sorted({*search.chosen, *bad}),
                sorted({*search.chosen_outputs, *hidden}),
            )
            if bad or hidden:
                continue
        root = np.linalg.cholesky(np.mean(P, axis=0))
        own = np.asarray(root if W is None else np.linalg.cholesky(W), dtype=np.float64)
        gains = np.zeros((0, 0, 0))
        found = InclusionSolution(some.turned(own), in_coordinates(P, own), T @ own, None, gains, record)
        return found, slack, T @ root
    return None


def drawn(search: InclusionPlants, posed: InclusionData, share: float) -> InclusionData:
    """Members drawn to their mean by a share, and moved outwards by the search's inflation."""
    if search.hull is not None and share == 1:  # whose directions are inflated instead
        return posed
    middle = posed.dynamics.mean(axis=0)
    return replace(posed, dynamics=middle + share * (1 + search.inflation) * (posed.dynamics - middle))


def adversaries(search: InclusionPlants, posed: InclusionData, P: Array, T: Array) -> Array:
    """Corners of the hull's cells at which the flow condition fails most, found by turns of vector and signs."""
    if search.hull is None:
        return np.zeros((0, *search.members.dynamics.shape[1:]))
    n, scale = posed.n, flow_scale(posed)
    both, slope = posed.slopes(P)
    far = (1 + search.inflation) * search.hull.moves
    M, D = (search.moved(X, T)[..., None, :, :] for X in (search.hull.middle, far))

    def forms(X: Array) -> Array:
        drift, off = both @ X[..., :n], -(both @ X[..., n:])
        corner = -(drift + np.swapaxes(drift, -1, -2))
        empty = np.zeros((*off.shape[:-2], off.shape[-1], off.shape[-1]))
        full = np.concatenate(
            [np.concatenate([corner, off], -1), np.concatenate([np.swapaxes(off, -1, -2), empty], -1)], -2
        )
        return np.asarray(scale.T @ full @ scale)

    still = np.zeros((len(both), n + posed.Qw.shape[0], n + posed.Qw.shape[0]))
    still[:, :n, :n], still[:, n:, n:] = -(slope + posed.eta * both), posed.Qw
    F, FD = scale.T @ still @ scale + forms(M), forms(D)
    values, vectors = np.linalg.eigh(F)
    signs = np.zeros(FD.shape[:3])
    for _ in range(TURNS):
        v = vectors[..., 0]
        signs = np.where(np.einsum("dkeij,kei,kej->dke", FD, v, v) > 0, -1.0, 1.0)
        values, vectors = np.linalg.eigh(F + np.einsum("dke,dkeij->keij", signs, FD))
    least = values[..., 0]
    found: dict[tuple[int, bytes], Array] = {}
    for at in np.argsort(least, axis=None)[: 4 * STIFF_JOINING]:
        k, e = np.unravel_index(at, least.shape)
        if least[k, e] < 0 and len(found) < STIFF_JOINING:
            sign = signs[:, k, e]
            found[int(k), sign.tobytes()] = search.hull.middle[k] + np.tensordot(sign, far[:, k], 1)
    return np.array(list(found.values())).reshape(len(found), *search.hull.middle.shape[1:])


def solve_stiff(search: InclusionPlants, eta: float, pieces: int, narrow: bool) -> InclusionSolution | None:
    """A P(tau) of large slack, or the narrowest that leaves some."""

    def posing(T: Array) -> tuple[InclusionData, Array]:
        return search.inner(eta, pieces, T)

    best: InclusionSolution | None = None
    T = search.inner(eta, pieces)[1]
    for share, join in STAGES:
        before = 0.0
        for _ in range(TURNS):
            found = fitted(search, posing, T, InclusionProgram.slackest, share, join)
            if found is None:
                return None
            best, slack, T = found
            if slack > SLACK_ENOUGH or slack < 1.2 * before:
                break
            before = slack
    power = DRAWN
    while narrow and best is not None and best.lam > 1.05 and power < LEAST_DRAWN:
        ratio = float(best.lam**power)
        found = fitted(search, posing, T, partial(InclusionProgram.within, ratio=ratio), 1.0, True)
        if found is None or found[1] < LEAST_SLACK or not found[0].lam < 0.98 * best.lam:
            power = float(np.sqrt(power))
        else:
            best, _, T = found
    return best


NARROWINGS, NARROW_ENOUGH = 12, 0.995
"""Turns in which P(tau) is drawn together; a turn that leaves lambda above this part of the last is the last."""
HIGHER = 1.0, 1e2, 1e4
"""Times the floor that the noise gain leaves P1: where the solver fails so near to a singular one, it is raised."""
ROUNDS = 12  # how often members that violate a solution may join the program
JOINING = 4  # members that join at once
DIGITS = (7, 9, 11, 15)  # decimals to which P is rounded, relative to its diagonal: the fewest that leave it proven
ROOM = 1e-6  # by which P1 and P2 stand off from P, relatively


Attempt = tuple[InclusionCertificate | None, Verification | None]


class InclusionSearch(InclusionPlants):
    """The programs of one plant, range of gaps and choice of weights, under a budget for lambda."""

    def solve(self, eta: float, pieces: int, narrow: bool = True) -> InclusionSolution | None:
        """The narrowest P(tau) found; None if there is none. Members that it violates join until none does."""
        posed, T = self.inner(eta, pieces)
        if self.stiff:
            return solve_stiff(self, eta, pieces, narrow)
        for _ in range(ROUNDS):
            if self.budget.over:
                return None
            found = self._solve_once(posed, T, narrow)
            if found is None:
                return None
            own = replace(posed, dynamics=self.inflated(posed)).turned(np.asarray(np.linalg.solve(T, found.T)))
            bad, hidden = list[int](), list[int]()
            if len(self.chosen) < len(self.members.dynamics):
                bad = worst_violated(flow_slacks(own, found.P), self.chosen, JOINING)
            if len(self.chosen_outputs) < posed.outputs.shape[1]:
                hidden = worst_violated(jump_slacks(own, found.P, found.gains), self.chosen_outputs, JOINING)
            if not bad and not hidden:
                return found
            self.chosen, self.chosen_outputs = sorted({*self.chosen, *bad}), sorted({*self.chosen_outputs, *hidden})
        return None

    def _solve_once(self, posed: InclusionData, T: Array, narrow: bool) -> InclusionSolution | None:
        dynamics = self.inflated(posed)[self.chosen]
        some = replace(posed, dynamics=dynamics, outputs=posed.outputs[:, self.chosen_outputs])
        search = self.program(some)
        floor, x, record = search.floor()
        if x is None:
            return None
        P = search.matrices(x)
        best = InclusionSolution(some, P, T, search.diagonals(x), search.gains(x), record)
        if not best.ends[0] > 0:  # a solver that was inaccurate
            return None
        if not narrow:
            return best
        current, basis = some, np.eye(some.n)
        for _ in range(NARROWINGS):
            if self.budget.over:
                break
            for higher in HIGHER:
                x, W, record = search.narrow(best.lam, floor * max(1 / self.noise_gain, SMALLEST) * higher)
                if x is not None:
                    break
            if x is None:
                break
            turn, P = np.asarray(np.linalg.cholesky(W)), search.matrices(x)
            current, basis = current.turned(turn), basis @ turn
            gains = search.gains(x) @ np.linalg.inv(turn).T
            found = InclusionSolution(current, in_coordinates(P, turn), T @ basis, search.diagonals(x), gains, record)
            if not found.ends[0] > 0:
                break
            done = found.lam > NARROW_ENOUGH * best.lam
            best = found if found.lam < (1 - ROOM) * best.lam else best  # less is rounding, and may cost information
            if done:
                break
            search = self.program(current)
        return best

    # --- from a solution to a certificate -----------------------------------------------------------------------------

    def certificate(
        self, found: InclusionSolution, eta: float, pieces: int, digits: int, seconds: float
    ) -> InclusionCertificate:
        """The certificate in physical coordinates and short decimals."""
        nodes = layout_of(self.graph, pieces).nodes
        P = rounded(found.T @ found.P @ found.T.T, digits)
        shape, (low, high) = found.T @ found.T.T, found.ends
        P1, P2 = rounded((1 - ROOM) * low * shape, digits + 1), rounded((1 + ROOM) * high * shape, digits + 1)
        lam = float(f"{(1 + 10 * ROOM) * found.lam:.9g}")
        details: dict[str, Plain] = {
            "pieces": found.posed.pieces.size,
            "members": len(found.posed.dynamics),
            "digits": digits,
        }
        solver = replace(found.record, seconds=seconds, details={**found.record.details, **details})
        model = self.plant
        return InclusionCertificate(
            self.centre, self.schedules, P1=P1, P2=P2, **self.weights._asdict(), eta=eta,
            lam=max(lam, 1.0), lam_samples=max(lam, 1.0), solver=solver,
            model=model, model_data=model.model_to_dict(), nodes=nodes, P=P, graph=self.graph,
            multipliers=self._multipliers(found),
        )  # fmt: skip

    def _multipliers(self, found: InclusionSolution) -> Array | None:
        """Those of physical columns, in short decimals."""
        if self.columns is None or found.diagonals is None:
            return None
        own = found.diagonals / (self.longest * self.sizes**2)
        return np.array([float(f"{x:.9g}") for x in own.ravel().tolist()]).reshape(own.shape)

    def proven(self, eta: float, pieces: int, began: Budget) -> Attempt:
        """A certificate that has passed, or the verdict on the last one that did not; neither if nothing was found."""
        if self.members.complete:
            return self._attempt(eta, pieces, began, (0.0,), DIGITS, len(DIGITS))
        verdict: Verification | None = None
        for hulled in (True, False) if self.stiff else (False,):
            if hulled and not self.enter_hull(eta):
                continue
            made, found = self._attempt(eta, pieces, began, INFLATED[1:2] if hulled else INFLATED, DIGITS[1:], 1)
            if hulled:
                self.leave_hull()
            if made is not None:
                return made, None
            verdict = found or verdict
        return None, verdict

    def _attempt(
        self,
        eta: float,
        pieces: int,
        began: Budget,
        inflated: tuple[float, ...],
        precisions: tuple[int, ...],
        proofs: int,
    ) -> Attempt:
        """The same for the members as they are, moved outwards by these shares; at most so many proofs of each."""
        verdict: Verification | None = None
        for inflation in inflated:
            self.inflation = inflation
            found = self.solve(eta, pieces)
            if found is None:
                continue
            tried = 0
            for digits in precisions:
                try:
                    made = self.certificate(found, eta, pieces, digits, began.spent)
                except ArgumentError:  # so few decimals leave P or its bounds indefinite in the plant's own coordinates
                    continue
                last = proofs > 1 and digits == precisions[-1]
                verdict = judged_while_sought(made.content, INCLUSION_CLAIM, LONGEST_PROOF if last else 0.0)
                if verdict.passed:
                    return accepted(made), None
                tried += 1
                if tried == proofs:
                    break
        return None, verdict


def accepted(made: InclusionCertificate) -> InclusionCertificate:
    """A certificate that was proven, on its way out: where all of them can be watched (tests/kept_certificates.py)."""
    return as_proven(made)


def rounded(P: Array, digits: int) -> Array:
    """Short decimals: each entry to `digits` digits of the root of its diagonal entries' product."""
    d = np.sqrt(np.einsum("...ii->...i", P))
    places = digits - 1 - np.floor(np.log10(d[..., :, None] * d[..., None, :])).astype(int)
    entries = [
        round(x, k)
        for x, k in zip(((P + np.swapaxes(P, -1, -2)) / 2).ravel().tolist(), places.ravel().tolist(), strict=True)
    ]
    return np.array(entries).reshape(P.shape)
