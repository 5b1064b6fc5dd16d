"""The programs of one plant that is not exactly known: members that bind, short decimals, and the proof."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design._balance import balance
from sampling_design._record import Plain
from sampling_design.certificates.exact.riccati import periodic_riccati_solution
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.certificates.form.horizon import output_information
from sampling_design.certificates.form.verdict import Verification
from sampling_design.certificates.inclusion.inclusion_certificate import InclusionCertificate
from sampling_design.certificates.inclusion.program import InclusionProgram, Posed
from sampling_design.certificates.inclusion.stiff import FASTEST, flow_slacks, jump_slacks, pace, solve_stiff
from sampling_design.certificates.rigorous.decide import judged
from sampling_design.errors import SamplingDesignError
from sampling_design.evidence import SolverRecord
from sampling_design.plants.inclusion import Hull, LinearInclusion, Members
from sampling_design.schedules.gap_range import GapRange

Array = npt.NDArray[np.float64]

NARROWINGS = 3
"""Solutions of the program in which P(tau) is drawn together, each in the coordinates of the last."""
INFLATED = (0.002, 0.02, 0.1)
"""Share by which sampled members are pushed outwards, so that cells of the region need not be tiny."""
ROUNDS = 12
"""How often members that violate a solution may join the program."""
JOINING = 4
"""Members that join at once."""
HULL_CORNERS, HALVINGS = 10, 3
"""Directions of a set that holds all C whose corners are members; halvings of a stiff plant's region into cells."""
DIGITS = (7, 9, 11, 15)
"""Decimals to which P is rounded, relative to its diagonal: the fewest that leave it proven."""
ROOM = 1e-6
"""By which P1 and P2 stand off from P, relatively."""


class InclusionWeights(NamedTuple):
    """Physical weights of noise."""

    Qw: Array
    R: Array
    Qv: Array


@dataclass(frozen=True, eq=False)
class InclusionSolution:
    """A solution in inner coordinates, not proven: P at the nodes between s shape and q shape."""

    posed: Posed
    P: Array
    shape: Array
    low: float
    high: float
    T: Array
    diagonals: Array | None
    record: SolverRecord

    @property
    def lam(self) -> float:
        """q/s."""
        return self.high / self.low


