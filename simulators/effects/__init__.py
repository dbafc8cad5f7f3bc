"""Physical effects that a simulator leaves out, one small file each."""
