"""The least guaranteed error: reference values, both proofs, and what is refused."""

import tomllib
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy import sampled_system, search
from sampling_design.accuracy import witness as witnessing
from sampling_design.accuracy.adversary_program import ConeWindow
from sampling_design.accuracy.bounded_directions import GapProof
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.errors import ArgumentError
from sampling_design.plants import library
from sampling_design.records.budget import Budget
from tests.cases import few
from tests.oracles import accuracy as oracle

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
GAPS = sd.PeriodicSchedule([0.7, 1.6, 0.9, 2.0])


@pytest.fixture(scope="module")
def found():
    return sd.guaranteed_accuracy(OSCILLATOR, GAPS, w_bound=0.02, v_bound=0.4)


def test_the_reference_values_of_an_oscillator(found):
    assert np.allclose(found.at_samples[0], 0.4, rtol=1e-6)
    assert np.allclose(found.at_samples[1], [0.5614, 0.4381, 0.5521, 0.4938], rtol=4e-4)
    assert found.upper[0] == pytest.approx(0.595, rel=3e-3)
    assert np.all(found.closed)
    assert np.all(found.upper <= 1.01 * found.lower)
    assert np.all(found.profile.lower <= found.profile.upper)
    assert np.all(found.profile.upper <= found.upper[:, None])


def test_a_worst_time_after_the_last_sample_is_one_of_the_period():
    schedule = sd.PeriodicSchedule([1.5, 0.2, 0.2])
    found = sd.guaranteed_accuracy(OSCILLATOR, schedule, w_bound=0.02, v_bound=0.4, of="velocity")
    assert 0 < found.worst[0] < schedule.times[0]  # the gap that leads into the next period
    begun, ended = found.profile.edges[[0, -1]]
    when = found.worst[0] + schedule.period
    assert begun < when < ended
    assert found.profile.lower[0, np.searchsorted(found.profile.edges, when)] >= found.lower[0] * (1 - 1e-6)


def test_the_reference_values_of_a_double_integrator():
    plant = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0, 0.6, 1.4]), w_bound=0.02, v_bound=0.1, rtol=1e-3)
    assert found.lower[0] <= 0.26903 <= found.upper[0]  # the oracle with 40 cells a gap: 0.2690294 to 0.2690299
    assert found.upper == pytest.approx([0.26903, 0.12338], rel=5e-4)
    assert found.at_samples[1] == pytest.approx([0.0960, 0.0954, 0.0954], abs=6e-5)


def test_the_oracle_agrees_at_a_sample_and_between():
    times = np.concatenate([[0.0], np.cumsum(np.tile([1.6, 0.9, 2.0, 0.7], 3))])[:10]
    A, C, G, c = OSCILLATOR.A, OSCILLATOR.C, OSCILLATOR.G, np.array([0.0, 1.0])
    low, *_ = oracle.adversary(A, C, G, times, c, 0.02, 0.4, cells=8)
    high, _ = oracle.gains(A, C, G, times, c, 0.02, 0.4, cells=8)
    found = sd.guaranteed_accuracy(OSCILLATOR, GAPS, w_bound=0.02, v_bound=0.4, of="velocity")
    last = (len(times) - 1) % 4  # ten samples back from the second of the period
    assert found.at_samples[0, last] == pytest.approx((low + high) / 2, rel=1e-3)
    d = 0.5
    row = c @ OSCILLATOR.transition(d)
    low, *_ = oracle.adversary(A, C, G, times, row, 0.02, 0.4, cells=8)
    value = low + oracle.flown(A, G, c, d, 0.02)
    edges = found.profile.edges
    k = int(np.searchsorted(edges, GAPS.times[last] + d)) - 1
    assert found.profile.lower[0, k] <= value * 1.002
    assert found.profile.upper[0, k] >= value * 0.999


