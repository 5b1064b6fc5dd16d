"""Sigma for samples that come early or late: no real times see less, and hardly any see as little."""

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError
from sampling_design.observability.windows import window_record
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from tests import command_lines
from tests.cases import few

DAYS = 5554.0
SATELLITE = sd.named_plant("satellite")
EVEN = sd.PeriodicSchedule.from_times((np.arange(12) + 0.5) * DAYS / 12, DAYS, time_unit="s")


def rows(plant, times, start):
    """C e^{A (t - start)}, by the definition."""
    from scipy.linalg import expm

    return np.vstack([plant.C @ expm(plant.A * (t - start)) for t in times] or [np.zeros((0, plant.n_states))])


def brute_force(plant, schedule, window, tolerance, positions=60):
    """The least sigma over corners of all real times, at evenly spaced windows: slow, plain, from above."""
    nominal = schedule.between(0, window + 4 * schedule.period).times
    least = np.inf
    for start in np.linspace(schedule.first, schedule.first + schedule.period, positions):
        sure = nominal[(nominal - tolerance >= start) & (nominal + tolerance <= start + window)]
        near = nominal[(nominal + tolerance >= start) & (nominal - tolerance <= start + window)]
        for late in product((-tolerance, 0.0, tolerance), repeat=near.size):
            real = near + late
            real = real[(real >= start) & (real <= start + window)]
            assert real.size >= sure.size
            if real.size * plant.n_outputs < plant.n_states:
                return 0.0
            least = min(least, float(np.linalg.svd(rows(plant, real, start), compute_uv=False)[-1]))
    return least


def drawn(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    plant = sd.Plant(rng.normal(size=(n, n)), rng.normal(size=(int(rng.integers(1, 3)), n)))
    schedule = sd.PeriodicSchedule(rng.uniform(0.3, 1.0, size=int(rng.integers(1, 6))))
    tolerance = float(rng.choice([0.001, 0.01, 0.05])) * schedule.gaps.min()
    return plant, schedule, float(rng.uniform(2, 5)), tolerance, rng


@pytest.mark.parametrize("seed", few(range(500), 0, 5))
def test_no_real_times_see_less_than_is_proven(seed):
    plant, schedule, window, tolerance, rng = drawn(seed)
    said = sd.window_sigma(plant, schedule, window, timing_tolerance=tolerance)
    planned = schedule.between(0, 30.0).times
    for _ in range(10):
        corners = rng.choice([-1.0, 0.0, 1.0], planned.size)
        real = planned + tolerance * (corners if rng.uniform() < 0.5 else rng.uniform(-1, 1, planned.size))
        assert sd.window_sigma(plant, sd.Schedule(real), window).upper >= said.lower * (1 - 1e-9)
    assert said.lower <= said.upper
    moved = said.witness
    assert np.all(np.abs(np.subtract.outer(moved.samples, planned)).min(axis=1, initial=0.0) <= tolerance * (1 + 1e-9))


def test_most_brackets_are_narrow():
    ratios = []
    for seed in range(20):
        plant, schedule, window, tolerance, _ = drawn(seed)
        said = sd.window_sigma(plant, schedule, window, timing_tolerance=tolerance)
        ratios.append(1.0 if said.upper == 0 else said.lower / said.upper)
    assert np.quantile(ratios, 0.5) >= 0.99
    assert np.mean(np.array(ratios) >= 0.95) >= 0.75


def test_a_small_case_agrees_with_all_corners():
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    schedule = sd.PeriodicSchedule([0.9, 0.6])
    said = sd.window_sigma(plant, schedule, 2.0, timing_tolerance=0.03)
    least = brute_force(plant, schedule, 2.0, 0.03)
    assert said.lower <= least <= said.upper * 1.02  # of windows at a grid of places
    assert said.upper <= least * (1 + 1e-9)
    assert said.lower >= 0.98 * least


def test_a_window_that_just_holds_a_sample_loses_it_and_a_little_more_of_a_window_does_not():
    """Twelve even samples in a window of one turn: eleven if one is a millionth late."""
    exact = sd.window_sigma(SATELLITE, EVEN, DAYS)
    fewer, wider = [], []
    for tolerance in (1e-6 * DAYS, 1e-2 * DAYS / 12, 0.1 * DAYS / 12):
        fewer.append(sd.window_sigma(SATELLITE, EVEN, DAYS, timing_tolerance=tolerance))
        wider.append(sd.window_sigma(SATELLITE, EVEN, DAYS + 2 * tolerance, timing_tolerance=tolerance))
    assert fewer[0].upper < 0.87 * exact.lower
    assert fewer[0].witness.samples.size == 11
    assert wider[0].lower == pytest.approx(exact.lower, rel=1e-4)
    for found in (fewer, wider):
        assert all(a.lower > b.lower for a, b in pairwise(found))
        assert found[1].lower >= 0.99 * found[1].upper
        assert found[2].lower >= 0.96 * found[2].upper
    assert wider[1].lower >= 0.99 * exact.lower


def test_the_loss_is_of_first_order_in_the_tolerance():
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    schedule, window = sd.PeriodicSchedule([0.9, 0.6]), 2.0
    exact = sd.window_sigma(plant, schedule, window, rtol=1e-9).lower
    lost = [
        exact - sd.window_sigma(plant, schedule, window + 2 * d, rtol=1e-9, timing_tolerance=d).lower
        for d in (1e-2, 1e-3, 1e-4)
    ]
    assert 5 < lost[0] / lost[1] < 20
    assert 5 < lost[1] / lost[2] < 20


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_units_change_nothing(unit):
    plant = sd.Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.3]])
    other = sd.Plant(plant.A / unit, plant.C)
    said = sd.window_sigma(plant, sd.PeriodicSchedule([0.9, 0.6]), 2.0, timing_tolerance=0.02)
    same = sd.window_sigma(
        other, sd.PeriodicSchedule([0.9 * unit, 0.6 * unit]), 2.0 * unit, timing_tolerance=0.02 * unit
    )
    assert same.lower == pytest.approx(said.lower, rel=1e-9)
    assert same.upper == pytest.approx(said.upper, rel=1e-9)