class InclusionSearch:
    """The programs of one plant, range of gaps and choice of weights."""

    def __init__(
        self, plant: LinearInclusion, family: GapRange, weights: InclusionWeights, budget: float, seed: int = 0
    ) -> None:
        self.plant, self.family, self.weights, self.budget = plant, family, weights, budget
        self.centre = plant.centre
        self.members: Members = plant.members(np.random.default_rng(seed))
        self.columns, self.sizes = plant.columns, np.zeros(0)
        if self.columns is not None:  # multipliers stand for all members
            self.members = self.members._replace(dynamics=self.columns.middle[None], complete=True)
        self.chosen, self.shown = extreme(self.members.dynamics), extreme(self.members.outputs)
        self.inflation = 0.0 if self.members.complete else INFLATED[0]
        self.extra: list[Array] = []
        self._roots: dict[float, Array] = {}
        self._sampled = (self.members, self.chosen, self.shown)
        self.hull: Hull | None = None

    def inner(self, eta: float, pieces: int, T: Array | None = None) -> tuple[Posed, Array]:
        """The program in inner coordinates, and the T with P = T P_inner T': by default that of the rate."""
        a, b = self.family.shortest, self.family.longest
        nodes = np.linspace(0.0, 1.0, pieces + 1)
        near = int(np.argmin(np.abs(nodes - a / b)))
        if near in (0, pieces) and 0 < a < b:
            nodes = np.insert(nodes, 1 if near == 0 else pieces, a / b)
        elif a < b:
            nodes[near] = a / b
        first = int(np.searchsorted(nodes, a / b * (1 - 1e-12)))
        T = self._coordinates(eta) if T is None else T
        inverse = np.linalg.inv(T)
        Rt = output_information(self.weights.R, self.weights.Qv)
        root_w, root_y = np.linalg.cholesky(self.weights.Qw), np.linalg.cholesky(Rt)
        n = self.centre.n_states
        M = np.concatenate([self.members.dynamics, *(extra[None] for extra in self.extra)])
        A = b * (T.T @ M[:, :, :n] @ inverse.T)
        G = np.sqrt(b) * (T.T @ M[:, :, n:] @ np.linalg.inv(root_w).T)
        outputs = root_y.T @ self.members.outputs @ inverse.T
        unit = inverse @ np.diag(1 / self.centre.states.scales**2) @ inverse.T
        q, p = G.shape[2], len(root_y)
        columns = seen = np.zeros((0, 0))
        if self.columns is not None:
            to_w = np.linalg.inv(root_w).T / np.sqrt(b)  # of inner disturbances in physical ones
            axes = np.vstack([np.hstack([inverse.T, np.zeros((n, q))]), np.hstack([np.zeros((q, n)), to_w])])
            seen = axes[list(self.columns.at)]
            self.sizes = np.linalg.norm(seen, axis=1)
            columns, seen = b * (T.T @ self.columns.add) * self.sizes, seen / self.sizes[:, None]
        posed = Posed(
            dynamics=np.concatenate([A, G], axis=2), outputs=outputs, centre=root_y.T @ self.centre.C @ inverse.T,
            Qw=np.eye(q), Rt=np.eye(p), unit=unit, eta=eta * b, nodes=nodes, first=first,
            columns=columns, seen=seen,
        )  # fmt: skip
        return posed, T

    def _coordinates(self, eta: float) -> Array:
        """The coordinates of a rate, found once."""
        if eta not in self._roots:
            self._roots[eta] = self._root(eta)
        return self._roots[eta]

    def _root(self, eta: float) -> Array:
        """A root of the information that the nominal plant keeps; of its balance where there is none."""
        if self.stiff:
            return pace(
                self.members.dynamics.mean(axis=0)[:, : self.centre.n_states],
                self.centre.states.scales,
                self.family.longest,
            )
        try:
            prior = np.diag(1 / self.centre.states.scales**2)
            problem = window_problem(self.centre, self.family.nominal, prior, *self.weights, eta)
            Y = np.mean(periodic_riccati_solution(problem), axis=0)
            root = np.linalg.solve(np.linalg.cholesky(Y), np.diag(1 / self.centre.states.scales)).T
            if np.all(np.isfinite(root)) and np.linalg.cond(root) < 1e12:
                return np.asarray(root)
        except (SamplingDesignError, np.linalg.LinAlgError):
            pass  # the centre alone may have no certificate, or none at this rate
        return np.diag(1 / balance(self.centre.A).d)

    def solve(self, eta: float, pieces: int, narrow: bool = True) -> InclusionSolution | None:
        """The narrowest P(tau) found; None if there is none. Members that it violates join until none does."""
        posed, T = self.inner(eta, pieces)
        if self.stiff:
            fit = solve_stiff(self, eta, pieces, narrow)
            return (
                None
                if fit is None
                else InclusionSolution(fit.posed, fit.P, np.eye(posed.n), *fit.ends, fit.T, None, fit.record)
            )
        for _ in range(ROUNDS):
            found = self._once(posed, T, narrow)
            if found is None:
                return None
            worst, unseen = self._violated(posed, found), self._hidden(posed, found)
            if not worst and not unseen:
                return found
            self.chosen, self.shown = sorted({*self.chosen, *worst}), sorted({*self.shown, *unseen})
        return None

    def _once(self, posed: Posed, T: Array, narrow: bool) -> InclusionSolution | None:
        dynamics = self._pushed(posed)[self.chosen_now(posed)]
        some = replace(posed, dynamics=dynamics, outputs=posed.outputs[self.shown])
        search = InclusionProgram(some)
        floor, x, record = search.floor()
        if x is None:
            return None
        P = search.matrices(x)
        best = self._found(some, P, np.eye(some.n), T, search.diagonals(x), record)
        if not narrow:
            return best
        current, basis = some, np.eye(some.n)
        for _ in range(NARROWINGS):
            turn = np.linalg.cholesky(np.mean(P, axis=0))
            current, basis = current.turned(turn), basis @ turn
            search = InclusionProgram(current)
            x, _, record = search.narrow(np.eye(some.n), best.lam, floor / self.budget)
            if x is None:
                break
            P = search.matrices(x)
            found = self._found(current, P, np.eye(some.n), T @ basis, search.diagonals(x), record)
            better = found.lam < best.lam
            done = found.lam > 0.98 * best.lam
            best = found if better else best
            if done:
                break
        return best

    def chosen_now(self, posed: Posed) -> list[int]:
        """Members in the program: those that were chosen, and points of the region that a proof has named."""
        return [*self.chosen, *range(len(self.members.dynamics), len(posed.dynamics))]

    def _pushed(self, posed: Posed) -> Array:
        """Members pushed away from their middle."""
        M = posed.dynamics
        middle = (M.max(axis=0) + M.min(axis=0)) / 2
        return np.asarray(middle + (1 + self.inflation) * (M - middle))

    @staticmethod
    def _found(
        posed: Posed, P: Array, shape: Array, T: Array, diagonals: Array | None, record: SolverRecord
    ) -> InclusionSolution:
        values = np.linalg.eigvalsh(P)
        return InclusionSolution(
            posed, P, shape, float(values[:, 0].min()), float(values[:, -1].max()), T, diagonals, record
        )

    def _violated(self, posed: Posed, found: InclusionSolution) -> list[int]:
        """Members that the solution violates most, not yet in the program."""
        if len(self.chosen) == len(self.members.dynamics):
            return []
        turn = np.asarray(
            np.linalg.solve(self._basis(posed), found.T), dtype=np.float64
        )  # of the solution's coordinates in those of `posed`
        moved = replace(posed, dynamics=self._pushed(posed)).turned(turn)
        least = flow_slacks(moved, found.P)
        bad = [int(k) for k in np.argsort(least)[:JOINING] if least[k] < 0 and int(k) not in self.chosen]
        return [k for k in bad if k < len(self.members.dynamics)]

    def _hidden(self, posed: Posed, found: InclusionSolution) -> list[int]:
        """Outputs at which the solution's jump fails most, not yet in the program."""
        if len(self.shown) == len(posed.outputs):
            return []
        turn = np.asarray(np.linalg.solve(self._basis(posed), found.T), dtype=np.float64)
        moved = posed.turned(turn)
        least = jump_slacks(moved, found.P)
        bad = [int(k) for k in np.argsort(least)[:JOINING] if least[k] < 0]
        return [k for k in bad if k not in self.shown]

    def _basis(self, posed: Posed) -> Array:
        return self._coordinates(posed.eta / self.family.longest)

    # --- from a solution to a certificate -----------------------------------------------------------------------------

    def certificate(self, found: InclusionSolution, eta: float, digits: int, seconds: float) -> InclusionCertificate:
        """The certificate in physical coordinates and short decimals."""
        nodes = self.nodes(found.posed)
        P = rounded(found.T @ found.P @ found.T.T, digits)
        shape = found.T @ found.shape @ found.T.T
        P1, P2 = (
            rounded((1 - ROOM) * found.low * shape, digits + 1),
            rounded((1 + ROOM) * found.high * shape, digits + 1),
        )
        lam = float(f"{(1 + 10 * ROOM) * found.lam:.9g}")
        details: dict[str, Plain] = {"pieces": nodes.size - 1, "members": len(found.posed.dynamics), "digits": digits}
        solver = replace(found.record, seconds=seconds, details={**found.record.details, **details})
        model = self.plant
        return InclusionCertificate(
            self.centre, self.family, P1=P1, P2=P2, Qw=self.weights.Qw, R=self.weights.R, Qv=self.weights.Qv,
            eta=eta, lam=max(lam, 1.0), lam_samples=max(lam, 1.0), solver=solver,
            model=model, model_data=model.model_to_dict(), nodes=nodes, P=P, multipliers=self._multipliers(found),
        )  # fmt: skip

    def _multipliers(self, found: InclusionSolution) -> Array | None:
        """Those of physical columns, in short decimals."""
        if self.columns is None or found.diagonals is None:
            return None
        own = found.diagonals / (self.family.longest * self.sizes**2)
        return np.array([float(f"{x:.9g}") for x in own.ravel().tolist()]).reshape(own.shape)

    def nodes(self, posed: Posed) -> Array:
        """Times since the last sample, the ends of the range as they were given."""
        nodes = np.array([float(f"{t:.10g}") for t in (posed.nodes * self.family.longest).tolist()])
        nodes[0], nodes[posed.first], nodes[-1] = 0.0, self.family.shortest, self.family.longest
        return nodes

    def proven(self, eta: float, pieces: int, began: float) -> InclusionCertificate | Verification | None:
        """A certificate that has passed, the verdict on the last one that did not, or None if nothing was found."""
        if self.members.complete:
            return self._attempt(eta, pieces, began, (0.0,), DIGITS)
        found = None
        for hulled in (True, False) if self.stiff else (False,):
            if hulled and not self.enter_hull(eta):
                continue
            made = self._attempt(eta, pieces, began, INFLATED[1:2] if hulled else INFLATED, DIGITS[1:2])
            if hulled:
                self.leave_hull()
            if isinstance(made, InclusionCertificate):
                return made
            found = made or found
        return found

    def _attempt(
        self, eta: float, pieces: int, began: float, inflated: tuple[float, ...], precisions: tuple[int, ...]
    ) -> InclusionCertificate | Verification | None:
        """The same for the members as they are, pushed outwards by these shares."""
        verdict: Verification | None = None
        for inflation in inflated:
            self.inflation = inflation
            found = self.solve(eta, pieces)
            if found is None:
                continue
            for digits in precisions:
                made = self.certificate(found, eta, digits, time.perf_counter() - began)
                verdict = judged(made.to_dict(), False, 0.0)
                if verdict.passed:
                    return accepted(made)
        return verdict

    @property
    def stiff(self) -> bool:
        """Whether the centre has rates beyond `FASTEST` per longest gap, which multipliers do not know of."""
        fastest = np.max(np.abs(np.linalg.eigvals(self.centre.A)), initial=0.0)
        return bool(self.columns is None and self.family.longest * fastest > FASTEST)

    def enter_hull(self, eta: float) -> bool:
        """Take for the members sets that hold all Jacobians of a cell each, so that a proof needs few cells."""
        T = self._coordinates(eta)

        def size(moves: Array) -> Array:
            return np.asarray(np.square(np.linalg.norm(self.moved(moves, T), axis=(-2, -1))).sum(axis=0))

        hull = self.plant.hull(HALVINGS if self.stiff else 0, size)
        if hull is None or not len(hull.moves):
            return False
        self._sampled = (self.members, self.chosen, self.shown)
        self.hull = hull
        outputs = corners(hull.output, hull.output_moves)
        self.members = Members(hull.middle, outputs, ("a cell of the region",) * len(hull.middle), False)
        self.chosen, self.shown = extreme(hull.middle), extreme(outputs)
        return True

    def leave_hull(self) -> None:
        """Take the sampled members again."""
        self.members, self.chosen, self.shown = self._sampled
        self.hull = None

    def moved(self, moves: Array, T: Array) -> Array:
        """Changes of (A, G) (..., n, n + q) in inner coordinates."""
        n, b = self.centre.n_states, self.family.longest
        A = b * T.T @ moves[..., :n] @ np.linalg.inv(T).T
        G = np.sqrt(b) * T.T @ moves[..., n:] @ np.linalg.inv(np.linalg.cholesky(self.weights.Qw)).T
        return np.asarray(np.concatenate([A, G], axis=-1))


