"""Simulated flights written as autopilots and ROS write theirs; frames and units are theirs, too.

What these files hold was looked up in the formats' own documents, not in the readers.
"""

import dataclasses
import struct
import zlib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

START = 12.0
"""Time on the autopilot's clock at which a flight begins [s]."""
HOVER = 0.5
"""Share of the largest thrust at which a vehicle hovers."""
IMU = (0.001, 0.002, 0.003, 0.1, 0.2, -9.81)
"""What gyroscopes [rad/s] and accelerometers [m/s^2] say, FRD; not those of the flight."""
RATES = {"pos": 5, "quat": 1, "cmd": 5}
"""Every which row is logged; rows stand at 250 Hz."""


@dataclasses.dataclass(frozen=True)
class Flown:
    """A flight in the frames of an autopilot: north, east, down; forward, right, down."""

    t: np.ndarray
    pos: np.ndarray
    vel: np.ndarray
    quat: np.ndarray
    """Scalar first."""
    cmd_quat: np.ndarray
    cmd_share: np.ndarray
    volts: np.ndarray

    def every(self, field, rates):
        """Rows at which a field is logged."""
        return np.arange(0, len(self.t), rates[field])


def flown(log, hover_thrust):
    """A DroneLog as an autopilot sees it."""
    swap = lambda v: np.stack([v[:, 1], v[:, 0], -v[:, 2]], axis=1)  # noqa: E731
    return Flown(
        t=log.t + START,
        pos=swap(log.pos),
        vel=swap(log.vel),
        quat=aerospace(log.quat),
        cmd_quat=aerospace(Rotation.from_euler("xyz", log.cmd[:, :3]).as_quat()),
        cmd_share=log.cmd[:, 3] * HOVER / hover_thrust,
        volts=4.0 - 0.01 * log.t if log.battery is None else log.battery,
    )


def aerospace(quat):
    """FRD in NED, scalar first, of FLU in ENU, scalar last: both bodies turned about x by 180
    degrees, the world from its north axis."""
    x, y, z, w = quat.T
    c = np.sqrt(0.5)
    # (c, c, 0, 0) turned about x and y together is ENU seen from NED; worked out by hand.
    return np.stack([c * (w + z), c * (x + y), c * (x - y), c * (w - z)], axis=1)


def write_ulog(path, log, hover_thrust, rates=RATES, hover=HOVER):
    """A ULog file, written by pyulog."""
    pyulog = pytest.importorskip("pyulog", reason="pyulog is not installed")
    data, ulog = flown(log, hover_thrust), pyulog.ULog(None)
    ulog._start_timestamp = int(START * 1e6)
    if hover is not None:
        ulog._initial_parameters["MPC_THR_HOVER"] = float(hover)
    zero = np.zeros((len(data.t), 2))
    thrust = np.column_stack([zero, -data.cmd_share])
    topics = {
        "vehicle_local_position": ("pos", {"x y z": data.pos, "vx vy vz": data.vel}),
        "vehicle_attitude": ("quat", {"float[4] q": data.quat}),
        "vehicle_attitude_setpoint": (
            "cmd",
            {"float[4] q_d": data.cmd_quat, "float[3] thrust_body": thrust},
        ),
        "battery_status": ("pos", {"voltage_v": data.volts[:, None]}),
        "vehicle_acceleration": ("pos", {"float[3] xyz": np.tile(IMU[3:], (len(data.t), 1))}),
    }
    for number, (name, (field, columns)) in enumerate(topics.items()):
        rows = data.every(field, rates)
        types = ";".join(
            entry if entry.startswith("float[") else ";".join(f"float {n}" for n in entry.split())
            for entry in columns
        )
        form = pyulog.ULog.MessageFormat(f"{name}:uint64_t timestamp;{types};".encode(), None)
        ulog._message_formats[name] = form
        head = struct.pack("<BH", 0, number) + name.encode()
        message = pyulog.ULog._MessageAddLogged(head, None, ulog._message_formats)
        values = np.column_stack([columns[entry][rows] for entry in columns]).astype("<f4")
        for t, row in zip(data.t[rows], values, strict=True):
            message.buffer += struct.pack("<Q", round(t * 1e6)) + row.tobytes()
        ulog._data_list.append(pyulog.ULog.Data(message))
    ulog.write_ulog(str(path))
    return path


