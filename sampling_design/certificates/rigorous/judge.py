"""Who decides on a certificate: the checker in floats, and ball arithmetic where asked for, or where floats cannot."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

from sampling_design.certificates.form.verdict import Verification, verdict_of

HANDED_OVER = 10.0
"""Most seconds that balls take for what was only asked of floats: what is tight stays undecided for ever."""


def judged(data: dict[str, Any], rigorous: bool, budget: float) -> Verification:
    """Return the verdict on the plain data of a certificate.

    The checker says yes and no only beyond its bound of all rounding; what it leaves undecided goes to ball arithmetic,
    if python-flint is installed, and so does everything if `rigorous`.
    """
    found = None if rigorous else verdict_of(data)
    if found is not None and (found.verdict != "undecided" or find_spec("flint") is None):
        return found
    from sampling_design.certificates.rigorous.decide import verify_rigorously

    return verify_rigorously(data, budget if rigorous else min(budget, HANDED_OVER))
