"""Files: written whole or not at all; read with one sentence on failure."""

import os
import stat
from pathlib import Path

import pytest

from sampling_design import read_plant, read_schedule
from sampling_design.checkers import strict
from sampling_design.errors import FileFormatError
from sampling_design.records import file_io
from sampling_design.records.file_io import csv_rows


def test_text_round_trip(tmp_path):
    path = file_io.write_text(tmp_path / "a.txt", "grün\n")
    assert file_io.read_text(path) == "grün\n"
    assert path.read_bytes() == "grün\n".encode()


def test_byte_order_mark_and_foreign_line_ends_are_understood(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbfa\r\nb\rc\n")
    assert file_io.read_text(path) == "a\nb\nc\n"


def test_files_get_ordinary_permissions(tmp_path):
    path = file_io.write_text(tmp_path / "a.txt", "x")
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = file_io.write_text(tmp_path / "a.txt", "old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(file_io.os, "replace", full)
    with pytest.raises(FileFormatError, match=r"a\.txt: cannot be written \(No space left on device\)"):
        file_io.write_text(path, "new")
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(FileFormatError, match=r"cannot be written \(No such file or directory\)"):
        file_io.write_text(tmp_path / "none" / "a.txt", "x")


def test_what_cannot_be_read_is_named(tmp_path, monkeypatch):
    with pytest.raises(FileFormatError, match=r"none\.txt: no such file"):
        file_io.read_text(tmp_path / "none.txt")
    with pytest.raises(FileFormatError, match="is a folder, expected a file") as caught:
        file_io.read_bytes(tmp_path)
    assert caught.value.path == str(tmp_path)
    binary = tmp_path / "b.txt"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileFormatError, match=r"b\.txt: is not a text file \(not UTF-8\)"):
        file_io.read_text(binary)

    def denied(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", denied)
    with pytest.raises(FileFormatError, match=r"cannot be read \(Permission denied\)"):
        file_io.read_bytes(binary)


def test_json_floats_are_exact():
    values = [0.1, 1 / 3, 5e-324, 1.7976931348623157e308, -0.0]
    back = file_io.from_json(file_io.to_json({"x": values}), "x")["x"]
    assert [v.hex() for v in back] == [v.hex() for v in values]


def test_json_refuses_what_has_no_number(tmp_path):
    for value in (float("nan"), float("inf")):
        with pytest.raises(ValueError, match="not JSON compliant"):
            file_io.to_json({"x": value})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": 1', r"x\.json: is not valid JSON at line 1 .*Was the file cut off"),
        (" \n", r"x\.json: is empty, expected one JSON object"),
        ("[1]", "must hold one JSON object"),
        ('{"a": 1, "a": 2}', "key 'a' .*occurs twice"),
        ('{"b": {"a": 1, "a": 2}}', "key 'a' .*occurs twice"),
        ('{"a": NaN}', "holds NaN.*, which is not allowed"),
        ('{"a": -Infinity}', "holds -Infinity.*, which is not allowed"),
    ],
)
def test_bad_json(text, message):
    with pytest.raises(FileFormatError, match=message):
        file_io.from_json(text, "x.json")


@pytest.mark.parametrize("text", ["a = [1, 2", 'a = "x', "a = 1\na = 2", "[a\n"])
def test_bad_toml(text):
    with pytest.raises(FileFormatError, match=r"x\.toml: is not valid TOML .*Was the file cut off"):
        file_io.from_toml(text, "x.toml")


def test_toml_is_read():
    assert file_io.from_toml("a = 1.5\n[b]\nc = [1]\n", "x") == {"a": 1.5, "b": {"c": [1]}}


@pytest.mark.parametrize(
    ("lines", "cells"),
    [
        (["time,y", "0.5,1"], [["time", "y"], ["0.5", "1"]]),
        (["time;y", "0,5;-1,25e-3"], [["time", "y"], ["0.5", "-1.25e-3"]]),
        (["time\ty", "0,5\t1"], [["time", "y"], ["0.5", "1"]]),
        (["time;y", "0.5;"], [["time", "y"], ["0.5", ""]]),
        (['"a;b",y', '"1,5",2'], [["a;b", "y"], ["1,5", "2"]]),
    ],
)
def test_cells_are_separated_by_what_separates_the_header(lines, cells):
    assert [row for _, row in csv_rows(enumerate(lines, 1), "f.csv")] == cells


@pytest.mark.parametrize("line", ['0.5,"1', "0.5," + "9" * 200_000])
def test_a_cell_that_cannot_be_read_is_one_sentence(line):
    with pytest.raises(FileFormatError, match=r"f.csv, line 2: cannot be read as cells .*Was a quote left open\?"):
        csv_rows([(1, "time,y"), (2, line)], "f.csv")


def test_spreadsheet_files_are_read_as_they_come(tmp_path):
    import sampling_design as sd

    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], outputs=["y"])
    (tmp_path / "m.csv").write_bytes("\ufefftime;y\r\n0,5;1,25\r\n1;\r\n2,5;-3\r\n".encode().replace(b"1;\r\n", b""))
    found = sd.read_measurements(tmp_path / "m.csv", plant)
    assert (found.times.tolist(), found.y.ravel().tolist()) == ([0.5, 2.5], [1.25, -3.0])
    (tmp_path / "s.csv").write_text("# sampling-design schedule; time_unit=s; period=2.0\ntime;y\n0,5;1\n1,5;1\n")
    assert sd.read_schedule(tmp_path / "s.csv").times.tolist() == [0.5, 1.5]
    (tmp_path / "t.csv").write_text("time;what\n0,5;a\n1,5;b\n")
    assert sd.schedules.import_time_stamps(tmp_path / "t.csv", "s").times.tolist() == [0.5, 1.5]


@pytest.mark.parametrize("reader", [file_io.from_json, file_io.from_toml])
@pytest.mark.parametrize("text", ['{{"a": {0}}}', "a = {0}"])
def test_what_no_one_means_is_one_sentence(reader, text):
    if (reader is file_io.from_json) == text.startswith("{"):
        for value in ("[" * 100_000, "9" * 5000):
            with pytest.raises(
                FileFormatError,
                match=r"is nested more than 20 levels|or holds a number of thousands of digits|a whole number beyond",
            ):
                reader(text.format(value), "f")
    else:
        with pytest.raises(FileFormatError, match="is not valid"):
            reader(text.format("1"), "f")


@pytest.mark.parametrize(("asked", "near"), [("nope.toml", ""), ("osk.toml", "osc.toml"), ("osc.json", "osc.toml")])
def test_a_file_that_is_missing_suggests_none_that_shares_its_ending_only(tmp_path, asked, near):
    (tmp_path / "osc.toml").write_text("")
    (tmp_path / "nopen.py").write_text("")
    with pytest.raises(FileFormatError, match=rf"no such file\.{f' Did you mean .*/{near}.' if near else ''}$"):
        read_plant(tmp_path / asked)


@pytest.mark.parametrize("reader", [read_plant, read_schedule])
def test_a_file_whose_ending_is_a_slip_is_missing_first(tmp_path, reader):
    (tmp_path / "osc.csv").write_text("")
    with pytest.raises(FileFormatError, match=r"osc\.cvs: no such file\. Did you mean .*/osc\.csv\?$"):
        reader(tmp_path / "osc.cvs")


def test_a_text_that_is_too_large_is_refused_before_it_is_read(monkeypatch):
    monkeypatch.setattr(strict, "MOST_BYTES", 3)
    for read in (file_io.from_json, file_io.from_toml):
        with pytest.raises(FileFormatError, match="is too large: 4 characters, expected at most 3"):
            read("a =1", "x")