def test_both_sides_verify_and_a_corrupt_one_does_not(found):
    assert found.verify()
    first = found.proof[0]
    worse = tuple(tuple(1.5 * g for g in gains) for gains in first.gains)
    forged = replace(found, proof=(GapProof(first.sample, first.directions, worse), *found.proof[1:]))
    assert not forged.verify()
    assert not replace(found, upper=0.9 * found.upper).verify()
    assert not replace(found, lower=1.1 * found.lower).verify()
    assert not replace(found, proof=found.proof[1:]).verify()
    leap = replace(found.witnesses[0], states=1.1 * found.witnesses[0].states)
    assert not replace(found, witnesses=(leap, found.witnesses[1])).verify()
    louder = replace(found.witnesses[0], w=1.1 * found.witnesses[0].w)
    assert not replace(found, witnesses=(louder, found.witnesses[1])).verify()


@pytest.mark.parametrize("seed", few(range(8), 5))
def test_what_directions_prove_together_verifies_whatever_each_adds_to_those_before_it(seed):
    """Of some plants a direction that added nothing to those before it is what later ones lean on."""
    rng = np.random.default_rng(seed)
    plant = sd.Plant(
        rng.standard_normal((3, 3)) - 1.5 * np.eye(3), rng.standard_normal((1, 3)), G=rng.standard_normal((3, 1))
    )
    wanted = np.random.default_rng(1).standard_normal((3, 3))
    schedule = sd.PeriodicSchedule(rng.uniform(0.4, 2.0, 1))
    assert sd.guaranteed_accuracy(plant, schedule, w_bound=0.1, v_bound=0.1, of=wanted).verify()


def test_a_witness_shows_nothing_and_is_far_away(found):
    for k, witness in enumerate(found.witnesses):
        v, x, w = witness.simulate()
        assert np.nanmax(np.abs(v)) <= 0.4 * (1 + 1e-9)
        assert np.max(np.linalg.norm(w, axis=1)) <= 0.02 * (1 + 1e-9)
        assert x[k] == pytest.approx(found.lower[k], rel=2e-9)
        assert "samples read zero" in witness.explain()


def test_the_record_speaks(found):
    assert "within 0.59" in found.explain()
    assert "position" in str(found)
    assert found.to_dict()["rows"]["names"] == ["position", "velocity"]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"w_bound": None}, "`w_bound` is missing: without a bound on w1, w2 nothing can be guaranteed"),
        ({"v_bound": None}, "`v_bound` is missing"),
        ({"v_bound": [-1.0]}, "`v_bound` must not be negative, got -1.0"),
        ({"of": "velocty"}, "got 'velocty'. Did you mean 'velocity'?"),
        ({"of": np.zeros((0, 2))}, "`of` must name at least one row"),
    ],
)
def test_bad_input_is_refused(change, match):
    given = {"schedule": GAPS, "w_bound": 0.02, "v_bound": 0.4, "of": None} | change
    with pytest.raises(ArgumentError, match=match):
        sd.guaranteed_accuracy(OSCILLATOR, given.pop("schedule"), **given)


def test_a_plant_that_nothing_drives_needs_no_bound_on_what_does():
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], G=np.zeros((2, 0)))
    asked = {"initial_error": 1.0, "v_bound": 0.1}
    found = [
        sd.guaranteed_accuracy(plant, sd.Schedule([0.0, 1.0, 2.0]), **asked, **more) for more in ({}, {"w_bound": 0})
    ]
    assert np.array_equal(found[0].upper, found[1].upper)


def test_a_name_of_a_state_and_of_another_output_is_refused():
    plant = sd.Plant(-np.eye(2), [[1.0, 1.0]], states=["level", "salt"], outputs=["level"])
    with pytest.raises(ArgumentError, match="a state and an output that is not that state alone"):
        sd.guaranteed_accuracy(plant, GAPS, w_bound=1.0, v_bound=1.0, of="level")


