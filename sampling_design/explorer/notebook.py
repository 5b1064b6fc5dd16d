"""The explorer in a notebook, through anywidget."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy.typing as npt

from sampling_design.checkers.strict import is_table
from sampling_design.design.problem.requirement import Requirement
from sampling_design.errors import MissingExtraError
from sampling_design.explorer.schedule_explorer import ScheduleExplorer
from sampling_design.explorer.server import MODULE
from sampling_design.planning.requirement import PlanRequirement
from sampling_design.plants.plant import Plant
from sampling_design.records.signatures import checked
from sampling_design.records.vector_bounds import VectorBound
from sampling_design.schedules.schedule import PeriodicSchedule

if TYPE_CHECKING:
    from anywidget import AnyWidget


class ExplorerOptions(TypedDict, total=False):
    """What a `ScheduleExplorer` takes beside plant, requirement and schedule."""

    w_bound: VectorBound
    v_bound: VectorBound
    tolerance: npt.ArrayLike
    projection: tuple[str, str]
    initial_error: VectorBound
    folder: str
    words: str


@checked
def explore(
    plant: Plant | ScheduleExplorer,
    requirement: Requirement | PlanRequirement | None = None,
    schedule: PeriodicSchedule | None = None,
    **options: Unpack[ExplorerOptions],
) -> AnyWidget:
    """Return a time line of samples to drag, with what they prove; a notebook shows it (extra `explore`).

    Parameters
    ----------
    plant : Plant or ScheduleExplorer
        An explorer is shown as it stands, and holds afterwards what was dragged.
    requirement, schedule, options
        As for `ScheduleExplorer`.

    Returns
    -------
    anywidget.AnyWidget
        Its `explorer.schedule` is the schedule as it lies now.

    Raises
    ------
    MissingExtraError
        If anywidget is not installed.
    """
    try:
        import anywidget
    except ImportError:
        raise MissingExtraError("anywidget", "explore") from None

    explorer = (
        plant if isinstance(plant, ScheduleExplorer) else ScheduleExplorer(plant, requirement, schedule, **options)
    )

    widget = type("Explorer", (anywidget.AnyWidget,), {"_esm": MODULE.read_text(), "__module__": __name__})()
    widget.explorer = explorer

    def on_message(_: object, message: dict[str, object], buffers: object) -> None:
        question = message.get("question")
        answer = explorer.answer(question if is_table(question) else {})
        widget.send({"number": message.get("number"), "answer": answer})

    widget.on_msg(on_message)
    made: AnyWidget = widget
    return made
