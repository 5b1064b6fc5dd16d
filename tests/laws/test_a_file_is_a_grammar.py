"""A changed file is refused in one sentence, or read as exactly what stands there; what it then proves is true.

One valid file of every kind; every key dropped, renamed and there twice, every value of another type and size, every
list shorter, longer and in another order, words, edges, masks, sources and targets among them (`tests/mutants.py`).
Digests are made anew, so that only the grammar and the mathematics stand between a certificate and a pass. What is read
or proven is compared by oracles that share nothing with the package.
"""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import GapRange, Jitter, LostSamples, PeriodicSchedule, Plant, Schedule, SpacedWindows
from sampling_design.accuracy.interval import Interval, state_interval
from sampling_design.accuracy.readings import BelowDetection, CompositeReading
from sampling_design.checkers import check
from sampling_design.checkers.parts import digest
from sampling_design.checkers.strict import BadFile, from_json
from sampling_design.errors import SamplingDesignError
from sampling_design.schedules.files import family_from_dict
from sampling_design.schedules.output_jitter import OutputJitter
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests import mutants
from tests.cases import few
from tests.oracles import dissipation, families, inclusions
from tests.oracles.files import facts_of_plant, facts_of_requirement, facts_of_schedule, facts_of_table, same

MOST = 150
"""Mutants of one file, drawn at random; `sweep` takes more."""
MOST_ORACLES = 6
"""Mutants of one file that are proven and state something else: so many are judged by an oracle and in balls."""

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
PARTLY = PeriodicSchedule([1.0, 0.5], 0.25, [[1, 0], [1, 1]])
TWO = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]])
FULL = Plant(
    [[-1.0, 0.5], [0.0, 0.25]],
    [[1.0, 0.0], [1.0, 2.0]],
    B=[[0.0], [1.0]],
    D=[[0.5], [0.0]],
    G=[[1.0], [3.0]],
    name="all there is",
    time_unit="h",
    states=sd.plants.Signals(("a", "b"), ("m", "K"), [1.0, 10.0]),
    outputs=sd.plants.Signals(("p", "q"), ("m", "K")),
    source="nobody",
)
DATED = {"time_unit": "h", "origin": "2026-01-05T00:00", "output_names": ("p", "q")}
REQUIREMENT = sd.Requirement(
    window=4.0,
    period=8.0,
    spacing=0.25,
    samples={"at_least": 3, "at_most": 5},
    target_sigma=0.5,
    decay_rate=0.1,
    forbidden=[[1.0, 1.5], [2.0, 2.5]],
    fixed=[0.25, 3.0],
    sensors={"p": {"available": [[0.0, 6.0]], "price": 2.0}, "q": {"price": 1.0}},
    cost_limit=30.0,
    time_unit="h",
)
UNCERTAIN = UncertainPlant(
    Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]]),
    [UncertainParameter("k", 0.9, 1.1, [[0.0, 0.0], [-1.0, 0.0]]), UncertainParameter("c", 0.9, 1.1, C=[[1.0, 0.0]])],
)
CERTIFICATES = {
    "periodic": lambda: sd.certify(TWO, PARTLY, eta=0.2, P2=np.eye(2)),
    "finite": lambda: sd.certify(OSCILLATOR, Schedule([0.5, 1.5, 3.0]), eta=0.4, P2=np.eye(2)),
    "gap range": lambda: sd.certify(OSCILLATOR, GapRange(0.9, 1.1), eta=0.2, memory=0, P2=np.eye(2)),
    "spaced windows": lambda: sd.certify(OSCILLATOR, SpacedWindows(3.0, 2, 1.0), eta=0.2, memory=1, P2=np.eye(2)),
    "lost samples": lambda: sd.certify(TWO, LostSamples(PARTLY, 1, 3), eta=0.1, memory=0, P2=np.eye(2)),
    "jitter": lambda: sd.certify(TWO, Jitter(PARTLY, 0.1), eta=0.1, memory=0, P2=np.eye(2)),
    "output jitter": lambda: sd.certify(TWO, OutputJitter(PARTLY, [0.1, 0.0], [0.0, 0.1]), eta=0.1, P2=np.eye(2)),
    "detectability": lambda: sd.certificates.certify_detectability(OSCILLATOR),
    "inclusion": lambda: certify_inclusion(UNCERTAIN, GapRange(0.5, 1.0), eta=0.1, pieces=2),
}
FAMILIES = {
    "gap range": GapRange(0.9, 1.1, time_unit="h"),
    "spaced windows": SpacedWindows(3.0, 2, 1.0, time_unit="h"),
    "lost samples": LostSamples(PeriodicSchedule([1.0, 0.5], time_unit="h"), 1, 3),
    "jitter": Jitter(PeriodicSchedule([1.0, 0.5], 0.25, [[1, 0], [1, 1]]), 0.1),
    "output jitter": OutputJitter(PeriodicSchedule([1.0, 0.5], 0.25, [[1, 0], [1, 1]]), [0.1, 0.0], [0.0, 0.1]),
}
FILES = {
    "plant.toml": (lambda p: sd.plants.write_plant(FULL, p), sd.read_plant, facts_of_plant),
    "plant.json": (lambda p: sd.plants.write_plant(FULL, p), sd.read_plant, facts_of_plant),
    "requirement.toml": (
        lambda p: sd.design.write_requirement(REQUIREMENT, p),
        sd.read_requirement,
        facts_of_requirement,
    ),
    "requirement.json": (
        lambda p: sd.design.write_requirement(REQUIREMENT, p),
        sd.read_requirement,
        facts_of_requirement,
    ),
    "finite.json": (
        lambda p: sd.schedules.write_schedule(Schedule([0.5, 1.5], [[1, 0], [1, 1]], **DATED), p),
        sd.read_schedule,
        facts_of_schedule,
    ),
    "periodic.json": (
        lambda p: sd.schedules.write_schedule(PeriodicSchedule([1.0, 0.5], 0.25, [[1, 0], [1, 1]], **DATED), p),
        sd.read_schedule,
        facts_of_schedule,
    ),
}


