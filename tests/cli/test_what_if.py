"""worst-case, pareto and losses: what if the schedule were another one."""

import json
from pathlib import Path

import pytest

import sampling_design as sd
from sampling_design.design.pareto import ParetoFront, ParetoPoint

EXAMPLES = Path(__file__).parents[2] / "examples"
OSCILLATOR = EXAMPLES / "plants" / "oscillator.toml"


def test_worst_case_brackets_sigma_and_draws_it(shell, tmp_path):
    result = shell("worst-case", OSCILLATOR, "--window", 4, "--count", 3, "--spacing", 0.5, "-o", tmp_path)
    assert result.code == 0
    data = json.loads((tmp_path / "worst_case.json").read_text())
    assert data["lower"] <= 0.349882 <= data["upper"] + 1e-6
    assert (tmp_path / "worst_case.png").read_bytes().startswith(b"\x89PNG")


def test_worst_case_takes_a_tolerance_of_each_output(shell, tmp_path):
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0], [0.0, 0.5]], outputs=["near", "far"])
    sd.plants.write_plant(plant, tmp_path / "plant.toml")
    rule = "worst-case", tmp_path / "plant.toml", "--window", 4, "--count", 3, "--spacing", 0.5, "--timing-tolerance"
    asked = sd.worst_case_sigma(plant, sd.SpacedWindows(4.0, 3, 0.5), timing_tolerance={"far": (0.0, 0.2)})
    told = shell(*rule, "far=0:0.2")
    assert "as planned; each output on time (near), up to 0.2 s late (far), over windows of 4.2 s" in asked.explain()
    assert asked.explain() in " ".join(told.out.split())
    assert "reading at `.readings` attains `upper`" in str(asked)
    data = json.loads(shell(*rule, "far=0:0.2", "--json").out)
    assert (data["lower"], data["timing_tolerance"]) == (asked.lower, {"near": 0.0, "far": [0.0, 0.2]})
    assert data["readings"] == asked.readings.tolist()
    late = shell(*rule, "far=0.3")
    assert late.code == 2
    assert "samples could change places" in late.err


def test_worst_case_of_too_few_samples_is_a_no(shell):
    assert shell("worst-case", OSCILLATOR, "--window", 4, "--count", 1, "--spacing", 0.5).code == 1


def test_infeasible_spacing_says_what_fits(shell):
    result = shell("worst-case", OSCILLATOR, "--window", 4, "--count", 9, "--spacing", 1)
    assert result.code == 1
    assert "What fits" in result.err


def test_worst_case_of_a_decaying_plant_needs_no_samples(shell):
    plant = EXAMPLES / "plants" / "three_compartment.toml"
    result = shell("worst-case", plant, "--window", 4, "--count", 3, "--spacing", 0.5)
    assert result.code == 0
    assert "--decay-rate" in result.out


def test_pareto_draws_and_resumes(shell, tmp_path):
    arguments = ("pareto", OSCILLATOR, "--counts", "2", "-o", tmp_path)
    first = shell(*arguments)
    assert first.code == 0
    kept = json.loads((tmp_path / "pareto.json").read_text())
    assert [p["samples"] for p in kept["points"]] == [2]
    assert (tmp_path / "pareto.png").exists()
    again = json.loads(shell("pareto", OSCILLATOR, "--counts", "2-3", "-o", tmp_path, "--json").out)
    assert again["points"][:1] == kept["points"]
    assert len(again["points"]) == 2


def test_a_clock_ends_pareto_only_where_it_is_asked_to(shell, monkeypatch):
    """What ends by the clock depends on how many share the work."""
    given = []

    def asked(plant, requirement, counts, *, budget, **rest):
        given.append(budget)
        return ParetoFront((ParetoPoint(2, 1.0, 1.0, (0.0, 1.0)),))

    monkeypatch.setattr(sd, "pareto_front", asked)
    assert shell("pareto", OSCILLATOR, "--counts", "2").code == 0
    assert shell("pareto", OSCILLATOR, "--counts", "2", "--budget", "7").code == 0
    assert given == [None, 7.0]
    refused = shell("pareto", OSCILLATOR, "--counts", "2", "--budget", "-1")
    assert (refused.code, "budget` must be" in refused.err) == (2, True)


@pytest.mark.parametrize("counts", ["", "a", "3-", "2-b"])
def test_counts_that_are_none_are_refused(shell, counts):
    result = shell("pareto", OSCILLATOR, "--counts", counts)
    assert result.code == 2
    assert "`--counts` must" in result.err


def test_losses_say_what_each_sample_is_worth(shell, tmp_path):
    requirement = EXAMPLES / "requirements" / "oscillator.toml"
    result = shell("losses", OSCILLATOR, requirement, "--every-period", "--seed", 1, "-o", tmp_path)
    assert result.code == 0
    data = json.loads((tmp_path / "losses.json").read_text())
    assert data["every_period"] is True
    assert len(data["without"]) == 4
    assert all(0 < row["lower"] <= row["bound"] < data["sigma"] for row in data["without"])
    assert (tmp_path / "losses.png").read_bytes().startswith(b"\x89PNG")


def test_losses_of_a_decaying_plant_need_no_samples(shell):
    result = shell("losses", EXAMPLES / "plants" / "three_compartment.toml")
    assert result.code == 0
    assert "--decay-rate" in result.out
