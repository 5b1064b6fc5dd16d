"""Every verb and command that takes a budget in seconds ends within 1.5 times it plus 2 s, with what it has.

The verbs are found by their signatures and the commands by their options, so that a new one is not forgotten. The
clock is made of what is done: a machine's speed and load change nothing.
"""

import contextlib
import functools
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.search import GainSearch
from sampling_design.cli import app
from sampling_design.errors import FileFormatError
from sampling_design.planning.figures import accuracy_of
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.search_progress import AFTER
from sampling_design.records.budget import ENDLESS, Budget
from tests import command_lines
from tests.cases import few
from tests.counted_clock import Counted
from tests.front_door import public

BUDGETS = (0.03,)


def allowed(budget: float) -> float:
    return 1.5 * budget + 2.0


def chain(oscillators: int) -> sd.Plant:
    """Oscillators with frequencies of no common measure, all behind one output: as hard as it is large."""
    A = np.zeros((2 * oscillators, 2 * oscillators))
    for k in range(oscillators):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = np.sqrt(k + 2.0) * np.array([[0.0, 1.0], [-1.0, 0.0]])
    return sd.Plant(A, np.tile([[1.0, 0.0]], oscillators))


HARD = chain(3)
OSCILLATOR = chain(1)
EASY = sd.PeriodicSchedule(np.linspace(0.35, 1.1, 24))
MANY = sd.UncertainPlant(chain(2), [sd.UncertainParameter(f"k{i}", -0.2, 0.2, A=np.eye(4, k=-i)) for i in (1, 2, 3)])
LARGE = sd.Requirement(window=24.0, period=24.0, spacing=0.05, samples=16)


def seconds_verbs() -> set[str]:
    """Public callables with a parameter `budget` whose documentation says seconds."""
    found = set()
    for name, thing in public().items():
        members = {name: thing}
        if inspect.isclass(thing):
            members = {
                f"{name}.{k}": v for k, v in vars(thing).items() if not k.startswith("_") and inspect.isfunction(v)
            }
        for label, member in members.items():
            if inspect.isfunction(member) and "budget" in inspect.signature(member).parameters:
                told = re.search(r"\n\s*budget : [^\n]*\n(?:\s+[^\n]*\n)?", inspect.getdoc(member) or "")
                inherited = re.search(r"budget.*?second", (inspect.getdoc(member) or "").lower(), re.DOTALL)
                if (told and "second" in told.group().lower()) or (inherited and not told):
                    found.add(label)
    return found


@functools.cache
def designed():
    return sd.design_schedule(HARD, LARGE, starts=1, branches=0, budget=0.1)


@functools.cache
def certificate():
    return sd.certify(OSCILLATOR, sd.PeriodicSchedule([0.7, 0.9]), eta=0.4, P2=np.eye(2))


@functools.cache
def uneven():
    return sd.certify(OSCILLATOR, EASY, eta=0.3, P2=np.eye(2))


@functools.cache
def compared():
    return uneven(), sd.certificates.constants_from_proof(OSCILLATOR, EASY)


@functools.cache
def family():
    return sd.certify(OSCILLATOR, sd.GapRange(0.5, 1.5), eta=0.2, P2=np.eye(2))


@functools.cache
def detectable():
    return sd.certificates.certify_detectability(HARD)


@functools.cache
def planned():
    plant = sd.Plant([[0.0]], [[1.0]], time_unit="s", states=["level"], outputs=["y"])
    terms = {"y": {"noise_bound": 0.1}}
    wanted = sd.PlanRequirement({"level": 0.52}, period=8.0, grid=1.0, w_bound=0.1, sensors=terms)
    return sd.plan_samples(plant, wanted, search_seconds=0.1, certificate=False, robustness=False, from_start=False)


