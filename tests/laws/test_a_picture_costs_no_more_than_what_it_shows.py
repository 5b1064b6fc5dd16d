"""A picture draws what is known already, drops no extreme, ends where nothing more is, and can be left out."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import plotting
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.cli import estimate
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.curve import EstimateEnvelope
from sampling_design.plotting import style
from tests.cases import few

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], time_unit="s", states=["place", "speed"])
BOUNDS = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}


@pytest.fixture
def solved(monkeypatch):
    """The programs that were solved."""
    asked, solve = [], RecordProgram._solved

    def counted(self, *arguments):
        asked.append(arguments)
        return solve(self, *arguments)

    monkeypatch.setattr(RecordProgram, "_solved", counted)
    return asked


def followed(folder, radii, tube=False, **flags):
    times = np.array([0.7, 1.3, 2.9, 3.6])
    record = sd.Measurements(PLANT, times, np.cos(times)[:, None])
    estimator = sd.MovingHorizonEstimator(PLANT, horizon=4.0, **BOUNDS)
    settings = Settings("estimate", output=folder, quiet=True, **flags)
    estimate.followed(settings, estimator, record, estimate.EstimateOptions(radii, tube), "words", BOUNDS)
    return [path.name for path in settings.files]


@pytest.mark.parametrize("radii", few(["intervals", "centred", "ellipsoids"], 2))
def test_a_picture_of_estimates_solves_nothing_that_was_not_solved_without(tmp_path, solved, radii):
    without = followed(tmp_path / "without", radii, no_picture=True)
    first = len(solved)
    drawn = followed(tmp_path / "drawn", radii)
    assert len(solved) == 2 * first
    assert (first > 0) == (radii != "ellipsoids")
    assert set(drawn) - set(without) == {"estimates.png"} == {p.name for p in (tmp_path / "drawn").glob("*.png")}
    assert not list((tmp_path / "without").glob("*.png"))
    followed(tmp_path / "tube", radii, tube=True)
    assert len(solved) > 3 * first  # asked for by its name


def envelope(count, start=1.0, stretches=600):
    """Estimates around zero, the first tenth of them with wider bounds; and what they are."""
    rng = np.random.default_rng(count)
    times = np.sort(rng.uniform(0.0, 50.0, count))
    x, radii = rng.normal(size=(2, count, 2))
    radii = np.abs(radii) + 0.1
    radii[: count // 10] *= start
    found = EstimateEnvelope.over(PLANT, times, stretches)
    found = found.including(times, x, radii, np.ones(count, dtype=bool), np.zeros(count, dtype=bool))
    return found, times, x, radii


@pytest.mark.parametrize(("count", "start"), few([(1, 1.0), (40, 1.0), (40, 90.0), (900, 1.0), (900, 90.0)], 2))
def test_a_band_ends_within_the_axis_or_says_where_it_ends(count, start):
    found, _, x, radii = envelope(count, start)
    for i, ax in enumerate(plotting.draw(found)):
        ax.figure.draw_without_rendering()
        low, high = ax.get_ylim()
        said = {float(text.get_text()) for text in ax.texts}
        for end, inside in (((x - radii)[:, i].min(), low), ((x + radii)[:, i].max(), high)):
            if low < end < high:
                assert abs(end - inside) > 0.01 * (high - low)  # a gap to the frame: here it ends
            else:
                assert any(abs(end - value) <= 0.006 * abs(end) for value in said)
        assert bool(said) == (start > 1.0)


@pytest.mark.parametrize("count", [7, 600, 601, 5000])
def test_no_extreme_is_dropped_however_many_there_are(count):
    found, times, x, radii = envelope(count)
    assert found.times.size <= 600
    assert (found.length == 0) == (count <= 600)
    edges = found.edges
    for k in (0, found.times.size // 2, found.times.size - 1):
        last = k == found.times.size - 1
        here = times == found.times[k] if found.length == 0 else (edges[k] <= times) & ((times < edges[k + 1]) | last)
        for key, ends, worst in (
            ("lowest", x, np.min),
            ("highest", x, np.max),
            ("lower", x - radii, np.min),
            ("upper", x + radii, np.max),
        ):
            expected = worst(ends[here], axis=0) if here.any() else np.full(2, np.nan)
            assert np.array_equal(getattr(found, key)[k], expected, equal_nan=True)
    assert f"{found.times.size} {'stretches of time' if found.length else 'times'}" in found.explain()


@pytest.mark.parametrize("count", [30, 4000])
def test_readings_of_a_long_record_keep_their_extremes_and_few_marks(count):
    rng = np.random.default_rng(1)
    times, y = np.sort(rng.uniform(0.0, 9.0, count)), rng.normal(size=count)
    y[count // 3], y[count // 2], y[5] = 40.0, -30.0, np.nan
    ax = style.new_axes()
    style.points(ax, times, y, ".", 5, "measured")
    style.sample_ticks(ax, times)
    drawn = [line.get_ydata() for line in ax.lines] + [
        np.concatenate([p.get_data().values, p.get_data().baseline]) for p in ax.patches
    ]
    assert (np.nanmax(drawn[0]), np.nanmin(drawn[0])) == (40.0, -30.0)
    assert drawn[0].size <= 2 * style.COLUMNS
    assert len(ax.collections[0].get_segments()) <= 2 * style.COLUMNS
    assert ax.get_legend_handles_labels()[1] == ["measured" if count == 30 else "measured, least to largest"]


@pytest.mark.parametrize("count", [30, 4000])
def test_of_a_long_schedule_one_line_stands_for_each_stretch_that_has_a_sample(count):
    times = np.sort(np.random.default_rng(2).uniform(0.0, 9.0, count))
    drawn = [lines.get_segments() for lines in sd.PeriodicSchedule.from_times(times, 10.0).plot().collections]
    assert [len(each) <= 2 * style.COLUMNS for each in drawn] == [True, True]
    shown = np.array([segment[0, 0] for segment in drawn[0]])
    assert set(shown) <= set(times)
    stretch = (times[-1] - times[0]) / style.COLUMNS
    assert count > 30 or shown.size == count
    assert all(np.abs(shown - t).min() <= stretch * (count > 30) for t in times)


def test_estimates_of_a_long_record_are_drawn_as_extremes():
    n = 700
    found, times, x, radii = envelope(n)
    record = sd.estimators.EstimateRecord(
        plant=PLANT,
        times=times,
        x=x,
        covariance=np.array([np.diag(r**2) for r in radii]),
        radius=np.ones(n),
        cost=np.zeros(n),
        status=("ok",) * n,
        certified=np.ones(n, dtype=bool),
        on_schedule=np.ones(n, dtype=bool),
    )
    for one, other in zip(record.plot(), found.plot(), strict=True):
        for drawn, expected in zip(one.patches, other.patches, strict=True):
            assert np.array_equal(drawn.get_data().values, expected.get_data().values, equal_nan=True)
    with pytest.raises(ArgumentError, match="has no picture"):
        plotting.draw(object())
