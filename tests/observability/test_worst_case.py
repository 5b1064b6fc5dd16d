"""Worst case sigma over spaced schedules: known values, edges, honesty of the bounds, errors."""

import json

import mpmath
import numpy as np
import pytest

import sampling_design as sd
from sampling_design import Plant
from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.observability.windows.sampled import sigma_min
from sampling_design.observability.worst_case import spaced_sphere
from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.observability.worst_case.spaced_search import search_worst, worst_of
from sampling_design.observability.worst_case.spaced_sphere import prove_worst
from sampling_design.observability.worst_case.spaced_tables import SphereTables
from sampling_design.observability.worst_case.worst_case_sigma import worst_case_sigma
from sampling_design.records.record import below
from sampling_design.schedules.spaced_windows import SpacedWindows
from tests.cases import few
from tests.oracles.worst_case import brute_force, is_admissible, sigma_of_times


def oscillators(*rates, damping=0.0):
    n = 2 * len(rates)
    A, C = np.zeros((n, n)), np.zeros((1, n))
    for i, w in enumerate(rates):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[-damping * w, w], [-w, -damping * w]]
        C[0, 2 * i] = 1.0
    return Plant(A, C)


def chain(n):
    return Plant(np.eye(n, k=1), np.eye(1, n))


@pytest.mark.parametrize(
    ("plant", "window", "count", "spacing", "sigma"),
    [
        (chain(2), 4.0, 2, 0.5, 0.0909215),
        (oscillators(1.0), 4.0, 3, 0.5, 0.3498820),
        (chain(3), 4.0, 3, 0.5, 0.0144325),
        (oscillators(1.0, 2.0), 4.0, 6, 0.3, 0.0486199),
        (oscillators(1.0, 3.0), 4.0, 7, 0.3, 0.0529931),
    ],
)
def test_known_plants_close_to_one_per_cent(plant, window, count, spacing, sigma):
    found = worst_case_sigma(plant, SpacedWindows(window, count, spacing))
    assert found.closed
    assert found.status == "closed"
    assert found.upper == pytest.approx(sigma, rel=2e-6)
    assert 0.99 * found.upper <= found.lower <= found.upper
    assert is_admissible(found.witness, window, spacing)
    assert found.upper == pytest.approx(sigma_of_times(plant.A, plant.C, found.witness), rel=1e-9)
    assert np.linalg.norm(found.direction) == pytest.approx(1.0)


def test_double_integrator_has_the_closed_form_at_the_end_of_the_window():
    # two samples at T - eps and T: O'O has trace 2 + a^2 + b^2 and determinant (b - a)^2
    a, b = 3.5, 4.0
    trace, determinant = 2 + a * a + b * b, (b - a) ** 2
    exact = np.sqrt((trace - np.sqrt(trace**2 - 4 * determinant)) / 2)
    found = worst_case_sigma(chain(2), SpacedWindows(4.0, 2, 0.5), rtol=1e-4)
    assert found.upper == pytest.approx(exact, rel=1e-12)
    assert exact * (1 - 1e-4) <= found.lower <= exact
    np.testing.assert_allclose(found.witness, [a, b], atol=1e-12)


@pytest.mark.parametrize("rtol", [0.3, 0.03, 0.003])
def test_bracket_is_as_narrow_as_asked_and_not_by_luck(rtol):
    found = worst_case_sigma(oscillators(1.0), SpacedWindows(4.0, 3, 0.5), rtol=rtol)
    assert found.closed
    assert found.lower >= (1 - rtol) * found.upper


def test_wider_families_are_worse_and_more_samples_are_better():
    sigma = [worst_case_sigma(chain(2), SpacedWindows(4.0, k, 0.5)).upper for k in (2, 3, 4)]
    assert sigma[0] < sigma[1] < sigma[2]
    near = worst_case_sigma(chain(2), SpacedWindows(4.0, 3, 0.25))
    assert near.upper < sigma[1]


def test_samples_half_a_period_apart_leave_a_direction_unseen():
    found = worst_case_sigma(oscillators(1.0), SpacedWindows(4.0, 2, 0.5))
    assert (found.lower, found.status, found.closed) == (0.0, "below rounding", True)
    assert found.upper < 1e-12
    assert found.witness[1] - found.witness[0] == pytest.approx(np.pi, abs=1e-9)
    assert "which rounding does not tell from zero" in found.explain()


