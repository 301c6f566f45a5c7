"""Localization of vehicles from radio beacons, on ROS 2."""
