"""plan: from one file to a plan, its files and its picture."""

import json
import math
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.cli.estimate import ErrorBoundArguments, known_bounds
from sampling_design.cli.plan import _now, plan
from sampling_design.cli.plan import next_sample as next_command
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError
from sampling_design.planning.plan_record import Plan
from sampling_design.planning.search import PlanSearch
from tests.cases import few

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = """format = "sampling-design/plan-requirement/1"
period = 6.4
grid = 0.8
w_bound = 0.02
initial_error = 0.05
[accuracy]
position = 0.5
[sensors.position]
noise_bound = 0.2
"""


@pytest.mark.parametrize(("complete", "code"), [(True, 1), (False, 3)])
def test_what_is_not_proven_within_the_budget_is_not_what_cannot_be_kept(shell, tmp_path, monkeypatch, complete, code):
    asked, made = (
        [],
        sd.PlanRequirement({"x": 0.52}, period=8, grid=4, w_bound=0.1, sensors={"y1": {"noise_bound": 0.1}}),
    )
    plant = sd.Plant([[0.0]], [[1.0]], states=["x"])
    found = sd.plan_samples(plant, made, certificate=False, robustness=False, from_start=False)
    found.save(tmp_path / "plan.json")
    nothing = replace(sd.next_sample(found, now=1.0), latest=-np.inf, kept_from=np.inf, proven=False, complete=complete)
    monkeypatch.setattr(sd, "next_sample", lambda *_, budget, **__: asked.append(budget) or nothing)
    assert shell("next", tmp_path / "plan.json", "--budget", 0.5, "--json").code == code
    assert asked == [0.5]


@pytest.mark.long
def test_a_plan_becomes_files_that_other_commands_take(shell, tmp_path):
    (tmp_path / "wanted.toml").write_text(SMALL)
    out = tmp_path / "out"
    brief = ("--search-seconds", 1)
    result = shell("plan", EXAMPLES / "plants" / "oscillator.toml", tmp_path / "wanted.toml", "-o", out, *brief)
    assert result.code == 0
    assert "keep position within" in " ".join(result.out.split())
    data = json.loads((out / "plan.json").read_text())
    assert data["format"] == "sampling-design/plan/1"
    assert data["reached"][0] <= 0.5
    assert f"Next: sampling-design next {out / 'plan.json'}" in result.out
    assert f"Next: sampling-design estimate {out / 'plan.json'} MEASUREMENTS.csv -o {out}" in result.out
    assert (out / "plan.png").read_bytes().startswith(b"\x89PNG")
    assert shell("accuracy", out / "plant.toml", out / "schedule.csv", "--w", "0.02", "--v", "0.2").code == 0
    plan_file = tmp_path / "out" / "plan.json"
    result = shell("next", plan_file, "--now", "0.5", "-o", tmp_path / "out")
    assert result.code == 0
    assert "Next sample at " in result.out
    assert json.loads((tmp_path / "out" / "next.json").read_text())["proven"]
    other = ("-o", tmp_path / "b", "--compare", plan_file, *brief)
    again = shell("plan", tmp_path / "out" / "plant.toml", tmp_path / "wanted.toml", *other)
    assert "Both cost the same" in " ".join(again.out.split())
    assert (tmp_path / "b" / "comparison.png").read_bytes().startswith(b"\x89PNG")
    assert set(json.loads((tmp_path / "b" / "comparison.json").read_text())) >= {"before", "now"}
    wrong = shell("next", plan_file, "--now", "tomorrow")
    assert wrong.code == 2
    with pytest.raises(ArgumentError, match="`--now` must be a number of"):
        next_command(Settings("next"), plan_file, now="tomorrow")


def test_a_requirement_without_a_plant_needs_one(shell, tmp_path):
    (tmp_path / "wanted.toml").write_text(SMALL)
    result = shell("plan", tmp_path / "wanted.toml")
    assert result.code == 2
    assert "`PLANT` is missing" in result.err
    assert "Did you mean" not in result.err
    (tmp_path / "plant.toml").write_text("")
    near = f"Did you mean {tmp_path / 'plant.toml'} {tmp_path / 'wanted.toml'}?"
    assert near in shell("plan", tmp_path / "wanted.toml").err
    with pytest.raises(ArgumentError, match="is a requirement that holds no plant"):
        plan(Settings("plan"), tmp_path / "wanted.toml")