def test_just_above_the_critical_number_sigma_is_small_but_proven_positive():
    # a window of just less than half a period holds no two times that miss the same direction
    found = worst_case_sigma(oscillators(1.0), SpacedWindows(np.pi - 1e-3, 2, 0.5))
    assert found.closed
    assert 0.98e-3 / np.sqrt(2) < found.lower <= found.upper < 1.02e-3 / np.sqrt(2)


def test_too_few_measurements_mean_zero():
    found = worst_case_sigma(chain(3), SpacedWindows(4.0, 2, 0.5))
    assert (found.lower, found.upper, found.status, found.closed) == (0.0, 0.0, "too few samples", True)
    assert is_admissible(found.witness, 4.0, 0.5)
    np.testing.assert_allclose(np.linalg.norm(found.profile.at_samples), 0.0, atol=1e-12)
    assert "fewer measurements than the 3 states" in found.explain()


def test_unobservable_plant_shows_the_unseen_direction():
    found = worst_case_sigma(Plant(np.diag([-1.0, -2.0]), [[1.0, 0.0]]), SpacedWindows(4.0, 4, 0.3))
    assert (found.lower, found.status) == (0.0, "below rounding")
    np.testing.assert_allclose(np.abs(found.direction), [0.0, 1.0], atol=1e-12)


def test_plant_without_states_has_nothing_to_miss():
    found = worst_case_sigma(Plant(np.zeros((0, 0)), np.zeros((1, 0))), SpacedWindows(4.0, 2, 0.3))
    assert (found.lower, found.upper, found.status) == (np.inf, np.inf, "no states")
    assert "nothing to observe" in found.explain()


def test_one_state_is_a_line_and_its_least_row_decides():
    found = worst_case_sigma(Plant([[-1.0]], [[2.0]]), SpacedWindows(3.0, 1, 0.3), rtol=1e-3)
    assert found.upper == pytest.approx(2 * np.exp(-3.0), rel=1e-9)
    assert found.lower >= 2 * np.exp(-3.0) * (1 - 1e-3)


def test_no_slack_leaves_one_schedule():
    found = worst_case_sigma(oscillators(1.0), SpacedWindows(4.0, 9, 0.5))
    exact = sigma_min(oscillators(1.0), np.arange(9) / 2)
    assert found.method == "only one schedule is admissible"
    assert exact * (1 - 1e-9) <= found.lower <= exact == found.upper


def test_spacing_that_does_not_fit_says_what_would():
    with pytest.raises(InfeasibleRequirementError, match="What fits: spacing at most") as caught:
        worst_case_sigma(chain(2), SpacedWindows(4.0, 10, 0.5))
    assert worst_case_sigma(chain(2), SpacedWindows(4.0, caught.value.nearest["count"], 0.5)).lower > 0


def test_several_outputs_agree_with_enumeration():
    A = np.array([[0.0, 1.0, 0.0], [-2.0, 0.0, 1.0], [0.0, 0.0, -0.3]])
    C = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = worst_case_sigma(Plant(A, C), SpacedWindows(2.0, 2, 0.4))
    best, _ = brute_force(A, C, 2.0, 2, 0.4, 25)
    assert found.closed
    assert found.lower <= best
    assert found.upper <= best * (1 + 1e-6)


def test_dip_narrower_than_the_first_grid_is_not_missed(monkeypatch):
    # samples half a turn apart see little but the faint second output: a dip of width 1e-3 in a window of 0.6,
    # met with a first grid of two cells and an attained bound that knows nothing of it
    monkeypatch.setattr(SphereTables, "first_cells", lambda self: 2)
    plant = Plant([[0.0, 25.0], [-25.0, 0.0]], [[1.0, 0.0], [0.0, 0.02]])
    rows = SpacedRows(plant, 0.6, 3, 0.15)
    naive = worst_of(rows, np.array([[0.0, 0.02, 0.03]]))
    dip = 0.02 * np.sqrt(3)
    assert naive.sigma > 20 * dip
    proof = prove_worst(rows, naive, 0.01, 20.0)
    assert proof.status == "closed"
    assert 0.98 * dip < proof.lower <= dip * (1 + 1e-9)
    assert proof.attained.sigma == pytest.approx(dip, rel=1e-6)