VERBS = {
    "window_sigma": lambda b: sd.window_sigma(HARD, EASY, 300.0, rtol=1e-9, budget=b),
    "worst_case_sigma": lambda b: sd.worst_case_sigma(HARD, sd.SpacedWindows(20.0, 12, 0.5), rtol=1e-9, budget=b),
    "design_schedule": lambda b: sd.design_schedule(HARD, LARGE, branches=10**6, budget=b),
    "design_and_losses": lambda b: sd.design.design_and_losses(HARD, LARGE, budget=b),
    "pareto_front": lambda b: sd.pareto_front(HARD, LARGE, range(16, 21), budget=b),
    "certify": lambda b: sd.certify(HARD, EASY, budget=b),
    "certify_inclusion": lambda b: sd.uncertain.certify_inclusion(MANY, sd.GapRange(0.4, 0.6), eta=0.1, budget=b),
    "certify of a family": lambda b: sd.certify(OSCILLATOR, sd.GapRange(0.05, 1.5), budget=b),
    "find_counterexample": lambda b: sd.certificates.find_counterexample(HARD, sd.GapRange(0.5, 40.0), 0.1, budget=b),
    "sample_losses": lambda b: sd.design.sample_losses(designed(), budget=b / 4),
    "guaranteed_accuracy": lambda b: sd.guaranteed_accuracy(
        HARD, sd.PeriodicSchedule([0.9, 1.4, 1.1, 0.8]), w_bound=0.1, v_bound=0.1, rtol=1e-6, budget=b
    ),
    "accuracy_by_count": lambda b: sd.accuracy.accuracy_by_count(
        HARD, (4, 5), period=4.2, w_bound=0.1, v_bound=0.1, rtol=1e-6, budget=b
    ),
    "accuracy_limit": lambda b: sd.accuracy.accuracy_limit(OSCILLATOR, w_bound=1e-3, v_bound=0.1, rtol=1e-4, budget=b),
    "check_detectability": lambda b: sd.nonlinear.check_detectability(
        sd.nonlinear.from_linear(OSCILLATOR),
        EASY,
        ([-1, -1], [1, 1]),
        cost=sd.CostFunction(eta=0.1),
        duration=9.0,
        pairs=10**6,
        budget=b,
    ),
    "compare_schedule": lambda b: sd.compare_schedule(HARD, EASY, EASY.between(0, 600.0).times, 100.0, budget=b),
    "largest_box": lambda b: sd.uncertain.largest_box(
        MANY, EASY, window=40.0, rtol=1e-9, budget=b / 16
    ),  # its steps are long
    "four_horizons": lambda b: sd.certificates.four_horizons(OSCILLATOR, EASY, *compared(), budget=b),
    "least_contracting": lambda b: sd.certificates.least_contracting(uneven(), budget=b),
    "certificate_exists": lambda b: sd.certificate_exists(MANY, EASY, 0.4, budget=b),
    "longest_gap": lambda b: sd.uncertain.longest_gap(MANY, eta=0.1, most=1.0, budget=b),
    "robustness": lambda b: sd.robustness(OSCILLATOR, certificate(), longest=8, budget=b),
    "next_sample": lambda b: sd.next_sample(planned(), budget=b),
    "Certificate.verify": lambda b: certificate().verify(rigorous=True, budget=b),
    "FamilyCertificate.verify": lambda b: family().verify(rigorous=True, budget=b),
    "DetectabilityCertificate.verify": lambda b: detectable().verify(rigorous=True, budget=b),
    "SampledCertificate.verify": lambda b: certificate().verify(rigorous=True, budget=b),
}
PREPARED = {
    "next_sample": planned,
    "sample_losses": designed,
    "robustness": certificate,
    "four_horizons": compared,
    "least_contracting": uneven,
    "Certificate.verify": certificate,
    "FamilyCertificate.verify": family,
    "SampledCertificate.verify": certificate,
    "DetectabilityCertificate.verify": detectable,
}
"""What is made once, before the budget of a call begins."""


def spent(call) -> float:
    with Counted().running() as clock, contextlib.suppress(sd.SamplingDesignError):  # "undecided" is an answer
        call()
    return clock.read()


