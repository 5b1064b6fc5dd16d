"""Lambda of a certificate holds for all real times at which the outputs of planned samples are read one by one."""

from functools import cache

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError, CertificateError
from sampling_design.schedules.output_jitter import OutputJitter
from tests.cases import few
from tests.oracles.families import adversarial_lambda, largest_lambda

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2), outputs=["a", "b"])
GROWING = sd.Plant([[0.5]], [[1.0], [0.3]])
EVEN = sd.PeriodicSchedule([1.0], first=0.5)


def drawn(seed):
    rng = np.random.default_rng(seed)
    n, p = 1 + seed % 3, 2 + seed // 3 % 2
    plant = sd.Plant(0.7 * rng.normal(size=(n, n)), rng.normal(size=(p, n)))
    seen = rng.uniform(size=(2, p)) < 0.7
    seen[0] = seen[1, 0] = True
    early, late = rng.uniform(0, 0.15, (2, p)) * rng.choice([0, 1, 1], (2, p))
    return OutputJitter(sd.PeriodicSchedule(rng.uniform(0.4, 0.8, 2), 0.3, seen), early, late), plant, rng


def reached(certificate, plant, samples, rng):
    family = certificate.family
    part = family.schedule.between(0.0, family.schedule.times[0] + samples * family.schedule.period)
    seen = np.ones((len(part), plant.n_outputs), bool) if part.outputs is None else part.outputs
    weights = certificate.Qw, certificate.R, certificate.Qv
    return adversarial_lambda(
        plant, weights, certificate.eta, certificate.P2, part.times, seen, family.early, family.late, rng
    )[0]


@cache
def certified(early, late, memory):
    return sd.certify(GROWING, OutputJitter(EVEN, early, late), eta=0.3, P2=[[1.0]], memory=memory)


@pytest.mark.parametrize("seed", few(range(30), 0))
def test_no_real_times_reach_a_larger_lambda(seed):
    family, plant, rng = drawn(seed)
    certificate = sd.certify(plant, family, eta=0.3, P2=np.eye(plant.n_states))
    assert certificate.verify().passed
    weights = certificate.Qw, certificate.R, certificate.Qv
    for _ in range(2):
        member = family.draw(rng, samples=2)
        assert family.contains(member)
        found = largest_lambda(plant, weights, 0.3, certificate.P2, member.times, member.outputs, 2, 1)
        assert found <= certificate.lam_proven


@pytest.mark.long
@pytest.mark.parametrize("seed", range(5))
def test_no_climb_over_the_real_times_reaches_a_larger_lambda(seed):
    family, plant, rng = drawn(100 + seed)
    certificate = sd.certify(plant, family, eta=0.3, P2=np.eye(plant.n_states))
    assert reached(certificate, plant, 1, rng) <= certificate.lam_proven


@pytest.mark.parametrize(
    ("early", "late", "memory", "share"),
    few([((0.02, 0.02), (0.02, 0.02), 0, 1 - 1e-6), ((0.2, 0.2), (0.2, 0.2), 3, 0.98)], 0),
)
def test_lambda_is_attained(early, late, memory, share):
    certificate = certified(early, late, memory)
    assert share * certificate.lam <= reached(certificate, GROWING, 1, np.random.default_rng(0))


def test_tolerances_of_one_reading_are_those_of_samples():
    """Words, gaps and lambda are those of the jitter family where each sample reads one output."""
    seen = [[True, False], [False, True]]
    planned = sd.PeriodicSchedule([1.0, 0.7], 0.4, seen)
    apart, whole = OutputJitter(planned, [0.1, 0.1], [0.1, 0.1]), sd.Jitter(planned, 0.1)
    for memory in range(3):
        one, other = apart.steps(memory, 2), whole.steps(memory, 2)
        for word in (("start",), *(step.word for step in other(("start",)))):
            for step, wanted in zip(one(word), other(word), strict=True):
                assert (step.word, step.outputs) == (wanted.word, wanted.outputs)
                assert (step.low, step.high) == pytest.approx((wanted.low, wanted.high), abs=1e-12)


