"""Arrays of numbers, and how rows of them are moved."""

from __future__ import annotations

import math
from typing import Any

import numpy.typing as npt

Array = npt.NDArray[Any]


def items(rows: Array) -> Array:
    """
    Return rows (M, ...), contiguous in memory, as M items: a view of the same memory.

    Picked and placed by it they are moved in one piece each, in a tenth of the time that numpy
    takes for their numbers one by one.
    """
    width = math.prod(rows.shape[1:])
    return rows.reshape(len(rows), width).view(f'V{width * rows.dtype.itemsize}')[:, 0]
