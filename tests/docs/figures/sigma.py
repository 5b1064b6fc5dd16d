"""docs/theory/sigma.md: what its sentences say of the code's own limits, and of a law."""

from sampling_design.design.bounds import branching
from sampling_design.design.design import BRANCHES, GAP, PATIENCE
from sampling_design.design.problem.design_problem import MOST_CHOICES
from sampling_design.design.sizes import MOST_GROWTH
from tests.docs.figures import Figure
from tests.laws import test_opening_hours_cost_no_design_its_sigma as hours

PAGE = "theory/sigma.md"


def cuts():
    assert (branching._LOOK, branching._HELPS) == (20, 1 / 20)
    return BRANCHES, PATIENCE, 100 * GAP


FIGURES = (
    Figure(PAGE, r"By default (\d+) boxes are cut, and up to (\d+) as long as the gap is above (\d+) %", cuts),
    Figure(
        PAGE,
        r"Of (\d+) random designs in opening hours, .* hour, all have a gap of at most (\d+) %",
        lambda: (len(hours.MANY), 100 * hours.GAP),
    ),
    Figure(PAGE, r"Up to (\d+) of these are bounded one by one", lambda: (MOST_CHOICES,)),
    Figure(PAGE, r"Growth beyond \$e\^\{(\d+)\}\$ over the window is refused", lambda: (MOST_GROWTH,)),
)
