"""The README's commands are the ones that continuous integration executes."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


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


def test_the_eight_lines_run(monkeypatch, capsys):
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL).group(1)
    monkeypatch.chdir(ROOT)
    exec(compile(code, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "passed      yes" in printed
    assert "sigma" in printed


def test_the_table_of_commands_is_the_command_line():
    from sampling_design.cli.app import app

    listed = set(re.findall(r"^\| `([a-z-]+) ", (ROOT / "README.md").read_text(), flags=re.MULTILINE))
    assert listed == {command.name for command in app.registered_commands}