DATAFLASH = {
    "PARM": ("QNf", "TimeUS,Name,Value"),
    "XKF1": ("QBccCfffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD"),
    "ATT": ("Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "RATE": ("Qf", "TimeUS,AOut"),
    "BAT": ("QBf", "TimeUS,Inst,Volt"),
}
"""Letters of types and names of columns, as ArduPilot's FMT messages give them."""
LETTERS = {"Q": "Q", "N": "16s", "f": "f", "B": "B", "c": "h", "C": "H"}


def write_dataflash(path, log, hover_thrust, rates=RATES, hover=HOVER):
    """A DataFlash log of ArduPilot; the test is skipped where nothing could read it."""
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    data, out = flown(log, hover_thrust), bytearray()
    for number, (name, (kinds, columns)) in enumerate(DATAFLASH.items(), start=1):
        size = 3 + struct.calcsize("<" + "".join(LETTERS[k] for k in kinds))
        texts = name.encode(), kinds.encode(), columns.encode()
        out += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, size, *texts)
    numbers = {name: i for i, name in enumerate(DATAFLASH, start=1)}

    def put(name, *values):
        kinds = DATAFLASH[name][0]
        form = "<" + "".join(LETTERS[kind] for kind in kinds)
        return b"\xa3\x95" + bytes([numbers[name]]) + struct.pack(form, *values)

    if hover is not None:
        out += put("PARM", round(START * 1e6), b"MOT_THST_HOVER", hover)
    turned = lambda quat: np.degrees(  # noqa: E731
        Rotation.from_quat(quat[:, [1, 2, 3, 0]]).as_euler("xyz")
    )
    flew, asked = turned(data.quat), turned(data.cmd_quat)
    for i, t in enumerate(data.t):
        us = round(t * 1e6)
        if i % rates["quat"] == 0:
            pairs = np.stack([asked[i], flew[i]], axis=1).ravel()
            out += put("ATT", us, *pairs)
        if i % rates["cmd"] == 0:
            out += put("RATE", us, data.cmd_share[i])
        if i % rates["pos"] == 0:
            out += put("XKF1", us, 0, 0, 0, 0, *data.vel[i], 0.0, *data.pos[i])
            out += put("XKF1", us, 1, 0, 0, 0, *data.vel[i], 0.0, *(data.pos[i] + 3.0))
            out += put("BAT", us, 0, data.volts[i])
            out += put("IMU", us, 0, *IMU)
    path.write_bytes(bytes(out))
    return path


def variables(log, thrust_max):
    """A flight as variables of the Crazyflie's firmware."""
    pitch = np.asarray([1.0, -1.0, 1.0])
    columns = {"stateEstimate": dict(zip("xyz", log.pos.T, strict=True))}
    columns["stateEstimate"] |= dict(zip(("vx", "vy", "vz"), log.vel.T, strict=True))
    columns["stateEstimate"] |= dict(zip(("qx", "qy", "qz", "qw"), log.quat.T, strict=True))
    angles = np.degrees(log.cmd[:, :3]) * pitch
    columns["controller"] = dict(zip(("roll", "pitch", "yaw"), angles.T, strict=True))
    columns["stabilizer"] = {"thrust": log.cmd[:, 3] / thrust_max * 65535.0}
    columns["pm"] = {"vbat": 4.0 - 0.01 * log.t}
    return {f"{group}.{n}": v for group, named in columns.items() for n, v in named.items()}


