"""Arrays by the numbers that they hold, as annotations name them everywhere."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]
"""What numpy indexes with, as `argsort` and `flatnonzero` return it."""
Integers = npt.NDArray[np.int_]