def test_growth_and_late_clocks():
    growing = sd.Plant([[20.0, 1.0], [0.0, -1.0]], [[1.0, 1.0]])
    said = sd.window_sigma(growing, sd.PeriodicSchedule([1.0]), 10.0, timing_tolerance=1e-4)
    assert 0 <= said.lower <= said.upper
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    times = np.arange(12) * 0.75
    early = sd.window_sigma(plant, sd.Schedule(times), 3.0, timing_tolerance=0.125)
    late = sd.window_sigma(plant, sd.Schedule(times + 2.0**30), 3.0, timing_tolerance=0.125)
    assert late.lower == pytest.approx(early.lower, rel=1e-4)


@pytest.mark.parametrize("size", [1e-200, 1e-12, 1e12, 1e100])
def test_the_size_of_an_output_is_a_factor(size):
    plant, schedule = sd.Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.3]]), sd.PeriodicSchedule([0.9, 0.6])
    said = sd.window_sigma(plant, schedule, 2.0, timing_tolerance=0.02)
    same = sd.window_sigma(sd.Plant(plant.A, size * plant.C), schedule, 2.0, timing_tolerance=0.02)
    assert (same.lower / size, same.upper / size) == pytest.approx((said.lower, said.upper), rel=1e-9)


@pytest.mark.parametrize("unit", few([1e4, 1e6, 1e12, 1e60], 0, 3))
@pytest.mark.parametrize("C", [[[1.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]]])
def test_rates_whose_exponential_is_no_number_prove_less_and_break_nothing(unit, C):
    """A double integrator in small units: e^(d |A|) overflows, e^(A d) does not."""
    plant, schedule = sd.Plant([[0.0, unit], [0.0, 0.0]], C), sd.PeriodicSchedule([1.0])
    for tolerance in (0.01, (0.0, 0.01), {"y1": (0.01, 0.0)}):
        said = sd.window_sigma(plant, schedule, 3.0, timing_tolerance=tolerance)
        assert 0 <= said.lower <= said.upper
        assert unit > 1e5 or said.lower > 0.9 * said.upper


SIDES = [(0.0, 0.2), (0.2, 0.0), (0.1, 0.3), {"a": (0.2, 0.0), "b": (0.0, 0.1)}]