def test_what_holds_of_samples_read_together_need_not_hold_of_outputs_that_come_apart():
    """A quarter of a turn after the position, the velocity is the position: one direction is never seen."""
    planned, quarter = sd.PeriodicSchedule([np.pi], first=1.0), np.pi / 4
    assert sd.certify(OSCILLATOR, planned, timing_tolerance=quarter, eta=0.3, P2=np.eye(2)).verify().passed
    with pytest.raises(CertificateError, match=r"no certificate with rate 0\.3 exists for this family") as caught:
        sd.certify(OSCILLATOR, planned, timing_tolerance={"a": quarter, "b": quarter}, eta=0.3)
    assert caught.value.details["counterexample"].verify()


def test_tolerances_as_long_as_the_gap_change_the_order_and_are_refused():
    with pytest.raises(ArgumentError, match=r"together less than the least gap 0\.7, got {'a': .*change places"):
        sd.certify(OSCILLATOR, sd.PeriodicSchedule([1.0, 0.7]), timing_tolerance={"a": (0.4, 0.0), "b": (0.0, 0.3)})


@pytest.mark.parametrize("scale", few([1e9, 1e-9], 0))
def test_units_of_time_change_nothing(scale):
    plant = sd.Plant(GROWING.A / scale, GROWING.C, G=GROWING.G / np.sqrt(scale))
    family = OutputJitter(
        sd.PeriodicSchedule([scale], first=0.5 * scale), 0.02 * scale * np.ones(2), [0.0, 0.02 * scale]
    )
    found = sd.certify(plant, family, eta=0.3 / scale, P2=[[1.0]])
    assert found.verify().passed
    assert found.lam == pytest.approx(certified((0.02, 0.02), (0.0, 0.02), 0).lam, rel=1e-3)


def test_an_error_bound_counts_every_reading():
    certificate, rng = certified((0.1, 0.2), (0.2, 0.1), 0), np.random.default_rng(1)
    for _ in range(20):
        times = certificate.family.draw(rng, samples=9).times
        for end in (*times.tolist(), 8.3):
            counted = np.sort(certificate._samples_until(end))[::-1]
            real = np.sort(times[times <= end])[::-1]
            assert np.all(counted[: real.size] >= real - 1e-12)


@pytest.mark.parametrize("joined", ["R", "Qv"])
def test_weights_that_join_the_outputs_are_refused(joined):
    weights = {"R": 2 * np.eye(2), "Qv": 2 * np.eye(2)} | {joined: [[2.0, 0.5], [0.5, 2.0]]}
    with pytest.raises(ArgumentError, match="`R` and `Qv` must be diagonal where outputs are read at times of their"):
        sd.certify(OSCILLATOR, EVEN, timing_tolerance={"a": 0.1}, **weights)


def test_other_outputs_are_refused():
    for names, words in ((["b", "a"], "outputs a, b in their order.*got b, a"), (None, "got 3")):
        planned = sd.PeriodicSchedule([1.0], output_names=names)
        size = 2 if names else 3
        with pytest.raises(ArgumentError, match=words):
            sd.certify(OSCILLATOR, OutputJitter(planned, np.zeros(size), 0.1 * np.ones(size)))


def test_plants_that_are_not_exactly_known_ask_for_samples_that_are_read_together():
    box = sd.UncertainPlant(
        OSCILLATOR, [sd.UncertainParameter("k", 0.0, 0.01, A=[[0.0, 0.0], [1.0, 0.0]], nominal=0.0)]
    )
    with pytest.raises(ArgumentError, match="whose outputs are read together for a plant that is not exactly known"):
        sd.certify(box, OutputJitter(EVEN, [0.1, 0.1], [0.1, 0.1]))
    with pytest.raises(ArgumentError, match="fall apart, and a family of schedules is of samples"):
        sd.certify(box, EVEN, timing_tolerance={"a": 0.1, "b": 0.2})
