"""The package's ROS nodes; the only importers of rclpy."""
