"""Given weights and rate: the best lambda of one schedule, and its proof."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from importlib.util import find_spec
from operator import attrgetter
from typing import TypeVar

import numpy as np

from sampling_design.certificates.exact.canonical import canonical, origin_question
from sampling_design.certificates.exact.certificate import Certificate, SampledCertificate, Witness
from sampling_design.certificates.exact.efforts import ATTEMPTS, FINER, HIGHER, LOOK_WORK, ROOM, SearchEffort, wider
from sampling_design.certificates.exact.given_weights import NoiseWeights
from sampling_design.certificates.exact.riccati import refine, supremum
from sampling_design.certificates.exact.riccati_peak import RiccatiPeak, at_peak, located, starts_at_sample
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.certificates.form.claims import RESOLUTION, STATED_MARGIN
from sampling_design.certificates.form.verdict import replays, verdict_on_schedule
from sampling_design.certificates.rigorous.decide import decided_on_schedule, replays_in_balls
from sampling_design.checkers.claims import certificate
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.errors import ArgumentError, SolverError, UndecidedError
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import plain
from sampling_design.records.record import SolverRecord
from sampling_design.schedules.family import AnySchedule

Provable = TypeVar("Provable", bound=SampledCertificate)


class ScheduleProof:
    """Given weights and rate: the best lambda, found in internal units, and its proof."""

    def __init__(
        self,
        plant: Plant,
        schedule: AnySchedule,
        weights: tuple[Array, Array, Array, Array],
        eta: float,
        efforts: SearchEffort,
        long_run: float = 0.0,
    ) -> None:
        self.long_run = long_run  # lambda that the search expects after many samples, where it has looked
        self.last_undecided: tuple[WorkLimit, float, UndecidedError] | None = None
        """Of the last check: its work, its room, and why it failed."""
        self.plant, self.schedule, self.weights, self.eta, self.efforts = plant, schedule, weights, eta, efforts
        self.canon = canon = canonical(plant, schedule, NoiseWeights(*weights[1:]), weights[0])
        inner = (canon.inside(weights[0]), *canon.weights)
        self.problem = window_problem(canon.plant, canon.schedule, *inner, eta * canon.time)

    @cached_property
    def peaks(self) -> tuple[RiccatiPeak, RiccatiPeak]:
        """Where lambda is attained: over all real starts, and over those at samples.

        Raises UndecidedError if the windows are lost in rounding.
        """
        return self.peaks_on(1)

    def peaks_on(self, finer: int) -> tuple[RiccatiPeak, RiccatiPeak]:
        """The peaks of grids that are so much finer; raises as `peaks`."""
        with np.errstate(all="ignore"):
            try:
                peaks = supremum(self.problem, finer, self.efforts.looks.share(LOOK_WORK))
            except (SolverError, np.linalg.LinAlgError) as error:
                raise UndecidedError(f"undecided: {error}") from None
        if not all(np.isfinite(peak.value) for peak in peaks):
            raise UndecidedError("undecided: the information kept by some window is below what doubles can hold.")
        return peaks

    @property
    def horizon(self) -> float:
        """ln(lam)/eta."""
        return float(np.log(max(self.peaks[0].value, 1.0))) / self.eta

    def closed(self, solver: SolverRecord, plainly: bool = False) -> Certificate:
        """Return the certificate, lambda raised to whatever window the checker finds.

        What its floats leave undecided is decided in balls where these are installed, then looked at on finer grids
        and, unless `plainly` (or later, when asked again), stated with `ROOM` to spare; or, if far above what was met,
        as the long run has it. What only took too much work is neither: then the wide room is next. Raises
        UndecidedError if the proof does not close, or not with the work that it may do.
        """
        finer, efforts, earlier = 1, self.efforts, self.last_undecided
        anywhere, at_samples = self.peaks
        beyond = self.long_run / max(at_samples.value, 1.0)
        beyond_windows = beyond > ROOM[-1]  # windows come near the long run too slowly to be followed there
        room_for_balls = ROOM[0] * beyond if beyond_windows else 1.0
        rooms = iter([room_for_balls] if beyond_windows else () if plainly else ROOM)
        room = wider(rooms, *earlier[:2]) if earlier else 1.0
        if earlier and (beyond_windows or not room):  # all has been tried
            raise earlier[2]
        balls_tried = bool(earlier)  # whether balls have left it undecided
        for _ in range(ATTEMPTS + len(ROOM)):
            made = _made(self, (anywhere, at_samples), solver, room)
            content, stands = made.content, replays
            bare = replace(content, witness=None)
            verdict = verdict_on_schedule(bare, work := efforts.check())
            for_balls = room == room_for_balls and not (balls_tried or work.over or efforts.balls.over)
            if verdict.verdict == "undecided" and for_balls and find_spec("flint") is not None:
                verdict, stands = decided_on_schedule(bare, efforts.check_in_balls()), replays_in_balls
                balls_tried = verdict.time is None  # a lambda that is hardly larger would not help
            if verdict.passed:  # a witness is true, but its replay may be lost in rounding
                return as_proven(made if stands(content) else replace(made, witness=None))
            if efforts.over:
                break
            if verdict.time is None or verdict.start is None:
                if finer == 1 and not work.over:  # the grids may have missed a peak by a hair
                    finer, before = FINER, (anywhere.value, at_samples.value)
                    others = self.peaks_on(finer)
                    at_samples = max(at_samples, others[1], key=attrgetter("value"))
                    anywhere = max(anywhere, others[0], at_samples, key=attrgetter("value"))
                    if anywhere.value > before[0] * HIGHER or at_samples.value > before[1] * HIGHER:
                        continue
                if other := wider(rooms, work, room):
                    room = other
                    continue
                break
            missed = located(self.problem, verdict.start / self.canon.time, verdict.time / self.canon.time)
            if "samples" in verdict.inequality or starts_at_sample(self.problem, missed):
                at_samples = max(refine(self.problem, missed, 0.0), at_samples, key=attrgetter("value"))
            else:
                missed = refine(self.problem, missed, self.problem.reach[missed.index] / 16)
            anywhere = max(anywhere, missed, at_samples, key=attrgetter("value"))
        question = origin_question(self.canon)
        reason = f"undecided: the proof of the certificate did not close: {verdict.reason}.{question}"
        self.peaks, error = (anywhere, at_samples), UndecidedError(reason, verification=verdict, certificate=made)
        self.last_undecided = work, room, error
        raise error

    def witness_of(self, peak: RiccatiPeak) -> Witness:
        """Return where a peak is attained, in the plant's coordinates."""
        Y, t, start = at_peak(self.problem, peak)
        values, vectors = np.linalg.eigh(Y)
        direction = self.canon.x * self.problem.physical(vectors[:, -1])
        direction /= np.linalg.norm(direction)
        time = self.canon.time
        return Witness(t * time, start * time, tuple(float(v) for v in direction), float(values[-1]))


