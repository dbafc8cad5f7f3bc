"""Commands beside a sweep: diagnosis, plug-ins, speed, machine."""
