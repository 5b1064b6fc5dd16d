"""The first hour can be typed as it stands."""

import re
import shlex
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "first_hour.md").read_text()


@pytest.mark.long
def test_every_command_of_the_first_hour_runs(monkeypatch, tmp_path, shell):
    monkeypatch.chdir(tmp_path)
    measured = re.search(r"```text\n(time,.*?)```", PAGE, re.DOTALL)[1]
    lines = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()]
    assert [line.split()[1] for line in lines] == [
        "new", "info", "design", "explore", "certify", "verify", "accuracy", "estimate",
    ]  # fmt: skip
    for line in lines:
        words = shlex.split(line)[1:]
        if words[0] == "estimate":
            (tmp_path / "hormone" / "blood.csv").write_text(measured)
        done = shell(*words, *(["--idle", "0.3", "--no-browser"] if words[0] == "explore" else []))
        assert done.code == 0, f"{line}: {done.err or done.out}"
        if words[0] in ("new", "design", "certify"):
            assert "Next: sampling-design " in done.out, line
    written = {path.name for path in (tmp_path / "hormone").iterdir()}
    assert {"plant.toml", "schedule.csv", "design.png", "schedule.ics", "certificate.json", "estimates.csv"} <= written