def test_one_clock_is_read_in_one_place():
    """`records/budget.py` reads it, so that a test replaces one name; whoever measures asks a `Budget` or `now()`."""
    reads = re.compile(r"from time import|\btime\.(perf_counter|monotonic|process_time|thread_time|time)(_ns)?\b")
    root = Path(sd.__file__).parent
    found = [str(path.relative_to(root)) for path in root.rglob("*.py") if reads.search(path.read_text())]
    assert found == ["records/budget.py"]


def test_no_verb_with_a_budget_is_forgotten():
    assert seconds_verbs() <= set(VERBS)


@pytest.mark.parametrize("name", few(sorted(VERBS), *(k for k in range(len(VERBS)) if k not in (12, 15, 21))))
@pytest.mark.parametrize("budget", BUDGETS)
def test_a_verb_ends_with_its_budget(name, budget):
    PREPARED.get(name, dict)()
    assert spent(lambda: VERBS[name](budget)) <= allowed(budget)


TANK = sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["gauge"])
LEVELS = sd.PlanRequirement({"level": 0.52}, period=8.0, grid=1.0, w_bound=0.1, sensors={"gauge": {"noise_bound": 0.1}})


TIGHT = ((0.1, 0.0), (0.2, 0.0), (0.5, 0.0))
"""Nothing beyond shares of the search's seconds: the level of a tank needs less than two seconds for everything."""


@pytest.mark.parametrize("tight", [False, True])
def test_a_plan_ends_with_its_work_and_says_what_did_not_fit(tight, monkeypatch, tmp_path):
    """Its seconds are counted: so is all that follows the search, and a piece that does not fit in is left out."""
    works, extend, seconds = [], Budget.extend, 0.05 if tight else 0.4

    def noted(work, *limit, **how):
        works.append(work)
        extend(work, *limit, **how)

    monkeypatch.setattr(Budget, "extend", noted)
    monkeypatch.setattr("sampling_design.planning.plan.AFTER", TIGHT if tight else AFTER)
    found = sd.plan_samples(TANK, LEVELS, search_seconds=seconds)
    assert 0 < works[-1].spent <= allowed(seconds) - 2 * tight
    assert found.keeps
    missing = {name for name in ("certificate", "robustness", "start") if getattr(found, name) is None}
    assert missing == set(found.left_out) - {"bound"} == ({"certificate", "robustness", "start"} if tight else set())
    assert ("left out" in str(found)) == ("Left out: " in found.explain()) == tight
    path = found.save(tmp_path / "plan.json")
    again = sd.read_plan(path)
    assert again.left_out == found.left_out
    assert ("left out" in str(found.compare(again))) == tight
    if tight:
        path.write_text(path.read_text().replace('"start"\n', '"a clock"\n', 1))
        with pytest.raises(FileFormatError, match="left_out"):
            sd.read_plan(path)


def asked_of(size):
    """A plant of three states, and goals of such a size."""
    plant = sd.Plant([[-0.3, 1.0, 0.2], [-1.0, -0.2, 0.4], [0.1, 0.3, -0.1]], [[1.0, 0.0, 0.5]])
    terms = {"period": 4.0, "grid": 1.0, "w_bound": 0.01, "sensors": {"y1": {"noise_bound": 0.1}}}
    return plant, sd.PlanRequirement({"x1": size, "x3": size}, **terms)


@functools.cache
def densest():
    problem = pose_plan(*asked_of(1.0))
    return accuracy_of(problem, problem.allowed)


@pytest.mark.parametrize(("size", "keeps"), [(1.02, False), (4.0, True)])
def test_a_plan_says_what_was_proven_when_its_work_was_spent(size, keeps, monkeypatch):
    """Goals as what is proven of all that may be measured, so much larger: what a proof that is cut says by then."""
    works, extend, seconds = [], Budget.extend, 0.02
    monkeypatch.setattr(Budget, "extend", lambda work, *limit, **how: (works.append(work), extend(work, *limit, **how)))
    monkeypatch.setattr("sampling_design.planning.plan.AFTER", ((0.0, 0.0), *TIGHT[1:]))
    found = sd.plan_samples(*asked_of(size * float(densest().upper.max())), search_seconds=seconds)
    assert works[0].spent <= 3 * seconds + 0.05  # a few programs for each goal
    assert found.status == "budget"
    assert found.keeps == (found.ratio <= 1) == keeps
    assert found.samples == 4
    assert not found.accuracy.closed.all()
    assert (found.reached >= densest().lower).all()
    assert set(found.left_out) >= {"certificate", *(("robustness", "start") if keeps else ())}
    assert found.verify()