def as_proven(made: Provable) -> Provable:
    """A certificate that was proven while it was sought: its file, as an auditor reads it, holds that."""
    assert plain(certificate(made.to_dict())) == plain(made.content), "the file says something else"
    return made


def _made(
    proof: ScheduleProof, peaks: tuple[RiccatiPeak, RiccatiPeak], solver: SolverRecord, room: float
) -> Certificate:
    """The certificate that claims these peaks, times `room`."""
    lam, lam_samples = (room * max(peak.value, 1.0) for peak in peaks)
    if room > 1:
        spare = f"{room:g} times the largest met: the proof needs the room"
        solver = replace(solver, details={**solver.details, "lambda": spare})
    P2, Qw, R, Qv = proof.weights
    P1, witness = (1 - RESOLUTION) * P2 / lam, proof.witness_of(peaks[0])
    try:
        checks.definite("P1", P1, proof.plant.n_states)
    except ArgumentError as error:
        raise UndecidedError(f"undecided: P1 = P2/lambda cannot be held in doubles ({error})") from None
    return Certificate(
        proof.plant, proof.schedule, P1=P1, P2=P2, Qw=Qw, R=R, Qv=Qv, eta=proof.eta, lam=lam, lam_samples=lam_samples,
        margin=STATED_MARGIN, witness=witness, solver=solver,
    )  # fmt: skip
