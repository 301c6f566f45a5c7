"""
The values that flow through the package, and the errors it raises.

Everything numeric has a leading vehicle axis V; a single vehicle is V = 1. Positions are metres in
one local Cartesian map frame, stamps are seconds.
"""

from tsmcl_ros.types.arrays import Array, items
from tsmcl_ros.types.errors import (
    BagError,
    ConfigError,
    LogError,
    MessageError,
    one_line,
    TsmclError,
)
from tsmcl_ros.types.links import Links
from tsmcl_ros.types.observation import (
    ANCHOR,
    Observation,
    PADDED,
    pair,
    pairs_of,
    Rows,
    Silence,
    split,
    UNTRUE,
    VEHICLE,
)
from tsmcl_ros.types.poses import Estimate, Motion, Odometry, Prior, Trajectory
from tsmcl_ros.types.protocols import Estimator, Progress, T, unshown

# Most base periods that may lie between two beacons.
MAX_PERIOD_FACTOR = 2 ** 31 - 1

__all__ = [
    'ANCHOR',
    'Array',
    'BagError',
    'ConfigError',
    'Estimate',
    'Estimator',
    'items',
    'Links',
    'LogError',
    'MAX_PERIOD_FACTOR',
    'MessageError',
    'Motion',
    'Observation',
    'Odometry',
    'one_line',
    'PADDED',
    'pair',
    'pairs_of',
    'Prior',
    'Progress',
    'Rows',
    'Silence',
    'split',
    'T',
    'Trajectory',
    'TsmclError',
    'unshown',
    'UNTRUE',
    'VEHICLE',
]