def test_bound_stays_below_the_dip_even_if_no_search_ever_finds_it(monkeypatch):
    monkeypatch.setattr(SphereTables, "first_cells", lambda self: 2)
    plant = Plant([[0.0, 25.0], [-25.0, 0.0]], [[1.0, 0.0], [0.0, 0.02]])
    rows = SpacedRows(plant, 0.6, 3, 0.15)
    naive = worst_of(rows, np.array([[0.0, 0.02, 0.03]]))
    monkeypatch.setattr(spaced_sphere, "search_from", lambda rows, direction, cells: naive)
    proof = prove_worst(rows, naive, 0.3, 0.5)
    assert proof.status == "budget"
    assert proof.lower <= 0.02 * np.sqrt(3)


@pytest.mark.long
def test_search_that_found_nothing_good_never_raises_the_proven_bound():
    plant, rng = oscillators(1.0, 2.0), np.random.default_rng(3)
    rows = SpacedRows(plant, 4.0, 6, 0.3)
    true = search_worst(rows, rng).sigma
    for _ in range(2):
        bad = worst_of(rows, np.sort(rng.uniform(0, rows.slack, (1, 6)), axis=1))
        proof = prove_worst(rows, bad, 0.05, 20.0)
        assert bad.sigma > 1.2 * true
        assert proof.lower <= true
        assert proof.attained.sigma == pytest.approx(true, rel=0.05)


def test_budget_that_runs_out_is_said_and_what_was_proven_stands(monkeypatch):
    room = "sampling_design.observability.worst_case.worst_case_sigma"
    monkeypatch.setattr(f"{room}.LEAST_SEARCH", 1e3)  # a busy machine finds less in a tenth of a second
    family = SpacedWindows(4.0, 5, 0.5)
    found = worst_case_sigma(chain(5), family, budget=0.0)
    assert (found.lower, found.status, found.closed) == (0.0, "budget", False)
    assert "the budget ran out" in found.explain()
    assert found.upper == pytest.approx(0.000994628, rel=1e-5)


def test_a_crowd_of_cells_ends_the_search_with_its_bound(monkeypatch):
    monkeypatch.setattr(spaced_sphere, "_MOST_CELLS", 12)
    found = worst_case_sigma(oscillators(1.0, 3.0), SpacedWindows(4.0, 7, 0.3))
    assert found.status == "budget"
    assert 0.0 <= found.lower <= found.upper


def test_rounding_is_taken_off_and_said():
    # e^{At} spans 1e13: what a late sample sees is known to about one
    plant = Plant(np.diag([15.0, -15.0]), [[1.0, 1.0]])
    found = worst_case_sigma(plant, SpacedWindows(2.0, 2, 0.1))
    assert found.status in ("rounding", "below rounding")
    assert found.lower <= found.upper
    worse = worst_case_sigma(Plant(np.diag([6.0, -6.0]), [[1.0, 1.0]]), SpacedWindows(2.0, 2, 0.1))
    assert worse.status in ("rounding", "below rounding")
    if worse.status == "rounding":
        assert "rounding keeps the bracket open" in worse.explain()


def test_more_states_than_corners_can_serve_are_refused_in_words():
    plant = Plant(np.diag(-np.arange(1.0, 14.0)), np.eye(13))
    found = worst_case_sigma(plant, SpacedWindows(1.0, 13, 0.05))
    assert (found.status, found.lower, found.closed) == ("too many states", 0.0, False)
    assert "retain fewer" in found.explain()
    few = worst_case_sigma(plant, SpacedWindows(1.0, 1, 0.1))  # times have no corners
    assert few.closed
    assert few.lower <= np.exp(-13.0) * (1 + 1e-6)
    assert few.upper == pytest.approx(np.exp(-13.0), rel=1e-6)


