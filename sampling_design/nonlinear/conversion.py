"""Linear plants as nonlinear ones."""

from __future__ import annotations

from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.plants.plant import Plant
from sampling_design.records.signatures import checked


@checked
def from_linear(plant: Plant, *, noises: bool = True) -> NonlinearPlant:
    """Return a linear plant as a nonlinear one.

        f = A x + B u + G w,    h = C x + D u + v

    Parameters
    ----------
    plant : Plant
    noises : bool
        False leaves v out.

    Returns
    -------
    NonlinearPlant

    Examples
    --------
    >>> plant = from_linear(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]))
    >>> plant.f([1.0, 2.0]).tolist()
    [2.0, -1.0]
    """
    return NonlinearPlant.of_linear(plant, noises)
