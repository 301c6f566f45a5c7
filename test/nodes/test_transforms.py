from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from tsmcl_ros.endpoint import OutputConfig
from tsmcl_ros.nodes.transforms import Broadcaster, map_to_odom
from tsmcl_ros.nodes.wire import message_class, RELIABLE
from tsmcl_ros.types import Estimate


def estimate(mean: list[float], rotation: float, odometry: list[float] | None) -> Estimate:
    nothing = np.full(1, np.nan)
    return Estimate(
        1.0, np.array([mean]), np.eye(len(mean))[None], np.array([rotation]), nothing, nothing, 1,
        nothing, nothing, nothing, None if odometry is None else np.array([odometry]))


def test_the_odometry_pose_goes_to_the_estimated_place_through_the_transform() -> None:
    translation, rotation, has_odometry = map_to_odom(
        estimate([10.0, 20.0], np.pi / 2, [3.0, 1.0, 0.0, 0.2]), 0)
    assert has_odometry
    assert rotation == np.pi / 2
    # A quarter turn takes (3, 1) to (-1, 3).
    np.testing.assert_allclose(translation + [-1.0, 3.0, 0.0], [10.0, 20.0, 0.0])


def test_in_three_dimensions_heights_count() -> None:
    translation, _, _ = map_to_odom(estimate([1.0, 2.0, 9.0], 0.0, [0.0, 0.0, 4.0, 0.0]), 0)
    np.testing.assert_allclose(translation, [1.0, 2.0, 5.0])


@pytest.mark.parametrize(('rotation', 'odometry'), [
    (0.3, None), (0.3, [np.nan] * 4), (np.nan, [1.0, 2.0, 0.0, 0.0]),
])
def test_without_odometry_or_rotation_the_vehicle_itself_is_placed(
    rotation: float, odometry: list[float] | None,
) -> None:
    translation, rotation, has_odometry = map_to_odom(
        estimate([1.0, 2.0], rotation, odometry), 0)
    assert not has_odometry
    assert translation.tolist() == [1.0, 2.0, 0.0]
    assert rotation == 0.0


@pytest.mark.skipif(find_spec('tf2_ros') is None, reason='tf2_ros is not installed')
@pytest.mark.parametrize(('odometry', 'frame'), [
    ([3.0, 1.0, 0.0, 0.2], 'veh_0/odom'), (None, 'veh_0/base_link')])
def test_tf_is_told_where_the_vehicle_or_its_odometry_frame_lies(
    probe: Any, odometry: list[float] | None, frame: str,
) -> None:
    told = probe.collect('/tf', 'tf2_msgs/msg/TFMessage', RELIABLE)
    broadcaster = Broadcaster(probe, OutputConfig(transform_tolerance=0.5), ['veh_0/'])
    where = estimate([10.0, 20.0], np.pi / 2, odometry)
    probe.insist(lambda: broadcaster.send(where), lambda: bool(told), 'a transform')
    transform, = deserialize_message(told[0], message_class('tf2_msgs/msg/TFMessage')).transforms
    stamp, moved = transform.header.stamp, transform.transform.translation
    assert (transform.header.frame_id, transform.child_frame_id) == ('map', frame)
    assert (stamp.sec, stamp.nanosec) == (1, 500_000_000)
    np.testing.assert_allclose(
        [moved.x, moved.y], [11.0, 17.0] if odometry else [10.0, 20.0])
