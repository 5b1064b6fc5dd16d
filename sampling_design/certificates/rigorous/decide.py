"""Certificates as theorems: the inequalities of a certificate file decided in ball arithmetic (extra `rigorous`)."""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar

import numpy as np

from sampling_design.certificates.form.claims import CLAIM, DETECTABILITY_CLAIM, FAMILY_CLAIM, RESOLUTION
from sampling_design.certificates.form.horizon import ConstantList
from sampling_design.certificates.form.verdict import Verification, verdict_of, verdict_on_content, verification
from sampling_design.certificates.rigorous.ball_problem import (
    BallTimes,
    BallWeights,
    ScheduleFrame,
    StatedInequality,
    positive_definite,
)
from sampling_design.certificates.rigorous.ball_proof import PROPOSALS, BallWindows
from sampling_design.certificates.rigorous.dissipation_balls import detectability
from sampling_design.certificates.rigorous.family_balls import family
from sampling_design.certificates.rigorous.refutation import refute
from sampling_design.checkers.claims import certificate, claim_of
from sampling_design.checkers.outcome import BAD_FILE, UNDECIDED, Refused, Undecided, Verdict, WorkLimit, holds, refused
from sampling_design.checkers.parts import FORMAT, Weights, of_whole_plant
from sampling_design.checkers.schedule_file import Sampled
from sampling_design.checkers.strict import BadFile
from sampling_design.errors import ArgumentError
from sampling_design.numerics import balls
from sampling_design.numerics.balls import Matrix, ball, matrix
from sampling_design.plants.plant import Plant
from sampling_design.records import file_io
from sampling_design.records.budget import ENDLESS, Budget, BudgetSpentError
from sampling_design.records.declarations import in_latex, latex_matrix
from sampling_design.records.dispatch import offered
from sampling_design.records.record import Claim, Plain, Record

REPLAY = 1e-6  # what a witness may miss of its stated ratio, relative
NEAR = 1e-9
"""Samples this close to the ends of the witness's window, relative to t, are the ends: limits from inside are meant."""
HANDED_OVER = 1e7
"""Most work, about microseconds, that balls do for what was only asked of floats: what is tight stays undecided for
ever."""
PATIENCE = 6  # halvings of a cell of window starts after which a counterexample is looked for


