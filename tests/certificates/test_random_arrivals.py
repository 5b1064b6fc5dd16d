"""Samples lost by chance, or a Poisson process: against all patterns, drawn records, limits, what no filter bears."""

import dataclasses
import itertools

import mpmath as mp
import numpy as np
import pytest
from scipy.linalg import eigh

import sampling_design as sd
from sampling_design import PeriodicSchedule, Plant, Schedule
from sampling_design.certificates import random_arrivals
from sampling_design.certificates.compare import arrival_patterns as module
from sampling_design.certificates.compare import random_arrivals as module_of_windows
from sampling_design.errors import ArgumentError
from sampling_design.observability import loss_tolerance
from tests.cases import few
from tests.oracles.families import after_sample, flow

SPIRAL = Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.0]])
TWO = Plant([[0.05, 1.0, 0.0], [-1.0, 0.05, 0.0], [0.0, 0.0, -0.2]], [[1.0, 0.0, 1.0], [0.0, 1.0, 0.5]])


@pytest.fixture(scope="module")
def spiral():
    weights = {"eta": 1.23, "P2": np.array([[0.23, 0.11], [0.11, 0.13]])}
    return sd.certify(SPIRAL, PeriodicSchedule([0.6, 1.7, 2.5]), **weights)


@pytest.fixture(scope="module")
def two():
    pattern = [[True, False], [False, True], [True, True]]
    weights = {"eta": 1.68, "P2": np.array([[0.08, 0.0, 0.05], [0.0, 0.06, -0.05], [0.05, -0.05, 0.21]])}
    return sd.certify(TWO, PeriodicSchedule([1.0, 0.5, 1.2], first=0.3, outputs=pattern), **weights)


def factor(certificate, start, times, rows, received):
    """Rho of one pattern, in information form."""
    c, now = certificate, start
    Y = np.linalg.inv(c.P2)
    for t, row, there in zip(times, rows, received, strict=True):
        F, W = flow(c.plant.A, c.plant.G, c.Qw, c.eta, t - now)
        Y, now = F @ Y @ F.T + W, t
        if there:
            Y = after_sample(Y, c.plant.C, c.R, c.Qv, row)
    return np.exp(-c.eta * (now - start)) * eigh(Y, np.linalg.inv(c.P2), eigvals_only=True)[-1]


def windows(certificate, periods):
    """Start, times and outputs of the windows that end at the samples of a period."""
    s = certificate.schedule
    rows = np.ones((len(s), certificate.plant.n_outputs), bool) if s.outputs is None else s.outputs
    times = (s.times + s.period * np.arange(periods + 1)[:, None]).ravel()
    for k in range(len(s)):
        at = slice(k + 1, k + 1 + periods * len(s))
        yield times[k], times[at], np.tile(rows, (periods + 1, 1))[at]


@pytest.mark.parametrize(
    ("name", "periods", "p"),
    few([(*each, p) for each in (("spiral", 1), ("spiral", 2), ("two", 2)) for p in (0.0, 0.1, 0.6, 1.0)], 3, 5, 11),
)
def test_bounds_coincide_with_the_sum_over_all_patterns(name, periods, p, request):
    certificate = request.getfixturevalue(name)
    found = random_arrivals(certificate, p, horizon=periods * certificate.schedule.period)
    for k, (start, times, rows) in enumerate(windows(certificate, periods)):
        patterns = list(itertools.product((True, False), repeat=len(times)))
        mass = [np.prod(np.where(each, 1 - p, p)) for each in patterns]
        rho = np.array([factor(certificate, start, times, rows, each) for each in patterns])
        assert found.probability[k] == pytest.approx([np.dot(mass, rho < 1)] * 2, abs=1e-12)
        assert found.factor[k] == pytest.approx([np.dot(mass, rho)] * 2, rel=1e-9)
        noise = np.sum(patterns, axis=1)  # what samples bring of it rises with them as the factor falls
        assert np.dot(mass, rho * noise) <= np.dot(mass, rho) * np.dot(mass, noise) * (1 + 1e-12)


