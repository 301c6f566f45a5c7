"""What localizers said in a bag of how they were doing."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import math

import numpy as np
from tsmcl_ros.messages import decode_diagnostics, Diagnosis
from tsmcl_ros.types import Array, MessageError

_LONGEST_ID = 12  # characters, with a space before it


@dataclass(frozen=True, eq=False)
class Condition:
    """
    One vehicle's diagnoses over time, T of them.

    Attributes
    ----------
    stamp : (T,) float64
        [s], increasing.
    level : (T,) int
        As in `Diagnosis`.
    particles, ess : (T,) float64
        How many particles there were, and how many of them counted; NaN where not told.
    suspects : mapping of int to float
        Which share of the diagnoses suspects a sender, by its id; none that nobody suspects.

    """

    stamp: Array
    level: Array
    particles: Array
    ess: Array
    suspects: Mapping[int, float]

    @property
    def effective(self) -> Array:
        """(T,) share of the particles that counted, NaN where there are no two."""
        return np.where(self.particles > 1, self.ess / np.maximum(self.particles, 1), np.nan)


def read_conditions(
    messages: Iterable[bytes], begin: float, end: float,
) -> dict[str, Condition]:
    """
    Return what was diagnosed from `begin` to `end` [s], and last before, by hardware_id.

    Diagnostics that cannot be decoded, or whose time goes back, are passed over: they are a
    by-product, and who else publishes there is not ours to judge.
    """
    found: dict[str, list[tuple[float, Diagnosis]]] = defaultdict(list)
    for data in messages:
        try:
            stamp, diagnoses = decode_diagnostics(data)
        except MessageError:
            continue
        if stamp > end:
            continue
        for one in diagnoses:
            known = found[one.hardware_id]
            if known and known[0][0] <= stamp <= begin:
                known.clear()
            if not known or known[-1][0] < stamp:
                known.append((stamp, one))
    return {name: _condition(known) for name, known in found.items()}


def _condition(known: list[tuple[float, Diagnosis]]) -> Condition:
    counts: dict[int, int] = defaultdict(int)
    for _, one in known:
        for word in one.values.get('suspects', '').split(','):
            if len(word) <= _LONGEST_ID and word.strip().isdecimal():
                counts[int(word)] += 1
    return Condition(
        np.array([stamp for stamp, _ in known]),
        np.array([one.level for _, one in known]),
        np.array([_number(one, 'particles') for _, one in known]),
        np.array([_number(one, 'effective particles') for _, one in known]),
        {identity: count / len(known) for identity, count in sorted(counts.items())},
    )


def _number(diagnosis: Diagnosis, key: str) -> float:
    try:
        return float(diagnosis.values[key])
    except (KeyError, ValueError):
        return math.nan
