"""A flight in closed form for the tests of imports: a circle, 250 rows a second."""

from log_tables import table

from diagnosis.importing.reader import Request, Stream
from diagnosis.logs.columns import GROUPS
from diagnosis.logs.flights import DroneLog

VEHICLE = 'name = "x"\ndrone = "cf2x_L250"\nmass = 0.032\n'
WEIGHT = 0.032 * 9.81
REQUEST = Request(mass=0.032, thrust_max=0.48)


def circle(seconds=3.0, freq=250.0):
    """The flight of `log_tables.table`."""
    frame = table(rows=round(seconds * freq), freq=freq, yaw=0.3)
    groups = {g: frame[list(GROUPS[g])].to_numpy() for g in ("pos", "vel", "quat", "cmd")}
    return DroneLog(t=frame["t"].to_numpy(), **groups)


def streams(log, every=None):
    """The streams of a flight, each with every so many rows of it."""
    fields = {"pos": log.pos, "vel": log.vel, "quat": log.quat}
    fields |= {"cmd_angles": log.cmd[:, :3], "cmd_thrust": log.cmd[:, 3:]}
    return [
        Stream(name, log.t[:: (every or {}).get(name, 1)], v[:: (every or {}).get(name, 1)], name)
        for name, v in fields.items()
    ]


def without(stream, first, last):
    """A stream with a hole [s]."""
    keep = (stream.t < first) | (stream.t > last)
    return Stream(stream.field, stream.t[keep], stream.values[keep], stream.source)
