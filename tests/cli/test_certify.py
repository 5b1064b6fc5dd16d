"""certify and verify: a certificate is written, checked, and refused once it is touched."""

import json
import shutil
from pathlib import Path

import pytest

import sampling_design as sd
from sampling_design import PeriodicSchedule, read_certificate, read_plant
from sampling_design.certificates.detectability.best_rate import certify_detectability
from sampling_design.cli import files
from sampling_design.cli.certify import certify
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError
from sampling_design.schedules.files import write_schedule

EXAMPLES = Path(__file__).parents[2] / "examples"
OSCILLATOR = EXAMPLES / "plants" / "oscillator.toml"


MADE = []
"""What `certify` said once, and the folder that it wrote then."""


@pytest.fixture
def certified(shell, tmp_path, tmp_path_factory):
    """What it said, and a copy of its folder that a test may spoil."""
    if not MADE:
        folder = tmp_path_factory.mktemp("certified")
        write_schedule(PeriodicSchedule([0.7, 1.6, 0.9], time_unit="s"), folder / "schedule.csv")
        MADE.append((shell("certify", OSCILLATOR, folder / "schedule.csv", "--horizons", "-o", folder), folder))
    said, folder = MADE[0]
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    return said, tmp_path


def test_certify_prints_four_horizons_and_writes_everything(certified):
    result, folder = certified
    assert result.code == 0
    for word in ("paper's constants", "exact, improved", "true contraction", "C_w", "Next: sampling-design verify "):
        assert word in result.out
    assert {"certificate.json", "horizons.png", "constants.md", "constants.tex"} <= {p.name for p in folder.iterdir()}
    assert "| exact, improved |" in (folder / "constants.md").read_text()


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
    from sampling_design.checkers.parts import digest

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
    assert shell("certify", OSCILLATOR, tmp_path / "even.csv", "--timing-tolerance", "0:0.1", "--eta", 0.1).code == 0
    assert shell("certify", OSCILLATOR, tmp_path / "even.csv", "--lost", 1, 3, "--eta", 0.1).code == 0
    assert shell("certify", OSCILLATOR, "--spaced", 2, 2, 0.5, "--eta", 0.1).code == 0


def test_a_tolerance_is_typed_as_one_number_two_or_by_output(shell, tmp_path):
    write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "even.csv")
    windows = ("sigma", OSCILLATOR, tmp_path / "even.csv", "--window", 4, "--json", "--timing-tolerance")
    found = [json.loads(shell(*windows, said).out) for said in ("0.1", "0:0.2", "position=0:0.2")]
    assert found[0]["lower"] == pytest.approx(found[1]["lower"], rel=1e-9)
    assert found[0]["lower"] == pytest.approx(found[2]["lower"], rel=1e-6)
    assert [said["timing_tolerance"] for said in found] == [0.1, [0.0, 0.2], {"position": [0.0, 0.2]}]
    known = ("accuracy", OSCILLATOR, tmp_path / "even.csv", "--w", 0.02, "--v", 0.4, "--rtol", 0.5, "--json")
    assert json.loads(shell(*known, "--timing-tolerance", "0:0.2").out)["timing_tolerance"] == [0.0, 0.2]
    rule = ("worst-case", OSCILLATOR, "--window", 4, "--count", 3, "--spacing", 0.5, "--json", "--timing-tolerance")
    late = json.loads(shell(*rule, "0.1:0.05").out)  # the rule is that of what is planned
    assert (late["family"]["window"], late["timing_tolerance"]) == (4.0, [0.1, 0.05])
    refused = shell(*windows, "ten")
    assert refused.code == 2
    assert """`--timing-tolerance` must be a time like 0.25 or "15 min", got 'ten'""" in refused.err
    with_units = json.loads(shell(*windows, "0 : 200 ms").out)
    assert (with_units["lower"], with_units["timing_tolerance"]) == (found[1]["lower"], [0.0, 0.2])


