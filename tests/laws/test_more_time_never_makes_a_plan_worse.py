"""However long a search goes on, its plan costs no more than any choice that it held before and that is proven."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import UndecidedError
from sampling_design.planning import plan as room
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import FeasibleChoices, ProvenChoice
from sampling_design.planning.search import PlanSearch
from sampling_design.records.budget import Budget

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"], outputs=["y"])
GIVEN = {"period": 6.4, "grid": 0.4, "w_bound": 0.02, "sensors": {"y": {"noise_bound": 0.2}}}
WANTED = sd.PlanRequirement({"position": 0.33, "velocity": 0.36}, **GIVEN)
BARE = {"certificate": False, "robustness": False, "from_start": False}


def posed():
    return pose_plan(OSCILLATOR, WANTED)


def drawn(rng, problem, count):
    """Choices in the order of a search: each with fewer samples than the one before."""
    found = []
    for samples in np.sort(rng.choice(np.arange(2, problem.steps), count, replace=False))[::-1]:
        found.append(np.zeros((problem.steps, 1), dtype=bool))
        found[-1][rng.choice(problem.steps, samples, replace=False)] = True
    return found


def told(chosen, worst):
    """A proof that says so much."""
    return ProvenChoice(chosen, (None, None), np.array([worst]))


def judged_by(weights, asked):
    """A proof that gains from every sample more, and the number of proofs that were asked for."""
    return lambda chosen: told(chosen, asked / max(float(weights @ chosen[:, 0]), 1e-9))


@pytest.mark.parametrize("seed", range(20))
def test_a_longer_search_is_never_dearer_whatever_the_proofs_say(seed):
    rng, problem = np.random.default_rng(seed), posed()
    held, everything = drawn(rng, problem, 6), np.ones((problem.steps, 1), dtype=bool)
    weights = rng.exponential(size=problem.steps)
    prove = judged_by(weights, weights.sum() * rng.uniform(0.1, 0.9))
    costs = []
    for moment in range(len(held) + 1):
        best = FeasibleChoices(problem, Budget(counted=True), prove).cheapest(held[:moment], everything)
        assert best.worst <= 1
        costs.append(problem.cost(best.chosen))
    assert costs == sorted(costs, reverse=True)


def test_without_any_work_left_what_was_proven_is_kept():
    problem, spent = posed(), Budget(0.0, counted=True)
    spent.add((1.0, 0.0), 0.0)
    held = drawn(np.random.default_rng(3), problem, 5)
    good = held[1].tobytes()
    asked = []

    def prove(chosen):
        asked.append(chosen.tobytes())
        return told(chosen, 0.9 if asked[-1] == good else 1.1)

    best = FeasibleChoices(problem, spent, prove).cheapest(held, np.ones((problem.steps, 1), dtype=bool))
    assert best.chosen.tobytes() == good
    assert len(asked) == len(set(asked)) == 4  # the three cheaper ones first, and nothing is made of them
    with pytest.raises(UndecidedError, match=r"the densest one is proven to keep 1.1 times them"):
        FeasibleChoices(problem, spent, prove).cheapest(held[2:], np.ones((problem.steps, 1), dtype=bool))


def test_of_equal_costs_only_what_may_be_better_is_proven():
    problem, asked = posed(), []
    first, same, better = drawn(np.random.default_rng(5), problem, 3)
    proven = {first.tobytes(): 0.8, better.tobytes(): 0.7}

    def prove(chosen):
        asked.append(chosen.tobytes())
        return told(chosen, proven[asked[-1]])

    held = FeasibleChoices(problem, Budget(counted=True), prove)
    found = held.sharpest([(same, 0.85), (better, 0.69)], held.proven(first))
    assert found.chosen.tobytes() == better.tobytes()
    assert asked == [first.tobytes(), better.tobytes()]


@pytest.mark.long
def test_a_proof_that_fails_late_gives_back_what_was_held_before(monkeypatch):
    keep, proof, held = PlanSearch.keep, room._Planning._proven, []

    def kept(search, chosen, worst):
        if np.isinf(search.problem.most_samples):
            held.append(chosen)
        keep(search, chosen, worst)

    def late(self, chosen):
        early = chosen.sum() == 5 and chosen.tobytes() == held[0].tobytes()
        return proof(self, chosen) if early else told(chosen, 1.1)

    monkeypatch.setattr(PlanSearch, "keep", kept)
    monkeypatch.setattr(room._Planning, "_proven", late)
    monkeypatch.setattr(room._Planning, "_needs_longer_past", lambda self, found: False)
    monkeypatch.setattr(room, "MARGINS", (room.MARGIN,))
    found = sd.plan_samples(OSCILLATOR, WANTED, search_seconds=0.6, **BARE)
    assert int(held[-1].sum()) == 4  # cheaper, and not proven
    assert found.samples == 5
    assert found.keeps
    assert found.status == "budget"