def drawn(whole, most, seed):
    """Mutants of a tree: label and tree."""
    every = [(path, kind) for path in mutants.places(whole) for kind in mutants.kinds(whole, path)]
    for k in np.random.default_rng(seed).permutation(len(every))[:most]:
        path, kind = every[k]
        yield f"{'.'.join(map(str, path))}: {kind}", mutants.mutant(whole, path, kind)


def sentence(error):
    """The words of a refusal, which are one line."""
    words = str(error)
    assert words
    assert "\n" not in words
    assert len(words) < 700, words
    return words


def read(reader, source):
    """What a reader makes of it; None if it refuses in one sentence."""
    try:
        return reader(source)
    except SamplingDesignError as error:
        sentence(error)
        return None


def sweep_files(kind, folder, most=MOST, seed=0):
    """Refused, or read as what stands there; return how many of each."""
    write, reader, facts = FILES[kind]
    path = Path(folder) / kind
    write(path)
    ending = path.suffix
    whole = json.loads(path.read_text()) if ending == ".json" else tomllib.loads(path.read_text())
    assert same(facts(whole), facts(reader(path)))
    found = [0, 0]
    for label, data in drawn(whole, most, seed):
        text = mutants.as_json(data) if ending == ".json" else mutants.as_toml(data)
        if text is None:
            continue
        path.write_text(text)
        record = read(reader, path)
        found[record is not None] += 1
        assert record is None or same(facts(data), facts(record)), label
    return found


def sweep_families(kind, most=MOST, seed=0):
    """The same for a family's plain data, those that only Python can hold among them."""
    whole = json.loads(json.dumps(FAMILIES[kind].to_dict()))
    found = [0, 0]
    for label, data in drawn(whole, most, seed):
        record = read(family_from_dict, data)
        found[record is not None] += 1
        assert record is None or same(facts_of_family(data), facts_of_family(record.to_dict())), label
    return found


def facts_of_family(data):
    """Numbers, and the schedule as what it says."""
    plain = {key: value for key, value in data.items() if key not in ("schedule", "time_unit")}
    schedule = facts_of_schedule(data["schedule"]) if "schedule" in data else None
    return {**plain, "unit": data.get("time_unit"), "schedule": schedule}


def sweep_certificates(kind, folder, most=MOST, seed=0, oracles=MOST_ORACLES):
    """Refused by the reader, the checker or the proof, or true; return how many ended how."""
    whole = json.loads(json.dumps(CERTIFICATES[kind]().to_dict()))
    path, found, judged = Path(folder) / "certificate.json", {}, 0
    for label, data in drawn(whole, most, seed):
        if not label.startswith("digest"):
            data["digest"] = with_digest(data)
        text = mutants.as_json(data)
        verdict = checked(text)
        if not label.startswith("digest"):
            assert verdict["inequality"] != "digest", label
        path.write_text(text)
        certificate = read(sd.read_certificate, path)
        never = "proven" if certificate is None else "bad file"
        assert verdict["verdict"] != never, (label, verdict)
        if certificate is not None:
            again = certificate.verify(budget=5.0)
            assert verdict["verdict"] != "proven" or again.verdict == "proven", label
            verdict["verdict"] = again.verdict
            assert same(stated(certificate.to_dict()), stated(data)), label
        found[verdict["verdict"]] = found.get(verdict["verdict"], 0) + 1
        if verdict["verdict"] == "proven" and not same(stated(data), stated(whole), 0.0) and judged < oracles:
            judged += 1
            assert true(data), label
            assert certificate is None or certificate.verify(rigorous=True, budget=20.0).verdict != "refuted", label
    return {**found, "judged": judged}


