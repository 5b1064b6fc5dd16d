"""A command takes the common flags that it reads, and no other: what is typed is never ignored in silence."""

import ast
import inspect
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from sampling_design import cli
from sampling_design.cli.app import COMMANDS
from sampling_design.cli.settings import COMMON_FLAGS, Settings, flags_of

SHARED = {"quiet", "as_json", "version"}
"""Read by whoever speaks: every command does."""


@cache
def functions() -> dict[tuple[str, str], ast.FunctionDef]:
    """All functions of the room by module and name, methods of `Settings` among them."""
    return {
        (path.stem, node.name): node
        for path in Path(inspect.getfile(cli)).parent.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
    }


def attributes(function: ast.FunctionDef) -> Iterator[tuple[str, str]]:
    """(variable, attribute) of what is read of the settings, and ("", name) of every function that is named."""
    for node in ast.walk(function):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in ("settings", "self")
        ):
            yield node.value.id, node.attr
        elif isinstance(node, ast.Name):
            yield "", node.id


def read_by(module: str, name: str) -> set[str]:
    """The common flags that a function reads, itself or through functions of the room."""
    methods = {name for name, each in vars(Settings).items() if inspect.isfunction(each) or isinstance(each, property)}
    flags, done, ahead = set(), set(), [(module, name)]
    while ahead:
        here = ahead.pop()
        if here in done:
            continue
        done.add(here)
        for owner, named in attributes(functions()[here]):
            if owner and named in COMMON_FLAGS:
                flags.add(named)
            elif owner and named in methods:
                ahead.append(("settings", named))
            elif not owner:  # of this file, else imported from another
                places = [place for place in functions() if place[1] == named and named not in {*COMMANDS, *methods}]
                ahead += [place for place in places if place[0] == here[0]] or places
    return flags


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_takes_the_flags_that_it_reads(name):
    assert set(flags_of(name)) | SHARED == read_by(*COMMANDS[name]) | SHARED


def test_a_flag_that_would_do_nothing_is_refused(shell, tmp_path):
    result = shell("new", tmp_path / "mine", "--oscillation", 24, "--decay-rate", 1)
    assert result.code == 2
    assert "--decay-rate" in result.err
    assert not (tmp_path / "mine").exists()


def test_chosen_rows_go_from_a_design_to_an_estimate(shell, tmp_path):
    plant, record = tmp_path / "three.toml", tmp_path / "y.csv"
    plant.write_text(
        'format = "sampling-design/plant/1"\ntime_unit = "s"\n[matrices]\n'
        "A = [[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, -1.0]]\nC = [[1.0, 0.0, 0.5]]\n"
    )
    record.write_text("time,y1\n0,1\n1.3,1.2\n2.7,1.3\n")
    made, rows = tmp_path / "out", ("--of", "x1")
    assert shell("design", plant, "--window", 4, "--samples", 3).code == 1  # x2 is seen by no output
    assert shell("design", plant, *rows, "--window", 4, "--samples", 3, "-o", made, "--no-picture").code == 0
    for words in (
        ("info", plant),
        ("sigma", plant, made / "schedule.csv", "--window", 4),
        ("worst-case", plant, "--window", 4, "--count", 3, "--spacing", 0.5),
        ("certify", plant, made / "schedule.csv", "-o", made, "--no-picture"),
        ("estimate", plant, record, "--certificate", made / "certificate.json"),
    ):
        assert shell(*words, *rows).code == 0
    refused = shell("estimate", plant, record, "--certificate", made / "certificate.json")
    assert (refused.code, "(--of on the command line)" in refused.err) == (1, True)
    assert "does not decay: 0.2 along x2" in shell("certify", plant, made / "schedule.csv", "--of", "x2").err