def test_families_exclude_each_other_and_say_what_they_need():
    with pytest.raises(ArgumentError, match="exclude each other: certify one family at a time"):
        certify(Settings(), OSCILLATOR, gap_range=(1.0, 2.0), timing_tolerance=0.1)
    with pytest.raises(ArgumentError, match=r"`SCHEDULE` is missing: give its file, or a plan .* for PLANT\."):
        certify(Settings(), OSCILLATOR, timing_tolerance=0.1)
    with pytest.raises(ArgumentError, match="`certify` needs no SCHEDULE file with --gap-range"):
        certify(Settings(), OSCILLATOR, OSCILLATOR, gap_range=(1.0, 2.0))
    with pytest.raises(ArgumentError, match=r"`SCHEDULE` is missing: .*, or a family such as --gap-range"):
        certify(Settings(), OSCILLATOR)
    with pytest.raises(ArgumentError, match="`--horizons` compares those of one SCHEDULE: it goes without a family"):
        certify(Settings(), OSCILLATOR, gap_range=(1.0, 2.0), horizons=True)


def test_a_certificate_is_made_and_no_horizon_is_compared_unless_asked(shell, tmp_path, monkeypatch):
    monkeypatch.setattr(sd.certificates, "four_horizons", None)
    write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "even.csv")
    told = shell("certify", OSCILLATOR, tmp_path / "even.csv", "--eta", 0.1, "-o", tmp_path)
    assert told.code == 0
    assert (tmp_path / "certificate.png").read_bytes().startswith(b"\x89PNG")
    assert not (tmp_path / "horizons.png").exists()


def test_robustness_finds_a_timing_error_and_draws_it(shell, tmp_path):
    write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "even.csv")
    assert shell("certify", OSCILLATOR, tmp_path / "even.csv", "--eta", 0.8, "-o", tmp_path).code == 0
    result = shell(
        "robustness", OSCILLATOR, tmp_path / "certificate.json", "--longest", 2, "-o", tmp_path, "--budget", 20
    )
    assert result.code == 0
    data = json.loads((tmp_path / "robustness.json").read_text())
    assert data["radius"] > 0.05
    assert (tmp_path / "robustness.png").read_bytes().startswith(b"\x89PNG")


def test_sigma_and_worst_case_are_proven_in_ball_arithmetic_on_request(shell, tmp_path):
    write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "even.csv")
    for arguments in (
        ("sigma", OSCILLATOR, tmp_path / "even.csv", "--window", 3),
        ("worst-case", OSCILLATOR, "--window", 4, "--count", 3, "--spacing", 0.5),
    ):
        plain, rigorous = (json.loads(shell(*arguments, *extra, "--json").out) for extra in ((), ("--rigorous",)))
        assert rigorous["rigorous"] is True
        assert rigorous["lower"] == pytest.approx(plain["lower"], rel=1e-3)


def test_detectability_is_certified_without_a_schedule_and_verified(shell, tmp_path):
    file = tmp_path / "detectability.json"
    result = shell("certify", OSCILLATOR, "--detectability", "-o", tmp_path, "--certificate", file)
    assert result.code == 0
    assert "come together" in result.out
    assert "DetectabilityCertificate" in result.out
    assert (tmp_path / "certificate.json").read_bytes() == file.read_bytes()
    plant = read_plant(OSCILLATOR)
    assert read_certificate(file, plant).to_dict() == certify_detectability(plant).to_dict()
    plain = shell("verify", file, "--plant", OSCILLATOR)
    assert plain.code == 0
    assert "Proven: P > 0 and [[A'P + PA" in plain.out
    rigorous = shell("verify", file, "--rigorous", "--json")
    assert (rigorous.code, json.loads(rigorous.out)["verdict"]) == (0, "proven")
    other = shell("verify", file, "--plant", EXAMPLES / "plants" / "double_integrator.toml")
    assert other.code == 1
    assert "another plant" in other.err


def test_detectability_has_weights_of_its_own(shell):
    refused = shell("certify", OSCILLATOR, "--detectability", "--v-bound", "0.1")
    assert refused.code == 2
    assert "`--detectability` has weights of its own and goes without bounds" in refused.err


