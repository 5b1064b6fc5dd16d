"""What a newcomer gets wrong, and what is said to it: one sentence that names what came and what to do."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.estimators import estimator_choice
from sampling_design.schedules.time_stamps import import_time_stamps

EXAMPLES = Path(__file__).parents[2] / "examples"
PLANT = EXAMPLES / "plants" / "oscillator.toml"
WISH = EXAMPLES / "requirements" / "oscillator.toml"
TEXT, WISHED = PLANT.read_text(), WISH.read_text()
DATA = "time,position\n0.5,0.2\n1.7,-0.3\n3.1,-0.9\n"
EDGE = 'format = "sampling-design/plant/1"\ntime_unit = "s"\n[matrices]\n'


def swapped(text, old, new):
    assert old in text
    return text.replace(old, new)


FREE = swapped(TEXT, TEXT[TEXT.index("B = ") : TEXT.index("C = ")], "")
FREE = swapped(FREE, FREE[FREE.index("[inputs]") : FREE.index("[disturbances]")], "")


# what is wrong: (file's name, its content, words that the answer holds, exit code)
PLANTS = {
    "flat C": (
        "p.toml",
        EDGE + "A = [[0.0, 1.0], [-1.0, 0.0]]\nC = [1.0, 0.0]\n",
        "One row is [[...]], in two brackets",
        2,
    ),
    "flat A": ("p.toml", EDGE + "A = [0.0, 1.0]\nC = [[1.0, 0.0]]\n", "One row is [[...]], in two brackets", 2),
    "A not square": ("p.toml", EDGE + "A = [[0.0, 1.0]]\nC = [[1.0, 0.0]]\n", "square", 2),
    "C of another size": ("p.toml", EDGE + "A = [[0.0, 1.0], [-1.0, 0.0]]\nC = [[1.0]]\n", "`C` must have", 2),
    "ragged A": ("p.toml", EDGE + "A = [[0.0, 1.0], [-1.0]]\nC = [[1.0, 0.0]]\n", "A", 2),
    "decimal commas": ("p.toml", EDGE + "A = [[0,0, 1,0], [-1,0, 0,0]]\nC = [[1,0]]\n", "point, not a comma", 2),
    "numbers as text": ("p.toml", EDGE + 'A = [["0", "1"], ["-1", "0"]]\nC = [[1.0, 0.0]]\n', "number", 2),
    "no C": ("p.toml", EDGE + "A = [[0.0]]\n", "C", 2),
    "nan": ("p.toml", EDGE + "A = [[nan]]\nC = [[1.0]]\n", "finite", 2),
    "MATLAB's semicolons": ("p.toml", EDGE + "A = [0 1; -1 0]\nC = [1 0]\n", "Rows stand in brackets of their own", 2),
    "unit in words": ("p.toml", swapped(TEXT, '"s"', '"seconds"'), "time_unit", 2),
    "unknown unit": ("p.toml", swapped(TEXT, '"s"', '"y"'), "time_unit", 2),
    "no unit": ("p.toml", swapped(TEXT, 'time_unit = "s"\n', ""), "time_unit", 2),
    "a misspelt key": ("p.toml", swapped(TEXT, "[matrices]", "[matrix]"), "matri", 2),
    "too many names": ("p.toml", swapped(TEXT, '"velocity",', '"velocity", "heat",'), "one per name", 2),
    "one name twice": ("p.toml", swapped(TEXT, '"velocity",', '"position",'), "position", 2),
    "an empty file": ("p.toml", "", "the file is empty, expected a plant", 2),
    "another kind of text": ("p.txt", TEXT, ".toml", 2),
    "a workbook": ("p.xlsx", b"PK\x03\x04" + bytes(60), ".toml", 2),
    "a workbook named toml": ("p.toml", b"PK\x03\x04\x00\xff" + bytes(60), "is a workbook", 2),
    "Latin letters of Windows": (
        "p.toml",
        swapped(TEXT, "oscillator", "Schwingfähig").encode("latin-1"),
        "Save it as UTF-8",
        2,
    ),
    "text of two bytes": ("p.toml", TEXT.encode("utf-16"), "UTF-", 2),
    "with a byte order mark": ("p.toml", b"\xef\xbb\xbf" + TEXT.encode(), "oscillator", 0),
    "with line ends of Windows": ("p.toml", TEXT.replace("\n", "\r\n"), "oscillator", 0),
    "MATLAB's blanks": ("p.toml", EDGE + "A = [[0.0]]\nC = [1 0]\n", "Numbers have commas between", 2),
    "matrices of no table": ("p.toml", "A = [[0.0]]\nC = [[1.0]]\n", "write the line [matrices] before it", 2),
    "matrices and wishes": ("p.toml", "A = [[0.0]]\nsamples = 5\n", "write the line [matrices] before it", 2),
    "no format": ("p.toml", EDGE.split("\n", 1)[1] + "A = [[0.0]]\n", 'the line format = "sampling-design/plant/1"', 2),
    "a requirement": ("p.toml", WISHED, "is a requirement file, expected a plant file", 2),
    "measurements": ("p.csv", DATA, "measurement", 2),
}
WISHES = {
    "a window of no length": (swapped(WISHED, "window = 6.28", "window = 0.0 # "), "`window` must be", 2),
    "a negative spacing": (swapped(WISHED, "spacing = 0.2", "spacing = -0.2"), "`spacing` must be", 2),
    "half a sample": (swapped(WISHED, "exactly = 4", "exactly = 4.5"), "samples", 2),
    "no sample": (swapped(WISHED, "exactly = 4", "exactly = 0"), "samples", 2),
    "more than fit": (swapped(WISHED, "spacing = 0.2", "spacing = 3.0"), "spacing", 1),
    "a misspelt key": (swapped(WISHED, "spacing", "spaceing"), "spacing", 2),
    "hours the wrong way round": (WISHED + "forbidden = [[3.0, 2.0]]\n", "forbidden", 2),
    "hours past the period": (WISHED + "forbidden = [[5.0, 9.0]]\n", "forbidden", 2),
    "everything closed": (WISHED + "forbidden = [[0.0, 6.283185307179586]]\n", "forbidden", 1),
    "an unknown sensor": (WISHED + "[sensors.speed]\nprice = 2.0\n", "speed", 2),
    "a plant": (TEXT, "is a plant file, expected a requirement file", 2),
    "no format": ("samples = 5\n", 'the line format = "sampling-design/requirement/1"', 2),
}
RECORDS = {
    "as it should be": (DATA, "3 ", 0),
    "`Time`": (DATA.replace("time", "Time"), "", 0),
    "`t`": (DATA.replace("time", "t"), "time", 2),
    "no head": (DATA.split("\n", 1)[1], "time", 2),
    "an unknown column": (DATA.replace("position", "pos"), "pos", 2),
    "a shorter name": (DATA.replace("position", "pos"), "Is it 'pos'?", 2),
    "a name mistyped": (DATA.replace("position", "postion"), "Is it 'postion'?", 2),
    "an extra column": ("time,position,note\n0.5,0.2,a\n1.7,-0.3,b\n", "the plant names position", 2),
    "an extra column of numbers": ("time,position,speed\n0.5,0.2,1.0\n1.7,-0.3,2.0\n", "speed", 2),
    "semicolons": (DATA.replace(",", ";"), "", 0),
    "semicolons and decimal commas": (DATA.replace(",", ";").replace(".", ","), "", 0),
    "decimal commas between commas": ("time,position\n0,5,0,2\n1,7,-0,3\n", "cell", 2),
    "tabs": (DATA.replace(",", "\t"), "", 0),
    "blanks after commas": (DATA.replace(",", ", "), "", 0),
    "a byte order mark": (b"\xef\xbb\xbf" + DATA.encode(), "", 0),
    "line ends of Windows": (DATA.replace("\n", "\r\n"), "", 0),
    "an empty file": ("", "empty", 2),
    "a head and nothing else": ("time,position\n", "no ", 2),
    "one row": ("time,position\n0.5,0.2\n", "", 0),
    "time backwards": ("time,position\n1.7,0.2\n0.5,-0.3\n", "", 0),
    "a time twice": ("time,position\n0.5,0.2\n0.5,-0.3\n", "line 3 repeats the time of line 2", 2),
    "a cell that is no number": (DATA.replace("-0.3", "n/a?"), "n/a?", 2),
    "an empty cell": (DATA.replace("-0.3", ""), "", 0),
    "nan": (DATA.replace("-0.3", "nan"), "", 0),
    "a word": (DATA.replace("-0.3", "lost"), "Leave the cell empty", 2),
    "an endless value": (DATA.replace("-0.3", "inf"), "inf", 2),
    "a row too short": ("time,position\n0.5,0.2\n1.7\n", "line 3", 2),
    "dates": ("date,position\n2026-03-16 08:00,0.2\n2026-03-16 08:01,0.1\n", "", 0),
    "dates under time": ("time,position\n2026-03-16 08:00,0.2\n2026-03-16 08:01,0.1\n", "a column named date", 2),
    "dates of Germany": ("date,position\n16.03.2026 08:00,0.2\n", "Write 2026-03-16", 2),
    "dates of America": ("date,position\n03/16/2026 8:00 AM,0.2\n", "Write 2026-03-16", 2),
    "a unit in the head": ("time,position [m]\n0.5,0.2\n1.7,-0.3\n", "without units", 2),
    "a unit in the cell": ("time,position\n0.5,0.2 m\n", "0.2 m", 2),
    "a workbook": (b"PK\x03\x04\x00\xff" + bytes(60), "Save the table as csv", 2),
}
HAND = "# sampling-design schedule; time_unit=s; period=4\n"
FILES = {
    "p.toml": FREE,
    "r.toml": WISHED,
    "s.csv": HAND + "time\n0.5\n1.7\n3.1\n",
    "bare.csv": "time,position\n0.5,1\n1.7,1\n",
    "list.csv": "0.5\n1.7\n3.1\n",
    "plan.toml": "grid = 1.0\n",
    "design.json": '{"format": "sampling-design/design/1", "sigma": 1.0}\n',
    "headless.csv": HAND + "0.5\n1.7\n",
    "long.csv": HAND.replace("4", "1.0") + "time\n0.5\n1.7\n",
    "yes.csv": HAND + "time,position\n0.5,yes\n",
    "dates.csv": HAND + "date,position\n2026-03-02,1\n",
    "m.csv": DATA,
    "empty.csv": DATA.splitlines()[0] + "\n",
    "certificate.json": '{"format": "sampling-design/certificate/1"}',
    "dated.csv": "date,position\n2026-03-16 08:00,0.2\n2026-03-16 08:01,0.1\n",
}
LINES = {
    "a unit at a number": ("design p.toml r.toml --window 4s", "'4s' is not a number. Times stand in the plant's unit"),
    "a decimal comma": ("design p.toml r.toml --spacing 0,5", "decimals have a point"),
    "a number in words": ("design p.toml r.toml --samples four", "'four' is not a whole number"),
    "half a sample": ("design p.toml r.toml --samples 2.5", "is not a whole number"),
    "minutes of a budget": ("design p.toml r.toml --budget 1min", "'1min' is not a number"),
    "a decimal comma in a bound": ("accuracy p.toml s.csv --w 0.1 --v 0,1", "Decimals have a point, not a comma"),
    "three bounds of two": ("estimate p.toml m.csv --w 1,2,3", "or 2: one for each of w_position, w_velocity"),
    "bounds in words": ("accuracy p.toml s.csv --w small --v 0.1", "must be numbers with commas between"),
    "no bound": ("accuracy p.toml s.csv", "without a bound on w_position, w_velocity nothing can be guaranteed"),
    "blanks for commas": (
        "accuracy p.toml s.csv --w 0.1 --v 0.1 --of position\u00a0velocity",
        "`--of` must name states",
    ),
    "times in place of a file": ("sigma p.toml 1,2,3", "the file must end in .csv or .json, got '1,2,3'"),
    "a zone without a date": ("design p.toml r.toml --zone Europe/Berlin", "give --start DATE with it"),
    "a date without a folder": ("design p.toml r.toml --start 2026-03-02", "Give --output DIR"),
    "a date in words": ("design p.toml r.toml -o o --start tomorrow", "a date like 2026-01-05T08:00"),
    "a date of Germany": ("design p.toml r.toml -o o --start 02.03.2026", "a date like 2026-01-05T08:00"),
    "half a zone": ("design p.toml r.toml -o o --start 2026-03-02 --zone Berlin", "a time zone like Europe/Berlin"),
    "a file mistyped": ("design p.toml rr.toml", "rr.toml: no such file. Did you mean r.toml?"),
    "a file without its ending": ("info p", "p: no such file. Did you mean p.toml?"),
    "a plant of the library mistyped": (
        "info satelite",
        "A plant of the library needs no file. Did you mean 'satellite'?",
    ),
    "a file beside the one that is meant": ("verify s.csv", "Did you mean certificate.json?"),
    "a form that nobody filled in": ("compare p.toml s.csv empty.csv", "`MEASUREMENTS` empty.csv holds no measurement"),
    "a design for its schedule": ("certify p.toml design.json", "The schedule of a design is in schedule.csv"),
    "a requirement for a plan's": ("plan p.toml r.toml", "`sampling-design new --within` writes one"),
    "a plan without its format": ("plan p.toml plan.toml", 'line format = "sampling-design/plan-requirement/1"'),
    "a scene mistyped": ("explore --scene pathologic", "`--scene` must be one of pathological, even"),
    "a file for a folder": ("design p.toml r.toml -o p.toml", "cannot be made a folder"),
    "a misspelt command": ("desing p.toml", "Did you mean 'design'?"),
    "counts that fall": ("pareto p.toml r.toml --counts 14-6", "must rise from the smaller number to the larger"),
    "counts with dots": ("pareto p.toml r.toml --counts 6..14", "must look like 8,10,12 or 8-16"),
    "gaps that fall": ("certify p.toml --gap-range 2 0.5", "Did you swap them?"),
    "a jitter below zero": (
        "certify p.toml s.csv --timing-tolerance -0.1",
        "`--timing-tolerance` must not be negative, got -0.1",
    ),
    "more lost than there are": ("certify p.toml s.csv --lost 4 3", "`--lost D`"),
    "no windows": ("certify p.toml --spaced -1 3 0.5", "`--spaced T` must be positive"),
    "one word for gaps": ("certify p.toml --gap-range 0.5-2", "takes 2 values, A B: Every schedule with gaps between"),
    "two of three": ("certify p.toml --spaced 5 4", "takes 3 values, T K E: Every schedule with K"),
    "neither schedule nor family": ("certify p.toml", "a plan (plan.json) for PLANT, or a family such as --gap-range"),
    "a plain table as schedule": (
        "sigma p.toml bare.csv",
        'A schedule begins with the line "# sampling-design schedule',
    ),
    "a plain list as schedule": ("sigma p.toml list.csv", 'must begin with "# sampling-design schedule; time_unit='),
    "no head of the times": ("sigma p.toml headless.csv", "the first column must be `time`, got '0.5'"),
    "times past the period": ("sigma p.toml long.csv", "Does the last time already belong to the next period?"),
    "yes for one": ("sigma p.toml yes.csv", "must be 1 (measured) or 0, got yes"),
    "dates for times": ("sigma p.toml dates.csv", "the first column must be `time`, got 'date'"),
    "dates and times": ("estimate p.toml dated.csv --schedule s.csv", "which date its time 0 is"),
    "a plan that is none": ("plan p.toml r.toml", "is a requirement file, expected a plan requirement file"),
    "a requirement to follow": ("next r.toml", "is a requirement file, expected a plan file"),
    "a schedule to verify": ("verify s.csv", "is a schedule file, expected a certificate file"),
    "files of a comparison swapped": ("compare p.toml m.csv s.csv", "is a measurement file, expected a schedule file"),
    "a rhythm in words": ("new x --oscillation daily", "must be positive numbers of h, or times like"),
    "hours of an English clock": ("new x --oscillation 24 --open 7am-10pm", 'as "Mon-Fri 8:30-12, 13-17, Sat 9-12"'),
    "a unit in words": ("new x --oscillation 24 --unit days", "must be one of ms, s, min, h, d, wk, got 'days'"),
    "nothing that moves": ("new x --no-level", "give --oscillation PERIODS, --decay or --half-life TIMES, or both"),
    "a plan without its noise": ("new x --oscillation 24 --within 1.7", "needs --noise: how far a reading may be off"),
}
CALLS = {
    "a list for C": (lambda: sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [1.0, 0.0]), "One row is [[...]], in two brackets"),
    "degrees": (lambda: sd.Schedule(["0°", "90°"]), "`times`"),
    "a count for times": (
        lambda: sd.observability.sigma_min(sd.named_plant("oscillator"), 4),
        "`times` must have 1 dimension",
    ),
    "times for gaps": (lambda: sd.PeriodicSchedule([0.0, 1.0, 2.0]), "gaps"),
    "a file's name for a plant": (lambda: sd.certify("plant.toml", sd.PeriodicSchedule([1.0])), "read_plant"),
    "a file's name for a schedule": (lambda: sd.certify(sd.named_plant("oscillator"), "s.csv"), "read_schedule"),
    "arguments swapped": (
        lambda: sd.certify(sd.PeriodicSchedule([1.0]), sd.named_plant("oscillator")),
        "got Plant",
    ),
    "seconds for hours": (
        lambda: sd.observability.sigma_min(sd.named_plant("oscillator"), sd.Schedule([1.0, 2.0], time_unit="h")),
        "in_unit",
    ),
    "an unknown plant": (lambda: sd.named_plant("pendulum"), "'cart_pendulum'"),
    "a plant like none": (lambda: sd.named_plant("rocket"), "'oscillator'"),
    "a bound forgotten": (
        lambda: sd.guaranteed_accuracy(sd.named_plant("oscillator"), sd.PeriodicSchedule([1.0]), w_bound=0.1),
        "`v_bound`",
    ),
    "a bound below zero": (
        lambda: sd.guaranteed_accuracy(
            sd.named_plant("oscillator"), sd.PeriodicSchedule([1.0]), w_bound=0.1, v_bound=-1.0
        ),
        "`v_bound`",
    ),
    "a goal misspelt": (
        lambda: sd.plan_samples(
            sd.named_plant("oscillator"),
            sd.PlanRequirement(
                {"positon": 1.0}, grid=1.0, period=8.0, w_bound=0.1, sensors={"position": {"noise_bound": 0.1}}
            ),
        ),
        "`accuracy` must name states or outputs, got 'positon'. Did you mean 'position'?",
    ),
    "a misspelt name": (lambda: sd.desing_schedule, "design_schedule"),
    "a complex matrix": (lambda: sd.Plant([[1j]], [[1.0]]), "real"),
    "a matrix of objects": (lambda: sd.Plant(np.array([[None]]), [[1.0]]), "`A`"),
}


def written(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def judged(done, words, code):
    """Whether it ended as it should, in one sentence that says so."""
    told = done.err if code else done.out
    one = not code or (len(done.err.strip().splitlines()) == 1 and "Traceback" not in done.err)
    return done.code == code and words.lower() in told.lower() and one


@pytest.mark.parametrize("what", PLANTS)
def test_a_plant_file(what, shell, tmp_path):
    name, content, words, code = PLANTS[what]
    done = shell("info", written(tmp_path, name, content))
    assert judged(done, words, code), done


@pytest.mark.parametrize("what", WISHES)
def test_a_requirement_file(what, shell, tmp_path):
    content, words, code = WISHES[what]
    done = shell("design", PLANT, written(tmp_path, "r.toml", content), "--branches", 0, "--quiet")
    assert judged(done, words, code), done


@pytest.mark.parametrize("what", RECORDS)
def test_a_measurement_file(what, shell, tmp_path, monkeypatch):
    """The gaps of a file that is read well are not certified: it is about the reading."""
    monkeypatch.setattr(estimator_choice, "FAMILY_STATES", 0)
    monkeypatch.setattr(estimator_choice, "OWN_SAMPLES", 0)
    content, words, code = RECORDS[what]
    path = written(tmp_path, "m.csv", content)
    plant = written(tmp_path, "free.toml", FREE)
    done = shell("estimate", plant, path, "--w", 0.1, "--v", 0.2, "--initial-error", 2.0)
    assert judged(done, words, code), done


@pytest.mark.parametrize("what", LINES)
def test_a_command_line(what, shell, tmp_path, monkeypatch):
    line, words = LINES[what]
    monkeypatch.chdir(tmp_path)
    for name, content in FILES.items():
        written(tmp_path, name, content)
    done = shell(
        *line.split(" "), *([] if line.startswith(("new", "desing", "certify p.toml --gap-range 0.5")) else ["--quiet"])
    )
    assert done.code == 2, done
    said = done.err.strip().splitlines()[-1]
    assert words in said, done
    assert "Traceback" not in done.err
    assert done.out == ""


@pytest.mark.parametrize("what", CALLS)
def test_a_call(what):
    call, words = CALLS[what]
    with pytest.raises((sd.SamplingDesignError, AttributeError), match=re.escape(words)):
        call()


def test_what_to_type_next_can_be_typed_whatever_a_folder_is_called(shell, tmp_path):
    folder = tmp_path / "my l\u00e4b (new)"
    runs = [shell("new", folder, "--oscillation", 24, "--samples", 4, "--spacing", 1)]
    runs.append(shell("design", folder / "plant.toml", folder / "requirement.toml", "-o", folder, "--branches", 0))
    runs.append(shell("certify", folder / "plant.toml", folder / "schedule.csv", "-o", folder))
    said = [line for run in runs for line in run.out.splitlines() if line.startswith("Next: ")]
    words = [word for line in said for word in shlex.split(line)[3:] if word.endswith((".toml", ".csv", ".json"))]
    assert len(said) == 4
    assert {word for word in words if not Path(word).is_file()} == {"MEASUREMENTS.csv"}


def test_every_line_to_type_next_quotes_its_paths():
    cli = Path(sd.__file__).parent / "cli"
    lines = [line for path in cli.glob("*.py") for line in path.read_text().splitlines() if '"Next: sampling' in line]
    loose = re.compile(r"\{(?!(?:options\.)?shell_word\(|first\}|made\}|asked\})")
    assert len(lines) > 6
    assert [line for line in lines if loose.search(line)] == []


EXCEL = {
    "empty rows": "{0}\n{1}\n;\n;;\n\n{2}\n;\n",
    "a line that says the separator": "sep=;\n{0}\n{1}\n{2}\n",
    "a mark and line ends": "\ufeff{0}\r\n{1}\r\n{2}\r\n\r\n",
}
"""How sheets come out of a spreadsheet program."""


@pytest.mark.parametrize("form", EXCEL)
def test_a_sheet_of_a_spreadsheet_program_is_the_table_that_it_shows(tmp_path, form):
    plant = sd.Plant([[0.0]], [[1.0]], time_unit="h", outputs=["gauge"])
    path = tmp_path / "sheet.csv"
    path.write_bytes(EXCEL[form].format("date;gauge", "2026-03-02 08:00;3,5", "2026-03-02 10:00;2,5").encode())
    record = sd.read_measurements(path, plant)
    assert record.y.tolist() == [[3.5], [2.5]]
    assert record.times.tolist() == import_time_stamps(path, "h").times.tolist() == [0.0, 2.0]
