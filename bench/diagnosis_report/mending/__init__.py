"""Files that carry a diagnosis to the simulator, the autopilot, and into the next flight."""
