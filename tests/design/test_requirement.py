"""Requirements: the record, its file, and what is refused at the door."""

import re

import numpy as np
import pytest

from sampling_design import Requirement, read_requirement
from sampling_design.design.problem.requirement import FORMAT, requirement_from_dict, write_requirement
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.schedules.sensor import Sensor

FULL = """
format = "sampling-design/requirement/1"
window = 5554.0
period = 5554.0
spacing = 60.0
samples = { exactly = 12 }
decay_rate = 0.0
forbidden = [[0.0, 600.0]]
fixed = [700.0]
[sensors.range]
available = [[0.0, 2700.0]]
price = 2.5
"""


@pytest.mark.parametrize("ending", ["toml", "json"])
def test_a_file_comes_back_as_it_was(tmp_path, ending):
    source = tmp_path / "given.toml"
    source.write_text(FULL)
    requirement = read_requirement(source)
    assert requirement.samples == {"exactly": 12}
    assert requirement.sensors["range"].price == 2.5
    again = read_requirement(write_requirement(requirement, tmp_path / f"again.{ending}"))
    assert again.to_dict() == requirement.to_dict()
    assert np.array_equal(again.sensors["range"].available, [[0.0, 2700.0]])


def test_a_target_may_stand_beside_the_samples_or_inside(tmp_path):
    head = 'format = "sampling-design/requirement/1"\n'
    for text in (
        "target_sigma = 0.2\n",
        "samples = { target_sigma = 0.2 }\n",
        "target_sigma = 0.2\nsamples.at_most = 9\n",
    ):
        path = tmp_path / "r.toml"
        path.write_text(head + text)
        assert read_requirement(path).target_sigma == 0.2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("format = 'sampling-design/plant/1'", "`format` must be 'sampling-design/requirement/1'"),
        (FULL.replace("60.0\n", "0.0\n"), "bad.toml: cannot be used: `spacing` must be positive"),
        (FULL.replace("window", "windw"), "unknown key 'windw' in the requirement. Did you mean 'window'"),
        (FULL.replace("600.0]]", "600.0"), "is not valid TOML"),
        (FULL.replace("60.0\n", "-60.0\n"), "`spacing` must be positive"),
        (FULL.replace("exactly", "exact"), "unknown key 'exact' in `samples`"),
        (FULL.replace("60.0\n", "true\n"), "`spacing` must be a number, got a boolean True"),
        (FULL.replace("60.0\n", "'60'\n"), """`spacing` must be a time like 0.25 or "15 min", got '60'"""),
        (FULL.replace("60.0\n", "inf\n"), "holds inf, which is not a finite double"),
        (FULL.replace("60.0\n", "-nan\n"), "holds -nan, which is not a finite double"),
        (FULL.replace("60.0\n", f"1{'0' * 400}\n"), "`spacing` must be a number that a double holds"),
        (FULL.replace("60.0\n", f"1{'0' * 5000}\n"), "holds a number of thousands of digits"),
        (FULL.replace("60.0\n", "[" * 30 + "]" * 30 + "\n"), "is nested more than 20 levels deep"),
        (FULL.replace("60.0\n", "1979-05-27\n"), "`spacing` must be a number, got"),
        (
            FULL.replace("exactly = 12", "exactly = true"),
            "`samples.exactly` must be a whole number, got a boolean True",
        ),
        (FULL.replace("exactly = 12", "exactly = 12.0"), "`samples.exactly` must be a whole number, got 12.0"),
        (FULL.replace("[700.0]", "[true]"), "`fixed[0]` must be a number, got a boolean True"),
        (FULL.replace("600.0]]", "600.0, 1.0]]"), "`forbidden[0]` must have a length of 2, got 3"),
        (FULL.replace("2.5", "'2.5'"), "`sensors.range.price` must be a number, got a text '2.5'"),
        (FULL.replace("[sensors.range]", "[[sensors]]"), "`sensors` must be a table of keys and values, got a list"),
        (FULL.replace("window", "spacing"), "is not valid TOML"),
        (FULL + "avail = []", "unknown key 'avail' in `sensors.range`"),
        (FULL + "cost = 2.0", "unknown key 'cost' in `sensors.range`"),
        (
            "format='sampling-design/requirement/1'\ntarget_sigma=1.0\nsamples={target_sigma=2.0}",
            "is given twice, beside",
        ),
    ],
)
def test_a_bad_file_is_one_sentence_with_the_file_named(tmp_path, text, words):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=re.escape(words)) as caught:
        read_requirement(path)
    assert "bad.toml" in str(caught.value)