class VerifiableRecord(Record):
    """A certificate: a record whose file states inequalities that can be proven from the file alone."""

    plant: Plant
    _weights: ClassVar[tuple[str, ...]]
    """Its matrices."""
    _inequality: ClassVar[str]
    """What it states, in LaTeX."""

    @property
    @abstractmethod
    def claim(self) -> Claim:
        """What the certificate says; `verify()` proves it."""

    @abstractmethod
    def to_dict(self) -> dict[str, Plain]:
        """Plain data as in the file, digest included."""

    def verify(self, rigorous: bool = False, budget: float = 60.0) -> Verification:
        """Prove the inequalities anew from the data alone, by the room `checkers`, which shares no code with this one.

        What its floats can neither prove nor disprove is handed to ball arithmetic, if that is installed.

        Parameters
        ----------
        rigorous : bool
            Decide in ball arithmetic at once (extra `rigorous`): "proven" is then a theorem about the stated doubles.
        budget : float [seconds]
            For the rigorous verdict, "undecided" when it runs out.

        Returns
        -------
        Verification
            Its `verdict` is "proven", "refuted" or "undecided"; with its `bits` where balls gave it.

        Raises
        ------
        MissingExtraError
            If `rigorous` is asked for and python-flint is not installed.
        """
        return judged(self.to_dict(), rigorous, budget)

    def to_latex(self) -> str:
        r"""Return the certificate as an appendix of a paper: claim, inequality, plant, weights, table of constants.

        The text is to be \input, and needs the package amsmath. Numbers are rounded to six digits, in wide
        matrices to four: the digest names the file that holds them whole, and `verify` is asked for the verdict.

        Notes
        -----
        Matrices that no page holds are left to the file.
        """
        claim, plant, times = self.claim, self.plant, self._sample_times()
        said = [
            ("Claim", claim.statement), ("Verdict", self.verify().verdict), ("Source", claim.theorem),
            ("Assumptions", "; ".join(each for each in claim.assumptions if each != times)), ("Sample times", times),
            ("Plant", f"{plant.name or 'no name'}; states {', '.join(plant.states.names)}; time in {plant.time_unit}"),
        ]  # fmt: skip
        shapes = {name: getattr(self, name) for name in self._weights} | {k: getattr(plant, k) for k in ("A", "C", "G")}
        texts = {name: latex_matrix(matrix) for name, matrix in shapes.items() if matrix.size}
        written = [f"  {'_'.join(name)} &= {text}" for name, text in texts.items() if text]
        parts = [
            "{\\sloppy\n"
            + "\n".join(rf"\noindent\textbf{{{head}.}} {in_latex(text)}.\par" for head, text in said if text),
            rf"\noindent\textbf{{File.}} digest {{\footnotesize\texttt{{{self.to_dict()['digest']}}}}}.\par}}",
            "\\begin{align*}\n" + self._inequality + "\n\\end{align*}",
            "{\\allowdisplaybreaks\n\\begin{align*}\n" + " \\\\\n".join(written) + "\n\\end{align*}}"
            if written
            else "",
            "{\\footnotesize\\noindent\n" + self._numbers().to_latex() + "\\par}\n",
        ]
        return "\n".join(part for part in parts if part)

    @abstractmethod
    def _numbers(self) -> ConstantList:
        """The constants of its table."""

    def _sample_times(self) -> str:
        """What samples it is about; none where it is about the plant alone."""
        return ""

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the certificate as JSON, whole or not at all; return the path.

        Raises
        ------
        ArgumentError
            If the ending is not .json.
        """
        if Path(path).suffix.lower() != ".json":
            raise ArgumentError(
                f"`path` of a certificate must end in .json, got {os.fspath(path)!r}. "
                "For an appendix or a table write the text of to_latex() or to_markdown()."
            )
        return file_io.write_text(path, file_io.to_json(self.to_dict()))


def judged(data: Mapping[str, object], rigorous: bool, budget: float) -> Verification:
    """Return the verdict on the plain data of a certificate.

    The checker says yes and no only beyond its bound of all rounding; what it leaves undecided goes to ball arithmetic,
    if python-flint is installed, and so does everything if `rigorous`.
    """
    verdict = None if rigorous else verdict_of(data)
    if verdict is not None and (verdict.verdict != "undecided" or find_spec("flint") is None):
        return verdict
    return verify_rigorously(data, budget, None if rigorous else WorkLimit(HANDED_OVER))


def judged_while_sought(content: object, claim: str, budget: float) -> Verification:
    """The same of what a file of a claim would hold, before there is one."""
    verdict = verdict_on_content(content, claim_of({"format": FORMAT, "claim": claim}).prove)
    if verdict.verdict != "undecided" or find_spec("flint") is None:
        return verdict
    return _verified(content, lambda clock: _decided_as(claim, content, clock), budget, WorkLimit(HANDED_OVER))


def verify_rigorously(data: Mapping[str, object], budget: float = 60.0, work: WorkLimit | None = None) -> Verification:
    """Decide in ball arithmetic whether what a certificate file states is true.

        Pi(t) >= (1 + margin) P1,   lam Pi(t) >= (1 - 1e-3) P2    for all real window starts and all t

    Raises MissingExtraError if python-flint is not installed.

    Parameters
    ----------
    data : dict
        Plain data of the file.
    budget : float [seconds]
        When it runs out the verdict is "undecided".
    work : WorkLimit, optional
        Counted instead of timed, and likewise "undecided" when it runs out.

    Returns
    -------
    Verification

    Notes
    -----
    *Assumptions.* The doubles in the file are the numbers meant; a periodic schedule is its gaps and its first time,
    without rounding of the sums. A weight is its symmetric part. *Claim.* "proven" and "refuted" are theorems.
    *Method.* `ball_proof` and, where that does not close, `refutation`; `family_balls` for families and
    `dissipation_balls` for detectability. *Numerical aspects.* 160 bits, 400 where no
    family is found; eigenvalues are guessed in floats, gains and families in midpoints, and proven by the pivots of
    L D L' in balls.
    """

    try:
        content = certificate(dict(data))
    except BadFile as error:
        balls.flint()
        return verification(Verdict(BAD_FILE, error.broken, f"the data are no certificate: {error}"), balls.BITS)
    return _verified(content, lambda clock: _decided_as(str(data["claim"]), content, clock), budget, work)


def decided_on_schedule(content: Sampled, work: WorkLimit) -> Verification:
    """The same of what a file on one schedule would hold, while it is sought."""
    return _verified(content, lambda clock: assumption_7(content, clock), np.inf, work)


def _verified(
    content: object, decide: Callable[[Budget], Verdict], budget: float, work: WorkLimit | None
) -> Verification:
    """The verdict on content that `decide` finds, or is stopped with."""
    balls.flint()
    clock = Budget(budget, work=work)
    try:
        with balls.precision(), np.errstate(all="ignore"):  # floats only guess: what is not finite proves nothing
            verdict = of_whole_plant(content, decide(clock))
    except Refused as stop:
        verdict = refused(stop)
    except BudgetSpentError:
        reason = "it takes more work than was handed over" if work and work.over else f"{budget:g} s were not enough"
        verdict = Verdict(UNDECIDED, "budget", reason)
    except (np.linalg.LinAlgError, ZeroDivisionError) as error:  # the latter: a ball holds a singular matrix
        verdict = Verdict(UNDECIDED, "guess", f"the guesses in floats broke down ({error})")
    return verification(verdict, balls.BITS, clock.spent)


def _decided_as(claim: str, content: object, clock: Budget) -> Verdict:
    decides = CLAIMS.get(claim) or offered("verify_rigorously", claim, Verdict)
    assert decides is not None, "a claim that the auditor reads and nobody decides"
    return decides(content, clock)


def targets(weights: Weights) -> list[StatedInequality]:
    """What a file states: target <= Pi(t), its name, and whether for sample starts only; implied ones left out."""
    P1, P2 = balls.symmetric(weights.P1), balls.symmetric(weights.P2)
    lam, lam_samples, margin = weights.lam, weights.lam_samples, weights.margin
    positive_definite("P1", P1)
    share = P2 * (ball(1.0) - ball(RESOLUTION))
    first = StatedInequality(P1 * (ball(1.0) + ball(margin)), "(1 + margin) P1 <= Pi(t)", False)
    second = StatedInequality(share / ball(lam), "(1 - 1e-3) P2 <= lam Pi(t)", False)
    third = StatedInequality(share / ball(lam_samples), "(1 - 1e-3) P2 <= lam_samples Pi(t), sample starts", True)
    if not len(weights.P1):
        return []
    needed = [first, second]
    if balls.definite(first.target - second.target):
        needed = [first]
    elif balls.definite(second.target - first.target):
        needed = [second]
    implied = lam_samples >= lam or any(balls.definite(other.target - third.target) for other in needed)
    return needed if implied else [*needed, third]


def assumption_7(c: Sampled, clock: Budget) -> Verdict:
    """Prove P1 and lam over all real starts, lam_samples over sample starts."""
    stated, slack = targets(c.weights), 1.0
    for k, (_, inequality, samples_only) in enumerate(stated):

        def make(k: int = k, inequality: str = inequality) -> ScheduleFrame:
            weights = BallWeights(c.plant, c.weights)
            return ScheduleFrame(weights, BallTimes(c.schedule), targets(c.weights)[k].target, inequality)

        slack = min(slack, prove(make, samples_only, clock))
    if stated:
        attained(c, clock)
    names = " and ".join(name for _, name, _ in stated) or "(1 + margin) P1 <= Pi(t)"
    return holds(names, slack, c.schedule.windows)


def replays_in_balls(content: Sampled) -> bool:
    """Whether the witness of a certificate on one schedule certainly reaches its ratio."""
    try:
        with balls.precision(), np.errstate(all="ignore"):
            attained(content, ENDLESS)
    except (Refused, np.linalg.LinAlgError):
        return False
    return True


def attained(c: Sampled, clock: Budget) -> None:
    """Raise Refused unless the witness, if there is one, reaches its ratio x'P2x / x'Pi(t)x, to `REPLAY` of it."""
    if c.witness is None:
        return
    weights = BallWeights(c.plant, c.weights)
    frame = ScheduleFrame(weights, BallTimes(c.schedule), weights.P2, "witness")
    start, t, stated = c.witness.start, c.witness.t, c.witness.ratio
    x, least = frame.L.transpose() * matrix(c.witness.direction[:, None]), ball(stated) * (1 - ball(REPLAY))
    for bound in (balls.lowered, balls.raised):
        Y = covariance_bound(frame, start, t, clock, bound)
        if Y is None or not balls.definite(Y):
            raise Undecided(frame.inequality, "the window of the witness is lost in rounding")
        ratio = (x.transpose() * x)[0, 0] / (x.transpose() * Y.solve(x))[0, 0]
        if ratio >= least and bound is balls.lowered:
            return
    reason = f"the witness reaches {float(ratio):.6g}, not {stated:.6g}"
    kind = Refused if ratio < least else Undecided
    raise kind(frame.inequality, reason, float(ratio) / stated - 1, t, start)


def covariance_bound(
    frame: ScheduleFrame, start: float, t: float, clock: Budget, bound: Callable[[Matrix], Matrix]
) -> Matrix | None:
    """A bound of Y at t in the window from `start`, `lowered` or `raised`; None where rounding leaves none.

    A window begins after a sample that is within `NEAR` of its start, and ends before one within `NEAR` of its end.
    """
    schedule, Y, now = frame.schedule, frame.start, ball(start)
    near, turn = NEAR * max(t, 1e-300), 0 * schedule.period
    if schedule.periodic:
        turn = schedule.period * int((start - float(schedule.times[-1])) // float(schedule.period))
    while float(turn) <= t:
        clock.check((100 + frame.n**3) * schedule.N)
        for i, at in enumerate(schedule.times):
            time = float(at + turn)
            if not start < time < t or float(turn) < 0:
                continue
            if time > start + near:
                before = bound(frame.flow.step(Y, at + turn - now))
                if time >= t - near:
                    return before
                left = frame.sampled(before, i)
                if left is None:
                    return None
                Y = bound(left)
            now = at + turn
        if not schedule.periodic:
            break
        turn += schedule.period
    return bound(frame.flow.step(Y, ball(t) - now))


def prove(make: Callable[[], ScheduleFrame], samples_only: bool, clock: Budget) -> float:
    """Prove Y <= I for one target and return the slack; Unproven if it is refuted, or cannot be decided."""
    halved: list[int] = []

    def failed(depth: int) -> None:
        if depth >= PATIENCE and not halved:
            halved.append(depth)
            refute(make, clock)

    for bits, inflations in PROPOSALS.items():
        with balls.precision(bits):
            windows = BallWindows(make(), clock)
            if windows.start_is_invariant():
                return 1.0 - windows.reached
            catches = windows.propose(inflations)
            if catches and (windows.at_samples() if samples_only else windows.everywhere(failed)):
                return 1.0 - windows.reached
        if catches:
            break
    if not halved:
        refute(make, clock, samples_only)
    name, why = windows.frame.inequality, "it is tight or nearly so"
    why = why if catches else "no bound that holds over all periods was found"
    raise Undecided(name, f"{name} could not be decided: {why}")


CLAIMS: dict[str, Callable[..., Verdict]] = {
    CLAIM: assumption_7,
    FAMILY_CLAIM: lambda c, clock: family(c, targets(c.weights), clock),
    DETECTABILITY_CLAIM: detectability,
}