@pytest.mark.parametrize("tolerance", [0.05, (0.03, 0.01), {"y1": 0.05, "y2": (0.0, 0.02)}])
def test_a_period_given_several_times_over_is_looked_at_once(monkeypatch, tolerance):
    """Equal gaps, and outputs in turn: the same sigma, and as many windows in which late samples are tried."""
    plant = sd.Plant([[0.0, 1.0], [-1.0, -0.1]], np.eye(2), outputs=["y1", "y2"])
    tried, own = [], window_record.moved_window
    monkeypatch.setattr(window_record, "moved_window", lambda *given: tried.append(1) or own(*given))
    for gaps, outputs in (([1.0], None), ([0.7, 0.9], [[1, 0], [0, 1]])):
        counts, found = [], []
        for times in (1, 6):
            mask = None if outputs is None else np.tile(np.array(outputs, dtype=bool), (times, 1))
            schedule = sd.PeriodicSchedule(gaps * times, first=0.4, outputs=mask)
            found.append(sd.window_sigma(plant, schedule, 4.2, timing_tolerance=tolerance))
            counts.append(len(tried))
            tried.clear()
        assert (found[0].lower, found[0].upper) == (found[1].lower, found[1].upper)
        assert counts[0] == counts[1] > 0


@pytest.mark.parametrize(("sides", "finite"), few(product(SIDES, [True, False]), 0, 3, 6, 7))
def test_no_window_begins_before_the_start_that_was_given(sides, finite):
    plant = sd.Plant([[0.3, 1.0], [-1.0, 0.3]], [[1.0, 0.2], [0.1, 1.0]], outputs=["a", "b"])
    schedule = sd.PeriodicSchedule([1.0, 0.7], first=1.6, outputs=[[True, False], [False, True]])
    asked = schedule.between(0, 9) if finite else schedule
    for start in (0.0, 0.4, 0.55):  # the rhythm begins at 0.6 or 0.9
        said = sd.window_sigma(plant, asked, 2.9, timing_tolerance=sides, start=start)
        assert said.from_time == start
        assert said.lower <= said.upper
        assert said.witness.t - said.window >= start - 1e-9
    with pytest.raises(ArgumentError, match=r"ends 8\.4 after `start` with up to 0\.2 more, got 8\.8"):
        sd.window_sigma(plant, schedule.between(0, 9), 8.8, timing_tolerance=(0.1, 0.2), start=0.0)


def test_sensors_that_measure_in_turn():
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2))
    masked = sd.PeriodicSchedule([0.5, 0.5], outputs=[[True, False], [False, True]])
    said = sd.window_sigma(plant, masked, 2.0, timing_tolerance=0.02)
    first = sd.window_sigma(plant, sd.PeriodicSchedule([0.5, 0.5]), 2.0, timing_tolerance=0.02)
    assert 0 < said.lower < first.lower
    assert said.lower >= 0.97 * said.upper


@pytest.mark.parametrize("sides", [(0.01, 0.05), (0.05, 0.01), (0.06, 0.0), (0.0, 0.06)])
def test_early_apart_from_late_is_one_number_about_another_time(sides):
    plant, schedule = sd.Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.3]]), sd.PeriodicSchedule([0.9, 0.6])
    said = sd.window_sigma(plant, schedule, 2.0, timing_tolerance=sides)
    same = sd.window_sigma(plant, schedule, 2.0, timing_tolerance=0.03)
    assert (said.lower, said.upper) == pytest.approx((same.lower, same.upper), rel=1e-9)
    assert said.timing_tolerance == list(sides)
    early, late = sides
    off = (said.witness.samples[:, None] - schedule.between(0, 30).times).T
    assert np.all(np.any((off >= -early - 1e-9) & (off <= late + 1e-9), axis=0))
    finite = schedule.between(0, 9)
    told = sd.window_sigma(plant, finite, 2.0, timing_tolerance=sides)
    least = sd.window_sigma(plant, sd.Schedule(finite.times + late), 2.0).upper
    assert told.lower <= min(least, sd.window_sigma(plant, sd.Schedule(finite.times - early), 2.0).upper)


