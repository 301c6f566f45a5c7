"""
MCB: Monte Carlo localization boxed, which redraws only where what was heard allows.

Baggio and Langendoen: Monte Carlo localization for mobile wireless sensor networks, 2006. MCL
whose redraws come from the anchor box, the intersection of the boxes around the heard disks (2R
for hops 2), within each particle's motion box. The paper draws uniformly in these boxes, which
takes the corners of the motion box for possible and every parent for equally so. Here parents are
chosen by what the motion model puts into the box, and draws follow it there, so that the cloud is
that of MCL, for any motion model, in fewer draws.
"""

from __future__ import annotations

from dataclasses import dataclass

from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.rejection import Redraw, RejectionConfig, RejectionFilter
from tsmcl_ros.types import Array


@dataclass(frozen=True)
class McbConfig(RejectionConfig):
    """What every filter of the family has."""


class Mcb(RejectionFilter):
    """MCB of V vehicles: predict, reject and redraw in boxes, weigh what is measured, resample."""

    Config = McbConfig

    def redraws(self, evidence: Evidence, survived: Array) -> Redraw:
        """Draw what the motion puts into the anchor box."""
        return self.redraw_in_boxes(*evidence.reach.anchor_box(), survived)
