# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.planning.files import read_plan as read_plan
from sampling_design.planning.plan import plan_samples as plan_samples
from sampling_design.planning.plan_record import write_plan as write_plan
from sampling_design.planning.requirement import PlanRequirement as PlanRequirement
from sampling_design.planning.requirement_file import read_plan_requirement as read_plan_requirement
from sampling_design.planning.upcoming_sample import next_sample as next_sample
