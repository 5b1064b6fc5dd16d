"""Bounds are kept, resonance resonates, and simulated truths are exact."""

import numpy as np
import pytest

from sampling_design import ArgumentError, PeriodicSchedule, Plant, simulate_record
from sampling_design.estimators.gap_flows.cost_weights import largest_energy
from sampling_design.estimators.window.check_points import SAME_TIME_ULPS
from sampling_design.validation.scenario import (
    ScenarioBounds,
    draw_inputs,
    initial_inputs,
    most_along,
    resonant_inputs,
    scaled_to,
    within,
)
from sampling_design.validation.timeline import CELLS_PER_GAP, build_timeline, default_duration
from tests.oracles.validation import integrate
from tests.validation.plants import FINITE, PLANTS, SCHEDULES

OSCILLATOR = PLANTS["oscillator"]


def excess(bound, values):
    if bound.ndim == 0:
        return np.max(np.linalg.norm(values, axis=-1)) - bound
    return np.max(np.abs(values) - bound)


@pytest.mark.parametrize("bounds", [(0.4, 0.3, 1.5), ([0.1, 0.7], [0.3], [1.0, 2.0])], ids=["norms", "entries"])
def test_every_scenario_stays_within_its_bounds_and_reaches_them(bounds):
    chosen = ScenarioBounds.of(OSCILLATOR, *bounds)
    line = build_timeline(OSCILLATOR, SCHEDULES["oscillator"], 15.0, 4.0)
    seeds = np.random.SeedSequence(0).spawn(40)
    for inputs in (draw_inputs(line, chosen, seeds), resonant_inputs(line, chosen)[0], initial_inputs(line, chosen)):
        for bound, values in zip((chosen.e0, chosen.w, chosen.v), inputs, strict=True):
            assert excess(bound, values) <= 1e-12
    drawn = draw_inputs(line, chosen, seeds)
    for bound, values in zip((chosen.e0, chosen.w, chosen.v), drawn, strict=True):
        assert excess(bound, values) >= -1e-12  # some draws are on the bound


def test_a_resonant_disturbance_drives_an_oscillator_at_the_fastest_rate():
    line = build_timeline(OSCILLATOR, PeriodicSchedule([1.0]), 40.0)
    inputs, names = resonant_inputs(line, ScenarioBounds.of(OSCILLATOR, 1.0))
    assert len(names) == 2
    assert names[0].startswith("1 rad per s")
    for w in inputs.w:
        x = integrate(OSCILLATOR.A, OSCILLATOR.G, np.zeros(2), line.times, w)[-1]
        assert np.linalg.norm(x) > 0.98 * 40.0  # |w| <= 1 cannot drive it faster than d|x|/dt = 1


def test_directions_and_sizes():
    ball, box = np.asarray(2.0), np.array([1.0, 3.0])
    assert most_along(ball, np.array([3.0, 4.0])) == pytest.approx([1.2, 1.6])
    assert most_along(ball, np.zeros(2)) == pytest.approx([0.0, 0.0])
    assert most_along(box, np.array([-0.1, 9.0])) == pytest.approx([-1.0, 3.0])
    assert scaled_to(box, np.array([[2.0, 1.0]])) == pytest.approx(np.array([[1.0, 0.5]]))
    assert scaled_to(ball, np.zeros((3, 2))) == pytest.approx(np.zeros((3, 2)))
    draws = within(ball, np.random.default_rng(0).normal(size=(2000, 2)))
    assert 0.4 < np.mean(np.linalg.norm(draws, axis=1) > 2.0 - 1e-9) < 0.6
    weight = np.array([[2.0, 0.5], [0.5, 1.0]])
    best = max(z @ weight @ z for z in np.array([[1, 3], [1, -3], [-1, 3]], float))
    assert largest_energy(weight, box) == pytest.approx(best)
    assert largest_energy(weight, ball) == pytest.approx(4 * np.linalg.eigvalsh(weight)[-1])


@pytest.mark.parametrize("size", [1e-320, 1e-162, 1e-155, 1.0, 1e300])
def test_what_reaches_furthest_keeps_its_bound_however_little_it_reaches(size):
    direction = size * np.array([[3.0, 4.0], [-0.5, 0.0]])
    found = most_along(np.asarray(2.0), direction)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 2.0, rtol=1e-14)
    np.testing.assert_allclose(found, [[1.2, 1.6], [-2.0, 0.0]], rtol=1e-3)


