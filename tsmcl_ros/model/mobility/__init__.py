"""How vehicles move: all of a fleet at once, a model a file."""

from tsmcl_ros.model.mobility.base import AreaConfig, Mobility, State, wrap
from tsmcl_ros.model.mobility.manhattan import Manhattan, ManhattanConfig
from tsmcl_ros.model.mobility.manoeuvre import Manoeuvre, ManoeuvreConfig
from tsmcl_ros.model.mobility.random_waypoint import RandomWaypoint, RandomWaypointConfig
from tsmcl_ros.model.mobility.trace import Replay, Trace

__all__ = [
    'AreaConfig', 'Manhattan', 'ManhattanConfig', 'Manoeuvre', 'ManoeuvreConfig', 'Mobility',
    'RandomWaypoint', 'RandomWaypointConfig', 'Replay', 'State', 'Trace', 'wrap',
]