def test_an_interrupt_writes_the_files_of_what_the_search_holds(shell, tmp_path, monkeypatch):
    keep = PlanSearch.keep

    def kept(search, chosen, worst):
        keep(search, chosen, worst)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(PlanSearch, "keep", kept)
    (tmp_path / "wanted.toml").write_text(SMALL)
    before = signal.getsignal(signal.SIGINT)
    result = shell("plan", EXAMPLES / "plants" / "oscillator.toml", tmp_path / "wanted.toml", "-o", tmp_path / "out")
    signal.signal(signal.SIGINT, before)
    assert result.code == 130
    assert "certificate.json is not written: interrupted." in " ".join(result.err.split())
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["status"] == "interrupted"
    assert (tmp_path / "out" / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_a_plan_without_dates_takes_no_date():
    undated = SimpleNamespace(requirement=SimpleNamespace(calendar=None), plant=SimpleNamespace(time_unit="s"))
    undated.elapsed = lambda *asked: Plan.elapsed(undated, *asked)
    with pytest.raises(ArgumentError, match="`--now` must be a number of s, got 'tomorrow'"):
        _now(Settings("next"), undated, "tomorrow")


def test_a_date_is_read_in_all_its_forms(capsys):
    place = sd.schedules.OpeningCalendar("2026-03-23", "Europe/Berlin")
    dated = SimpleNamespace(requirement=SimpleNamespace(calendar=place), minutes=lambda t: 60 * t)
    dated.elapsed = lambda *asked: Plan.elapsed(dated, *asked)
    for text in ("2026-03-30T08:00", "2026-03-30T08:00+02:00", "2026-03-30T07:00[Europe/London]", "175"):
        assert _now(Settings("next"), dated, text) == 7 * 24 + 7
    assert capsys.readouterr().err.count("Dates without a zone") == 1


@pytest.fixture(scope="module")
def small_plan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    outputs = ["position", "speed"]
    plant = sd.Plant([[0, 1], [-1, 0]], np.eye(2), time_unit="s", states=outputs, outputs=outputs)
    sd.plants.write_plant(plant, folder / "plant.toml")
    terms = {name: {"noise_bound": 0.2} for name in outputs}
    wanted = sd.PlanRequirement({"position": 0.6}, period=6.4, grid=0.8, w_bound=0.02, sensors=terms, initial_error=1.5)
    plan = sd.plan_samples(plant, wanted, search_seconds=2.0, certificate=False, robustness=False, from_start=False)
    rows = "".join(f"{t!r},{math.cos(t)!r},{-math.sin(t)!r}\n" for t in plan.schedule.between(0.1, 14.0).times.tolist())
    (folder / "measured.csv").write_text(f"time,position,speed\n{rows}")
    return plan, plan.save(folder / "plan.json"), folder / "measured.csv"


def test_a_plan_is_certified_with_its_samples_and_bounds_whatever_its_file_is_called(shell, small_plan, tmp_path):
    plan, file, _ = small_plan
    renamed = shutil.copy(file, tmp_path / "mine.txt")
    sd.plants.write_plant(plan.plant, tmp_path / "plant.toml")
    sd.schedules.write_schedule(plan.schedule, tmp_path / "schedule.csv")
    apart = [tmp_path / "plant.toml", tmp_path / "schedule.csv", "--w", 0.02, "--v", "0.2,0.2", "--initial-error", 1.5]
    alone, typed = shell("certify", renamed, "--certificate", tmp_path / "c.json"), shell("certify", *apart, "--json")
    found, same = json.loads((tmp_path / "c.json").read_text()), json.loads(typed.out)
    assert all(found[key] == same[key] for key in ("eta", "lam", "P2", "Qw", "R"))
    assert "--v-bound not given: that of the plan" in alone.err
    said = "It is about the plan's samples at their times, none lost: --timing-tolerance and --lost allow for more."
    assert said in " ".join(alone.out.split())
    late = " ".join(shell("certify", renamed, "--timing-tolerance", 0.1).out.split())
    assert "early or late" in late
    assert said not in late


@pytest.mark.parametrize("place", few(["plant", "schedule", "both"], 2))
def test_a_plan_stands_for_plant_schedule_and_bounds(shell, small_plan, place):
    plan, file, measured = small_plan
    first = file.with_name("plant.toml") if place == "schedule" else file
    beside = () if place == "plant" else ("--plan", file)
    found = shell("estimate", first, measured, *beside, "--initial-error", "1", "--json")
    assert found.code == 0
    heard = " ".join(found.err.split())
    assert "--w-bound not given: that of the plan, 0.02, is used." in heard
    assert "--v-bound not given: that of the plan, [0.2, 0.2], is used." in heard
    assert "--initial-error not given" not in heard
    assert json.loads(found.out)["guarantee"] == "The guarantee is for the schedule given."
    bounds = {**plan.error_bounds, "initial_error": 1.0}
    certificate = sd.certify(plan.plant, plan.schedule, eta=1 / plan.schedule.d_max, **bounds)
    own = sd.MovingHorizonEstimator(plan.plant, certificate, **bounds)
    assert json.loads(found.out)["x"] == own.run(sd.read_measurements(measured, plan.plant)).to_dict()["x"]


def test_rows_of_a_plan_have_its_bounds_on_disturbance_and_noise(shell, small_plan):
    """`--of` takes another part of the state; what disturbs and what is read are the same signals."""
    _, file, measured = small_plan
    asked = ("estimate", file, measured, "--of", "position", "--initial-error", "1", "--json")
    found = shell(*asked)
    assert "--w-bound not given: that of the plan, 0.02, is used." in " ".join(found.err.split())
    assert "--v-bound not given: that of the plan" in " ".join(found.err.split())
    typed = shell(*asked, "--w", "0.02", "--v", "0.2,0.2")
    assert json.loads(found.out)["radii"] == json.loads(typed.out)["radii"]


@pytest.mark.parametrize("command", ["estimate", "certify", "accuracy"])
def test_a_plan_of_another_plant_brings_the_bounds_of_signals_that_both_have(shell, small_plan, command):
    plan, file, measured = small_plan
    outputs = plan.plant.outputs.names
    slower = sd.Plant([[0, 1], [-0.9, 0]], np.eye(2), time_unit="s", states=outputs, outputs=outputs)
    other = sd.plants.write_plant(slower, file.with_name("slower.toml"))
    words = (command, other, *((measured, "--schedule", file) if command == "estimate" else (file,)))
    typed = ("--w-bound", "0.02", "--v-bound", "speed=0.2,position=0.2", "--initial-error", "1.5")
    typed = typed[:4] if command == "accuracy" else typed
    found, same = shell(*words, "--json"), shell(*words, *typed, "--json")
    assert found.code == same.code < 2
    whose = "that of the plan, [0.2, 0.2], is used, which is for another plant: its A[1, 0] is -1.0, not -0.9."
    assert f"--v-bound not given: {whose}" in " ".join(found.err.split())
    both = [json.loads(each.out) for each in (found, same)]
    assert [data.get(key) for key in ("Qv", "radii", "upper") for data in both[:1]] == [
        data.get(key) for key in ("Qv", "radii", "upper") for data in both[1:]
    ]


def test_a_command_proves_the_plan_of_its_file_once(shell, small_plan, tmp_path, monkeypatch):
    """It is asked for the plant, the schedule and the bounds; what is changed meanwhile is read anew."""
    (plan, file, measured), proofs = small_plan, []
    monkeypatch.setattr("sampling_design.planning.files.proven_plan", lambda *_: proofs.append(1) or plan)
    for place, words in enumerate((("accuracy",), ("compare", measured))):
        copy = tmp_path / f"{place}.json"
        copy.write_text(file.read_text())
        assert shell(words[0], copy, *words[1:]).code == 0
        assert len(proofs) == place + 1
    copy.write_text(file.read_text().replace('"cost": ', '"cost": 9'))
    assert "`cost` is 9" in shell("compare", copy, measured).err


@pytest.mark.parametrize("command", ["estimate", "validate", "certify", "accuracy"])
def test_a_plan_brings_no_bounds_of_signals_that_a_plant_has_not(shell, small_plan, command):
    plan, file, measured = small_plan
    other = sd.Plant([[0, 1], [-1, 0]], np.eye(2), time_unit="s", outputs=["position", "pace"])
    written = sd.plants.write_plant(other, file.with_name("pace.toml"))
    words = (written, measured, "--schedule", file) if command == "estimate" else (written, file)
    found = shell(command, *words, "--w", 0.02)
    assert found.code == 2
    assert "`--v-bound` is missing, and the plan is for another plant: " in " ".join(found.err.split())
    untyped = ErrorBoundArguments(w_bound=None, v_bound=None, initial_error=None)
    with pytest.raises(ArgumentError, match="is missing, and the plan is for another plant"):
        known_bounds(Settings(command), other, other, untyped, plan)
    minutes = sd.Plant(60 * other.A, np.eye(2), G=60 * np.eye(2), time_unit="min", outputs=plan.plant.outputs.names)
    with pytest.raises(ArgumentError, match="`--w-bound` is missing, and the plan is for another plant"):
        known_bounds(Settings(command), minutes, minutes, untyped, plan)


def test_an_accuracy_without_bounds_says_which_are_missing_of_a_plan_too(shell, small_plan, tmp_path):
    plan, file, _ = small_plan
    found = shell("accuracy", file.with_name("plant.toml"), file.with_name("plan.json"), "--json")
    assert found.code == 0
    assert json.loads(found.out)["upper"] == json.loads(shell("accuracy", file, "--json").out)["upper"]
    sd.schedules.write_schedule(plan.schedule, tmp_path / "schedule.csv")
    alone = shell("accuracy", file.with_name("plant.toml"), tmp_path / "schedule.csv", "--w", "0.02")
    assert alone.code == 2
    assert "`--v-bound` is missing: without a bound on position, speed" in " ".join(alone.err.split())


def test_what_contradicts_a_plan_says_which_bound_was_not_given(shell, small_plan):
    _, file, measured = small_plan
    far = measured.with_name("far.csv")
    far.write_text("time,position,speed\n0.5,90,0\n1.0,-90,0\n")
    found = shell("estimate", file, far)
    assert found.code == 1
    assert "Bounds that were not given" not in found.err
    again = shell("estimate", file.with_name("plant.toml"), far, "--v", "0.2,0.2")
    assert again.code == 1
    assert "Bounds that were not given" in again.err


def test_a_plan_is_a_schedule_for_other_commands(shell, small_plan):
    plan, file, _ = small_plan
    found = shell("sigma", file, file, "--window", "6.4", "--json")
    assert json.loads(found.out)["lower"] == sd.window_sigma(plan.plant, plan.schedule, 6.4).lower
    wrong = shell("robustness", file, file)
    assert wrong.code == 2
    assert "The certificate of a plan is in certificate.json, written beside it." in " ".join(wrong.err.split())


def test_scales_in_place_of_bounds_are_called_so(shell, tmp_path):
    """Readings of 90 contradict a noise of typical size 1: no bound was given, and nothing is made of it."""
    (tmp_path / "y.csv").write_text("time,position,force_per_mass\n0.5,90,0\n1.0,-90,0\n1.7,90,0\n")
    found = shell("estimate", EXAMPLES / "plants" / "oscillator.toml", tmp_path / "y.csv")
    heard = " ".join(found.err.split())
    assert found.code == 1
    assert "--v-bound not given: the plant's scales [1] are used, typical sizes in place of bounds." in heard
    assert "Bounds that were not given are the plant's scales, typical sizes that data may well exceed" in heard


def test_a_plan_without_a_bound_says_so(small_plan):
    plan, *_ = small_plan
    bare = replace(plan, bound=replace(plan.bound, ratio=None, cost=None))
    assert str(plan).count("could be gained") == 1
    assert "proven: what the plan keeps, and what none beats, by trajectories" in str(plan)
    assert "proven: what the plan keeps\n" in str(bare)
    assert "of the tolerances; nobody has bounded how much could be gained" in str(bare)


@pytest.mark.parametrize("month", ["03", "07"])
def test_estimates_of_a_dated_plan_have_dates_of_its_zone(shell, tmp_path, month):
    """In winter and in summer a date without offset is one of the plan's zone, not of its first day's offset."""
    plant = sd.Plant([[-0.01]], [[1.0]], time_unit="h", states=["level"], outputs=["lab"])
    wanted = sd.PlanRequirement(
        {"level": 2.0}, period="1 d", grid="6 h", w_bound=0.05, sensors={"lab": {"noise_bound": 0.5}},
        calendar={"start": "2026-03-02", "zone": "Europe/Berlin"},
    )  # fmt: skip
    plan = sd.plan_samples(plant, wanted, search_seconds=1.0, certificate=False, robustness=False, from_start=False)
    file = plan.save(tmp_path / "plan.json")
    naive, said = tmp_path / "naive.csv", tmp_path / "said.csv"
    offset = "+02:00" if month == "07" else "+01:00"
    naive.write_text(f"date,lab\n2026-{month}-10 08:10,1.0\n2026-{month}-11 08:05,0.9\n")
    said.write_text(f"date,lab\n2026-{month}-10 08:10{offset},1.0\n2026-{month}-11 08:05{offset},0.9\n")
    first, second = (shell("estimate", file, each, "--initial-error", "9") for each in (naive, said))
    assert "Dates without a zone are read in Europe/Berlin." in first.err
    assert first.out == second.out
    assert f"Last estimate, at 2026-{month}-11 08:05{offset}" in " ".join(first.out.split())
    folder = shell("estimate", tmp_path, naive)
    assert folder.code == 2
    assert "plan.json?" in " ".join(folder.err.split())


@pytest.mark.parametrize("start", ["2026-03-28", "2026-10-24"])
def test_samples_on_the_dates_of_a_plan_are_on_time_after_a_change_of_clocks(shell, tmp_path, start):
    plant = sd.Plant([[-0.02]], [[1.0]], time_unit="h", states=["level"], outputs=["probe"])
    wanted = sd.PlanRequirement(
        {"level": 2.0}, period=48.0, grid=8.0, w_bound=0.02, sensors={"probe": {"noise_bound": 0.1}},
        calendar={"start": start, "zone": "Europe/Berlin"},
    )  # fmt: skip
    plan = sd.plan_samples(plant, wanted, search_seconds=1.0, certificate=False, robustness=False)
    folder = plan.save(tmp_path / "out")
    head, *lines = (folder / "form.csv").read_text().splitlines()
    local = [f"{line.split(',')[0][:16]},1.0" for line in lines]  # as it is typed: without an offset
    (tmp_path / "filled.csv").write_text("\n".join([head, *local, "2026-12-01T12:00,1.0"]))
    for planned in ("plan.json", "dates.csv"):
        found = json.loads(
            shell("compare", folder / "plan.json", folder / planned, tmp_path / "filled.csv", "--json").out
        )
        assert found["deviations"][: len(local)] == [0.0] * len(local)
    said = shell("compare", folder / "plan.json", folder / "dates.csv", tmp_path / "filled.csv").out
    assert "1 at 2026-12-01 12:00+01:00" in said
    assert "nothing is claimed; the times" in said  # every mode decays
    alone, twice = (shell("compare", *[folder / "plan.json"] * k, tmp_path / "filled.csv") for k in (1, 2))
    assert (alone.code, alone.out) == (0, twice.out)
    missing = shell("compare", folder / "plant.toml", folder / "dates.csv")
    assert missing.code == 2
    assert "`MEASUREMENTS` is missing: give it last, after PLANT and SCHEDULE or after a plan." in missing.err
