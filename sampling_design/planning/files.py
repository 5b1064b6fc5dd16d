"""Plan files: what was asked, when to measure, and the evidence of the bounds; accuracy is worked out anew."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.files import certificate_from_dict
from sampling_design.checkers.parts import time_unit
from sampling_design.checkers.strict import (
    Reader,
    Tree,
    anything,
    count,
    flag,
    list_of,
    matrix,
    nonnegative,
    number,
    or_nothing,
    positive,
    refuse,
    table,
    word,
)
from sampling_design.planning.discrete_plant import DiscretePlant, discretize
from sampling_design.planning.evidence import CostProof, CostTree, PlanBound, trajectory_of
from sampling_design.planning.figures import LEFT_OUT, LOST, PlanRobustness, PlanStart
from sampling_design.planning.plan_record import FORMAT, Plan, same_samples
from sampling_design.planning.problem import SAME_PRICE, PlanProblem, pose_plan
from sampling_design.planning.proven_choice import proven_plan
from sampling_design.planning.requirement_file import plan_requirement_from_dict
from sampling_design.plants.files import plant_from_dict
from sampling_design.plants.functional import is_about
from sampling_design.records.arrays import freeze
from sampling_design.records.file_io import from_json, read_text, usable
from sampling_design.records.signatures import checked
from sampling_design.schedules.files import schedule_from_dict

SAME = 1e-3  # figures in a file may differ from those worked out anew by this share: solvers of other machines
MOST_PARTS = 64  # steps of a trajectory in one of the grid, at most
MOST_TREE = 10_000  # nodes of a tree of proofs that a file may hold: more takes minutes to check

_TRAJECTORY = table(
    {"goal": count, "end": count, "at_sample": flag, "reach": positive},
    {
        "knots": list_of(count),
        "states": matrix(),
        "w": matrix(),
        "parts": count,
        "point": list_of(list_of(nonnegative, 3)),
    },
)
_RESPONSE = ("knots", "states", "w")
_NODE = table({}, {"variable": count, "multipliers": list_of(list_of(number, 2))})
_PROOF = table({"level": positive, "value": number, "rows": list_of(list_of(count, 2)), "tree": list_of(_NODE)})
_ROBUSTNESS = table(
    {
        "time_unit": time_unit,
        **dict.fromkeys(("times", "late", "step", "late_ratio"), list_of(nonnegative)),
        "lost": count,
        "lost_ratio": list_of(or_nothing(nonnegative)),
    }
)
_START = table(
    {"time_unit": time_unit, **dict.fromkeys(("from_time", "ratio"), or_nothing(nonnegative)), "bounded": flag}
)
_TREE: Reader = table(
    {
        "format": word(FORMAT),
        "status": word("complete", "budget", "interrupted"),
        "plant": anything,
        "requirement": anything,
        "schedule": anything,
        "reached": list_of(nonnegative),
        "cost": number,
        "ratio": nonnegative,
        "trajectories": list_of(_TRAJECTORY),
        "no_better_than": or_nothing(_PROOF),
        "no_cheaper_than": or_nothing(_PROOF),
    },
    {
        "certificate": anything,
        "robustness": or_nothing(_ROBUSTNESS),
        "start": or_nothing(_START),
        "left_out": list_of(word(*LEFT_OUT)),
    },
    whole="the plan",
)


@checked
def read_plan(path: str | os.PathLike[str]) -> Plan:
    """Read a plan; what it guarantees is worked out anew, so that a file never says more than can be proven.

    Parameters
    ----------
    path : path

    Returns
    -------
    Plan
        Its bounds are as in the file: `verify()` works them out. So is its `status`, the search's own word, which
        nothing proves: what no plan can beat is said by the bounds.

    Raises
    ------
    FileFormatError
        If the file is missing, cut off, of another format, or contradicts itself: better figures than its own schedule
        gives, a schedule that begins, counts or reads in another way than its requirement and plant, `left_out` what it
        holds.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from sampling_design import Plant, PlanRequirement, plan_samples
    >>> plant, gauge = Plant([[0.0]], [[1.0]], time_unit="h"), {"y1": {"noise_bound": 0.1}}
    >>> wanted = PlanRequirement({"x1": 0.4}, period=2.0, grid=1.0, w_bound=0.1, sensors=gauge)
    >>> plan = plan_samples(plant, wanted, certificate=False, robustness=False, from_start=False)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found = read_plan(pathlib.Path(plan.save(folder)) / "plan.json")
    >>> found.cost, found.keeps
    (1.0, True)
    """
    where = os.fspath(path)
    data = from_json(read_text(where), where)
    with usable(where):
        tree = _TREE(data, "")
        plant = plant_from_dict(tree["plant"], f"{where}: plant")
        requirement = plan_requirement_from_dict(tree["requirement"], f"{where}: requirement")
        schedule = schedule_from_dict(tree["schedule"])
        if not schedule.endless:
            raise refuse("schedule", "must be periodic")
        problem = pose_plan(plant, requirement)
        chosen = problem.chosen(schedule)
        if not problem.is_admissible(chosen):
            raise refuse("schedule", "does not keep the hours, spacings or limits of the requirement")
        bound = _bound(problem, discretize(problem), tree)
        found = proven_plan(problem, chosen, bound, tree["status"])
        if schedule.origin not in (None, found.schedule.origin):
            raise refuse("schedule.origin", f"is {schedule.origin!r} where the calendar begins at another time")
        for key, mine in (("reached", found.reached), ("cost", found.cost), ("ratio", found.ratio)):
            given, share = np.asarray(tree[key]), SAME_PRICE if key == "cost" else SAME
            least = np.asarray(mine) * (1 - share)
            most = np.asarray(mine) * (1 + share) if key == "cost" else np.inf  # accuracy may be proven better by now
            if given.shape != least.shape or not np.all((given >= least) & (given <= most)):
                raise refuse(
                    key, f"is {given.tolist()!r:.40} where the schedule gives {np.asarray(mine).tolist()!r:.40}"
                )
        whole = replace(
            found,
            certificate=_certificate(tree.get("certificate"), found),
            robustness=_robustness(tree.get("robustness"), found),
            left_out=tuple(tree.get("left_out", ())),
            start=_start(tree.get("start")),
        )
        held = {"bound": bound.ratio, **{key: getattr(whole, key) for key in LEFT_OUT if key != "bound"}}
        for key in whole.left_out:
            if held[key] is not None:
                raise refuse("left_out", f'names "{key}", which the file holds')
        return whole


def _certificate(data: object, found: Plan) -> Certificate | None:
    if data is None:
        return None
    if not isinstance(data, dict):
        raise refuse("certificate", "must be a table of keys and values")
    certificate = certificate_from_dict(data, "certificate")
    if not isinstance(certificate, Certificate) or not is_about(certificate.plant, found.plant):
        raise refuse("certificate", "is of another plant, or of no schedule")
    if not same_samples(certificate.schedule, found.schedule):
        raise refuse("certificate", "is of another schedule")
    return certificate


def _start(data: Tree | None) -> PlanStart | None:
    if data is None:
        return None
    never = {key: np.inf for key in ("from_time", "ratio") if data[key] is None}
    return PlanStart(**{**data, **never})


def _robustness(data: Tree | None, found: Plan) -> PlanRobustness | None:
    if data is None:
        return None
    arrays = {}
    for key in ("times", "late", "step", "late_ratio", "lost_ratio"):
        arrays[key] = freeze(np.array([np.inf if x is None else x for x in data[key]], dtype=float))
        if arrays[key].size != found.samples:
            raise refuse(f"robustness.{key}", f"must have {found.samples} entries, one for each sample")
    if data["lost"] >= len(LOST):
        raise refuse("robustness.lost", f"must be 0 to {len(LOST) - 1}")
    return PlanRobustness(time_unit=data["time_unit"], lost=data["lost"], **arrays)


def _bound(problem: PlanProblem, discrete: DiscretePlant, tree: Tree) -> PlanBound:
    trajectories = tree["trajectories"]
    for k, trajectory in enumerate(trajectories):
        own = [key for key in (*_RESPONSE, "point") if key in trajectory]
        if own not in ([*_RESPONSE], ["point"]) or trajectory["goal"] >= len(problem.goals):
            raise refuse(
                f"trajectories[{k}]", "must be a trajectory (knots, states, w) or a tangent (point), of a goal"
            )
        if "point" in trajectory:
            cells = trajectory["point"]
            inside = all(a % 1 == b % 1 == 0 and a < problem.steps and b < len(problem.v_bound) for a, b, _ in cells)
            if (
                not inside
                or any(share > 1 for _, _, share in cells)
                or not problem.goals[trajectory["goal"]].stochastic
            ):
                raise refuse(
                    f"trajectories[{k}]", "touches beside the grid and its sensors, or is of a goal that is guaranteed"
                )
            continue
        knots, steps, q = trajectory["knots"], len(trajectory["w"]), discrete.G.shape[1]
        rising = all(a < b for a, b in pairwise(knots)) and knots[:1] == [0]
        shaped = trajectory["w"].shape == (steps, q) and trajectory["states"].shape == (len(knots), discrete.n)
        if not 1 <= trajectory.get("parts", 1) <= MOST_PARTS:
            raise refuse(f"trajectories[{k}].parts", f"must be 1 to {MOST_PARTS}")
        if not rising or not shaped or knots[-1] > steps:
            raise refuse(f"trajectories[{k}]", "has knots, states and w that do not fit together")
    found = tuple(trajectory_of(problem, discrete, trajectory) for trajectory in trajectories)
    return PlanBound(
        found,
        _proof(tree["no_better_than"], len(found), "no_better_than"),
        _proof(tree["no_cheaper_than"], len(found), "no_cheaper_than"),
    )


def _proof(data: Tree | None, trajectories: int, place: str) -> CostProof | None:
    if data is None:
        return None
    if len(data["tree"]) > MOST_TREE or any(row[0] >= trajectories for row in data["rows"]):
        raise refuse(place, "has a tree beyond all measure, or rows of none of the `trajectories`")
    if not data["tree"] and not data["rows"]:
        return CostProof(data["level"], data["value"], (), CostTree(), judged=True)
    nodes = iter(data["tree"])
    tree = _tree(nodes, place)
    if next(nodes, None) is not None:
        raise refuse(place, "has nodes beside its tree")
    return CostProof(data["level"], data["value"], tuple((a, e) for a, e in data["rows"]), tree)


def _tree(nodes: Iterator[Tree], place: str, depth: int = 0) -> CostTree:
    """A tree from the walk through it."""
    node = next(nodes, None)
    if node is None or len(node) != 1 or depth > 400:
        raise refuse(place, "has a tree that is cut off")
    if "variable" in node:
        return CostTree(variable=node["variable"], branches=tuple(_tree(nodes, place, depth + 1) for _ in range(2)))
    pairs = node["multipliers"]
    return CostTree(tuple(int(row) for row, _ in pairs), tuple(float(value) for _, value in pairs))