def corners(middle: Array, moves: Array) -> Array:
    """The middle and all signs of the moves, of up to `HULL_CORNERS` of them."""
    signs = np.array(list(product((-1.0, 1.0), repeat=min(len(moves), HULL_CORNERS))))
    return np.asarray(middle + np.tensordot(signs.reshape(len(signs), -1), moves[:HULL_CORNERS], 1))


def accepted(made: InclusionCertificate) -> InclusionCertificate:
    """A certificate that was proven, on its way out: where all of them can be watched (tests/rigour.py)."""
    return made


def extreme(stack: Array) -> list[int]:
    """Members that begin: all where there are few, else those that are extreme in some entry."""
    flat = stack.reshape(len(stack), -1)
    if len(stack) <= 8:
        return list(range(len(stack)))
    moving = np.flatnonzero(np.ptp(flat, axis=0) > 0)
    ends = {int(k) for j in moving for k in (np.argmin(flat[:, j]), np.argmax(flat[:, j]))}
    return sorted(ends)[:16]


def rounded(P: Array, digits: int) -> Array:
    """Short decimals: each entry to `digits` digits of the root of its diagonal entries' product."""
    d = np.sqrt(np.einsum("...ii->...i", P))
    places = digits - 1 - np.floor(np.log10(d[..., :, None] * d[..., None, :])).astype(int)
    entries = [
        round(x, k)
        for x, k in zip(((P + np.swapaxes(P, -1, -2)) / 2).ravel().tolist(), places.ravel().tolist(), strict=True)
    ]
    return np.array(entries).reshape(P.shape)