def test_the_worst_case_refers_to_the_scales_that_the_plant_has():
    plain = chain(2)
    scaled = Plant(plain.A * np.array([1.0, 10.0]) / np.array([[1.0], [10.0]]), plain.C)
    from sampling_design.plants.plant import Signals

    both = Plant(plain.A, plain.C, states=Signals(("p", "v"), (), [1.0, 10.0]))
    family = SpacedWindows(4.0, 2, 0.5)
    found = worst_case_sigma(both, family)
    assert worst_case_sigma(both.unscaled(), family).upper == pytest.approx(worst_case_sigma(plain, family).upper)
    assert found.upper == pytest.approx(worst_case_sigma(scaled, family).upper)
    assert "scaled coordinates" in str(found)


def test_time_may_be_measured_in_any_unit():
    slow = Plant(chain(2).A / 60, chain(2).C, time_unit="s")
    found = worst_case_sigma(slow, SpacedWindows(240.0, 2, 30.0, time_unit="s"))
    assert found.upper == pytest.approx(worst_case_sigma(chain(2), SpacedWindows(4.0, 2, 0.5)).upper)


def test_result_repeats_and_the_bound_needs_no_luck():
    plant, family = chain(3), SpacedWindows(4.0, 4, 0.3)
    first, second = (worst_case_sigma(plant, family) for _ in range(2))
    other = worst_case_sigma(plant, family, rng=np.random.default_rng(99))
    assert (first.lower, first.upper, first.cells) == (second.lower, second.upper, second.cells)
    np.testing.assert_array_equal(first.witness, second.witness)
    assert other.lower <= first.upper
    assert first.lower <= other.upper


def test_progress_runs_to_the_end_without_stepping_back():
    seen = []
    worst_case_sigma(chain(3), SpacedWindows(4.0, 3, 0.5), progress=lambda f, m: seen.append((f, m)))
    shares = [f for f, _ in seen]
    assert shares == sorted(shares)
    assert 0 <= shares[0] <= shares[-1] == pytest.approx(1.0)
    assert "cells open" in seen[0][1]


def test_record_shows_everything_and_is_plain_data():
    found = worst_case_sigma(chain(2), SpacedWindows(4.0, 2, 0.5))
    assert "proven" in str(found)
    assert "attained" in str(found)
    assert "is attained" in found.explain()
    assert found.claim.strength == "proven"
    assert "Theorem 17" in str(found.claim)
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert data["lower"] == found.lower
    assert data["family"] == {"window": 4.0, "count": 2, "spacing": 0.5}
    profile = found.profile
    assert np.linalg.norm(profile.at_samples) == pytest.approx(found.upper, rel=1e-9)
    np.testing.assert_array_equal(profile.samples, found.witness)
    assert profile.times[0] == 0.0
    assert profile.times[-1] == 4.0
    assert not found.witness.flags.writeable


def test_bad_arguments_are_refused_in_words():
    family = SpacedWindows(4.0, 2, 0.5)
    with pytest.raises(ArgumentError, match="`plant` must be a Plant or a plant of another kind, got int"):
        worst_case_sigma(3, family)
    with pytest.raises(ArgumentError, match="`family` must be a SpacedWindows, got tuple"):
        worst_case_sigma(chain(2), (4.0, 2, 0.5))
    with pytest.raises(ArgumentError, match=r"`rtol` must be less than 1, got 1\.5"):
        worst_case_sigma(chain(2), family, rtol=1.5)
    with pytest.raises(ArgumentError, match="`rtol` must be positive"):
        worst_case_sigma(chain(2), family, rtol=0)
    with pytest.raises(ArgumentError, match="`budget` must not be negative"):
        worst_case_sigma(chain(2), family, budget=-1)
    with pytest.raises(ArgumentError, match="`family` is in h and the plant in s"):
        worst_case_sigma(chain(2), SpacedWindows(4.0, 2, 0.5, time_unit="h"))
    with pytest.raises(ArgumentError, match="is too long for this plant"):
        worst_case_sigma(Plant([[100.0]], [[1.0]]), SpacedWindows(40.0, 2, 0.5))


def test_a_plant_without_states_is_plain_data_without_infinities():
    nothing = Plant(np.zeros((0, 0)), np.zeros((1, 0)))
    found = worst_case_sigma(nothing, SpacedWindows(4.0, 3, 0.5))
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert found.lower == np.inf
    assert (data["lower"], data["upper"], data["status"]) == (None, None, "no states")


