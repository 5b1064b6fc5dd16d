"""The README's commands are the ones that continuous integration executes."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def readme_commands() -> list[str]:
    near_top = "\n".join((ROOT / "README.md").read_text().splitlines()[:40])
    return [block.strip() for block in re.findall(r"```sh\n(.*?)```", near_top, flags=re.DOTALL)]


def test_readme_has_exactly_two_commands_near_its_top():
    commands = readme_commands()
    assert len(commands) == 2
    assert all("\n" not in command and command.startswith("python3 -m venv") for command in commands)
    assert "sampling-design design examples/plants/satellite.toml" in commands[0]
    assert "pytest" in commands[1]


def test_ci_executes_both_commands():
    lines = [line.strip() for line in (ROOT / ".ci" / "run").read_text().splitlines()]
    for command in readme_commands():
        assert command in lines


def test_ci_stops_at_the_first_failure():
    assert "set -euo pipefail" in (ROOT / ".ci" / "run").read_text()


@pytest.mark.long
def test_the_eight_lines_run(monkeypatch, capsys):
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL).group(1)
    monkeypatch.chdir(ROOT)
    exec(compile(code, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "passed      yes" in printed
    assert "sigma" in printed


@pytest.mark.long
def test_a_plant_becomes_a_calendar_and_visits_become_estimates_in_fifteen_lines(monkeypatch, tmp_path, capsys):
    code = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)[1]
    assert len([line for line in code.splitlines() if line]) <= 15
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), names)
    assert {path.name for path in (tmp_path / "out" / "tank").iterdir()} >= {"plan.ics", "sheet.html", "plan.json"}
    assert "gauge" in (tmp_path / "out" / "tank" / "plan.ics").read_text()
    assert len(names["estimates"]) == len(names["visits"]) == names["plan"].samples > 1
    assert "level radius" in capsys.readouterr().out


def test_the_table_of_commands_is_the_command_line():
    from sampling_design.cli.app import COMMANDS

    listed = re.findall(r"^\| `([a-z-]+) ", (ROOT / "README.md").read_text(), flags=re.MULTILINE)
    assert listed == list(COMMANDS)


def test_the_flags_that_the_readme_gives_to_every_command_are_those_that_every_command_has():
    from sampling_design.cli.app import COMMANDS, loaded
    from sampling_design.cli.settings import COMMON_FLAGS

    flags = {name: {flag for option in loaded(name).params for flag in option.opts} for name in COMMANDS}
    told = re.search(
        r"^Each takes (.*?), and all but `new` take `-o DIR`(.*?) are there where", README, flags=re.M | re.S
    )
    named = [set(re.findall(r"`(--[a-z-]+)", part)) for part in told.groups()]
    assert named[0] == set.intersection(*flags.values()) - {"--version"}
    assert {name for name, own in flags.items() if "-o" not in own} == {"new"}
    common = {name: "--" + name.replace("_", "-") for name in COMMON_FLAGS}
    assert named[1] == {
        flag for flag in common.values() if 0 < sum(flag in own for own in flags.values()) < len(COMMANDS) - 1
    }


def test_the_exit_codes_are_the_same_everywhere():
    from sampling_design import errors
    from sampling_design.cli import exit_codes
    from sampling_design.cli.app import app

    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type)]
    codes = {0, exit_codes.DEFECT, exit_codes.INTERRUPTED, *(getattr(kind, "exit_code", 0) for kind in kinds)}
    table = (ROOT / "docs" / "conventions.md").read_text().split("(errors)=")[1].split("(tolerances)=")[0]
    assert {int(code) for code in re.findall(r"^\| (\d+) \|", table, flags=re.MULTILINE)} == codes
    for text in (README.split("Exit codes:")[1].split("\n\n")[0], app.info.epilog.split("Exit codes:")[1]):
        assert {int(code) for code in re.findall(r"\b(\d+) [a-z]", text)} == codes


def test_a_command_is_called_as_its_function():
    """By the words of the verb that it calls, or some of them; those that call none, or a verb of a room, are named."""
    import sampling_design as sd
    from sampling_design.cli.app import COMMANDS

    verbs = [set(name.split("_")) for name in sd.__all__ if name.islower()]
    alone = [name for name in COMMANDS if not any(set(name.split("-")) <= verb for verb in verbs)]
    assert alone == ["new", "info", "losses", "explore", "verify", "estimate", "thyroid"]


def test_the_first_pages_show_one_example():
    """From a plant to an estimate per visit: the build executes the documentation's, and the README's is the same."""
    here, there = ((ROOT / name).read_text() for name in ("README.md", "docs/index.md"))
    shown = [re.search(r"import control\n.*?```", text, re.DOTALL).group() for text in (here, there)]
    lines = [[line.split("  # ")[0] for line in each.splitlines() if "print(" not in line] for each in shown]
    assert lines[0] == lines[1]
    assert len(lines[0]) > 10