def by_output(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    plant = sd.Plant(rng.normal(size=(n, n)), rng.normal(size=(2, n)), outputs=["a", "b"])
    schedule = sd.PeriodicSchedule(rng.uniform(0.3, 1.0, size=int(rng.integers(1, 5))))
    unit = float(rng.choice([0.003, 0.03])) * schedule.gaps.min()
    sides = unit * rng.choice([0.0, 1.0, 2.0], size=(2, 2))
    return plant, schedule, float(rng.uniform(2, 5)), {"a": tuple(sides[0]), "b": tuple(sides[1])}, rng


@pytest.mark.parametrize("seed", few(range(300), 0, 4))
def test_outputs_that_fall_apart_see_no_less_than_is_proven(seed):
    plant, schedule, window, tolerance, rng = by_output(seed)
    said = sd.window_sigma(plant, schedule, window, timing_tolerance=tolerance)
    planned = schedule.between(0, 4 * window + 4 * schedule.period).times
    for _ in range(8):
        real = []
        for k, (early, late) in enumerate(tolerance.values()):
            share = rng.choice([0.0, 0.5, 1.0, rng.uniform()], planned.size)
            times = planned - early + share * (early + late)
            real += [(t, k) for t in times]
        real = sorted(real)
        times = np.array([t for t, _ in real])
        times += 1e-9 * np.arange(times.size)  # two that are read at once are two readings
        mask = np.zeros((times.size, 2), dtype=bool)
        mask[np.arange(times.size), [k for _, k in real]] = True
        keep = times > planned[0] + max(max(side) for side in tolerance.values())
        whole = sd.Schedule(times[keep], mask[keep])
        assert sd.window_sigma(plant, whole, window).upper >= said.lower * (1 - 1e-6)
    assert said.lower <= said.upper


def test_an_output_that_comes_on_time_loses_less():
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2), outputs=["a", "b"])
    schedule = sd.PeriodicSchedule([0.9, 0.6])
    both, first, none = (
        sd.window_sigma(plant, schedule, 2.1, timing_tolerance=tolerance)
        for tolerance in ({"a": 0.03, "b": 0.03}, {"a": 0.03}, 0.0)
    )
    assert both.lower < first.lower < none.lower
    assert both.lower >= 0.97 * both.upper
    assert first.lower >= 0.95 * first.upper
    assert "up to 0.03 s early or late (a), on time (b)" in first.explain()
    with pytest.raises(ArgumentError, match="unknown key 'c'"):
        sd.window_sigma(plant, schedule, 2.1, timing_tolerance={"c": 0.1})


@pytest.mark.parametrize("beyond", few([-0.08, 0.0, 0.01], 1, 2))
def test_the_only_output_with_a_tolerance_of_its_own_is_a_sample_with_it(beyond):
    """Windows of four gaps, early and late together longer: each just holds four samples, whenever they come."""
    plant, schedule = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), sd.PeriodicSchedule([np.pi / 2])
    own, whole = (
        sd.window_sigma(plant, schedule, 2 * np.pi + 0.1 + beyond, timing_tolerance=tolerance)
        for tolerance in ({"y1": 0.05}, 0.05)
    )
    assert (own.lower, own.upper) == pytest.approx((whole.lower, whole.upper), rel=1e-9)
    assert own.deviations.lost == pytest.approx(whole.deviations.lost, rel=1e-9)


def test_the_tolerance_of_an_output_whose_name_is_a_number_counts():
    plant = sd.Plant([[0.0]], [[1.0]], outputs=["1"])
    named, told = sd.Requirement(timing_tolerance={1: 0.25}), {"1": 0.25}
    assert named.timing_tolerance == told
    found = sd.window_sigma(plant, sd.PeriodicSchedule([1.0]), 1.25, timing_tolerance=named.timing_tolerance)
    assert found.timing_tolerance == told
    with pytest.raises(ArgumentError, match="unknown key '1'"):
        sd.design_schedule(sd.Plant([[0.0]], [[1.0]]), named)


def test_a_tolerance_that_leaves_nothing_proven_says_so():
    plant = sd.Plant([[0.0, 6.0], [-6.0, 0.0]], [[1.0, 0.0]])
    said = sd.window_sigma(plant, sd.PeriodicSchedule([0.3]), 1.0, timing_tolerance=0.14)
    assert said.lower == 0 < said.upper
    assert (said.status, said.closed) == ("timing", False)
    assert "bounded no better" in said.explain()
    empty = sd.window_sigma(plant, sd.PeriodicSchedule([0.3]), 0.4, timing_tolerance=0.14)
    assert (empty.lower, empty.upper, empty.status) == (0.0, 0.0, "too few samples")