@pytest.mark.long
@pytest.mark.parametrize(
    ("count", "scale", "best"),
    few([(3, 1.0, np.sqrt(0.5)), (4, 1.0, 1.0), (4, 1e3, 1.0), pytest.param(6, 1.0, 2.0, marks=pytest.mark.long)], 0),
)
def test_clusters_of_a_millionth_half_a_turn_apart_are_found_and_closed(count, scale, best):
    """Samples half a turn apart see the same state least: two clusters of them around its two zeros, in closed form."""
    plant, spacing = Plant(scale * oscillators(1.0).A, [[1.0, 0.0]]), 1e-6 / scale
    found = worst_case_sigma(plant, SpacedWindows(4.0 / scale, count, spacing))
    assert found.closed
    assert found.upper == pytest.approx(1e-6 * best, rel=1e-6)
    assert 0.99 * found.upper <= found.lower <= 1e-6 * best * (1 + 1e-9)


def test_a_zero_that_clusters_would_hide_is_found():
    found = worst_case_sigma(oscillators(1.0), SpacedWindows(20.0, 4, 1e-6))
    assert (found.status, found.lower) == ("below rounding", 0.0)
    assert found.upper < 1e-14
    assert np.allclose(np.diff(found.witness) % np.pi, 0.0, atol=1e-7) or np.allclose(
        np.sin(np.diff(found.witness)), 0.0, atol=1e-7
    )


def test_two_samples_a_millionth_of_the_window_apart_close():
    found = worst_case_sigma(chain(2), SpacedWindows(4.0, 2, 1e-6))
    assert found.closed
    assert found.upper == pytest.approx(1e-6 / np.sqrt(34), rel=1e-5)


def test_what_rounding_may_take_from_the_sums_is_less_than_is_allowed():
    """Against 80 digits: the rows and the state as the tables hold them, the form at a corner of a small cell."""
    rng = np.random.default_rng(5)
    rows = SpacedRows(oscillators(1.0), 4.0, 3, 1e-6)
    tables = SphereTables(rows, np.array([0.0, 1e-3, 2.0]), 1e-4)
    cells = tables.least_cells
    point = np.tile(np.arange(cells + 1), (1, 3, 1))
    table, _, at = tables.at(cells, point)
    for half in (1e-8, 1e-4, 1e-1):
        y = np.array([[1.0, rng.uniform(-0.5, 0.5)]])
        step = np.array([[0.0, half]])
        along, _, of_y = table.against(y, at)
        computed = np.einsum("bknw,bn->bkw", along, y) + along[:, :, 1] * half
        allowed = table.rounded(y, step, of_y, at)
        with mpmath.workdps(80):
            for k, w in np.ndindex(3, cells + 1):
                seen = mpmath.matrix(table.rows[at[0, k, w]].tolist())
                f, g = (seen * mpmath.matrix(v.tolist()) for v in (y[0], (y + step)[0]))
                true = sum(a * b for a, b in zip(f, g, strict=True))
                assert abs(float(true - computed[0, k, w])) <= allowed[0, k, w]


@pytest.mark.parametrize("at", few([0, 1, 5, 20], 2))
def test_an_interrupt_of_the_proof_leaves_what_is_proven(at, monkeypatch):
    plant = sd.Plant(
        [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0], [0.0, 0.0, -2.0, 0.0]],
        [[1.0, 0.0, 1.0, 0.0]],
    )
    family, calls, worked = sd.SpacedWindows(4.0, 6, 0.3), [], spaced_sphere._SphereSearch._worked

    def rung(search, cells):
        calls.append(1)
        if len(calls) == at + 1:
            raise KeyboardInterrupt
        return worked(search, cells)

    whole = sd.worst_case_sigma(plant, family)
    monkeypatch.setattr(spaced_sphere._SphereSearch, "_worked", rung)
    left = sd.worst_case_sigma(plant, family)
    assert len(calls) == at + 1
    assert (left.status, left.closed) == ("interrupted", False)
    assert 0 <= left.lower <= whole.upper
    assert whole.lower <= left.upper
    assert "interrupted before the bracket closed" in left.explain()


