"""
A radio driver in its least form: publishes what it ranges as the localizer wants it.

    python examples/radio_driver.py
    localizer --ros-args -r __ns:=/veh_0 -p method:=ekf -p radio_range:=50.0

Put your radio's readings into `measure`.
"""

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

# Where the anchors stand [m], by id; the vehicle of this example stands at (3, 4).
ANCHORS = {1: (0.0, 0.0, 0.0), 2: (10.0, 0.0, 0.0), 3: (0.0, 10.0, 0.0), 4: (10.0, 10.0, 0.0)}
COLUMNS = ('x', 'y', 'z', 'id', 'range', 'range_std')
ROW = np.dtype([(name, 'u4' if name == 'id' else 'f4') for name in COLUMNS])
FIELDS = [
    PointField(name=name, offset=4 * number, count=1,
               datatype=PointField.UINT32 if name == 'id' else PointField.FLOAT32)
    for number, name in enumerate(COLUMNS)
]


def measure() -> dict[int, float]:
    """Return the range of each anchor that was heard [m], by id."""
    noise = np.random.default_rng().normal(0, 0.1, len(ANCHORS))
    return {number: float(np.hypot(3 - x, 4 - y)) + error
            for (number, (x, y, _)), error in zip(ANCHORS.items(), noise, strict=True)}


def main() -> None:
    """Publish five times a second."""
    rclpy.init()
    node = rclpy.create_node('radio_driver')
    publisher = node.create_publisher(PointCloud2, '/veh_0/beacons', 10)

    def publish() -> None:
        rows = np.array([(*ANCHORS[number], number, distance, 0.1)
                         for number, distance in measure().items()], ROW)
        publisher.publish(PointCloud2(
            header=Header(stamp=node.get_clock().now().to_msg(), frame_id='map'),
            height=1, width=len(rows), fields=FIELDS, point_step=ROW.itemsize,
            row_step=rows.nbytes, data=rows.tobytes()))

    node.create_timer(0.2, publish)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == '__main__':
    main()
