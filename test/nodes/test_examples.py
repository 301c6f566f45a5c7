"""What the README tells newcomers to run."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.nodes import wire

EXAMPLES = Path(__file__).resolve().parents[2] / 'examples'


def test_the_radio_driver_leads_a_localizer_to_where_the_vehicle_stands(start, probe) -> None:
    localizer = start('nodes.localizer', '--ros-args', '-r', '__ns:=/veh_0', '-p',
                      'method:=ekf', '-p', 'radio_range:=50.0')
    poses = probe.collect('/veh_0/pose', messages.POSE, wire.LATCHED_INPUT)
    driver = subprocess.Popen([sys.executable, EXAMPLES / 'radio_driver.py'])
    try:
        # By the sixth the velocity, which may be anything at first, has settled.
        probe.expect(lambda: len(poses) > 5, 'poses')
    finally:
        driver.kill()
        driver.wait()
    assert np.linalg.norm(messages.decode_pose(poses[-1]).position[:2] - [3, 4]) < 0.5
    assert 'rejected' not in localizer.output
