"""Faults of the interface between a vehicle and its log, which look like physics and are none."""