def test_an_interrupt_of_one_plant_leaves_the_schedule_that_it_had_found(monkeypatch):
    def rung(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(spaced_sphere._SphereSearch, "_worked", rung)
    plant = sd.UncertainPlant(
        sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), [sd.UncertainParameter("k", -0.1, 0.1, A=np.eye(2))]
    )
    found = sd.worst_case_sigma(plant, sd.SpacedWindows(4.0, 3, 0.5))
    assert (found.status, found.closed, found.lower, found.plants) == ("interrupted", False, 0.0, 1)
    assert 0 < found.upper < 2
    assert "whether sigma is positive is undecided" in found.explain()


@pytest.mark.parametrize("plant", [oscillators(1.0), chain(2)], ids=["oscillator", "chain"])
def test_what_a_rule_keeps_of_sigma_holds_for_late_and_lost_samples(plant):
    family, rng = SpacedWindows(4.0, 4, 0.5), np.random.default_rng(3)
    sigma = worst_case_sigma(plant, family)
    found = sigma.deviations
    d = found.tolerance.radius
    assert (d, found.lost_sample, found.in_sigma) == (0.005, None, False)
    assert 0 < found.late == found.lost < found.late_wider < sigma.lower
    assert found.late_wider > 0.97 * sigma.lower  # no cliff there
    for _ in range(4):
        member = family.draw(rng)
        times = member.times + d * rng.choice([-1.0, 1.0], len(member))
        real = sd.Schedule(times + d)
        assert sd.window_sigma(plant, real, 4.0).upper >= found.late
        assert sd.window_sigma(plant, real, 4.0 + 2 * d).upper >= found.late_wider
        kept = np.delete(member.times, rng.integers(1, len(member) - 1))
        assert sd.window_sigma(plant, sd.Schedule(kept), 4.0).upper >= found.lost
    assert f"If one sample is lost, sigma is at least {below(found.lost)}." in sigma.explain()
    assert "if one sample is lost" in str(sigma)
    assert sigma.to_dict()["deviations"] == found.to_dict()


def test_a_rule_with_no_sample_to_spare_keeps_nothing():
    found = worst_case_sigma(oscillators(1.0), SpacedWindows(3.0, 2, 0.5)).deviations
    assert (found.late, found.lost) == (0.0, 0.0)
    still = worst_case_sigma(Plant([[0.0]], [[1.0]]), SpacedWindows(4.0, 1, 0.5)).deviations
    assert (still.late, still.lost) == (0.0, 0.0)
    assert still.late_wider == pytest.approx(1.0, rel=0.01)


def test_a_rule_for_late_samples_says_only_what_a_lost_one_leaves():
    found = worst_case_sigma(oscillators(1.0), SpacedWindows(4.0, 4, 0.5), timing_tolerance=(0.0, 0.1))
    assert found.deviations.in_sigma
    assert found.deviations.late == found.lower
    assert found.deviations.lost == worst_case_sigma(oscillators(1.0), SpacedWindows(4.1, 3, 0.4)).lower
    assert found.explain().endswith(f" If one sample is lost, sigma is at least {below(found.deviations.lost)}.")
    balls = worst_case_sigma(oscillators(1.0), SpacedWindows(4.0, 4, 0.5), timing_tolerance=(0.0, 0.1), rigorous=True)
    assert balls.deviations.late == balls.lower < found.lower  # no more than what balls prove


def test_a_single_sample_and_a_single_state_are_said_as_such():
    few = worst_case_sigma(oscillators(1.0), SpacedWindows(3.5, 1, 1.0))
    assert few.explain().endswith("fewer measurements than the 2 states (1 sample, 1 s apart, in a window of 3.5 s).")
    none = sd.window_sigma(Plant([[0.0]], [[1.0]]), sd.PeriodicSchedule([1.0]), 0.5)
    assert "with 0 samples, too few for 1 state: sigma is 0." in none.explain()
    one = sd.window_sigma(Plant([[0.0]], [[1.0]]), sd.PeriodicSchedule([1.0]), 1.0)
    assert "with 1 sample." in one.explain()