def with_digest(data):
    """The digest, made anew; that of data that no certificate can hold does not matter."""
    try:
        return digest(data)
    except (ValueError, TypeError):
        return "0" * 64


def checked(text):
    """The verdict of the checkers that stand alone."""
    try:
        found = check(from_json(text))
    except BadFile as error:
        found = {"verdict": "bad file", "inequality": "text", "reason": str(error)}
    sentence(found["reason"])
    return found


def stated(data):
    """What a certificate states: not who found it, how, and in how many seconds."""
    kept = {key: value for key, value in data.items() if key not in ("digest", "tool", "solver", "method", "plant")}
    times = kept.pop("times", None)
    family = times is not None and times["kind"] not in ("finite", "periodic")
    about = facts_of_family(times) if family else None if times is None else facts_of_schedule(times)
    return {**kept, "about": about, "plant": facts_of_plant(data["plant"])}


def true(data):
    """Whether what a certificate states holds where an oracle looks: 50 digits, or Riccati along schedules."""
    if data["claim"] == "detectability":
        return dissipation.holds(data)
    if data["claim"] == "inclusion":
        return inclusions.holds(data, facts_of_plant(data["plant"]))
    facts = facts_of_plant(data["plant"])
    plant = Plant(facts["A"], facts["C"], G=facts["G"])
    weights = tuple(np.array(data[key], dtype=float) for key in ("Qw", "R", "Qv"))
    P1, P2 = (np.array(data[key], dtype=float) for key in ("P1", "P2"))
    room = (1 + 1e-6) / (1 + data["margin"])
    return all(
        families.largest_ratio(plant, weights, data["eta"], P2, times, outputs, against) <= most * room
        for times, outputs in members(data)
        for against, most in ((P1, 1.0), (P2, data["lam"] * (1 + data["margin"])))
    )


def members(data):
    """Some schedules that a certificate is about, ten samples each, from the window's start."""
    times = data["times"]
    if times["kind"] in ("finite", "periodic"):
        facts = facts_of_schedule(times)
        periods = 1 if times["kind"] == "finite" else -(-10 // len(facts["times"]))
        one, mask = np.array(facts["times"]), facts["outputs"]
        yield (
            np.concatenate([one + k * (facts["period"] or 0.0) for k in range(periods)]),
            None if mask is None else np.tile(np.array(mask, bool), (periods, 1)),
        )
        return
    rng = np.random.default_rng(5)
    for _ in range(3):
        drawn_one = family_from_dict(times).draw(rng, samples=8)
        yield drawn_one.times, drawn_one.outputs


@pytest.mark.parametrize("kind", FILES)
def test_a_changed_file_is_refused_or_read_as_it_stands(kind, tmp_path):
    refused, taken = sweep_files(kind, tmp_path)
    assert min(refused, taken) > 0


@pytest.mark.parametrize("kind", FAMILIES)
def test_a_changed_family_is_refused_or_read_as_it_stands(kind):
    refused, taken = sweep_families(kind)
    assert min(refused, taken) > 0


@pytest.mark.parametrize("periodic", [False, True])
def test_a_changed_table_is_refused_or_read_as_it_stands(periodic, tmp_path):
    refused, taken = sweep_tables(periodic, tmp_path)
    assert min(refused, taken) > 0


def sweep_tables(periodic, folder, most=MOST, seed=0):
    """The same for a schedule's CSV."""
    mask = [[1, 0], [1, 1], [0, 1]]
    ends = PeriodicSchedule.from_times([0.5, 1.5, 3.0], 4.0, mask, **DATED)
    path = sd.schedules.write_schedule(
        ends if periodic else Schedule([0.5, 1.5, 3.0], mask, **DATED), Path(folder) / "s.csv"
    )
    every = list(mutants.of_table(path.read_text()))
    found = [0, 0]
    for k in np.random.default_rng(seed).permutation(len(every))[:most]:
        label, text = every[k]
        path.write_text(text)
        record = read(sd.read_schedule, path)
        found[record is not None] += 1
        assert record is None or same(facts_of_table(text), facts_of_schedule(record)), label
    return found


@pytest.mark.long
@pytest.mark.parametrize("kind", CERTIFICATES)
def test_a_changed_certificate_is_refused_or_true(kind, tmp_path):
    found = sweep_certificates(kind, tmp_path)
    assert found["bad file"] > 0
    assert found["judged"] > 0


def sweep_intervals(folder, v_bound=0.3, most=MOST, seed=0):
    """The same for an interval; what is proven is evaluated once more by what shares no line with the checker."""
    record = [
        (0.0, [1.0], [0.5]),
        (1.0, [BelowDetection(0.9)], None),
        (2.0, [CompositeReading(0.2, since=1.0)], None),
        (2.5, [0.0], None),
    ]
    plant = Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0]], B=[[0.0], [1.0]])
    path = state_interval(plant, record, w_bound=0.1, v_bound=v_bound, initial_error=[2.0, 2.0]).save(
        Path(folder) / "i.json"
    )
    whole, found = json.loads(path.read_text()), {}
    assert checked(path.read_text())["verdict"] == "proven"
    for label, data in drawn(whole, most, seed):
        if not label.startswith("digest"):
            data["digest"] = with_digest(data)
        text = mutants.as_json(data)
        verdict = checked(text)["verdict"]
        path.write_text(text)
        again = read(Interval.read, path)
        assert verdict != ("proven" if again is None else "bad file"), label
        found[verdict] = found.get(verdict, 0) + 1
        if verdict == "proven" and again.disproof is not None:
            least = {which: (1 - 1e-4) * factor for which, factor in again.disproof.factors.items()}
            assert replace(again.disproof, factors=least).verify(), label
        elif verdict == "proven":
            wide = replace(again, lower=again.lower - 1e-4 * again.radii, upper=again.upper + 1e-4 * again.radii)
            assert wide.verify(), label
    return found