@pytest.mark.parametrize(
    "name", few(["double_integrator", "triple_integrator", "oscillator", "helicopter_he1", "cart_pendulum"], 0, 2)
)
def test_plants_of_the_library_close_to_one_percent(name):
    plant = library.named_plant(name)
    gaps = {"helicopter_he1": [0.5, 0.8, 0.3], "cart_pendulum": [0.2, 0.3, 0.1]}.get(name, [1.0, 0.6, 1.4])
    found = sd.guaranteed_accuracy(
        plant,
        sd.PeriodicSchedule(gaps),
        w_bound=plant.disturbances.scales / 50,
        v_bound=plant.outputs.scales / 10,
    )
    assert np.all(found.closed)
    assert np.all(found.upper <= 1.01 * found.lower)
    assert found.verify()


def test_rows_are_known_where_the_whole_state_is_not():
    """A position and its bias are seen together only: their sum is known, each alone is not."""
    A = np.zeros((3, 3))
    A[0, 1] = 1.0
    rng = np.random.default_rng(1)
    T = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    plain = sd.Plant(A, [[1.0, 0.0, 1.0]])
    turned = sd.Plant(T @ A @ T.T, plain.C @ T.T, G=T)
    wanted = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    schedule = sd.PeriodicSchedule([1.0, 0.6, 1.4])
    found = sd.guaranteed_accuracy(turned, schedule, w_bound=0.02, v_bound=0.1, of=wanted @ T.T)
    assert np.isinf(found.upper).tolist() == [False, False, True]
    assert np.isinf(found.lower[2])
    assert np.all(found.upper[:2] <= 1.01 * found.lower[:2])
    assert found.verify()
    assert "holds at all times: no sample shows the mode" in found.explain()
    assert "without bound" in str(found)
    assert found.to_dict()["upper"][2] is None


def _hidden_by_samples(shared):
    """An oscillation at twice the samples' period, and a level that drifts; one sensor for both, or one for each."""
    A = np.zeros((3, 3))
    A[0, 1], A[1, 0] = np.pi, -np.pi
    return A, np.array([[1.0, 0.0, 1.0]]) if shared else np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("gaps", few([[1.0], [1.0, 1.0]], 0))
@pytest.mark.parametrize("shared", [False, True])
def test_rows_are_known_where_only_the_samples_hide_a_mode(shared, gaps):
    A, C = _hidden_by_samples(shared)
    schedule, bounds = sd.PeriodicSchedule(gaps), {"w_bound": [0.1, 0.1, 0.1], "v_bound": 0.1}
    found = sd.guaranteed_accuracy(sd.Plant(A, C), schedule, **bounds)
    assert np.isinf(found.upper).tolist() == [True, True, False]
    assert np.all(found.upper[2] <= 1.01 * found.lower[2])
    assert "3.14159i" in found.explain()
    assert found.verify()
    T = np.random.default_rng(1).standard_normal((3, 3)) * [[1e-6], [1.0], [1e6]]
    back = np.linalg.inv(T)
    turned = sd.guaranteed_accuracy(sd.Plant(T @ A @ back, C @ back, G=T), schedule, of=back, **bounds)
    assert np.isinf(turned.upper).tolist() == [True, True, False]
    assert turned.lower[2] <= found.upper[2]
    assert found.lower[2] <= turned.upper[2]
    if not shared:  # the level alone: what moves it between samples, and the noise
        assert found.lower[2] <= 0.2 <= found.upper[2]
    else:  # the oracle knows nothing of the start, and has as good as forgotten it
        ball = sd.guaranteed_accuracy(sd.Plant(A, C), schedule, w_bound=0.1, v_bound=0.1, of="x3")
        value = oracle.adversary(A, C, np.eye(3), np.arange(16.0), [0.0, 0.0, 1.0], 0.1, 0.1, cells=12)[0]
        assert abs(ball.at_samples[0, 0] - value) <= 0.01 * value


