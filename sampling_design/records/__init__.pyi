# Written from the table in __init__.py by `python -m tests.house.front_door`.
from sampling_design.records.budget import progress_bar as progress_bar
from sampling_design.records.sweeps import Sweep as Sweep
from sampling_design.records.sweeps import sweep as sweep
