"""Pictures of estimates, validations and logs show what the records say."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import plotting
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.curve import estimate_curve
from sampling_design.plotting import style
from sampling_design.records.record import below

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["place", "speed"])
SCHEDULE = sd.PeriodicSchedule([0.7, 1.6, 0.9], time_unit="s")
BOUNDS = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}


def estimates(**bounds):
    record = sd.simulate_record(PLANT, SCHEDULE, 8.0, w_bound=0.1, v_bound=0.1)
    mhe = sd.MovingHorizonEstimator(PLANT, horizon=4.0, cost=sd.CostFunction(eta=0.3), **bounds)
    return mhe.run(record.measurements), record.measurements


def report(schedule=SCHEDULE, **options):
    certificate = sd.certify(PLANT, schedule, eta=0.4, P2=np.eye(2))
    return sd.validate(PLANT, schedule, certificate, runs=6, **{"duration": 12.0, **BOUNDS, **options})


def test_estimates_have_a_panel_per_state_with_tube_and_readings():
    found, readings = estimates(**BOUNDS)
    axes = plotting.draw(found, measurements=readings)
    assert [ax.get_ylabel() for ax in axes] == ["place", "speed"]
    assert axes[-1].get_xlabel() == "time [s]"
    bars = np.array(axes[0].collections[0].get_segments())  # one for each estimate, and nothing between
    assert bars[:, 0, 0] == pytest.approx(found.times)
    assert bars[:, 1, 1] == pytest.approx(found.x[:, 0] + found.ellipsoid_radii[:, 0])
    assert bars[:, 0, 1] == pytest.approx(found.x[:, 0] - found.ellipsoid_radii[:, 0])
    assert list(axes[0].lines[0].get_ydata()) == list(found.x[:, 0])
    assert list(axes[0].lines[1].get_ydata()) == list(readings.y[:, 0])  # the output reads the first state
    named = [str(line.get_label()) for line in axes[1].lines]
    assert [name for name in named if not name.startswith("_")] == ["estimate"]
    assert len(axes[1].collections[1].get_segments()) == len(readings)  # of the second it says only when


def test_no_tube_is_drawn_where_none_is_proven():
    found, _ = estimates()
    ax = plotting.draw(found)[0]
    assert ax.collections[0].get_segments() == []


def test_a_curve_is_drawn_with_the_tube_that_holds_the_truth_between_samples():
    record = sd.simulate_record(PLANT, SCHEDULE, 8.0, w_bound=0.1, v_bound=0.1)
    mhe = sd.MovingHorizonEstimator(PLANT, horizon=4.0, cost=sd.CostFunction(eta=0.3), **BOUNDS)
    curve = estimate_curve(mhe, record.measurements, points=4)
    axes = plotting.draw(curve)
    ends = axes[0].collections[0].get_paths()[0].vertices[:, 1]
    assert ends.max() == pytest.approx(np.nanmax(curve.tube.upper[:, 0]))
    assert list(axes[0].lines[0].get_xdata()) == list(curve.estimates.times)
    assert "all times" in axes[0].collections[0].get_label()
    mhe.start()
    nothing = sd.MovingHorizonEstimator(PLANT, horizon=4.0, cost=sd.CostFunction(eta=0.3))
    unproven = estimate_curve(nothing, record.measurements, points=2)
    assert unproven.tube is None or not np.isfinite(unproven.tube.upper).any()
    with pytest.raises(ArgumentError, match="`estimator` must be an estimator of this package, got Plant"):
        estimate_curve(PLANT, record.measurements)
    with pytest.raises(ArgumentError, match="`measurements` must be a Measurements"):
        estimate_curve(mhe, [(0.0, [1.0])])


@pytest.mark.long
def test_a_wide_start_does_not_rule_the_panels_of_a_validation():
    found = report(initial_error=50.0, duration=40.0)
    low, high = found.plot()[1].get_ylim()
    later = found.example.radii[len(found.example.times) // 3 :, 0].max()
    assert 2 * later < high - low < 1.4 * found.example.radii[:, 0].max()


def test_a_validation_shows_errors_below_the_bound_and_a_run_inside_its_tubes(tmp_path):
    found = report()
    axes = plotting.draw(found)
    drawn = np.concatenate([line.get_ydata() for line in axes[0].lines])
    assert 2.0 < np.nanmin(drawn) / axes[0].get_ylim()[0] < 4.0  # no empty decades
    assert len(axes) == 3
    assert axes[0].get_yscale() == "log"
    lines = {line.get_label(): line.get_ydata() for line in axes[0].lines}
    assert np.all(np.nan_to_num(lines["largest, random noise"]) <= lines["proven for every run"])
    assert "median, random noise" in lines
    assert axes[0].get_title(loc="left") == "all promises held"
    assert list(axes[2].lines[0].get_ydata()) == list(found.example.errors[:, 1])
    assert plotting.save(found, tmp_path / "v.png", dpi=40).read_bytes().startswith(b"\x89PNG")


def test_a_broken_promise_is_red_and_without_an_example_there_is_one_panel():
    blind = sd.PeriodicSchedule([np.pi])
    found = sd.validate(
        PLANT, blind, runs=3, scenarios=["resonant"], horizon=12.0, cost=sd.CostFunction(eta=0.1), **BOUNDS
    )
    ax = found.plot()
    assert ax.get_title(loc="left") == "1 promise broken"
    assert ax._left_title.get_color() == style.FAILED
    assert "proven for every run" not in [line.get_label() for line in ax.lines]


def test_a_log_shows_both_rows_of_times_and_both_sigmas():
    log = sd.compare_schedule(PLANT, sd.PeriodicSchedule([1.0]), [1.1, 2.0, 2.2, 4.3, 4.9, 6.0], window=3.0)
    top, bottom = plotting.draw(log)
    planned, actual = (c.get_segments() for c in top.collections[:2])
    assert [s[0][0] for s in planned] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert [s[0][0] for s in actual] == list(log.actual.times)
    assert "1 missed, 1 not planned" in top.get_title(loc="left")
    drawn = np.concatenate([line.get_ydata() for line in bottom.lines])
    assert np.nanmin(drawn) >= 0.0
    labels = [t.get_text() for t in bottom.get_legend().get_texts()]
    assert labels[1] == f"actual: at least {below(log.actual_sigma.lower, 4)}"
    calm = sd.Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0]])
    late = sd.compare_schedule(calm, sd.Schedule(np.arange(6.0)), np.arange(6.0) + 0.1, window=2.0)
    even = late.plot()[1]  # of sigmas that hardly move, too, the highest lies below the frame
    assert even.get_ylim()[1] > 1.05 * max(np.nanmax(line.get_ydata()) for line in even.lines)
    short = sd.compare_schedule(PLANT, sd.PeriodicSchedule([1.0]), [1.0, 2.0], window=9.0)
    assert short.plot().get_xlabel() == "time [s]"


def test_all_are_drawn_on_given_axes():
    from matplotlib.figure import Figure

    axes = Figure().subplots(3, 1)
    log = sd.compare_schedule(PLANT, sd.PeriodicSchedule([1.0]), [1.0, 2.0, 3.0, 4.0], window=3.0)
    for record, ax in zip((estimates(**BOUNDS)[0], report(scenarios=["random"]), log), axes, strict=True):
        assert record.plot(ax) is ax
        assert ax.has_data()