@pytest.mark.parametrize("outputs", [2, 3])
def test_bounds_on_the_norm_have_no_axes(outputs):
    """Whoever turns all outputs, or all disturbances, says the same; noise of one output alone is within either."""
    A, C = np.array([[-0.3, 1.0], [-1.0, -0.1]]), np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 0.3]])[:outputs]
    Q, R = (np.linalg.qr(np.random.default_rng(3).standard_normal((k, k)))[0] for k in (outputs, 2))
    asked = {"schedule": sd.PeriodicSchedule([0.7]), "w_bound": 0.05, "v_bound": 0.2, "of": "x1", "rtol": 1e-3}
    one = sd.guaranteed_accuracy(sd.Plant(A, C), **asked)
    other = sd.guaranteed_accuracy(sd.Plant(A, Q @ C, G=R), **asked)
    assert other.lower[0] <= one.upper[0]
    assert one.lower[0] <= other.upper[0]
    box = sd.guaranteed_accuracy(sd.Plant(A, C), **asked | {"v_bound": [0.2] * outputs})
    assert one.upper[0] < box.lower[0]


def test_every_row_of_an_oscillation_that_samples_hide_is_unknown():
    plant = sd.Plant([[0.0, np.pi], [-np.pi, 0.0]], [[1.0, 0.0]])
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0]), w_bound=0.1, v_bound=0.1)
    assert np.all(np.isinf(found.upper))
    assert found.unknown == ("0+3.14159i", "0-3.14159i")


def test_exact_sensors_say_that_the_program_is_degenerate():
    plant = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], outputs=["position"])
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0]), w_bound=0.1, v_bound=0.0)
    assert "Samples of position count as exact (noise bound 0)" in found.notice
    assert found.notice in found.explain()
    assert "degenerate" in str(found)
    assert sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0]), w_bound=0.1, v_bound=0.1).notice == ""


@pytest.mark.parametrize(("unit", "kind"), few(product([1.0, 1e-9, 1e9], ["endless", "finite", "together", "late"]), 5))
def test_less_noise_is_never_worse_down_to_none(kind, unit):
    """A sensor's rows in units of noise that is nearly none have parted states by more than doubles hold."""
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]] if kind != "together" else [[1.0, 0.0], [0.9, 0.1]])
    asked = {"w_bound": 0.02 * unit, "timing_tolerance": 0.01 if kind == "late" else 0.0}
    schedule = sd.PeriodicSchedule.from_times([0.0, 3.0], 6.4)
    if kind == "finite":
        schedule, asked["initial_error"] = sd.Schedule([0.0, 0.4, 3.0]), unit
    before = None
    for noise in (1e-3, 1e-5, 1e-6, 1e-7, 1e-8, 1e-10, 1e-13, 0.0):
        found = sd.guaranteed_accuracy(plant, schedule, v_bound=noise * unit, **asked)
        assert found.verify()
        assert kind == "late" or found.closed.all()
        if before is not None:
            assert np.all(found.lower <= before.upper)
            assert np.all(found.upper <= before.upper * 1.02)  # brackets are 1 % wide
        before = found


def test_what_is_unseen_and_decays_is_known():
    plant = sd.Plant([[-0.5, 0.0], [0.0, 0.0]], [[0.0, 1.0]])
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0]), w_bound=[0.1, 0.1], v_bound=0.1)
    assert found.lower[0] <= 0.2 <= found.upper[0]  # int_0^inf e^{-s/2} 0.1 ds
    assert np.all(found.upper <= 1.01 * found.lower)
    assert found.verify()


HIDDEN = [(0.0, 1.0, 0.1), (0.0, 1e-7, 0.0), (1.7, 1.0, 0.1), (1.7, 1e7, 0.0)]


@pytest.mark.parametrize(("turn", "unit", "noise"), few(HIDDEN, 0, 1))
def test_what_nothing_drives_hides_behind_what_is_driven(turn, unit, noise):
    """A bias of y = x + b, constant or turning, which x' = -x + w makes up for, for ever: w stays what it is, too."""
    n = 3 if turn else 2
    A = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, turn], [0.0, -turn, 0.0]])[:n, :n]
    plant = sd.Plant(A, np.array([[1.0, 1.0, 0.0]])[:, :n], G=unit * np.eye(n)[:, :1])
    bounds = {"w_bound": 0.3, "v_bound": noise * unit, "rtol": 0.5}
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([0.8]), of=["x1", "x2"], **bounds)
    least = 0.3 / np.hypot(1.0, turn)  # amplitude of x at that rate
    assert np.all(found.lower >= (least + noise * np.arange(2)) * unit * (1 - 1e-6))
    assert np.all(found.lower <= found.upper)
    assert found.verify()


