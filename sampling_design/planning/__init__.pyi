# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.planning.files import load_plan as load_plan
from sampling_design.planning.requirement import PlanRequirement as PlanRequirement
from sampling_design.planning.requirement_file import read_plan_requirement as read_plan_requirement
