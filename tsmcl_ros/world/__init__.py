"""
The simulated world: where vehicles truly are, what their wheels tell them and their radios hear.

The parts serve on their own too: the simulator node moves vehicles here and lets them `receive`
what anchors really transmitted.
"""

from tsmcl_ros.world.anchors import anchor_table, AnchorConfig, lay_out
from tsmcl_ros.world.core import Epoch, World
from tsmcl_ros.world.hearing import hear_each_other, receive
from tsmcl_ros.world.making import CONFIGS, make_mobility, make_world
from tsmcl_ros.world.settings import MOBILITY, MobilityConfig, WorldConfig
from tsmcl_ros.world.wheels import WheelOdometry

__all__ = [
    'anchor_table',
    'AnchorConfig',
    'CONFIGS',
    'Epoch',
    'hear_each_other',
    'lay_out',
    'make_mobility',
    'make_world',
    'MOBILITY',
    'MobilityConfig',
    'receive',
    'WheelOdometry',
    'World',
    'WorldConfig',
]