def test_record_text_and_file_name_the_tolerance():
    said = sd.window_sigma(SATELLITE, EVEN, DAYS / 2, timing_tolerance=4.0)
    assert "up to 4 s early or late" in said.explain()
    assert "samples are up to 4 s early or late" in str(said.claim)
    assert said.to_dict()["timing_tolerance"] == 4.0
    assert dict(said._rows())["samples come"] == "up to 4 s early or late"
    assert "exact" in str(sd.window_sigma(SATELLITE, EVEN, DAYS / 2).claim)
    assert replace(said, late=ON_TIME).explain() != said.explain()


def test_what_is_refused():
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    schedule = sd.PeriodicSchedule([0.5])
    with pytest.raises(ArgumentError, match="`timing_tolerance` must"):
        sd.window_sigma(plant, schedule, 2.0, timing_tolerance=-0.1)
    with pytest.raises(ArgumentError, match=r"`timing_tolerance` must be less than half of the least gap 0\.5"):
        sd.window_sigma(plant, schedule, 2.0, timing_tolerance=0.25)
    with pytest.raises(ArgumentError, match="longer than early and late together"):
        sd.window_sigma(plant, schedule, 0.2, timing_tolerance=0.1)
    with pytest.raises(ArgumentError, match="`rigorous` is for exact sample times"):
        sd.window_sigma(plant, schedule, 2.0, rigorous=True, timing_tolerance=0.1)
    box = sd.UncertainPlant(plant, [sd.UncertainParameter("k", -0.1, 0.1, A=np.eye(2))])
    with pytest.raises(ArgumentError, match="`timing_tolerance` is for exactly known plants"):
        sd.window_sigma(box, schedule, 2.0, timing_tolerance=0.1)


@pytest.mark.parametrize(("tolerance", "code"), [("0.02", 0), ("0.14", 3), ("0.15", 2)])
def test_the_command_ends_with_what_is_proven(tolerance, code, tmp_path):
    plant = sd.Plant([[0.0, 6.0], [-6.0, 0.0]], [[1.0, 0.0]])
    sd.plants.write_plant(plant, tmp_path / "plant.toml")
    sd.schedules.write_schedule(sd.PeriodicSchedule([0.3], time_unit="s"), tmp_path / "schedule.csv")
    asked = [str(tmp_path / "plant.toml"), str(tmp_path / "schedule.csv"), "--window", "1.0"]
    ended = command_lines.run(["sigma", *asked, "--timing-tolerance", tolerance])
    assert ended.code == code
    assert ended.raw() == ""


@pytest.mark.parametrize(
    "tolerance", [{"y1": 0.01, "y2": 0.1}, {"y1": 0.1, "y2": 0.01}, {"y1": (0.0, 0.1), "y2": 0.02}]
)
@pytest.mark.parametrize("window", [1.3, 2.3])
def test_windows_are_tried_that_hold_no_output_which_nearly_comes_on_time(window, tolerance):
    """Where only starts of pieces are tried, such an output is in, and sigma attained is up to 1.3 times as large."""
    plant = sd.Plant([[0.3, 1.0], [-1.0, 0.3]], [[1.0, 0.0], [0.2, 1.0]])
    found = sd.window_sigma(plant, sd.PeriodicSchedule([1.0]), window, timing_tolerance=tolerance)
    assert found.lower >= 0.96 * found.upper
    moved, ends = found.witness, TimingTolerance.of(tolerance, plant.outputs.names)
    real = np.sort(
        np.concatenate([t + each for t in np.arange(1.0, 6.0) for each in (-np.array(ends.early), ends.late)])
    )
    assert np.all(np.abs(np.subtract.outer(moved.samples, real)).min(axis=1) < 1e-9)