def test_a_row_of_which_only_the_width_of_a_panel_is_left_ends():
    """Nothing drives the second state, and no gains make its bound less than what its panels lose."""
    A, C = [[-0.20857866, -0.52738419], [0.0, -0.64134852]], [[-0.05606444, 0.74688562], [-1.8473248, 1.56654877]]
    schedule = sd.PeriodicSchedule.from_times([0.65797302, 1.42196308, 1.91467925, 2.3112569], 2.7112569)
    found = sd.guaranteed_accuracy(sd.Plant(A, C, G=[[1.0], [0.0]]), schedule, w_bound=0.1, v_bound=1.0, rtol=0.05)
    assert found.closed.all()
    assert found.upper[1] <= 1e-6


@pytest.mark.long
def test_a_drift_that_nothing_drives_is_known_the_better_the_longer_the_past():
    """Where it is, noise hides; how fast it goes is known exactly in the end, which no finite window proves."""
    plant = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0]), w_bound=0.0, v_bound=0.1)
    assert found.lower == pytest.approx([0.1, 0.0], rel=1e-6)
    assert found.upper[0] <= 0.101
    assert found.upper[1] <= 2.5 * 0.1 / search.FADING * 2  # the slope between readings so many samples apart
    assert found.closed.tolist() == [True, False]
    assert found.verify()


@pytest.mark.long
def test_rows_asked_for_together_are_known_as_well_as_alone():
    """Directions bounded for later rows crowd out none that served an earlier one."""
    plans = Path(__file__).parents[2] / "examples" / "plans"
    asked = tomllib.loads((plans / "activated_sludge.toml").read_text())
    matrices = {key: np.array(value) for key, value in asked["plant"]["matrices"].items()}
    plant = sd.Plant(matrices["A"], matrices["C"][3:], G=matrices.get("G"), time_unit="h")
    schedule = sd.PeriodicSchedule.from_times([8.0, 62.0, 112.0], 168.0)
    both = sd.guaranteed_accuracy(
        plant, schedule, w_bound=asked["w_bound"], v_bound=[20.0], of=np.eye(5)[2:], rtol=0.005
    )
    assert both.closed.all()
    assert both.upper[0] == pytest.approx(3.1112, rel=1e-3)  # 3.1531 where pairs of atoms are sought nearby only


def test_what_only_the_width_of_panels_leaves_open_is_not_sought_for_ever(monkeypatch):
    """A sample that says nothing new: 0.1 at all times, where 64 panels of a long gap cannot tell 0.1 from 0.1005."""
    calls, attack = [], search.GainSearch.both_sides
    monkeypatch.setattr(search.GainSearch, "both_sides", lambda *given: calls.append(1) or attack(*given))
    found = sd.guaranteed_accuracy(
        sd.Plant([[-1.0]], [[1.0]]), sd.PeriodicSchedule([24.0]), w_bound=0.1, v_bound=0.5, rtol=1e-3
    )
    assert found.lower[0] == pytest.approx(0.1, rel=1e-9)
    assert 0.1 <= found.upper[0] <= 0.101
    assert len(calls) < 20


def test_states_that_a_motion_does_not_move_close_none_of_it_open():
    """A satellite's radial place says nothing of its motion across: 1e-26 of rounding there left nothing attained."""
    plant = sd.named_plant("satellite")
    schedule = sd.PeriodicSchedule([1350.0] * 4, time_unit="s")
    found = sd.guaranteed_accuracy(
        plant, schedule, w_bound=[1.85e-6] * 3, v_bound=[5.0] * 3, of=np.eye(6)[:1], rtol=0.02
    )
    assert found.closed.all()
    assert np.all(np.abs(found.witnesses[0].states[:, [2, 5]]) < 1e-20)
    assert found.verify()
    unattained = replace(found, lower=np.zeros(1)).explain()
    assert "brackets" in found.explain()
    assert "0: nothing was attained" in unattained


