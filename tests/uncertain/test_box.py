"""Sigma, counts, existence and accuracy over a box of constant parameters: proven, attained, refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import (
    PeriodicSchedule,
    Plant,
    SpacedWindows,
    certificate_exists,
    guaranteed_accuracy,
    window_sigma,
    worst_case_sigma,
    zero_count_bound,
)
from sampling_design.errors import ArgumentError, NotObservableError, UndecidedError
from sampling_design.plants.plant import Signals
from sampling_design.uncertain.accuracy import accuracy_over_box
from sampling_design.uncertain.box.branching import branch, halved
from sampling_design.uncertain.box.model import BoxCells, BoxModel, exponentials
from sampling_design.uncertain.existence.largest_box import largest_box
from sampling_design.uncertain.observability import zero_count_over_box
from sampling_design.uncertain.observability.worst_case_over_box import least_over, points_of
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests.cases import few
from tests.oracles.boxes import random_box
from tests.oracles.observability import exponential_50_digits
from tests.rescale import Units

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
STIFF = [[0.0, 0.0], [-1.0, 0.0]]
DAMPED = [[0.0, 0.0], [0.0, -1.0]]


def oscillator(low=0.81, high=1.21, **more):
    return UncertainPlant(OSCILLATOR, [UncertainParameter("omega^2", low, high, A=STIFF, nominal=1.0)], **more)


def test_sigma_over_a_box_of_frequencies_is_that_of_the_worst_frequency():
    found = window_sigma(oscillator(), PeriodicSchedule([2.8]), 9.0)
    scan = min(
        window_sigma(oscillator().at([x]), PeriodicSchedule([2.8]), 9.0).upper for x in np.linspace(0.81, 1.21, 4)
    )
    assert found.closed
    assert found.sees_every_plant
    assert found.lower <= scan * (1 + 1e-9)
    assert found.lower >= 0.98 * scan
    assert found.worst["omega^2"] == pytest.approx(1.21, rel=1e-3)
    assert "for every plant of the box" in found.explain()


def test_what_late_and_lost_samples_leave_of_every_plant_is_said_beside_sigma():
    found = window_sigma(oscillator(), PeriodicSchedule([1.0, 0.7]), 3.6)
    left = found.deviations
    plants = [oscillator().at([x]) for x in (0.81, 1.21)]
    each = [window_sigma(P, PeriodicSchedule([1.0, 0.7]), 3.6).deviations for P in plants]
    for name in ("late", "late_wider", "lost"):
        least = min(getattr(one, name) for one in each)
        assert 0.95 * least <= getattr(left, name) <= least * 1.01
    assert left.lost_sample == 1
    assert left.explain() in found.explain()
    assert left._rows()[0] in found._rows()
    assert found.to_dict()["deviations"] == left.to_dict()
    spent = replace(found, beside=lambda: None)
    assert spent.deviations is None


@pytest.mark.long
def test_the_unit_of_time_changes_nothing_of_it_and_a_window_of_whole_gaps_keeps_nothing():
    left = window_sigma(oscillator(), PeriodicSchedule([1.0, 0.7]), 3.6).deviations
    slow = UncertainPlant(
        Plant(OSCILLATOR.A * 1e-12, OSCILLATOR.C),
        [UncertainParameter("k", 0.81, 1.21, A=np.array(STIFF) * 1e-12, nominal=1.0)],
    )
    same = window_sigma(slow, PeriodicSchedule(np.array([1.0, 0.7]) * 1e12), 3.6e12).deviations
    assert [same.late, same.lost] == pytest.approx([left.late, left.lost], rel=1e-9)
    cliff = window_sigma(oscillator(), PeriodicSchedule([1.0]), 2.0).deviations
    assert cliff.late == cliff.lost == 0.0 < cliff.late_wider


def test_a_schedule_that_misses_one_frequency_of_the_box_is_told_which():
    found = window_sigma(oscillator(), PeriodicSchedule([2.857]), 9.0)
    assert found.sees_every_plant is False
    assert found.lower == 0.0
    assert found.worst["omega^2"] == pytest.approx((np.pi / 2.857) ** 2, rel=1e-6)
    assert "Not every plant" in found.explain()


def test_a_window_that_holds_too_few_samples_sees_no_plant():
    found = window_sigma(oscillator(), PeriodicSchedule([2.0]), 1.0)
    assert (found.lower, found.status, found.sees_every_plant) == (0.0, "too few samples", False)


def test_an_hour_is_not_spent_where_the_budget_is_none():
    found = window_sigma(oscillator(0.5, 2.0), PeriodicSchedule([0.9]), 2.0, rtol=1e-6, budget=0.0)
    assert found.status == "budget"
    assert not found.closed
    assert found.lower <= found.upper


@pytest.mark.parametrize("time", few([10.0, 1e4, 1e-6, 1e8], 2))
def test_the_unit_of_time_changes_no_bound_of_chains_over_a_box(time):
    """An integrator has no rate of its own: only the time that is asked about says how fast it is."""
    measured, pull = np.eye(2), np.array([[0.0, 0.0], [0.1, 0.0]])

    def told(unit):
        plant = Plant(np.array([[0.0, 1.0], [0.0, 0.0]]) / unit, measured)
        box = UncertainPlant(plant, [UncertainParameter("k", -1.0, 1.0, A=pull / unit, nominal=0.0)])
        schedule = PeriodicSchedule(np.array([0.5, 0.65]) * unit)
        sigma = window_sigma(box, schedule, 1.725 * unit, rtol=0.1)
        worst = worst_case_sigma(box, SpacedWindows(unit, 3, 0.3 * unit), rtol=0.3)
        share = largest_box(box, schedule, window=1.725 * unit, at_least=0.54).share
        exists = certificate_exists(box, schedule, 0.1 / unit)
        return [sigma.lower, sigma.upper, worst.lower, worst.upper, share, exists.margin]

    assert told(time) == pytest.approx(told(1.0), rel=1e-6)


@pytest.mark.long
def test_units_change_no_bound_over_a_box():
    plant, schedule = oscillator(), PeriodicSchedule([1.0, 0.7])
    plain = window_sigma(plant, schedule, 3.0)
    units = Units(np.array([1e6, 1e-9]), np.array([1e-4]), disturbances=np.ones(2), time=1e5)
    scaled = Plant(OSCILLATOR.A, OSCILLATOR.C, states=Signals(["x", "v"], (), [1.0, 1.0]))
    moved = units.plant(scaled)
    A = np.array(STIFF) * units.states[:, None] / units.states / units.time
    other = UncertainPlant(moved, [UncertainParameter("omega^2", 0.81, 1.21, A=A, nominal=1.0)])
    found = window_sigma(other, PeriodicSchedule(schedule.gaps * units.time), 3.0 * units.time)
    assert found.lower == pytest.approx(plain.lower, rel=0.02)
    exists = [certificate_exists(p, s, 0.1 / t).exists for p, s, t in (
        (plant, PeriodicSchedule([2.8]), 1.0), (other, PeriodicSchedule([2.8 * units.time]), units.time)
    )]  # fmt: skip
    assert exists == [True, True]


def test_a_direction_in_small_units_is_not_called_unseen():
    S, schedule = np.array([1e-6, 1e9]), PeriodicSchedule([1.0, 0.7])
    moved = Plant(OSCILLATOR.A * S[:, None] / S, OSCILLATOR.C / S)
    plant = UncertainPlant(moved, [UncertainParameter("k", 0.81, 1.21, A=np.array(STIFF) * S[:, None] / S, nominal=1)])
    found = window_sigma(plant, schedule, 3.0)
    assert found.sees_every_plant
    assert found.lower >= 0.99 * found.upper > 0
    assert largest_box(plant, schedule, window=3.0).share == pytest.approx(1.0)
    assert zero_count_bound(plant, 3.0).samples == zero_count_bound(oscillator(), 3.0).samples
    missed = window_sigma(plant, PeriodicSchedule([np.pi]), 9.5)
    assert missed.sees_every_plant is False
    assert missed.worst["k"] == pytest.approx(1.0, rel=1e-6)


def test_a_count_over_a_box_is_that_of_its_fastest_plant():
    found = zero_count_bound(oscillator(), np.pi)
    assert found.samples == zero_count_bound(oscillator().at([1.21]), np.pi).samples == 3
    assert 2.2 <= found.frequency_spread <= 2.21
    assert found.attained == pytest.approx(2.2, rel=1e-6)
    assert "fastest" in found.explain()


@pytest.mark.parametrize("low", [1.0, 0.5])
def test_where_no_parameter_moves_anything_counts_and_existence_are_those_of_the_plant(low):
    """A parameter of zero width, or of the disturbance alone: of defective modes, too, which bounds in cells blur."""
    rng = np.random.default_rng(5)
    plants = [Plant(rng.normal(size=(n, n)), rng.normal(size=(p, n))) for n, p in ((2, 1),)]
    plants += [Plant(np.diag(np.ones(n - 1), 1), np.eye(n)[:p] + 0.1) for n, p in ((2, 2), (3, 1))]
    for plant in plants:
        moved = {"A" if low == 1.0 else "G": np.ones_like(plant.A)}
        box = UncertainPlant(plant, [UncertainParameter("k", low, 1.0, nominal=1.0, **moved)])
        for duration in (1.0, 2 * np.pi):
            assert zero_count_bound(box, duration).samples == zero_count_bound(plant, duration).samples
        for eta, schedule in ((0.3, PeriodicSchedule([1.0, 0.7])), (0.0, PeriodicSchedule([2.0]))):
            found, own = (certificate_exists(one, schedule, eta) for one in (box, plant))
            assert (found.exists, found.margin, found.reason) == (own.exists, own.margin, own.reason)


def test_a_count_is_refused_where_a_plant_of_the_box_hides_a_mode():
    hidden = UncertainPlant(OSCILLATOR, [UncertainParameter("gain", -0.1, 1.0, C=[[1.0, 0.0]], nominal=1.0)])
    with pytest.raises(NotObservableError, match="for every plant of the box"):
        zero_count_bound(hidden, 1.0)


def test_a_count_says_when_it_could_not_be_decided(monkeypatch):
    monkeypatch.setattr(zero_count_over_box, "SECONDS", 0.0)
    model = BoxModel.of(oscillator(-8.0, 8.0), "zero_count_bound", 3.0)
    with pytest.raises(UndecidedError, match="whether every plant of the box is observable"):
        zero_count_over_box.require_every_plant_observable(model)
    with pytest.raises(ArgumentError, match="must hold fewer than"):
        zero_count_bound(oscillator(), 1e17)


def test_the_worst_case_over_a_box_holds_for_every_plant_drawn():
    plant, family = oscillator(0.97, 1.03), SpacedWindows(4.0, 3, 0.8)
    found = worst_case_sigma(plant, family, rtol=0.15)
    assert found.closed
    each = [worst_case_sigma(plant.at([x]), family).upper for x in (0.97, 1.0, 1.03)]
    assert 0.85 * found.upper <= found.lower <= min(each)
    assert "every such schedule" in found.explain()


@pytest.mark.parametrize("seed", range(6))
def test_no_plant_of_a_cell_lies_below_what_its_corners_say(seed):
    """Where one schedule alone is admissible, sigma of each plant is that of its rows."""
    rng = np.random.default_rng(seed)
    model = BoxModel.of(random_box(rng), "worst_case_sigma", 1.0)
    k = model.n + int(rng.integers(0, 3))
    family = SpacedWindows(0.4 * (k - 1) + 1e-9, k, 0.4)
    cell = BoxCells.whole(model.m)._replace(half=rng.uniform(0.1, 1.0, (1, model.m)))
    times = 0.4 * np.arange(k)

    def sigma(u, unit):
        A, C = model.at(u[None])
        rows = np.vstack([C[0] @ expm(A[0] * t) for t in times]) / unit
        return np.linalg.svd(rows, compute_uv=False)[model.n - 1]

    far = replace(model, unit=10.0 ** rng.uniform(-3, 3, model.n))  # units far apart
    for judged, half in ((model, 1.0), (far, 1.0), (model, 0.01), (far, 0.01)):
        small = cell._replace(half=cell.half * half)
        least, inner = (min(sigma(u, unit) for u in points_of(small)) for unit in (judged.unit, np.ones(model.n)))
        inside = small.half[0] * rng.uniform(-1.0, 1.0, (50, model.m))
        allowed = min(sigma(u, judged.unit) for u in inside) * (1 + 1e-9)
        assert least_over(judged, small, family, least) <= least_over(judged, small, family, least, inner) <= allowed
    narrow = cell._replace(half=cell.half * 1e-12)
    least = min(sigma(u, model.unit) for u in points_of(narrow))
    assert least_over(model, narrow, family, least) >= 0.9 * least  # tight where a cell is small


@pytest.mark.parametrize("unit", [1e3, 1e13])
def test_units_far_apart_leave_the_worst_case_a_bound(unit):
    plant, family = oscillator(0.99, 1.01), SpacedWindows(4.0, 4, 0.3)
    D, inverse = np.diag([1.0, unit]), np.diag([1.0, 1 / unit])
    known = Plant(D @ plant.nominal.A @ inverse, plant.nominal.C @ inverse)
    part = replace(plant.parameters[0], A=D @ plant.parameters[0].A @ inverse)
    found = worst_case_sigma(UncertainPlant(known, [part]), family, budget=20.0)
    assert found.closed
    for x in (0.99, 1.0, 1.01):
        rows = np.vstack([plant.at([x]).C @ expm(plant.at([x]).A * t) for t in found.witness]) @ inverse
        assert found.lower <= np.linalg.svd(rows, compute_uv=False)[1] * (1 + 1e-9)


def test_corners_that_are_seen_prove_nothing_of_a_frequency_between_them_that_is_not():
    """Half a turn apart, two samples miss the frequency 1 alone."""
    model, family = BoxModel.of(oscillator(0.81, 1.21), "worst_case_sigma", np.pi), SpacedWindows(np.pi, 2, np.pi)
    corners = [worst_case_sigma(oscillator().at([x]), family).lower for x in (0.81, 1.21)]
    assert min(corners) > 0.1
    assert worst_case_sigma(oscillator().at([1.0]), family).upper < 1e-12
    assert least_over(model, BoxCells.whole(model.m), family, min(corners)) == 0.0


def test_the_frechet_derivative_and_the_exponential_agree_with_fifty_digits():
    rng = np.random.default_rng(0)
    M = rng.normal(size=(4, 3, 3)) * np.geomspace(0.01, 20, 4)[:, None, None]
    for X, E in zip(M, exponentials(M), strict=True):
        exact = exponential_50_digits(X, 1.0)
        assert np.linalg.norm(E - exact) <= 1e-12 * np.linalg.norm(exact)


def test_halves_cover_their_cell():
    cells = BoxCells(np.zeros((1, 2)), np.ones((1, 2)), np.zeros(1), np.ones(1), np.zeros(1, dtype=int))
    parts = halved(cells, np.array([[0.1, 2.0, 0.3]]))
    np.testing.assert_array_equal(parts.u, [[0.0, -0.5], [0.0, 0.5]])
    np.testing.assert_array_equal(parts.half, [[1.0, 0.5], [1.0, 0.5]])
    assert halved(cells, np.array([[0.1, 0.2, 0.3]])).s.tolist() == [-0.5, 0.5]


def test_a_descent_from_the_first_cells_shows_at_once_that_one_is_enough():

    def value(u, s, piece):
        return 1.0 + (u[0] - 0.3) ** 2

    def judged(least):
        def judge(cells):
            centre = 1.0 + (cells.u[:, 0] - 0.3) ** 2
            lower = np.minimum(least, centre - 2.0 * cells.half[:, 0])
            return lower, centre, np.column_stack([cells.half[:, 0], 0 * cells.s])

        return judge

    one = BoxCells(np.zeros((1, 1)), np.full((1, 1), 1e-9), np.zeros(1), np.zeros(1), np.zeros(1, dtype=int))
    ends = (np.zeros(1), np.zeros(1))
    wide = one._replace(half=np.ones((1, 1)))
    first = branch(one, judged(0.995), value, lambda *_: False, 0.01, np.inf, ends, None)
    assert (first.status, first.cells) == ("closed", 1)
    assert first.upper == pytest.approx(1.0)
    seen = branch(wide, judged(0.995), value, lambda *_: False, 0.01, np.inf, ends, None)
    assert seen.status == "closed"
    assert 0.99 <= seen.lower <= seen.upper == pytest.approx(1.0)


# --- certificates -----------------------------------------------------------------------------------------------------


def test_certificates_exist_for_every_plant_or_the_plant_that_has_none_is_named():
    assert certificate_exists(oscillator(), PeriodicSchedule([2.85]), 0.1).exists
    found = certificate_exists(oscillator(), PeriodicSchedule([2.857]), 0.1)
    assert not found.exists
    assert found.worst["omega^2"] == pytest.approx((np.pi / 2.857) ** 2, rel=1e-6)
    assert "aliased" in found.explain()
    near = certificate_exists(oscillator(), PeriodicSchedule([3.0]), 0.1)
    assert not near.exists
    assert near.worst["omega^2"] == pytest.approx((np.pi / 3) ** 2, rel=1e-6)


def test_a_mode_that_no_output_sees_may_decay_for_every_plant_of_a_box():
    plant = Plant([[-1.0, 0.0], [0.0, 0.1]], [[0.0, 1.0]])
    box = UncertainPlant(plant, [UncertainParameter("a", -0.5, 0.5, A=[[1.0, 0.2], [0.0, 0.1]])])
    assert certificate_exists(box, PeriodicSchedule([1.0]), 0.3).exists
    assert not certificate_exists(box, PeriodicSchedule([1.0]), 1.3).exists
    assert certificate_exists(box, PeriodicSchedule([1.0]).between(0, 5), 1.3).exists


def test_existence_that_is_not_decided_says_so():
    schedule = PeriodicSchedule([2.85])
    with pytest.raises(UndecidedError, match="exists for every plant of the box"):
        certificate_exists(oscillator(), schedule, 0.1, budget=1e-9)


@pytest.mark.long
def test_the_largest_box_ends_where_the_schedule_aliases():
    plant, schedule = oscillator(0.5, 2.0), PeriodicSchedule([2.8])
    edge = (np.pi / 2.8) ** 2
    by_gains = largest_box(plant, schedule, eta=0.1)
    assert by_gains.closed
    assert by_gains.high["omega^2"] <= edge <= by_gains.high["omega^2"] * 1.01
    assert by_gains.worst["omega^2"] == pytest.approx(edge, rel=1e-6)
    assert certificate_exists(by_gains.box.at([by_gains.high["omega^2"]]), schedule, 0.1).exists
    by_sigma = largest_box(plant, schedule, window=9.0, at_least=0.3)
    ends = [by_sigma.low["omega^2"], by_sigma.high["omega^2"]]
    assert min(window_sigma(plant.at([x]), schedule, 9.0).upper for x in ends) >= 0.3
    assert window_sigma(plant.at(by_sigma.worst), schedule, 9.0).lower <= 0.3
    assert largest_box(plant, PeriodicSchedule([0.5]), window=4.0).share == pytest.approx(1.0)
    assert largest_box(plant, schedule, window=1.0).share == 0.0
    assert "it fails at" in by_gains.explain()


# --- accuracy ---------------------------------------------------------------------------------------------------------


def test_accuracy_over_a_box_holds_between_its_worst_plant_and_all_of_them():
    leak = UncertainParameter("leak", 0.8, 1.2, A=[[-1.0]], C=[[0.1]], nominal=1.0)
    plant, schedule = UncertainPlant(Plant([[-1.0]], [[1.0]], G=[[1.0]]), [leak]), PeriodicSchedule([1.2])
    bounds = {"w_bound": 0.5, "v_bound": 0.4}
    found = guaranteed_accuracy(plant, schedule, rtol=0.2, **bounds)
    each = [guaranteed_accuracy(plant.at([x]), schedule, **bounds) for x in (0.8, 1.0, 1.2)]
    assert found.closed.all()
    assert found.upper[0] >= max(a.lower[0] for a in each)
    assert found.lower[0] <= max(a.upper[0] for a in each)
    assert "Whichever plant" in found.explain()


@pytest.mark.long
def test_a_parameter_that_is_known_changes_no_accuracy_in_whatever_unit():
    leak = UncertainParameter("leak", 0.8, 1.2, A=[[-1.0]], nominal=1.0)
    known = UncertainParameter("known", 1e9, 1e9, A=[[1e-3]], nominal=1e9)
    plain, schedule = Plant([[-1.0]], [[1.0]], G=[[1.0]]), PeriodicSchedule([1.2])
    found = [
        guaranteed_accuracy(UncertainPlant(plain, each), schedule, rtol=0.2, w_bound=0.5, v_bound=0.4)
        for each in ([leak], [leak, known])
    ]
    assert found[1].upper == pytest.approx(found[0].upper, rel=1e-9)
    assert found[1].lower == pytest.approx(found[0].lower, rel=1e-9)


@pytest.mark.parametrize("absent", [{}, {"w_bound": []}])
def test_accuracy_over_a_box_around_a_plant_at_rest_that_nothing_drives(absent):
    """x2 is what a sensor of a gain 1 + b/2 with |v| <= .1 leaves: .1/.95 at b = -.1."""
    still = Plant(np.zeros((2, 2)), np.eye(2), G=np.zeros((2, 0)))
    known = UncertainParameter("a", 0.0, 0.0, A=1e10 * np.eye(2, k=1))
    gain = UncertainParameter("b", -0.1, 0.1, C=0.5 * np.eye(2))
    found = guaranteed_accuracy(
        UncertainPlant(still, [known, gain]), PeriodicSchedule([1.0]), v_bound=[0.1, 0.1], **absent
    )
    assert found.lower[1] <= 0.1 / 0.95 * (1 + 1e-12)
    assert found.upper[1] >= 0.1 / 0.95
    assert found.upper[1] <= 1.01 * found.lower[1]


def test_accuracy_that_cannot_be_bounded_says_so(monkeypatch):
    def one(asked, rows, tolerance, limit, opposed):
        return np.zeros(opposed), np.full(len(rows), np.inf)

    monkeypatch.setattr(accuracy_over_box, "bracket_of_rows", one)
    monkeypatch.setattr(accuracy_over_box, "SECONDS", 0.0)
    with pytest.raises(UndecidedError, match="could not be bounded in"):
        guaranteed_accuracy(oscillator(), PeriodicSchedule([1.0]), w_bound=[1.0, 1.0], v_bound=1.0)


def test_accuracy_over_a_box_says_of_which_rows_nothing_finite_was_proven(monkeypatch):
    def one(asked, rows, tolerance, limit, opposed):
        return np.ones(opposed), np.where(np.arange(len(rows)) == 1, np.inf, 2.0)

    monkeypatch.setattr(accuracy_over_box, "bracket_of_rows", one)
    monkeypatch.setattr(accuracy_over_box, "SECONDS", 0.0)
    found = guaranteed_accuracy(oscillator(), PeriodicSchedule([1.0]), w_bound=[1.0, 1.0], v_bound=1.0)
    assert np.isinf(found.upper).all()
    assert not found.closed.any()
    assert found.lower.tolist() == [1.0, 1.0]
    assert "Of x1, x2 nothing finite was proven in time" in found.explain()


def test_one_cell_proves_what_a_mismatch_does_that_bounds_itself_far_above_the_centre():
    leak = UncertainParameter("leak", -0.5, 0.5, A=[[1.0]])
    plant, schedule = UncertainPlant(Plant([[-0.5]], [[1.0]], G=[[1.0]]), [leak]), PeriodicSchedule([1.0])
    found = guaranteed_accuracy(plant, schedule, rtol=0.95, w_bound=0.5, v_bound=0.2)
    worst = guaranteed_accuracy(plant.at([0.5]), schedule, w_bound=0.5, v_bound=0.2)
    assert found.cells == 1
    assert worst.lower[0] <= found.upper[0] <= 1.4 * worst.upper[0]


# --- what is refused --------------------------------------------------------------------------------------------------


def test_what_has_no_meaning_over_a_box_is_refused():
    schedule = PeriodicSchedule([1.0])
    between = UncertainPlant(OSCILLATOR, vertices=[OSCILLATOR, OSCILLATOR])
    with pytest.raises(ArgumentError, match="must have parameters in a box"):
        window_sigma(between, schedule, 3.0)
    with pytest.raises(ArgumentError, match="must have constant parameters"):
        certificate_exists(oscillator(varying=True), schedule, 0.1)
    with pytest.raises(ArgumentError, match="one of them and not both"):
        largest_box(oscillator(), schedule)
    with pytest.raises(ArgumentError, match="on a finite one every plant has a certificate"):
        largest_box(oscillator(), schedule.between(0, 5), eta=0.1)
    with pytest.raises(ArgumentError, match="must be periodic for accuracy over a box"):
        guaranteed_accuracy(oscillator(), schedule.between(0, 5), w_bound=[1.0, 1.0], v_bound=1.0)
    with pytest.raises(ArgumentError, match="one bound for each entry, for accuracy over a box"):
        guaranteed_accuracy(oscillator(), schedule, w_bound=1.0, v_bound=1.0)
    with pytest.raises(ArgumentError, match="must be left out for accuracy over a box"):
        guaranteed_accuracy(oscillator(), schedule, w_bound=[1.0, 1.0], v_bound=1.0, start=0.0)


def test_growth_beyond_doubles_is_refused_in_one_sentence():
    spiral = Plant([[4.0, 1.0], [-1.0, 4.0]], [[1.0, 0.0]])
    box = UncertainPlant(spiral, [UncertainParameter("a", -0.1, 0.1, A=[[1, 0], [0, 0]])])
    with pytest.raises(ArgumentError, match=r"up to t = 125: unstable modes of some plant of the box overflow"):
        window_sigma(box, PeriodicSchedule([60.0]), 130.0)


@pytest.mark.parametrize("seconds", [1e-3, 6.0, 120.0])
def test_accuracy_over_a_box_keeps_to_its_budget_where_every_plant_takes_all_it_is_given(monkeypatch, seconds):
    clock = [0.0]

    def spent(asked, rows, tolerance, limit, opposed):
        clock[0] += limit.seconds
        return np.zeros(opposed), np.ones(len(rows))

    monkeypatch.setattr(accuracy_over_box, "bracket_of_rows", spent)
    monkeypatch.setattr("sampling_design.records.budget.now", lambda: clock[0])
    found = accuracy_over_box.accuracy_over_box(
        oscillator(), PeriodicSchedule([0.6]), w_bound=[0.1, 0.1], v_bound=[0.1], budget=seconds
    )
    assert not found.closed.any()
    assert clock[0] <= 1.5 * seconds
