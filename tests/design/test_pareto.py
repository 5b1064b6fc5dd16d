"""Samples against sigma: grows with the count, resumes from its file, runs on any executor."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sampling_design import Plant, Requirement, pareto_front
from sampling_design.checkers.parts import digest
from sampling_design.design.pareto import NO_TIME
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.records.record import below

PLANT = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
REQUIREMENT = Requirement(window=4.0, spacing=0.7)
OPTIONS = {"starts": 2, "branches": 0}


@pytest.fixture(scope="module")
def resumed(tmp_path_factory):
    path = tmp_path_factory.mktemp("pareto") / "front.json"
    pareto_front(PLANT, REQUIREMENT, [3], resume=path, **OPTIONS)
    return path


def test_sigma_grows_with_the_count_and_impossible_counts_say_why():
    front = pareto_front(PLANT, REQUIREMENT, [5, 2, 3, 6, 1], **OPTIONS)
    assert [p.samples for p in front.points] == [1, 2, 3, 5, 6]
    assert "`samples` 1 per period" in front.points[0].obstacle
    assert "room for 5 samples" in front.points[-1].obstacle
    sigmas = [p.sigma for p in front.efficient]
    assert [p.samples for p in front.efficient] == [2, 3, 5]
    assert sigmas == sorted(sigmas)
    assert all(p.sigma <= p.upper_bound for p in front.points)
    assert "From 2 to 5 samples" in front.explain()
    assert "3 samples" in str(front)
    left = front.points[2].deviations
    assert left.lost < left.late < left.late_wider < front.points[2].sigma
    assert f"{left.tolerance.describe('s')}: {below(left.late)}; one lost: {below(left.lost)}" in str(front)
    assert f"If one sample is lost, sigma is at least {below(front.efficient[-1].deviations.lost)}." in front.explain()


def test_a_file_is_resumed_and_not_designed_again(tmp_path):
    path = tmp_path / "front.json"
    alone = pareto_front(PLANT, REQUIREMENT, [3], resume=path, **OPTIONS)
    assert alone.coordinates == alone.points[0].coordinates == "physical"
    assert "sigma refers to" in str(alone)
    assert alone.explain().startswith(f"3 samples per period: sigma {below(alone.points[0].sigma)}. If ")
    data = json.loads(path.read_text())
    data["points"][0]["sigma"] = 0.123  # a mark: a point that is designed again would lose it
    path.write_text(json.dumps({**data, "digest": digest(data)}))
    messages = []
    front = pareto_front(
        PLANT, REQUIREMENT, [3, 4], resume=path, progress=lambda f, m: messages.append((f, m)), **OPTIONS
    )
    assert front.points[0].sigma == 0.123
    assert front.points[0].deviations.to_dict() == data["points"][0]["deviations"]
    assert front.points[1].sigma > 0.5
    assert len(messages) == 1
    assert len(json.loads(path.read_text())["points"]) == 2


def test_what_needs_no_samples_and_what_was_not_designed_have_no_finite_bound(tmp_path):
    decaying, wanted, path = Plant([[-1.0]], [[1.0]]), REQUIREMENT.replace(decay_rate=0.5), tmp_path / "front.json"
    for _ in range(2):  # the second time from the file
        front = pareto_front(decaying, wanted, [2, 3], resume=path)
        assert [(p.sigma, p.upper_bound) for p in front] == [(np.inf, np.inf)] * 2
        assert front.explain() == "No samples needed."
    (late,) = pareto_front(PLANT, REQUIREMENT, [3], budget=1e-9)
    assert (late.sigma, late.upper_bound, late.obstacle) == (0.0, np.inf, NO_TIME)


def test_a_file_of_another_requirement_is_refused(tmp_path):
    path = tmp_path / "front.json"
    pareto_front(PLANT, REQUIREMENT, [3], resume=path, **OPTIONS)
    with pytest.raises(FileFormatError, match="belongs to another plant, requirement, option or version"):
        pareto_front(PLANT, REQUIREMENT.replace(spacing=0.6), [3], resume=path, **OPTIONS)
    path.write_text('{"format": "other"}')
    with pytest.raises(FileFormatError, match="`format` must be 'sampling-design/pareto/1'"):
        pareto_front(PLANT, REQUIREMENT, [3], resume=path, **OPTIONS)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data.pop("points"), "`points` must be a list, got nothing"),
        (lambda data: data["points"].append(3), r"`points\[1\]` must be a table of keys and values"),
        (lambda data: data["points"][0].pop("sigma"), r"`sigma` is missing in `points\[0\]`"),
        (lambda data: data["points"][0].update(upper_bound=-1.0), r"`points\[0\].upper_bound` must not be negative"),
        (lambda data: data["points"][0].update(times=None), r"`points\[0\].times` must be a list"),
        (lambda data: data["points"][0]["deviations"].pop("late"), "`late` is missing"),
        (
            lambda data: data["points"][0]["deviations"].update(lost_sample=0.5),
            "deviations.lost_sample` must be a whole",
        ),
        (
            lambda data: data["points"][0]["deviations"].update(tolerance=[0.1]),
            "deviations.tolerance` must have a length",
        ),
        (lambda data: data["points"][0].update(sigma=data["points"][0]["sigma"] * 1.01), "was changed since"),
        (lambda data: data["points"][0].update(samples=4), "was changed since"),
        (lambda data: data.pop("digest"), "was changed since"),
    ],
)
def test_a_changed_file_is_refused_in_one_sentence(resumed, change, said):
    data = json.loads(resumed.read_text())
    change(data)
    changed = resumed.with_name("changed.json")
    changed.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match=said):
        pareto_front(PLANT, REQUIREMENT, [3], resume=changed, **OPTIONS)


@pytest.mark.long
def test_executors_and_backends_give_the_same_front():
    plain = pareto_front(PLANT, REQUIREMENT, [2, 3], **OPTIONS)
    with ThreadPoolExecutor(2) as pool:
        assert pareto_front(PLANT, REQUIREMENT, [2, 3], workers=pool, **OPTIONS).points == plain.points
    assert pareto_front(PLANT, REQUIREMENT, [2, 3], workers="threading", **OPTIONS).points == plain.points
    assert pareto_front(PLANT, REQUIREMENT, [2, 3], workers=1, **OPTIONS).points == plain.points


def test_bad_arguments_are_named():
    with pytest.raises(ArgumentError, match="`counts` must be at most 1000 numbers of samples, got more"):
        pareto_front(PLANT, REQUIREMENT, range(1, 10**12))
    with pytest.raises(ArgumentError, match="`counts` must hold at least one"):
        pareto_front(PLANT, REQUIREMENT, [])
    with pytest.raises(ArgumentError, match=r"`workers` must be a concurrent\.futures\.Executor or a Dask client or"):
        pareto_front(PLANT, REQUIREMENT, [3], workers=2.5)
