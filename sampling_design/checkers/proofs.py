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


def _holds(inequality: str, slack: float, subject: str) -> Proven:
    return Proven(inequality, f"{inequality} for {subject}, slack {slack:.3g}", slack)


def _sampled(c: Sampled, work: Work) -> Proven:
    return _holds(*sampled.prove(c, work), "every real window start and every later t")


def _family(c: OfFamily, work: Work) -> Proven:
    subject = "every schedule of the family, every real window start and every later t"
    return _holds(*families.prove(c, work), subject)


def _inclusion(c: Inclusion, work: Work) -> Proven:
    return _holds(*inclusion.prove(c), "every plant of the model, all gaps in the range and every real window start")


def _interval(c: OfInterval, work: Work) -> Proven:
    return _holds(*recovered.prove(c, work), "every row and every trajectory within the bounds")


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