def test_a_bracket_that_had_no_time_is_proven_and_says_that_it_is_wide(found):
    told = []
    short = sd.guaranteed_accuracy(
        OSCILLATOR, GAPS, w_bound=0.02, v_bound=0.4, rtol=1e-5, budget=1e-9, progress=lambda *one: told.append(one)
    )
    assert short.verify()
    assert not short.closed.any()
    assert np.all(short.lower <= found.upper)
    assert np.all(found.lower <= short.upper)
    assert np.all(short.upper < np.inf)
    assert [share for share, _ in told] == [0.5, 1.0]
    assert told[0][1].startswith("position ")
    with pytest.raises(ArgumentError, match="budget"):
        sd.guaranteed_accuracy(OSCILLATOR, GAPS, w_bound=0.02, v_bound=0.4, budget=0.0)


@pytest.mark.parametrize("at", few([0, 1, 3, 6], 1, 3))
def test_an_interrupt_leaves_what_is_proven(at, found, monkeypatch):
    calls, attack = [], search.GainSearch.both_sides

    def interrupted(*given):
        calls.append(1)
        if len(calls) == at + 1:
            raise KeyboardInterrupt
        return attack(*given)

    monkeypatch.setattr(search.GainSearch, "both_sides", interrupted)
    left = sd.guaranteed_accuracy(OSCILLATOR, GAPS, w_bound=0.02, v_bound=0.4, rtol=1e-5)
    assert left.verify()
    assert np.all(left.lower <= found.upper)
    assert np.all(found.lower <= left.upper)
    assert np.all(left.upper < np.inf)
    assert not left.closed.all()


@pytest.mark.parametrize("v_bound", few([[[0.4], [0.3]] * 3, 0.4, {"y1": (-0.1, 0.5)}], 2))
def test_a_period_given_several_times_over_is_asked_once(v_bound, monkeypatch):
    """At no cost beside one period, with the same numbers, a proof that holds and every sample in its place."""
    solves, gains = [], search.GainSearch.gains
    monkeypatch.setattr(search.GainSearch, "gains", lambda *given: solves.append(1) or gains(*given))
    gaps = np.array([0.75, 1.5])
    once = sd.guaranteed_accuracy(
        OSCILLATOR,
        sd.PeriodicSchedule(gaps),
        w_bound=0.02,
        v_bound=v_bound[:2] if isinstance(v_bound, list) else v_bound,
        of=OSCILLATOR.states.names[:1],
    )
    alone = len(solves)
    thrice = sd.guaranteed_accuracy(
        OSCILLATOR,
        sd.PeriodicSchedule(np.tile(gaps, 3)),
        w_bound=0.02,
        v_bound=v_bound,
        of=OSCILLATOR.states.names[:1],
    )
    assert len(solves) == 2 * alone
    assert thrice.upper.tolist() == once.upper.tolist()
    assert thrice.lower.tolist() == once.lower.tolist()
    assert thrice.at_samples.tolist() == np.tile(once.at_samples, 3).tolist()
    assert len(thrice.schedule) == 6
    assert thrice.profile.samples.tolist() == thrice.schedule.times.tolist()
    assert thrice.profile.edges[0] == thrice.schedule.times[0]
    assert thrice.profile.edges[-1] == pytest.approx(thrice.schedule.times[0] + 3 * gaps.sum())
    assert np.all(np.diff(thrice.profile.edges) > 0)
    assert thrice.verify()
    assert thrice.verify(rigorous=True)
    assert not replace(thrice, upper=thrice.upper * 0.99).verify()


