"""What to do about a diagnosis: parameters to change, and the next flight as a trajectory."""
