"""
The one pipeline from messages to estimates: input gate, method, health. There is no ROS in it.

The node, the offline bag run and the experiments all drive `Localizer`. Its estimates depend on
the messages' stamps and on their order within each topic, not on how topics interleave: an epoch
is worked on once every vehicle's beacons and odometry have passed its stamp, or once `max_wait`
has passed on the messages' own clock. So topics may lag each other by `max_wait`, less the time
between two odometry poses.
"""

from tsmcl_ros.localizer.health import Health
from tsmcl_ros.localizer.pipeline import Localizer
from tsmcl_ros.localizer.schedule import LONGEST_LEAP
from tsmcl_ros.localizer.settings import CONFIGS, LocalizerConfig

__all__ = ['CONFIGS', 'Health', 'Localizer', 'LocalizerConfig', 'LONGEST_LEAP']