def test_a_period_whose_noise_differs_is_not_shortened():
    v = np.full((4, 1), 0.4)
    v[2] = 0.1
    schedule = sd.PeriodicSchedule([0.75] * 4)
    one = sd.guaranteed_accuracy(OSCILLATOR, schedule, w_bound=0.02, v_bound=v)
    assert len(set(one.at_samples[1].round(6))) == 4


@pytest.mark.parametrize("left", [0.0, np.inf])
def test_within_a_limit_one_adversary_is_simulated_or_the_one_of_the_shortest_history_too(left, monkeypatch):
    """To simulate them took twice as long as the budget of the search that had found them."""
    simulated = []

    def nothing(one, question):
        simulated.append(one.samples.size)
        return replace(one, value=0.0)

    monkeypatch.setattr("sampling_design.accuracy.witness.admissible", nothing)
    monkeypatch.setattr(Budget, "share", lambda self, fraction: Budget(left))
    found = sd.guaranteed_accuracy(OSCILLATOR, GAPS, w_bound=0.02, v_bound=0.4, of="position", rtol=0.01)
    assert found.lower[0] == 0.0
    if left:
        assert len(simulated) > 2
    else:
        assert 1 <= len(simulated) <= 2
        assert simulated[-1] == min(simulated)


@pytest.mark.parametrize(("lasts", "late"), [(False, 0.0), (False, 0.02), (True, 0.0)])
def test_what_decays_and_nothing_drives_is_nothing_in_the_end(lasts, late):
    """Of an endless past only what does not decay is left: the same accuracy as without the rest of the plant."""
    rng = np.random.default_rng(5)
    T, A, C = np.linalg.qr(rng.standard_normal((3, 3)))[0], np.diag([0.0, -0.3, -40.0]), rng.standard_normal((2, 3))
    A[0, 0], A[0, 1] = (0.4, 0.0) if lasts else (-0.3, 1.0)
    bounds = {"w_bound": 0.0, "v_bound": [0.2, 0.1], "timing_tolerance": late}
    plant, schedule = sd.Plant(T @ A @ T.T, C @ T.T, G=T @ rng.standard_normal((3, 1))), sd.PeriodicSchedule([0.5, 0.8])
    found = sd.guaranteed_accuracy(plant, schedule, of=T.T, **bounds)
    assert found.upper[1:] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert found.verify()
    if lasts:
        alone = sd.guaranteed_accuracy(sd.Plant([[0.4]], C[:, :1]), schedule, **bounds)
        assert [found.lower[0], found.upper[0]] == pytest.approx([alone.lower[0], alone.upper[0]], rel=1e-6)
    else:
        assert not found.upper.any()
        assert found.closed.all()


def test_a_witness_is_made_smaller_until_it_keeps_its_bounds(monkeypatch):
    """A smaller one is closed by another rounding, which may exceed a bound again."""
    walk = sd.Plant([[0.0]], [[1.0]])
    found = sd.guaranteed_accuracy(walk, sd.PeriodicSchedule([1.0]), w_bound=0.3, v_bound=1.0)
    exact, seen = witnessing.attains, list[float]()

    def rounded(*given):
        value, excess = exact(*given)
        seen.append(excess * (1 + 1e-8 * (len(seen) < 5)))
        return value, seen[-1]

    monkeypatch.setattr(witnessing, "attains", rounded)
    kept = witnessing.admissible(found.witnesses[0], found.question)
    assert seen[-1] <= 1 < max(seen[:-1])
    assert kept.value == pytest.approx(found.witnesses[0].value, rel=1e-6)