def write_usd(path, log, thrust_max, version=2, named=None):
    """A log of the uSD deck, of `named` variables or those of the flight."""
    named = named or variables(log, thrust_max)
    out = bytearray(struct.pack("<BHHH", 0xBC, version, 1, 7) + b"fixedFrequency\0")
    out += struct.pack("<H", len(named)) + b"".join(f"{n}(f)".encode() + b"\0" for n in named)
    for i, t in enumerate(log.t + START):
        ticks = round(t * 1e6) if version == 2 else round(t * 1e3)
        out += struct.pack("<HQ" if version == 2 else "<HI", 7, ticks)
        out += struct.pack(f"<{len(named)}f", *(values[i] for values in named.values()))
    path.write_bytes(out + struct.pack("<I", zlib.crc32(out)))
    return path


def write_cflib(folder, log, thrust_max, rates=RATES):
    """CSV files of cfclient, one for each block of a flight."""
    named, rows = variables(log, thrust_max), np.arange(len(log.t))
    blocks = {
        "pos": [f"stateEstimate.{n}" for n in ("x", "y", "z", "vx", "vy", "vz")],
        "quat": [f"stateEstimate.{n}" for n in ("qx", "qy", "qz", "qw")],
        "cmd": [*(f"controller.{n}" for n in ("roll", "pitch", "yaw")), "stabilizer.thrust"],
    }
    folder.mkdir()
    for block, names in blocks.items():
        lines = [",".join(["Timestamp", *names])]
        for i in rows[:: rates[block]]:
            cells = [f"{(log.t[i] + START) * 1e3:.0f}", *(repr(float(named[n][i])) for n in names)]
            lines.append(",".join(cells))
        (folder / f"{block}-20261123.csv").write_text("\n".join(lines) + "\n")
    return folder


TARGET = """std_msgs/Header header
uint8 type_mask
geometry_msgs/Quaternion orientation
geometry_msgs/Vector3 body_rate
float32 thrust
"""
"""mavros_msgs/AttitudeTarget without its constants."""


def write_bag(path, log, full_thrust, kind, rates=RATES, drones=("",)):
    """A bag with poses of a motion capture, velocities, and setpoints of mavros.

    Args:
        kind: `ros1`, `ros2` (a database) or `mcap`.
    """
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    old = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(TARGET, "mavros_msgs/msg/AttitudeTarget"))
    t = store.types
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    asked = Rotation.from_euler("xyz", log.cmd[:, :3]).as_quat()

    def header(ns):
        stamp = t["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        return t["std_msgs/msg/Header"](*([0] if old else []), stamp, "map")

    def vector(values):
        return t["geometry_msgs/msg/Vector3"](*map(float, values))

    def messages(i, ns):
        pose = t["geometry_msgs/msg/Pose"](
            t["geometry_msgs/msg/Point"](*map(float, log.pos[i])),
            t["geometry_msgs/msg/Quaternion"](*map(float, log.quat[i])),
        )
        twist = t["geometry_msgs/msg/Twist"](vector(log.vel[i]), vector(np.zeros(3)))
        turn = t["geometry_msgs/msg/Quaternion"](*map(float, asked[i]))
        thrust = float(np.float32(log.cmd[i, 3] / full_thrust))
        return {
            "quat": ("pose", "geometry_msgs/msg/PoseStamped", (pose,)),
            "pos": ("twist", "geometry_msgs/msg/TwistStamped", (twist,)),
            "cmd": (
                "target",
                "mavros_msgs/msg/AttitudeTarget",
                (0, turn, vector(np.zeros(3)), thrust),
            ),
        }

    made = Writer1(path) if old else Writer2(path, version=9, storage_plugin=plugin)
    with made as writer:
        connections = {}
        for i, seconds in enumerate(log.t + START):
            ns = round(seconds * 1e9)
            for field, (topic, name, content) in messages(i, ns).items():
                if i % rates[field]:
                    continue
                message = t[name](header(ns), *content)
                write = store.serialize_ros1 if old else store.serialize_cdr
                for place in (f"{drone}/{topic}" for drone in drones):
                    if place not in connections:
                        connections[place] = writer.add_connection(place, name, typestore=store)
                    # Recorded a little later than it was measured.
                    writer.write(connections[place], ns + 3_000_000, write(message, name))
    return path