def test_a_simulated_record_is_exact_with_inputs_and_feedthrough():
    plant = Plant([[0.0, 1.0], [-1.0, -0.2]], [[1.0, 0.0], [0.0, 1.0]], B=[[0.0], [1.0]], D=[[0.5], [0.0]])
    schedule = PeriodicSchedule([0.7, 1.1], outputs=[[1, 1], [1, 0]])
    changes = [(0.35, [2.0]), (3.1, [-1.0])]
    found = simulate_record(plant, schedule, 6.0, x0=[1.0, 0.0], inputs=changes, w_bound=0.2, v_bound=0.1)
    edges = np.unique(np.concatenate([found.times, [0.35, 3.1]]))
    middle = (edges[1:] + edges[:-1]) / 2
    u = np.where(middle < 0.35, 0.0, np.where(middle < 3.1, 2.0, -1.0))[:, None]
    w = found.w[np.searchsorted(found.times, middle) - 1]
    both = np.hstack([w, u])
    states = integrate(plant.A, np.hstack([plant.G, plant.B]), [1.0, 0.0], edges, both)
    assert found.states == pytest.approx(states[np.searchsorted(edges, found.times)], abs=1e-8)
    with pytest.raises(ArgumentError, match=r"`inputs` must hold pairs \(t, u\), got float 0.35"):
        simulate_record(plant, schedule, 6.0, inputs=[0.35])
    record = found.measurements
    taken = np.isfinite(record.y).any(axis=1)
    assert record.times[taken] == pytest.approx(schedule.between(0.0, 6.0).times)
    assert np.isnan(record.y[taken][1, 1])
    held = np.array([[0.0 if t < 0.35 else 2.0 if t < 3.1 else -1.0] for t in record.times])
    assert record.u == pytest.approx(held)
    expected = found.truth @ plant.C.T + held[taken] @ plant.D.T + found.v
    assert np.nanmax(np.abs(record.y[taken] - expected)) < 1e-12
    assert "exact" in found.explain()
    assert "largest w" in str(found)


def test_window_starts_are_break_points_and_snap_to_samples():
    line = build_timeline(OSCILLATOR, PeriodicSchedule([0.1]), 2.0, horizon=0.3)
    starts = line.times[line.starts]
    samples = line.times[line.samples]
    assert starts[3:] == pytest.approx(samples[3:] - 0.3, abs=2 * SAME_TIME_ULPS * np.spacing(2.0))
    assert np.isin(line.starts[4:], line.samples).all()  # 0.4 - 0.3 is the sample at 0.1 but for rounding
    uneven = build_timeline(OSCILLATOR, PeriodicSchedule([1.0]), 6.0, horizon=2.25)
    assert uneven.times[uneven.starts] == pytest.approx(np.maximum(np.arange(1.0, 7.0) - 2.25, 0.0))
    assert np.max(uneven.lengths) <= 1.0 / CELLS_PER_GAP + 1e-12


def test_default_durations():
    assert default_duration(FINITE, 99.0) == FINITE.times[-1]
    assert default_duration(PeriodicSchedule([1.0]), 5.0) == 41.0
    assert default_duration(PeriodicSchedule([1.0]), 500.0) == 201.0


def test_bad_input_is_refused():
    with pytest.raises(ArgumentError, match="`w_bound` must not be negative"):
        ScenarioBounds.of(OSCILLATOR, [-1.0, 1.0])
    with pytest.raises(ArgumentError, match="`v_bound` must not be negative"):
        ScenarioBounds.of(OSCILLATOR, None, -1.0)
    with pytest.raises(ArgumentError, match="`initial_error` must have 2 entries"):
        ScenarioBounds.of(OSCILLATOR, None, None, [1.0])
    with pytest.raises(ArgumentError, match="`schedule` holds no sample in"):
        simulate_record(OSCILLATOR, PeriodicSchedule([5.0]), 3.0)
    with pytest.raises(ArgumentError, match="`duration` must be positive"):
        simulate_record(OSCILLATOR, PeriodicSchedule([5.0]), -3.0)


@pytest.mark.parametrize("growth", [150.0, 800.0])
def test_a_truth_beyond_all_numbers_is_refused_and_not_left_out(growth):
    plant = Plant([[growth, 1.0], [-1.0, growth]], [[1.0, 0.0]])
    with pytest.raises(ArgumentError, match="`duration` must end before the state grows beyond all numbers, at t = "):
        simulate_record(plant, PeriodicSchedule([0.5]), 6.0, x0=[1.0, 0.0])


@pytest.mark.parametrize("outputs", [1, 2])
@pytest.mark.parametrize("bound", [0.1, None], ids=["norm", "entries"])
def test_noise_varies_unless_it_is_asked_to_stand_still(outputs, bound):
    """Seven records of five seeds had the same number at every sample, and did not say so."""
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2)[:outputs])
    size = [0.1] * outputs if bound is None else bound
    for seed in range(6):
        for noise in ("independent", "extremal", "constant"):
            record = simulate_record(
                plant, PeriodicSchedule([0.7]), 20.0, v_bound=size, noise=noise, rng=np.random.default_rng(seed)
            )
            assert record.noise == noise
            assert f"{noise} noise" in record.explain()
            assert (np.ptp(record.v, axis=0) == 0).all() == (noise == "constant")
            within = np.abs(record.v).max() if bound is None else np.linalg.norm(record.v, axis=1).max()
            assert within <= 0.1 * (1 + 1e-12)
    with pytest.raises(ArgumentError, match="`noise` must be one of independent, extremal, constant"):
        simulate_record(plant, PeriodicSchedule([0.7]), 3.0, noise="white")
