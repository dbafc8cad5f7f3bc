"""A flight in closed form for the tests of imports: a circle, 250 rows a second."""

from log_tables import table
from log_writers import RATES, write_bag, write_cflib, write_dataflash, write_ulog, write_usd

from diagnosis.importing.reader import Stream
from diagnosis.logs.columns import GROUPS
from diagnosis.logs.flights import DroneLog

VEHICLE = 'name = "x"\ndrone = "cf2x_L250"\nmass = 0.032\n'
WEIGHT = 0.032 * 9.81
FLOWN = 'name = "x"\ndrone = "cf21B_500"\nmass = 0.0434\n'
"""The vehicle of `flights_for_tests`."""
FORMATS = ("ulog", "ardupilot", "ros1", "ros2", "mcap", "usd", "usd version 1", "cflib")
"""What `write_log` writes."""


def write_log(kind, folder, log, weight, most, rates=RATES):
    """A log in a format, for a weight and a largest thrust [N]; a uSD card has every row.

    A bag's thrust of 1 is twice the weight: `log_writers.HOVER` is a half.
    """
    match kind:
        case "ulog":
            return write_ulog(folder / "a.ulg", log, weight, rates)
        case "ardupilot":
            return write_dataflash(folder / "a.bin", log, weight, rates)
        case "usd" | "usd version 1":
            return write_usd(folder / "log00", log, most, version=1 if kind[-1] == "1" else 2)
        case "cflib":
            return write_cflib(folder / "session", log, most, rates)
    return write_bag(folder / ("a.bag" if kind == "ros1" else "a"), log, 2.0 * weight, kind, rates)


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
