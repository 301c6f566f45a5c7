"""Command lines that are no ROS nodes."""
