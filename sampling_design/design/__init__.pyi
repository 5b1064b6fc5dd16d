# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.design import bounds as bounds
from sampling_design.design import problem as problem
from sampling_design.design import search as search
from sampling_design.design.bounds.evidence import BoundPart as BoundPart
from sampling_design.design.bounds.evidence import UpperBound as UpperBound
from sampling_design.design.design import design_schedule as design_schedule
from sampling_design.design.losses import SampleLosses as SampleLosses
from sampling_design.design.losses import sample_losses as sample_losses
from sampling_design.design.pareto import ParetoFront as ParetoFront
from sampling_design.design.pareto import ParetoPoint as ParetoPoint
from sampling_design.design.pareto import pareto_front as pareto_front
from sampling_design.design.problem.requirement import OutputAccess as OutputAccess
from sampling_design.design.problem.requirement import Requirement as Requirement
from sampling_design.design.problem.requirement_file import read_requirement as read_requirement
from sampling_design.design.problem.requirement_file import requirement_from_dict as requirement_from_dict
from sampling_design.design.problem.requirement_file import write_requirement as write_requirement
from sampling_design.design.schedule_design import ScheduleDesign as ScheduleDesign
