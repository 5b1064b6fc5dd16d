"""Arrays by the numbers that they hold, as annotations name them everywhere; and those that nobody changes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]
"""What numpy indexes with, as `argsort` and `flatnonzero` return it."""
Integers = npt.NDArray[np.int_]


def freeze(array: object) -> Array:
    """Return an owned, C-ordered, read-only float64 copy."""
    copy = np.array(array, dtype=np.float64, order="C")
    copy.flags.writeable = False
    return copy
