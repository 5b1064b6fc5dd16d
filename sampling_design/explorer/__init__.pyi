# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.explorer.notebook import explore as explore
from sampling_design.explorer.scenes import SCENES as SCENES
from sampling_design.explorer.scenes import scene as scene
from sampling_design.explorer.schedule_explorer import ScheduleExplorer as ScheduleExplorer
from sampling_design.explorer.server import serve as serve
