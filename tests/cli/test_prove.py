"""certify and verify: a certificate is written, checked, and refused once it is touched."""

import json
from pathlib import Path

import pytest

from sampling_design import PeriodicSchedule, write_schedule
from sampling_design.cli.prove import certify
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError

EXAMPLES = Path(__file__).parents[2] / "examples"
OSCILLATOR = EXAMPLES / "plants" / "oscillator.toml"


@pytest.fixture
def certified(shell, tmp_path):
    write_schedule(PeriodicSchedule([0.7, 1.6, 0.9], time_unit="s"), tmp_path / "schedule.csv")
    return shell("certify", OSCILLATOR, tmp_path / "schedule.csv", "-o", tmp_path), tmp_path


def test_certify_prints_four_horizons_and_writes_everything(certified):
    result, folder = certified
    assert result.code == 0
    for word in ("paper chain", "exact, sharp", "true contraction", "C_w"):
        assert word in result.out
    assert {"certificate.json", "horizons.png", "constants.md", "constants.tex"} <= {p.name for p in folder.iterdir()}
    assert "| exact, sharp |" in (folder / "constants.md").read_text()


def test_verify_accepts_the_file_and_its_plant(certified, shell):
    _, folder = certified
    result = shell("verify", folder / "certificate.json", "--plant", OSCILLATOR)
    assert result.code == 0
    assert "Proven" in result.out
    data = json.loads(shell("verify", folder / "certificate.json", "--json", "-o", folder).out)
    assert data["passed"] is True
    assert json.loads((folder / "verdict.json").read_text()) == data


def test_verify_refuses_another_plant(certified, shell):
    _, folder = certified
    result = shell("verify", folder / "certificate.json", "--plant", EXAMPLES / "plants" / "double_integrator.toml")
    assert result.code != 0
    assert "another plant" in result.err


def test_verify_refuses_a_touched_file(certified, shell):
    _, folder = certified
    text = (folder / "certificate.json").read_text()
    (folder / "touched.json").write_text(text.replace('"eta": ', '"eta": 1', 1))
    result = shell("verify", folder / "touched.json")
    assert result.code in (1, 2)
    assert "Traceback" not in result.err
    assert result.err.startswith("sampling-design: ")


def test_a_false_certificate_is_a_no(certified, shell):
    from sampling_design.certificates.files import digest

    _, folder = certified
    data = json.loads((folder / "certificate.json").read_text())
    data["P1"] = [[2 * v for v in row] for row in data["P1"]]
    data["digest"] = digest(data)
    (folder / "false.json").write_text(json.dumps(data))
    result = shell("verify", folder / "false.json")
    assert result.code == 1


def test_a_blind_schedule_has_no_certificate(shell, tmp_path):
    write_schedule(PeriodicSchedule([3.141592653589793], time_unit="s"), tmp_path / "blind.csv")
    result = shell("certify", OSCILLATOR, tmp_path / "blind.csv")
    assert result.code == 1
    assert "Traceback" not in result.err


def test_a_gap_range_is_certified_and_verified_rigorously(shell, tmp_path):
    result = shell("certify", OSCILLATOR, "--gap-range", 0.9, 1.1, "--eta", 0.1, "-o", tmp_path)
    assert result.code == 0
    assert not (tmp_path / "horizons.png").exists()
    assert (tmp_path / "family.png").read_bytes().startswith(b"\x89PNG")
    plain = shell("verify", tmp_path / "certificate.json")
    rigorous = shell("verify", tmp_path / "certificate.json", "--rigorous", "--json")
    assert (plain.code, rigorous.code) == (0, 0)
    assert json.loads(rigorous.out)["verdict"] == "proven"


def test_a_range_that_holds_pi_is_refused_with_pi(shell):
    result = shell("certify", OSCILLATOR, "--gap-range", 3.0, 3.3, "--eta", 0.1)
    assert result.code == 1
    assert "3.14159" in result.err


def test_jitter_and_losses_need_a_schedule(shell, tmp_path):
    write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "even.csv")
    assert shell("certify", OSCILLATOR, tmp_path / "even.csv", "--jitter", 0.05, "--eta", 0.1).code == 0
    assert shell("certify", OSCILLATOR, tmp_path / "even.csv", "--lost", 1, 3, "--eta", 0.1).code == 0
    assert shell("certify", OSCILLATOR, "--spaced", 2, 2, 0.5, "--eta", 0.1).code == 0


def test_families_exclude_each_other_and_say_what_they_need():
    with pytest.raises(ArgumentError, match="exclude each other: certify one family at a time"):
        certify(Settings(), OSCILLATOR, gap_range=(1.0, 2.0), jitter=0.1)
    with pytest.raises(ArgumentError, match="`certify` needs a SCHEDULE file with --jitter"):
        certify(Settings(), OSCILLATOR, jitter=0.1)
    with pytest.raises(ArgumentError, match="`certify` needs no SCHEDULE file with --gap-range"):
        certify(Settings(), OSCILLATOR, OSCILLATOR, gap_range=(1.0, 2.0))
    with pytest.raises(ArgumentError, match="`certify` needs a SCHEDULE file or a family"):
        certify(Settings(), OSCILLATOR)


def test_survive_finds_a_timing_error_and_draws_it(shell, tmp_path):
    write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "even.csv")
    assert shell("certify", OSCILLATOR, tmp_path / "even.csv", "--eta", 0.8, "-o", tmp_path).code == 0
    result = shell("survive", OSCILLATOR, tmp_path / "certificate.json", "--longest", 3, "-o", tmp_path, "--budget", 20)
    assert result.code == 0
    data = json.loads((tmp_path / "survival.json").read_text())
    assert data["radius"] > 0.05
    assert (tmp_path / "survival.png").read_bytes().startswith(b"\x89PNG")


def test_sigma_and_worst_case_are_proven_in_ball_arithmetic_on_request(shell, tmp_path):
    write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "even.csv")
    for arguments in (
        ("sigma", OSCILLATOR, tmp_path / "even.csv", "--window", 3),
        ("worst-case", OSCILLATOR, "--window", 4, "--count", 3, "--spacing", 0.5),
    ):
        plain, rigorous = (json.loads(shell(*arguments, *extra, "--json").out) for extra in ((), ("--rigorous",)))
        assert rigorous["rigorous"] is True
        assert rigorous["lower"] == pytest.approx(plain["lower"], rel=1e-3)