def test_few_patterns_leave_bounds_around_the_exact_values(spiral, monkeypatch):
    exact = random_arrivals(spiral, 0.2, horizon=3 * spiral.schedule.period)
    widths = []
    for most in (2, 16, 64):
        monkeypatch.setattr(module, "MOST_CLASSES", most)
        found = random_arrivals(spiral, 0.2, horizon=3 * spiral.schedule.period)
        for rough, fine in ((found.probability, exact.probability), (found.factor, exact.factor)):
            assert np.all(rough[:, 0] <= fine[:, 0] + 1e-12)
            assert np.all(fine[:, 1] <= rough[:, 1] * (1 + 1e-12))
        widths.append(np.ptp(found.factor, axis=1).max())
    assert widths[0] > widths[1] > widths[2] > 0


def exact_factors(certificate, count):
    """Rho of all patterns of a plant of real modes in 60 digits, one sample a period; windows start at a sample."""
    c, gap, n = certificate, mp.mpf(float(certificate.schedule.period)), certificate.plant.n_states
    rates = [mp.mpf(float(a)) + mp.mpf(c.eta) / 2 for a in np.diag(c.plant.A)]
    drive = mp.inverse(mp.matrix(c.Qw.tolist()))
    F = mp.diag([mp.exp(a * gap) for a in rates])
    W = mp.matrix(n, n)
    for i, j in itertools.product(range(n), repeat=2):
        W[i, j] = drive[i, j] * mp.expm1((rates[i] + rates[j]) * gap) / (rates[i] + rates[j])
    C, V = mp.matrix(c.plant.C.tolist()), 1 / mp.mpf(c.R[0, 0]) + 1 / mp.mpf(c.Qv[0, 0])
    found = [mp.inverse(mp.matrix(c.P2.tolist()))]
    for _ in range(count):
        before = [F * Y * F.T + W for Y in found]
        found = before + [Y - Y * C.T * C * Y / ((C * Y * C.T)[0] + V) for Y in before]
    root = mp.cholesky(mp.matrix(c.P2.tolist()))
    scale = mp.exp(-mp.mpf(c.eta) * gap * count)
    return [scale * max(mp.eigsy(root.T * Y * root, eigvals_only=True)) for Y in found]


@pytest.mark.parametrize(("rates", "count"), few([((6.0, 5.0), 6), ((6.0, -0.5), 5), ((4.0, 3.5), 4)], 0))
def test_growth_that_drowns_what_is_seen_leaves_bounds_around_the_truth(rates, count):
    """After e^18 and more one sample leaves its rounding in place of what it knows of the other mode."""
    made = sd.certify(Plant(np.diag(rates), [[1.0, 1.0]]), PeriodicSchedule([1.0]), eta=3.0, P2=np.eye(2))
    with mp.workdps(60):
        rho = exact_factors(made, count)
        for p in (0.0, 0.01, 0.3):
            lost = [count - k.bit_count() for k in range(2**count)]
            mass = [mp.mpf(p) ** m * (1 - mp.mpf(p)) ** (count - m) for m in lost]
            mean = mp.fdot(mass, rho)
            share = mp.fsum(m for m, each in zip(mass, rho, strict=True) if each < 1)
            found = random_arrivals(made, p, horizon=float(count))
            assert found.mean_factor[0] * (1 - 1e-9) <= mean <= found.mean_factor[1] * (1 + 1e-9)
            assert found.contracts[0] - 1e-12 <= share <= found.contracts[1] + 1e-12


@pytest.mark.parametrize("p", [5e-324, 1e-16, 0.1, 1 - 1e-16, 1.0])
def test_bounds_stand_in_order_however_rare_a_pattern_is(spiral, p):
    for found in (random_arrivals(spiral, p, horizon=spiral.schedule.period), random_arrivals(spiral, p)):
        assert np.all(found.probability[:, 0] <= found.probability[:, 1])
        assert np.all(found.factor[:, 0] <= found.factor[:, 1])


def test_without_losses_it_is_the_certificate_itself(spiral):
    found = random_arrivals(spiral, 0.0)
    assert found.contracts == (1.0, 1.0)
    assert found.mean_factor[1] <= spiral.lam * np.exp(-spiral.eta * found.length) < 1
    assert found.rate > 0
    assert found.length >= spiral.horizon().length > found.length - spiral.schedule.period