def large(n=8):
    """A plant of many states that an endless schedule shows, with gaps that differ."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(n, n)) / np.sqrt(n) - 0.9 * np.eye(n)
    return sd.Plant(A, rng.normal(size=(2, n))), sd.PeriodicSchedule([0.6, 0.9, 0.7])


def test_of_many_states_gains_of_one_sample_serve_at_another_one():
    """What is put together without a program is proven again as it stands, and hardly worse than what one finds."""
    plant, schedule = large()
    question = AccuracyQuestion.of(plant, schedule, 0.1, 0.2, None, None, None)
    seek, row = search.GainSearch(*question.filter_bounds(plant)), np.eye(8)[:1]
    mu = [seek.system.mu(j, row)[:, 0] for j in range(3)]
    solved = [seek.gains(j, mu[j]) for j in range(3)]
    for j, k in ((0, 1), (1, 2), (2, 0)):
        found = seek.followed(j, mu[j], solved[k].gains, k)
        assert seek.evaluate(j, mu[j][None], [found.gains])[0].value == pytest.approx(found.value, rel=1e-12)
        assert solved[j].value * (1 - 1e-4) <= found.value <= solved[j].value * 1.05


def test_of_many_states_few_programs_close_the_bracket():
    plant, schedule = large()
    found = sd.guaranteed_accuracy(plant, schedule, w_bound=0.1, v_bound=0.2, of="x1", rtol=0.05)
    assert found.closed.all()
    assert found.verify()


def test_what_a_filter_proves_of_a_plant_that_grows_in_mixed_coordinates_is_not_lost_in_its_digits():
    """Over 64 samples the digits of a gain grow by e^70, what the filter makes of them decays."""
    A = [[0.12, -0.02, -0.38, 0.26], [-0.05, -0.03, -0.23, 0.1], [-0.62, -0.04, 0.42, -0.51], [0.62, 0.05, -0.33, 0.46]]
    C = [[0.8, 0.89, 0.38, -1.2], [-2.04, 2.14, -0.05, 2.05], [-0.24, -1.18, 0.0, -1.23]]
    plant = sd.Plant(A, C, G=np.eye(4)[:, :1])
    spent = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0]), w_bound=0.01, v_bound=1.0, budget=1e-9)
    assert spent.verify()
    seek = search.GainSearch(*spent.question.filter_bounds(plant))
    for part in spent.proof:
        together = seek.evaluate(part.sample, part.directions, part.gains)
        for mu, gains, found in zip(part.directions, part.gains, together, strict=True):
            assert seek.evaluate(part.sample, mu[None], [gains])[0].value == pytest.approx(found.value, rel=1e-12)


def test_rows_without_bound_verify_over_several_periods():
    hidden = sd.Plant(np.zeros((2, 2)), [[1.0, 0.0]])
    found = sd.guaranteed_accuracy(hidden, sd.PeriodicSchedule([1.0] * 3), w_bound=0.1, v_bound=0.1, rtol=0.1)
    assert found.upper.tolist()[1] == np.inf
    assert found.verify()
    lost = sd.guaranteed_accuracy(hidden, sd.PeriodicSchedule([1.0] * 3), w_bound=0.1, v_bound=0.1, of="x2")
    assert lost.verify()


def test_however_often_a_plant_turns_in_a_gap_no_program_outgrows_memory(monkeypatch):
    """A slip of six digits in an entry asked for 15 GB: a gap has so many cells at most, a window so many entries."""
    windows = []

    class Window(ConeWindow):
        def __init__(self, *given, **others):
            super().__init__(*given, **others)
            windows.append((self.entries, max(len(gap.cells) for gap in self._gaps)))

    plant = sd.Plant([[0.0, 30.0], [-30.0, -0.05]], [[1.0, 0.0]])
    asked = plant, sd.PeriodicSchedule([1.0])
    bounds = {"w_bound": 0.2, "v_bound": 0.2, "rtol": 0.1}
    whole = sd.guaranteed_accuracy(*asked, **bounds)
    monkeypatch.setattr(search, "ConeWindow", Window)
    monkeypatch.setattr(search, "LARGEST_WINDOW", 1000)
    monkeypatch.setattr(sampled_system, "MOST_CELLS", 32)
    found = sd.guaranteed_accuracy(*asked, **bounds)
    assert np.all(found.lower <= whole.upper)
    assert np.all(whole.lower <= found.upper)
    assert found.verify()
    entries, cells = np.transpose(windows)
    assert max(entries) <= 1000
    assert max(cells) == 32
