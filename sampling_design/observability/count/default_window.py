"""The window that is used where none is given: one rule for designs, counts and sigma alike."""

from __future__ import annotations

import numpy as np

from sampling_design.plants.modes import ModalSplit
from sampling_design.records.signatures import checked


@checked
def default_window(split: ModalSplit) -> float | None:
    """Return the window that is used where none is given: the slowest oscillation, else 4/|A| of the retained part.

        T = 2 pi / min |Im lambda| over the non-zero ones,    else T = 4/|A_retained|, in scaled coordinates

    Parameters
    ----------
    split : ModalSplit

    Returns
    -------
    float or None
        In the plant's time unit; None where the retained part neither oscillates nor moves.
    """
    rates = np.abs(np.array([c.value.imag for c in split.retained_clusters]))
    rates = rates[rates > 0]
    norm = float(np.linalg.norm(split.retained.scaled().A, 2)) if split.retained.n_states else 0.0
    if rates.size:
        return float(2 * np.pi / rates.min())
    return 4 / norm if norm else None