def test_another_ending_is_not_written(tmp_path):
    with pytest.raises(FileFormatError, match="a requirement file ends in"):
        write_requirement(Requirement(), tmp_path / "r.txt")
    assert not (tmp_path / "r.txt").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"window": -1.0}, "`window` must be positive"),
        ({"samples": 2.5}, "`samples` must be a whole number of at least 1"),
        (
            {"samples": {"exactly": 3, "at_most": 4}},
            "`samples` must give either exactly or at_least and at_most, got both",
        ),
        ({"samples": {"at_least": 5, "at_most": 4}}, "`samples` asks for at_least 5 and at_most 4"),
        ({"forbidden": [[2.0, 1.0]]}, "`forbidden` must hold intervals [start, stop) with start < stop"),
        ({"forbidden": [[-1.0, 1.0]]}, "`forbidden` must not be negative, got -1.0"),
        ({"forbidden": [[0.0, 9.0]], "period": 4.0}, "`forbidden` must lie within the period 4.0, got 9.0"),
        ({"fixed": [4.0], "period": 4.0}, "`fixed` must lie in [0, period) = [0, 4.0), got 4.0"),
        ({"sensors": len}, "`sensors` must be a table of terms by output, got"),
        ({"forbidden": [[0.0], [1.0, 2.0]]}, "`forbidden` must be a rectangular array of numbers"),
        ({"sensors": {"y": 3}}, "`sensors.y` must be a table of keys and values, got int 3"),
        ({"sensors": {"y": {"price": -1}}}, "`price` must not be negative"),
        ({"time_unit": "fortnight"}, "`time_unit` must be one of"),
    ],
)
def test_bad_arguments_are_named(arguments, words):
    with pytest.raises(ArgumentError, match=re.escape(words)):
        Requirement(**arguments)


def test_overlapping_intervals_are_joined_and_kept_half_open():
    requirement = Requirement(forbidden=[[2.0, 3.0], [0.0, 1.0], [0.5, 2.0]])
    assert requirement.forbidden.tolist() == [[0.0, 3.0]]


def test_records_speak():
    requirement = Requirement(window=4.0, samples={"at_most": 5}, forbidden=[[0, 1]], sensors={"y": Sensor(price=2)})
    assert "At most 5 samples per period" in requirement.explain()
    assert "none in [0, 1)" in requirement.explain()
    assert Sensor().explain() == "price 0."
    assert "window" in str(requirement)
    assert requirement.replace(window=5.0).window == 5.0
    with pytest.raises(ArgumentError, match="unknown key 'windoe' in the requirement"):
        requirement.replace(windoe=5.0)


def test_a_length_of_time_may_have_a_unit_of_its_own(tmp_path):
    """As in a plan: in arguments and in a file alike."""
    said = {"window": "4 h", "period": "1 d", "spacing": "30 min"}
    found = Requirement(**said, time_unit="min")
    assert (found.window, found.period, found.spacing) == (240.0, 1440.0, 30.0)
    path = tmp_path / "requirement.toml"
    lines = [f'{key} = "{text}"' for key, text in {"format": FORMAT, **said, "time_unit": "min"}.items()]
    path.write_text("\n".join(lines))
    assert read_requirement(path).to_dict() == found.to_dict()
    assert requirement_from_dict(found.to_dict()).to_dict() == found.to_dict()
    with pytest.raises(ArgumentError, match="has a unit of its own: give `time_unit`, that of all times"):
        Requirement(window="4 h")
    with pytest.raises(ArgumentError, match=r"`window` must be a time like 0\.25 or"):
        Requirement(window="soon", time_unit="h")