def test_no_expected_factor_contracts_where_no_filter_bears_the_losses(spiral):
    least = loss_tolerance(SPIRAL, spiral.schedule).upper
    for periods in (1, 3):
        found = random_arrivals(spiral, least, horizon=periods * spiral.schedule.period)
        assert found.mean_factor[0] >= 1
        assert found.rate is None
        assert found.windows_in_a_row(2)[0] <= found.contracts[0]
        assert "does not shrink" in found.explain()


@pytest.mark.parametrize("cases", [2_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_drawn_records_keep_the_mean(spiral, cases):
    """The error of the filter restarted each window, from the worst start, with losses that are drawn."""
    rng, p = np.random.default_rng(5), 0.25
    found = random_arrivals(spiral, p)
    worst = int(np.argmax(found.factor[:, 1]))
    start, times, rows = list(windows(spiral, round(found.length / spiral.schedule.period)))[worst]
    counts = {}
    for received in rng.uniform(size=(cases, len(times))) >= p:
        counts[tuple(received)] = counts.get(tuple(received), 0) + 1
    rho = {each: factor(spiral, start, times, rows, each) for each in counts}
    mean = sum(counts[each] * rho[each] for each in counts) / cases
    spread = np.sqrt(sum(counts[each] * (rho[each] - mean) ** 2 for each in counts) / cases**2)
    assert abs(mean - found.factor[worst, 0]) < 4 * spread
    share = sum(counts[each] for each in counts if rho[each] < 1) / cases
    assert abs(share - found.probability[worst, 0]) < 4 * np.sqrt(0.25 / cases)


@pytest.mark.parametrize(("size", "per", "angle"), few([(1e-9, 1.0, 0.0), (1e9, 3600.0, 0.0), (1.0, 1.0, 0.8)], 2))
def test_units_and_axes_change_nothing(spiral, size, per, angle, monkeypatch):
    monkeypatch.setattr(module, "MOST_CLASSES", 8)
    monkeypatch.setattr(module, "STEPS", 16)
    T = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    c = spiral
    P2 = T @ c.P2 @ T.T
    weights = {"P2": P2, "Qw": c.Qw / per, "R": c.R / size**2, "Qv": c.Qv / size**2, "eta": c.eta / per}
    times = PeriodicSchedule(c.schedule.gaps * per, first=c.schedule.first * per)
    turned = Plant(T @ SPIRAL.A @ T.T / per, SPIRAL.C @ T.T * size, G=T / per)
    made = sd.certify(turned, times, **weights)
    assert random_arrivals(made, 0.2).contracts == pytest.approx(random_arrivals(c, 0.2).contracts)
    often = [random_arrivals(each, arrival_rate=rate) for each, rate in ((made, 2.0 / per), (c, 2.0))]
    assert often[0].probability == pytest.approx(often[1].probability, rel=1e-4)
    assert often[0].factor == pytest.approx(often[1].factor, rel=1e-2)


def test_growth_beyond_doubles_is_bounded_by_nothing(monkeypatch):
    monkeypatch.setattr(module, "MOST_CLASSES", 16)
    steep = sd.certify(Plant([[10.0]], [[1.0]]), PeriodicSchedule([1.0]))
    found = random_arrivals(steep, 0.5, horizon=60.0)
    assert found.contracts[0] >= 0
    assert found.mean_factor[1] == np.inf
    assert "not decided" in found.explain() or "does not shrink" in found.explain()


@pytest.mark.parametrize("plant", [Plant([[-100.0]], [[1.0]]), Plant(np.zeros((0, 0)), np.zeros((1, 0)))])
def test_a_factor_below_all_doubles_still_has_a_rate_that_is_proven(plant, monkeypatch):
    """e^{-eta M} is 0 in doubles; with no states there is no error, and nothing but 0 to bound."""
    monkeypatch.setattr(module, "MOST_CLASSES", 16)
    made = sd.certify(plant, PeriodicSchedule([1.0]), eta=8.0)
    found = random_arrivals(made, 0.3, horizon=120.0)
    assert found.contracts[1] == 1.0
    assert 5.0 < found.rate <= 9.0
    assert "at the rate" in found.explain()


def test_what_it_says(spiral):
    found = random_arrivals(spiral, 0.05)
    assert "If each sample is lost with probability 0.05, a window" in found.explain()
    assert "at the rate" in found.explain()
    assert found.to_dict()["contracts"] == list(found.contracts)
    assert "at least 0.9998" in str(found.claim)


def test_what_is_nearly_certain_is_not_called_certain(spiral):
    found = random_arrivals(spiral, 0.05)
    for least, said, word in ((1 - 1e-9, "0.999999999", "0.999999999"), (1.0, "1", "1"), (0.25, "0.25", "0.25")):
        nearly = dataclasses.replace(found, probability=np.full_like(found.probability, least))
        assert f"at least {said}, and" in str(nearly.claim)
        assert f"with probability {said} to" in repr(nearly) + str(nearly)
        assert f"contracts with probability {word}." in nearly.explain()


def test_a_window_is_no_period_longer_for_rounding():
    for period in (0.1, 0.3, 1 / 3, 7.7e8):
        for count in range(1, 60):
            assert module_of_windows._periods(count * period, period, 1, True) == count
            assert module_of_windows._periods(count * period * (1 + 1e-6), period, 1, True) == count + 1


def test_what_it_refuses(spiral):
    with pytest.raises(ArgumentError, match=r"`loss_probability` must lie between 0 and 1, got 1\.5"):
        random_arrivals(spiral, 1.5)
    with pytest.raises(ArgumentError, match="must be a whole number of periods"):
        random_arrivals(spiral, 0.1, horizon=3.0)
    with pytest.raises(ArgumentError, match="spans 129 samples: at most 128 are followed"):
        random_arrivals(spiral, 0.1, horizon=43 * spiral.schedule.period)
    with pytest.raises(ArgumentError, match=r"spans 1e\+300 samples: at most 128"):
        random_arrivals(spiral, 0.1, horizon=1e300 * spiral.schedule.period / len(spiral.schedule))
    with pytest.raises(ArgumentError, match="spans inf samples"):
        random_arrivals(sd.certify(Plant([[-0.5]], [[1.0]]), PeriodicSchedule([0.25])), 0.1, horizon=1e308)
    finite = sd.certify(Plant([[-0.5]], [[1.0]]), Schedule([1.0, 2.0]))
    with pytest.raises(ArgumentError, match="must be on a periodic schedule"):
        random_arrivals(finite, 0.1)
    with pytest.raises(ArgumentError, match="`certificate` must be"):
        random_arrivals(SPIRAL, 0.1)
    with pytest.raises(ArgumentError, match=r"spans 2\.\d+e\+07 time constants of the plant .* at most 1024"):
        random_arrivals(spiral, arrival_rate=1.0, horizon=1e7)


def drawn_factors(certificate, rate, length, count, seed=7):
    """Rho of drawn arrivals of the spiral in closed form: its flow grows by e^{t/10} and turns by t; Qw is round."""
    c, rng = certificate, np.random.default_rng(seed)
    arrivals = rng.poisson(rate * length, count)
    times = np.sort(
        np.where(np.arange(arrivals.max()) < arrivals[:, None], rng.uniform(0, length, (count, arrivals.max())), length)
    )
    growth, V = 0.2 + c.eta, 1 / c.R[0, 0] + 1 / c.Qv[0, 0]
    assert c.Qw == pytest.approx(c.Qw[0, 0] * np.eye(2))
    Y, now = np.broadcast_to(np.linalg.inv(c.P2), (count, 2, 2)), np.zeros(count)
    for k in range(arrivals.max() + 1):
        then = times[:, k] if k < arrivals.max() else np.full(count, length)
        gap = then - now
        F = np.moveaxis(np.array([[np.cos(gap), np.sin(gap)], [-np.sin(gap), np.cos(gap)]]), 2, 0)
        F = F * np.exp(growth * gap / 2)[:, None, None]
        Y = F @ Y @ F.swapaxes(1, 2) + (np.expm1(growth * gap) / growth / c.Qw[0, 0])[:, None, None] * np.eye(2)
        seen = np.linalg.inv(np.linalg.inv(Y) + np.diag([1 / V, 0.0]))
        Y, now = np.where((k < arrivals)[:, None, None], seen, Y), then
    return np.exp(-c.eta * length) * np.abs(np.linalg.eigvals(c.P2 @ Y)).max(axis=1)


@pytest.mark.parametrize(
    ("rate", "periods", "count"),
    [
        (0.6, 1, 4_000),
        pytest.param(1.5, 1, 100_000, marks=pytest.mark.long),
        pytest.param(1.0, 3, 100_000, marks=pytest.mark.long),
    ],
)
def test_drawn_poisson_arrivals_lie_between_the_bounds(spiral, rate, periods, count, monkeypatch):
    if count < 100_000:
        monkeypatch.setattr(module, "MOST_CLASSES", 48)
    length = periods * spiral.schedule.period
    found = random_arrivals(spiral, arrival_rate=rate, horizon=length)
    rho = drawn_factors(spiral, rate, length, count)
    room = 4 / np.sqrt(count)
    assert found.contracts[0] - room < np.mean(rho < 1) < found.contracts[1] + room
    assert found.mean_factor[0] - room * rho.std() < rho.mean() < found.mean_factor[1] + room * rho.std()
    assert found.mean_factor[1] < 3 * found.mean_factor[0] or periods > 1
    assert found.contracts[1] - found.contracts[0] < 0.5


def test_rates_of_nothing_and_of_very_much(spiral, monkeypatch):
    monkeypatch.setattr(module, "MOST_CLASSES", 8)
    length = spiral.schedule.period
    never = random_arrivals(spiral, arrival_rate=0.0, horizon=length)
    lost = random_arrivals(spiral, 1.0, horizon=length)
    assert never.factor[0] == pytest.approx([lost.factor.max()] * 2, rel=1e-9)
    rarely = random_arrivals(spiral, arrival_rate=1e-9, horizon=length)
    assert rarely.mean_factor == pytest.approx(never.mean_factor, rel=1e-6)
    assert rarely.contracts == pytest.approx(never.contracts, abs=1e-6)
    often = random_arrivals(spiral, arrival_rate=1e4)
    assert often.contracts[0] > 1 - 1e-3
    assert often.mean_factor[1] < spiral.lam * np.exp(-spiral.eta * often.length) < 1  # today's claim
    assert often.rate > 0
    assert "samples come as a Poisson process, 10000 per" in often.explain()


@pytest.mark.parametrize("rate", few([1e6, 1e9, 1e12, 1e15, 1e18, 1e60, 1e300], 2, 4, 6))
def test_more_samples_do_no_harm_however_many(rate, monkeypatch):
    """Both values are monotone in the rate, so that bounds at one of them are bounds at every other, on one side."""
    monkeypatch.setattr(module, "MOST_CLASSES", 8)
    A = np.diag([1.0, 1.0], 1) + 0.2 * np.eye(3)
    made = sd.certify(Plant(A, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), PeriodicSchedule([1.0]), eta=2.0, P2=np.eye(3))
    few_, many = (random_arrivals(made, arrival_rate=each) for each in (1e3, rate))
    assert many.mean_factor[0] <= many.mean_factor[1]
    assert many.mean_factor[0] <= few_.mean_factor[1] < 1
    assert many.contracts[1] >= few_.contracts[0] > 0.9
    assert many.contracts[0] > 0.9


@pytest.mark.parametrize("x", [1e-9, 0.5, 30.0, 0.99 * module.OFTEN, 1.01 * module.OFTEN])
def test_the_mean_of_one_over_the_arrivals(x):
    """E[1/N; N > 0] = e^-x (Ei(x) - ln x - gamma)."""
    with mp.workdps(60):
        exact = mp.exp(-mp.mpf(x)) * (mp.ei(x) - mp.log(x) - mp.euler) / -mp.expm1(-mp.mpf(x))
    assert module._mean_inverse(x) == pytest.approx(float(exact), rel=1e-9)


@pytest.mark.long
def test_a_poisson_process_is_the_limit_of_losses_on_a_fine_grid(spiral, monkeypatch):
    monkeypatch.setattr(module, "MOST_CLASSES", 24)
    c, rate, count = spiral, 1.0, 12
    length = c.schedule.period
    fine = PeriodicSchedule([length / count] * count)
    weights = {"P2": c.P2, "Qw": c.Qw, "R": c.R, "Qv": c.Qv, "eta": c.eta}
    grid = random_arrivals(sd.certify(SPIRAL, fine, **weights), np.exp(-rate * length / count), horizon=length)
    limit = random_arrivals(c, arrival_rate=rate, horizon=length)
    assert limit.mean_factor[0] * 0.9 < grid.mean_factor[0] < grid.mean_factor[1] < limit.mean_factor[1] * 1.1
    assert limit.contracts[0] - 0.02 < grid.contracts[0] < grid.contracts[1] < limit.contracts[1] + 0.02
    assert grid.mean_factor[1] < 1.1 * grid.mean_factor[0]


def test_lost_arrivals_thin_the_process(spiral, monkeypatch):
    monkeypatch.setattr(module, "MOST_CLASSES", 8)
    monkeypatch.setattr(module, "STEPS", 16)
    thinned = random_arrivals(spiral, 0.25, arrival_rate=2.0)
    assert thinned.factor == pytest.approx(random_arrivals(spiral, arrival_rate=1.5).factor)
    assert "each of which is lost with probability 0.25" in thinned.explain()
    assert thinned.samples == pytest.approx(2.0 * thinned.length)


def test_one_state_is_bounded_closely(monkeypatch):
    """Few classes say almost all where Y is a number that samples bring back to nearly the same."""
    monkeypatch.setattr(module, "MOST_CLASSES", 48)
    made = sd.certify(Plant([[0.2]], [[1.0]]), Schedule([1.0, 2.0]))
    found = random_arrivals(made, arrival_rate=2.0, horizon=4.0)
    assert found.mean_factor[1] < 1.02 * found.mean_factor[0]
    assert found.contracts[1] - found.contracts[0] < 0.02
    bare = random_arrivals(
        sd.certify(Plant(np.zeros((0, 0)), np.zeros((1, 0))), PeriodicSchedule([1.0])), arrival_rate=1.0
    )
    assert (bare.contracts, bare.mean_factor) == ((1.0, 1.0), (0.0, 0.0))


def test_the_other_mean_would_be_no_bound(spiral, monkeypatch):
    """Of 1/Y the means are harmonic: with the arithmetic one what is called a lower bound is not."""
    exact = random_arrivals(spiral, 0.4, horizon=2 * spiral.schedule.period)
    monkeypatch.setattr(module, "MOST_CLASSES", 4)
    assert np.all(random_arrivals(spiral, 0.4, horizon=2 * spiral.schedule.period).factor[:, 0] < exact.factor[:, 0])
    monkeypatch.setattr(module, "_harmonic", lambda Y, Z, a, b: a * Y + b * Z)
    wrong = random_arrivals(spiral, 0.4, horizon=2 * spiral.schedule.period)
    assert np.any(wrong.factor[:, 0] > 1.01 * exact.factor[:, 0])


def test_bounds_of_a_sample_hold_where_a_row_sees_growth_at_a_slant():
    rng = np.random.default_rng(11)
    for _ in range(20):
        grown, row = rng.standard_normal(3), rng.standard_normal((1, 3))
        row -= (1 - 10.0 ** -rng.uniform(0, 3)) * (row @ grown) / (grown @ grown) * grown
        Y = 1e14 * np.outer(grown, grown) + np.diag(rng.uniform(0.1, 1.0, 3))
        with mp.workdps(50):
            exact, c = mp.matrix(Y.tolist()), mp.matrix(row.tolist())
            cross = exact * c.T
            exact -= cross * cross.T / (1 + (c * cross)[0])
            over, under = (
                [way(Y[None], row)[0][i, j] - exact[i, j] for i in range(3) for j in range(3)]
                for way in (module._updated, module._updated_below)
            )
        assert np.linalg.eigvalsh(np.array(over, dtype=float).reshape(3, 3))[0] >= 0
        assert np.linalg.eigvalsh(np.array(under, dtype=float).reshape(3, 3))[-1] <= 0
