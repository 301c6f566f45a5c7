"""
Conversion between the package's values and serialized standard messages.

This is the only place that knows field layouts, a module a family of messages. It works on
serialized bytes, which is what raw subscriptions deliver, what publishers take as they are, and
what bags hold: a node and an offline run go through the same code.
"""

from tsmcl_ros.messages.beacons import decode_beacons, decode_scan, encode_beacons
from tsmcl_ros.messages.clouds import MAX_COORDINATE, POINT_CLOUD
from tsmcl_ros.messages.diagnostics import (
    decode_diagnostics,
    Diagnosis,
    DIAGNOSTICS,
    encode_diagnostics,
)
from tsmcl_ros.messages.links import decode_links, encode_links, LINK
from tsmcl_ros.messages.pacing import (
    CLOCK,
    decode_clock,
    decode_period,
    encode_clock,
    encode_period,
    UINT32,
)
from tsmcl_ros.messages.poses import (
    decode_any_pose,
    decode_odometry,
    decode_pose,
    encode_odometry,
    encode_pose,
    encode_pose_array,
    encode_poses,
    ODOMETRY,
    POSE,
    Pose,
    POSE_ARRAY,
    POSE_STAMPED,
    POSES,
    UNMEASURED,
)
from tsmcl_ros.messages.ranges import decode_range, encode_range, RANGE, RangeReading
from tsmcl_ros.messages.rows import BEACON
from tsmcl_ros.messages.trajectories import decode_odometries, decode_poses

__all__ = [
    'BEACON',
    'CLOCK',
    'decode_any_pose',
    'decode_beacons',
    'decode_clock',
    'decode_diagnostics',
    'decode_links',
    'decode_odometries',
    'decode_odometry',
    'decode_period',
    'decode_pose',
    'decode_poses',
    'decode_range',
    'decode_scan',
    'Diagnosis',
    'DIAGNOSTICS',
    'encode_beacons',
    'encode_clock',
    'encode_diagnostics',
    'encode_links',
    'encode_odometry',
    'encode_period',
    'encode_pose',
    'encode_pose_array',
    'encode_poses',
    'encode_range',
    'LINK',
    'MAX_COORDINATE',
    'ODOMETRY',
    'POINT_CLOUD',
    'Pose',
    'POSE',
    'POSE_ARRAY',
    'POSE_STAMPED',
    'POSES',
    'RANGE',
    'RangeReading',
    'UINT32',
    'UNMEASURED',
]
