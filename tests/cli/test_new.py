"""new: a plant and a requirement that a newcomer can read, and that every other command takes."""

import json

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.cli.new import _closed, _positive
from sampling_design.errors import ArgumentError


def test_what_it_writes_is_what_was_said(shell, tmp_path):
    done = shell("new", tmp_path / "a", "--rhythm", "24,12", "--decay", 2, "--sensors", "blood, urine", "--samples", 6)
    assert done.code == 0
    assert "Next: sampling-design design" in done.out
    plant = sd.read_plant(tmp_path / "a" / "plant.toml")
    assert plant.outputs.names == ("blood", "urine")
    rates = np.linalg.eigvals(plant.A)
    assert sorted(np.round(np.abs(rates.imag), 6)) == pytest.approx([0, 0, *[0.261799] * 2, *[0.523599] * 2], abs=1e-6)
    assert min(rates.real) == pytest.approx(-np.log(3) / 2)
    assert plant.transition(2.0)[-1, -1] == pytest.approx(1 / 3)
    text = (tmp_path / "a" / "plant.toml").read_text()
    assert text.count("\n# ") + text.startswith("# ") == 4
    requirement = sd.read_requirement(tmp_path / "a" / "requirement.toml")
    assert (requirement.period, requirement.samples) == (24.0, {"exactly": 6})


def test_nobody_copies_thirty_closed_nights_by_hand(shell, tmp_path):
    done = shell("new", tmp_path, "--rhythm", "12.42", "--period", 720, "--open", "7-19", "--json")
    assert json.loads(done.out)["requirement"]["forbidden"][:2] == [[0.0, 7.0], [19.0, 31.0]]
    closed = sd.read_requirement(tmp_path / "requirement.toml").forbidden
    example = sd.read_requirement("examples/requirements/tidal_gauge.toml").forbidden
    np.testing.assert_allclose(closed, example)


def test_weekends_are_closed_and_other_units_are_converted():
    spans = _closed("h", 168.0, "8-16", False)
    assert spans[-1].tolist() == [112.0, 168.0]
    assert len(spans) == 6
    np.testing.assert_allclose(_closed("min", 168.0 * 60, "8-16", False), 60 * spans)
    assert _closed("s", 10.0, "", True).shape == (0, 2)
    assert _closed("s", 10.0, "0-24", True).shape == (0, 2)


def test_the_files_are_designed_for(shell, tmp_path):
    shell("new", tmp_path, "--rhythm", 24, "--samples", 4, "--open", "7-22")
    done = shell("design", tmp_path / "plant.toml", tmp_path / "requirement.toml", "--branches", 0, "-o", tmp_path)
    assert done.code == 0
    assert np.all(sd.read_schedule(tmp_path / "schedule.csv").times >= 7.0)


def test_a_terminal_is_asked(shell, tmp_path, monkeypatch):
    asked, answers = [], iter(["24", "3", "7-19"])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("typer.prompt", lambda text, *_, **__: asked.append(text) or next(answers))
    assert shell("new", tmp_path).code == 0
    assert len(asked) == 3
    assert sd.read_plant(tmp_path / "plant.toml").n_states == 4


def test_nothing_is_written_over_unless_forced(shell, tmp_path):
    shell("new", tmp_path, "--rhythm", 24)
    before = (tmp_path / "plant.toml").read_text()
    refused = shell("new", tmp_path, "--rhythm", 12)
    assert refused.code == 2
    assert "already" in refused.err
    assert (tmp_path / "plant.toml").read_text() == before
    assert shell("new", tmp_path, "--rhythm", 12, "--force").code == 0


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ((), "`new` needs to know what moves"),
        (("--rhythm", "daily"), "`--rhythm` must be positive numbers"),
        (("--rhythm", "24", "--open", "19-7"), "`--open` must be two hours of a day"),
        (("--rhythm", "24", "--unit", "fortnight"), "time"),
        (("--rhythm", "24", "--period", "1e6", "--open", "7-19"), "at most 400"),
        (("--rhythm", "24", "--sensors", "a,a"), "twice"),
    ],
)
def test_a_slip_is_one_sentence_and_writes_nothing(shell, tmp_path, flags, said):
    done = shell("new", tmp_path / "mine", *flags)
    assert done.code == 2
    assert said in done.err
    assert not (tmp_path / "mine").exists()


def test_what_the_flags_refuse(tmp_path, monkeypatch):
    with pytest.raises(ArgumentError, match="must be positive numbers with commas between"):
        _positive("--decay", "-1")
    with pytest.raises(ArgumentError, match="must be two hours of a day, as 7-19"):
        _closed("h", 24.0, "7", True)
    with pytest.raises(ArgumentError, match="closes every day: a period of"):
        _closed("h", 24.0 * 500, "7-19", True)
    from sampling_design.cli.new import new
    from sampling_design.cli.settings import Settings

    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(ArgumentError, match="needs to know what moves"):
        new(Settings("new"), tmp_path / "x")
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="cannot be made a folder"):
        new(Settings("new"), tmp_path / "file" / "x", rhythm="24")
    (tmp_path / "plant.toml").write_text("")
    with pytest.raises(ArgumentError, match=r"already\. Take another folder, or --force"):
        new(Settings("new"), tmp_path, rhythm="24")