@pytest.mark.parametrize("seconds", [0.1, None])
def test_an_interrupt_in_the_proof_of_a_plan_ends_it_and_nothing_else(seconds, monkeypatch):
    def rung(search, found):
        monkeypatch.undo()
        raise KeyboardInterrupt

    monkeypatch.setattr(GainSearch, "profile", rung)
    found = sd.plan_samples(TANK, LEVELS, search_seconds=seconds)
    assert found.status == "interrupted"
    assert found.keeps
    assert set(found.left_out) == {"bound", "certificate", "robustness", "start"}
    assert not ENDLESS.over


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A hard plant and what belongs to it."""
    place = tmp_path_factory.mktemp("budget")
    sd.plants.write_plant(HARD, place / "plant.toml")
    sd.plants.write_plant(OSCILLATOR, place / "oscillator.toml")
    sd.design.write_requirement(LARGE, place / "requirement.toml")
    sd.schedules.write_schedule(sd.PeriodicSchedule(EASY.gaps, time_unit="s"), place / "schedule.csv")
    certificate().save(place / "certificate.json")
    planned().save(place / "plan.json")
    record = sd.simulate_record(HARD, EASY, 200.0).measurements
    sd.estimators.write_measurements(record, place / "measurements.csv")
    return place


COMMANDS = {
    "design": ["design", "plant.toml", "requirement.toml", "--branches", "1000000"],
    "sigma": ["sigma", "plant.toml", "schedule.csv", "--window", "300"],
    "certify": ["certify", "oscillator.toml", "schedule.csv"],
    "worst-case": ["worst-case", "plant.toml", "--window", "20", "--count", "12", "--spacing", "0.5", "--rtol", "1e-9"],
    "pareto": ["pareto", "plant.toml", "requirement.toml", "--counts", "16-20"],
    "losses": ["losses", "plant.toml", "requirement.toml"],
    "robustness": ["robustness", "oscillator.toml", "certificate.json"],
    "next": ["next", "plan.json"],
    "verify": ["verify", "certificate.json", "--rigorous"],
    "accuracy": ["accuracy", "oscillator.toml", "schedule.csv", "--w", "0.1", "--v", "0.1", "--rtol", "1e-6"],
    "compare": ["compare", "plant.toml", "schedule.csv", "measurements.csv", "--window", "100"],
}


def commands_with_a_budget() -> set[str]:
    return {name for name in app.COMMANDS if "budget" in {p.name for p in app.loaded(name).params}}


def test_no_command_with_a_budget_is_forgotten():
    assert commands_with_a_budget() == set(COMMANDS)


@pytest.mark.parametrize("name", few(sorted(COMMANDS), 1, 6, 7, 8, 9))
def test_a_command_ends_with_its_budget(name, files, monkeypatch):
    monkeypatch.chdir(files)
    (budget,) = BUDGETS
    with Counted().running() as clock:
        ended = command_lines.run([*COMMANDS[name], "--budget", str(budget), "--quiet"])
    assert clock.read() <= allowed(budget)
    assert ended.raw() == ""
    assert ended.code in (0, 1, 3)


def test_what_follows_a_certificate_has_the_rest_of_the_seconds(files, monkeypatch):
    """The comparison of horizons took a minute on a schedule whose certificate took a third of a second."""
    made = uneven()
    monkeypatch.chdir(files)
    monkeypatch.setattr(sd, "certify", lambda *plain, **named: made)
    with Counted().running() as clock:
        ended = command_lines.run(["certify", "oscillator.toml", "schedule.csv", "--horizons", "--budget", "0.02"])
    assert clock.read() <= allowed(0.4) + 2.0
    assert ended.code == 0
    assert "not every length was tried within" in " ".join(ended.out.split())
