"""Logs of autopilots and of ROS, brought into the format that the diagnosis reads."""