def test_rate_and_noise_budget_of_detectability_are_those_asked_for(shell):
    found = {
        arguments: json.loads(shell("certify", OSCILLATOR, "--detectability", "--json", *arguments).out)
        for arguments in (("--eta", 0.5), (), ("--noise-gain", 5))
    }
    assert found["--eta", 0.5]["eta"] == 0.5
    assert found["--noise-gain", 5]["eta"] < found[()]["eta"]
    assert found["--noise-gain", 5]["c_w"] == pytest.approx(found[()]["c_w"] / 2)


def test_a_false_detectability_file_is_a_no_with_direction(shell, tmp_path):
    from sampling_design.checkers.parts import digest

    shell("certify", OSCILLATOR, "--detectability", "-o", tmp_path)
    data = json.loads((tmp_path / "certificate.json").read_text())
    data["c_w"] *= 0.99
    data["digest"] = digest(data)
    (tmp_path / "false.json").write_text(json.dumps(data))
    for flags in ((), ("--rigorous",)):
        result = shell("verify", tmp_path / "false.json", *flags)
        assert result.code == 1
        assert "fails by" in " ".join(result.out.split())
        assert "direction" in result.out


def test_an_undetectable_plant_is_refused_with_its_mode(shell, tmp_path):
    (tmp_path / "blind.toml").write_text(
        'format = "sampling-design/plant/1"\ntime_unit = "s"\n[matrices]\nA = [[0.2]]\nC = [[0.0]]\n'
    )
    result = shell("certify", tmp_path / "blind.toml", "--detectability")
    assert result.code == 1
    assert "Not detectable: no output observes" in result.err
    assert "0.2" in result.err


def test_detectability_goes_without_schedules(shell, tmp_path):
    write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "even.csv")
    result = shell("certify", OSCILLATOR, tmp_path / "even.csv", "--detectability")
    assert result.code == 2
    assert result.err == (
        "sampling-design: `--detectability` is about the plant alone and goes without a SCHEDULE file.\n"
    )
    for family in ({"gap_range": (1.0, 2.0)}, {"spaced": (2.0, 2, 0.5)}, {"timing_tolerance": "0.1"}, {"lost": (1, 3)}):
        flag = next(iter(family)).replace("_", "-")
        with pytest.raises(ArgumentError, match=f"is about the plant alone and goes without `--{flag}`"):
            certify(Settings(), OSCILLATOR, detectability=True, **family)


def test_commands_that_need_samples_refuse_a_detectability_file(shell, tmp_path):
    shell("certify", OSCILLATOR, "--detectability", "-o", tmp_path)
    write_schedule(PeriodicSchedule([1.0], time_unit="s"), tmp_path / "even.csv")
    (tmp_path / "seen.csv").write_text("time,position,force_per_mass\n0.5,1.0,0\n1.5,0.2,0\n")
    file = tmp_path / "certificate.json"
    for arguments in (
        ("estimate", OSCILLATOR, tmp_path / "seen.csv", "--certificate", file),
        ("validate", OSCILLATOR, tmp_path / "even.csv", "--certificate", file),
        ("robustness", OSCILLATOR, file),
    ):
        result = shell(*arguments, "--quiet")
        assert result.code == 2, arguments
        assert "proves that the plant is detectable, which promises nothing about samples" in result.err
        assert result.err.count("\n") == 1
    with pytest.raises(ArgumentError, match="which promises nothing about samples: make one with"):
        files.sampling_certificate(file, read_plant(OSCILLATOR))


@pytest.mark.parametrize(("flag", "name"), [("--eta", "--eta"), ("--noise-gain", "--noise-gain")])
def test_numbers_of_detectability_are_refused_by_the_name_that_was_typed(shell, flag, name):
    result = shell("certify", OSCILLATOR, "--detectability", flag, -1)
    assert result.code == 2
    assert f"`{name}` must be positive, got -1.0" in result.err