@pytest.mark.parametrize("v_bound", [0.3, 1e-9])
def test_what_was_read_of_an_interval_is_written_as_it_stood(v_bound, tmp_path):
    record = [(0.5, [0.1, 0.2], None), (1.3, [np.nan, 0.3], None), (2.0, [0.2, np.nan], None)]
    found = state_interval(TWO, record, w_bound=0.1, v_bound=v_bound, initial_error=2.0)
    assert (found.disproof is None) == (v_bound > 1e-3)
    first = found.save(tmp_path / "first.json")
    assert Interval.read(first).save(tmp_path / "again.json").read_text() == first.read_text()


@pytest.mark.parametrize("v_bound", few([0.3, 1e-9], 0))
def test_a_changed_interval_is_refused_or_true(v_bound, tmp_path):
    found = sweep_intervals(tmp_path, v_bound)
    assert min(found.get(how, 0) for how in ("bad file", "refuted", "proven")) > 0


@pytest.mark.parametrize("factor", [100.0, None])
@pytest.mark.parametrize("which", ["all", "w", "v"])
def test_gains_of_zero_contradict_nothing(which, factor):
    """They spend none of any bound and gain nothing: 0 >= 100 times 0 is no contradiction of data that fit."""
    found = state_interval(OSCILLATOR, [(0.5, [0.1], None)], w_bound=0.1, v_bound=0.3, initial_error=2.0)
    forged = found._sealed() | {"lower": [None, None], "upper": [None, None]}
    factors = dict.fromkeys(("all", "w", "v"), 0.0) | {"all": 1.0 + 1e-9, which: factor}
    forged["disproof"] = {"factors": factors, "gains": {key: [0.0] for key in factors}}
    assert checked(json.dumps(forged | {"digest": with_digest(forged)}))["verdict"] == "undecided"


@pytest.mark.parametrize("bounds", [(0.0, 0.0, 0.0), (0.0, 0.01, 0.01), (0.01, 0.0, 0.01)])
def test_a_bound_of_zero_never_suffices_however_often_it_is_taken(bounds, tmp_path):
    record = [(0.5, [0.1], None), (1.3, [9.2], None), (1.5, [-90.0], None)]
    given = dict(zip(("w_bound", "v_bound", "initial_error"), bounds, strict=True))
    path = state_interval(OSCILLATOR, record, **given).save(tmp_path / "i.json")
    again = Interval.read(path)
    assert again.disproof.factors["v" if bounds[0] else "w"] == np.inf
    assert again.verify()
    assert again.verify(rigorous=True)
    assert again.save(tmp_path / "again.json").read_text() == path.read_text()
