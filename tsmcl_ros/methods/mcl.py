"""
MCL: Monte Carlo localization by rejection and redraw, the baseline.

Hu and Evans: Localization for mobile sensor networks, MobiCom 2004, with N = 50 and the `random`
motion model. A particle survives with the probability that its presence evidence gives it: with
hard disks that is the paper's filter, d <= R for hops 1 and R < d <= 2R for hops 2. Ranges and
rssi, which the paper does not have, weigh the survivors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.rejection import Redraw, RejectionConfig, RejectionFilter
from tsmcl_ros.types import Array, Motion


@dataclass(frozen=True)
class MclConfig(RejectionConfig):
    """What every filter of the family has."""


class Mcl(RejectionFilter):
    """MCL of V vehicles: predict, reject and redraw, weigh what is measured, resample."""

    Config = MclConfig

    def redraws(self, evidence: Evidence, survived: Array) -> Redraw:
        """Predict from random parents, whose weight is inherited."""
        size, motion = self.cloud.states.shape[1], self._motion
        parents = self._parents.reshape(-1, self._parents.shape[2])
        inherited = self.cloud.weights.flatten()

        def redraw(owner: Array) -> tuple[Array, Array, Array]:
            parent = owner * size + self.rng.integers(size, size=len(owner))
            own = motion
            if motion.displacement is not None and motion.turn is not None:
                own = Motion(motion.elapsed, motion.displacement[owner], motion.turn[owner])
            states = self.cloud.motion.predict(
                parents.take(parent, axis=0, mode='clip')[:, None], own, self.rng)[:, 0]
            return states, inherited.take(parent, mode='clip'), np.ones(len(owner), bool)

        return redraw
