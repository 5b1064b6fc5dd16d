"""How each claim is proven: from its judged content to the inequality, and what was proven of it."""

from collections.abc import Callable
from dataclasses import dataclass

from . import detectability, families, inclusion, recovered, sampled
from .grammar import Detectability, OfFamily, Sampled
from .inclusion_file import Inclusion
from .interval_file import OfInterval
from .work import Work


@dataclass(frozen=True)
class Proven:
    """An inequality that holds, one sentence, and its relative slack."""

    inequality: str
    reason: str
    slack: float


def _sampled(c: Sampled, work: Work) -> Proven:
    inequality, slack = sampled.prove(c, work)
    return Proven(inequality, f"{inequality} for every real window start and every later t, slack {slack:.3g}", slack)


def _family(c: OfFamily, work: Work) -> Proven:
    inequality, slack = families.prove(c, work)
    subject = "for every schedule of the family, every real window start and every later t"
    return Proven(inequality, f"{inequality} {subject}, slack {slack:.3g}", slack)


def _inclusion(c: Inclusion, work: Work) -> Proven:
    inequality, slack = inclusion.prove(c)
    subject = "for every plant of the model, all gaps in the range and every real window start"
    return Proven(inequality, f"{inequality} {subject}, slack {slack:.3g}", slack)


def _interval(c: OfInterval, work: Work) -> Proven:
    inequality, slack = recovered.prove(c, work)
    subject = "for every row and every trajectory within the bounds"
    return Proven(inequality, f"{inequality} {subject}, slack {slack:.3g}", slack)


def _detectability(c: Detectability, work: Work) -> Proven:
    how, slack = detectability.prove(c)
    return Proven(detectability.INEQUALITY, f"P > 0 and {detectability.INEQUALITY}, {how}", slack)


PROOFS: dict[type, Callable[..., Proven]] = {
    Sampled: _sampled,
    OfFamily: _family,
    Inclusion: _inclusion,
    OfInterval: _interval,
    Detectability: _detectability,
}
"""Record of a claim -> its proof, which raises `Refused` or `Undecided` where there is none."""
