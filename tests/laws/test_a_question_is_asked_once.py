"""One verb asks the zero count of a plant, and whether a certificate exists on a schedule, once."""

import numpy as np
import pytest

import sampling_design as sd
from tests.cases import few

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
QUESTIONS = {
    "count": "sampling_design.observability.count.zero_count.search",
    "existence": "sampling_design.certificates.existence.periodic.judged",
}


@pytest.fixture
def asked(monkeypatch):
    """How often each question reaches its mathematics, whoever passes it on."""
    counted = dict.fromkeys(QUESTIONS, 0)

    def watch(name: str, target: str) -> None:
        room, _, verb = target.rpartition(".")
        real = getattr(__import__(room, fromlist=[verb]), verb)

        def counting(*arguments, **options):
            counted[name] += 1
            return real(*arguments, **options)

        monkeypatch.setattr(target, counting)

    for name, target in QUESTIONS.items():
        watch(name, target)
    return counted


@pytest.mark.parametrize(
    "requirement", [sd.Requirement(), sd.Requirement(window=4.0, spacing=0.5, samples=3)], ids=["defaults", "given"]
)
def test_a_design_counts_the_zeros_once(asked, requirement):
    once = dict(asked)
    sd.zero_count_bound(OSCILLATOR, requirement.window or 2 * np.pi)
    alone = {name: asked[name] - once[name] for name in asked}
    assert alone["count"] > 0
    before = dict(asked)
    sd.design_schedule(OSCILLATOR, requirement, starts=1, budget=1.0)
    assert asked["count"] - before["count"] == alone["count"]


@pytest.mark.parametrize(
    "given", few([{}, {"eta": 0.3}, {"P2": np.eye(2)}, {"eta": 0.3, "P2": np.eye(2)}], 0, 2, 3), ids=str
)
def test_a_certificate_asks_once_whether_one_exists(asked, given):
    sd.certify(OSCILLATOR, sd.PeriodicSchedule([1.0]), **given)
    assert asked["existence"] == 1
