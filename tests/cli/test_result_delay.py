"""Results that are out, on the command line: `accuracy --result-delay` and `next --awaited`."""

import json

import numpy as np

import sampling_design as sd
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan

WALK = sd.Plant([[0.0]], [[1.0], [1.0]], states=["level"], outputs=["gauge", "lab"], time_unit="h")


def test_results_that_are_out_on_the_command_line(shell, tmp_path):
    sensors = {
        "gauge": {"noise_bound": 0.3},
        "lab": {"noise_bound": 0.02, "detection_limit": 0.5, "lowest": 0.0, "result_delay": (0.5, 1.5)},
    }
    asked = sd.PlanRequirement({"level": 1.0}, period=4.0, grid=0.5, w_bound=0.1, sensors=sensors)
    problem = pose_plan(WALK, asked)
    chosen = np.zeros_like(problem.allowed)
    chosen[0, 1] = True
    plan = proven_plan(problem, chosen, PlanBound((), None, None), "budget").save(tmp_path / "plan.json")
    (tmp_path / "read.csv").write_text("time,gauge,lab\n0,,1.0\n4,,<0.5\n8,,1.2\n")
    (tmp_path / "numbers.csv").write_text("time,gauge,lab\n0,,1.0\n4,,0.7\n8,,1.2\n")
    said = shell("next", plan, tmp_path / "read.csv", "--now", "12.5", "--awaited", "lab 12", "--json")
    found = json.loads(said.out)
    assert found["awaited"][0]["output"] == "lab"
    assert found["awaited"][0]["latest"]["time"] == 13.5
    same = shell("next", plan, tmp_path / "numbers.csv", "--now", "12.5", "--awaited", "lab 12", "--json")
    assert json.loads(same.out)["known"] == found["known"]
    wrong = shell("next", plan, tmp_path / "read.csv", "--now", "12.5", "--awaited", "lab")
    assert wrong.code == 2
    assert "`--awaited` must be a sensor and when it was read, as 'lab 3.5', got 'lab'" in wrong.err
    assert "`--awaited` needs MEASUREMENTS: without one" in shell("next", plan, "--awaited", "lab 12").err
    sd.plants.write_plant(WALK, tmp_path / "plant.toml")
    sd.schedules.write_schedule(problem.schedule(chosen), tmp_path / "schedule.csv")
    given = ("accuracy", tmp_path / "plant.toml", tmp_path / "schedule.csv", "--w", "0.1", "--v", "0.3,0.02", "--json")
    upper = [json.loads(shell(*given, *more).out)["upper"][0] for more in ((), ("--result-delay", "0,1.5"))]
    assert np.allclose(upper, [0.42, 0.57], rtol=2e-3)