def least_seen(plant, times, late, rng, starts=20, grid=41):
    """The least sigma of real times that a search found: the state, and for each sample the time that sees it least."""
    at = np.linspace(-late, late, grid)
    every = np.array([[plant.C @ plant.transition(t + e) for e in at] for t in times])[:, :, 0]
    _, size, right = np.linalg.svd(every[:, grid // 2])
    found = np.inf
    for start in range(starts):
        state = right[-1] if start == 0 else right.T @ (rng.standard_normal(len(size)) / size)
        for _ in range(20):
            chosen = every[np.arange(len(times)), np.argmin(np.abs(every @ state), axis=1)]
            _, now, turned = np.linalg.svd(chosen)
            state, found = turned[-1], min(found, now[-1])
    return found


@pytest.mark.parametrize("rate", [1.5, 2.5, 2.8])
def test_growth_hides_nothing_that_is_left_of_the_other_states(rate):
    """Rows grow by up to e^17 within a window, its squares by more than the digits of a float."""
    rng = np.random.default_rng(3)
    turned = np.array([[1.0, 0.4, 0.1], [-0.3, 1.0, 0.2], [0.2, -0.5, 1.0]])
    plant = sd.Plant(turned @ np.diag([rate, 0.4, 0.05]) @ np.linalg.inv(turned), [[1.0, 0.3, 0.5], [-0.4, 1.0, 0.2]])
    schedule = sd.PeriodicSchedule([1.0, 1.0])
    for tolerance in (0.02, {"y1": 0.02, "y2": 0.02}):
        found = sd.window_sigma(plant, schedule, 6.1, timing_tolerance=tolerance)
        assert found.lower > 0.85 * found.upper
    for start in schedule.times[0] + np.array([1e-6, 0.4, 0.8]):
        sure = np.arange(1, 12) + schedule.times[0]
        sure = sure[(sure - 0.02 > start) & (sure + 0.02 < start + 6.1)]
        assert found.lower <= least_of_both(plant, sure - start, 0.02, rng)


@pytest.mark.parametrize("late", [0.01, 0.05, 0.1])
def test_long_rows_that_hold_little_of_what_is_seen_least_take_little_from_it(late):
    """The last rows of a window are up to e^13 long; weighed alike they leave .4 of sigma at .01, nothing at .05."""
    turned = np.array([[1.0, 0.4, 0.1], [-0.3, 1.0, 0.2], [0.2, -0.5, 1.0]])
    A = np.array([[2.5, 1.2, 0.0], [-1.2, 2.5, 0.0], [0.0, 0.0, 0.05]])
    plant = sd.Plant(turned @ A @ np.linalg.inv(turned), [[1.0, 0.3, 0.5]])
    schedule = sd.PeriodicSchedule.from_times([0.1, 1.1, 1.9, 3.1], 4.0)
    found, rng = sd.window_sigma(plant, schedule, 6.0, timing_tolerance=late), np.random.default_rng(3)
    assert found.lower > 0.9 * found.upper
    planned = schedule.between(0, 20).times
    for start in np.concatenate([planned[:4] - late + 1e-9, planned[:4] + late + 1e-9]):
        sure = planned[(planned - late > start) & (planned + late < start + 6.0)]
        assert found.lower <= least_of_both(plant, sure - start, late, rng)


def least_of_both(plant, lags, late, rng, starts=10, grid=21):
    """The same as `least_seen` of two outputs that come at times of their own."""
    at = np.linspace(-late, late, grid)
    every = np.array([[plant.C @ plant.transition(lag + e) for e in at] for lag in lags])
    every = every.transpose(0, 2, 1, 3).reshape(-1, grid, plant.n_states)
    found = np.inf
    for _ in range(starts):
        chosen = every[np.arange(len(every)), rng.integers(grid, size=len(every))]
        for _ in range(20):
            _, now, turned = np.linalg.svd(chosen)
            found = min(found, now[-1])
            chosen = every[np.arange(len(every)), np.argmin(np.abs(every @ turned[-1]), axis=1)]
    return found


def test_half_an_hour_leaves_the_tide_something():
    plant, k = sd.named_plant("tidal_gauge"), np.arange(30)
    times = 24 * k + 7 + 12 * (k * (5**0.5 - 1) / 2 % 1)
    month = sd.PeriodicSchedule.from_times(times, 720.0, time_unit="h")
    found = sd.window_sigma(plant, month, 721.0, timing_tolerance=0.5)
    assert 0.0172 < found.lower < found.upper <= least_seen(plant.scaled(), times, 0.5, np.random.default_rng(0))
    assert found.lower > 0.48 * found.upper
