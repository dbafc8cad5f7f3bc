"""ROS 1 and ROS 2: bags (.bag, folders with metadata.yaml, .db3) and MCAP, read with rosbags.

| message | becomes | |
|---|---|---|
| `PoseStamped`, `TransformStamped`, `PoseWithCovarianceStamped` | `pos`, `quat` | |
| `nav_msgs/Odometry` | `pos`, `quat`, `vel`, `ang_vel` | its twist is in the body frame |
| `TwistStamped` | `vel` | in the world; one of a body frame is left out |
| `sensor_msgs/Imu` | `ang_vel`, `acc` | |
| `mavros_msgs/AttitudeTarget` | `cmd_angles`, `cmd_thrust` | thrust 0 to 1; masked rows are empty |
| `sensor_msgs/BatteryState` | `battery` | |
| `px4_msgs/*` | as in a ULog file | `diagnosis.importing.ulog` |

Frames are those of REP 103 (ENU, FLU) except in `px4_msgs`. Times are those of the header where
there is one, else of the recording. Topics below one name (`/cf1/pose`, `/cf1/imu`) are one drone;
where only one of them has an input, the others are that drone's, too. Where several topics could be
one field, `--topic FIELD=TOPIC` chooses, once for each drone. Other set points than of an attitude
are left out.
"""

import dataclasses
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float64

from diagnosis.importing.frames import rpy_of, to_world
from diagnosis.importing.reader import (
    FIELDS,
    AbstractReader,
    Recording,
    Request,
    Stream,
    known_voltage,
    reading,
)
from diagnosis.importing.ulog import HOVER, TOPICS, px4_streams
from diagnosis.logs.columns import LogError

MAGICS = (b"#ROSBAG V2.0", b"\x89MCAP0\r\n")
"""First bytes of a ROS 1 bag and of MCAP."""
SQLITE = b"SQLite format 3\x00"
"""First bytes of a database; with the ending .db3 it is a part of a ROS 2 bag."""
DEPTH = 2
"""Parts that a topic's name has at least where the first of them is a drone: /cf1/pose."""
SHARED = ("mavros", "fmu", "vrpn_client_node", "vrpn_mocap", "vicon", "qualisys", "mocap")
"""First parts of topics' names that are no drone's."""
DRIVEN_BY = frozenset({"cmd_thrust", "rotor_vel", "pwm"})
"""Fields that tell a drone from what looks at one."""
SET_POINT = "setpoint"
"""Part of the names of mavros' topics that are asked for, not flown."""
BODY_FRAMES = ("base_link", "body", "fcu")
"""Parts of the names of frames that turn with a drone (REP 105, mavros)."""
IGNORE_ATTITUDE, IGNORE_THRUST = 128, 64
"""Bits of `AttitudeTarget.type_mask`; MAVLink, `ATTITUDE_TARGET_TYPEMASK`."""


class BagReader(AbstractReader):
    """Bags of ROS 1 and ROS 2."""

    name: ClassVar[str] = "ros"
    label: ClassVar[str] = "ROS bag"
    package: ClassVar[str] = "rosbags"
    extra: ClassVar[str] = "ros"

    def recognises(self, path: Path, head: bytes) -> bool:
        if path.is_dir():
            return (path / "metadata.yaml").is_file()
        return head.startswith(MAGICS) or (head.startswith(SQLITE) and path.suffix == ".db3")

    def read(self, path: Path, request: Request) -> Recording:
        highlevel, types = self.module("rosbags.highlevel"), self.module("rosbags.typesys")
        store = types.get_typestore(types.Stores.LATEST)
        with reading("ROS bag"), highlevel.AnyReader([path], default_typestore=store) as bag:
            wanted = [c for c in bag.connections if _kind(c.msgtype) in (*_FIELDS_OF, *_PX4)]
            rows: dict[tuple[str, str], list[tuple[float, Any]]] = {}
            unknown = set()
            for connection, stamp, raw in bag.messages(wanted) if wanted else ():
                if connection.msgtype not in bag.typestore.fielddefs:
                    unknown.add(connection.msgtype)
                    continue
                message = bag.deserialize(raw, connection.msgtype)
                key = (connection.topic, _kind(connection.msgtype))
                rows.setdefault(key, []).append((_time(message, stamp), message))
            topics = sorted({f"{c.topic} ({c.msgtype})" for c in bag.connections})
            return _recording(rows, topics, sorted(unknown), request)


def _kind(msgtype: str) -> str:
    """A message's type without its package's folder: `geometry_msgs/PoseStamped`."""
    return msgtype.replace("/msg/", "/")


def _time(message: Any, stamp: int) -> float:
    """When a message was made [s]: its header's time, else when it was recorded."""
    header = getattr(message, "header", None)
    if header is not None and (header.stamp.sec or header.stamp.nanosec):
        return header.stamp.sec + header.stamp.nanosec * 1e-9
    return stamp * 1e-9


def _recording(
    rows: dict[tuple[str, str], list[tuple[float, Any]]],
    topics: list[str],
    unknown: list[str],
    request: Request,
) -> Recording:
    """Streams of every drone in the bag."""
    drones: dict[str, list[Stream]] = {}
    px4: dict[tuple[str, int], dict[str, str]] = {}
    notes = [f"The bag does not say what {name} holds; it is left out." for name in unknown]
    for (topic, kind), found in sorted(rows.items(), key=lambda item: item[0]):
        if kind in _PX4:
            # A second topic of one kind (/fmu/in, /fmu/out) stands beside the first.
            drone, name = _drone(topic), _PX4[kind]
            n = sum(name in names for (one, _), names in px4.items() if one == drone)
            px4.setdefault((drone, n), {})[name] = topic
            continue
        t = np.asarray([time for time, _ in found], np.float64)
        messages = [message for _, message in found]
        if (why := _left_out(topic, kind, messages)) is not None:
            notes.append(f"{topic} is left out: {why}.")
            continue
        for stream in _FIELDS_OF[kind](topic, t, messages, request):
            drones.setdefault(_drone(topic), []).append(stream)
    missing = [f"Of {len(topics)} topics none is of a known type: {', '.join(topics)[:300]}."]
    missing = [] if rows else missing
    for (drone, n), names in px4.items():
        tables = {name: _table([m for _, m in rows[names[name], _OF_PX4[name]]]) for name in names}
        streams, more, also = px4_streams(tables, request, None)
        drones.setdefault(drone, []).extend(_named(stream, names) for stream in streams)
        missing, notes = missing + (more if n == 0 else []), notes + also
    drones = _with_inputs(drones)
    _check_topics(drones, request)
    chosen = {name: tuple(_chosen(streams, request)) for name, streams in drones.items()}
    return Recording(chosen, tuple(missing), tuple(notes))


def _left_out(topic: str, kind: str, messages: list[Any]) -> str | None:
    """Why a topic says nothing of how a drone flew or was told to; None if it does."""
    if kind in _OF_POSE and SET_POINT in topic:
        return "it is a set point"
    if kind == _TWIST and all(any(b in m.header.frame_id for b in BODY_FRAMES) for m in messages):
        return f"its velocities are in the frame {messages[0].header.frame_id}, not in the world's"
    return None


def _named(stream: Stream, topics: dict[str, str]) -> Stream:
    """A stream of PX4's messages, by the names of its topics."""
    name, _, rest = stream.source.partition(" ")
    return dataclasses.replace(stream, source=f"{topics[name]} {rest}")


def _with_inputs(drones: dict[str, list[Stream]]) -> dict[str, list[Stream]]:
    """Each drone's streams.

    Names without an input (a camera, motion capture, a battery) are no drones: they are the only
    drone's, or are left out where there are several.
    """
    fields = {name: {stream.field for stream in streams} for name, streams in drones.items()}
    driven = [name for name in drones if fields[name] & DRIVEN_BY]
    if len(driven) == 1:
        return {driven[0]: [stream for streams in drones.values() for stream in streams]}
    if driven:
        return {name: drones[name] for name in driven}
    return {name: drones[name] for name in drones if {"pos", "quat"} & fields[name]} or drones


def _topic(stream: Stream) -> str:
    return stream.source.split()[0]


def _check_topics(drones: dict[str, list[Stream]], request: Request) -> None:
    """Raises LogError if a topic that was asked for is not there."""
    every = [stream for streams in drones.values() for stream in streams]
    for field, topics in request.topics.items():
        could = [_topic(stream) for stream in every if stream.field == field]
        for wanted in topics:
            if wanted not in could:
                found = ", ".join(could) or "none"
                raise LogError(f"--topic {field}={wanted}: there is no such topic; found: {found}.")


def _drone(topic: str) -> str:
    """The drone that a topic belongs to; empty where its name does not say."""
    parts = topic.strip("/").split("/")
    return parts[0] if len(parts) >= DEPTH and parts[0] not in SHARED else ""


def _chosen(streams: list[Stream], request: Request) -> Iterable[Stream]:
    """One stream for each field.

    Raises:
        LogError: Several topics could be one field.
    """
    for field in dict.fromkeys(stream.field for stream in streams):
        could = [stream for stream in streams if stream.field == field]
        names = ", ".join(map(_topic, could))
        wanted = [x for x in could if _topic(x) in request.topics.get(field, ())]
        could = wanted or could
        if len(could) > 1:
            raise LogError(
                f"several topics could be {field}: {names}; choose one with --topic {field}=TOPIC."
            )
        yield could[0]


def _xyz(vectors: Iterable[Any]) -> Float64[np.ndarray, "rows 3"]:
    return np.asarray([[v.x, v.y, v.z] for v in vectors], np.float64)


def _xyzw(quats: Iterable[Any]) -> Float64[np.ndarray, "rows 4"]:
    return np.asarray([[q.x, q.y, q.z, q.w] for q in quats], np.float64)


Maker = Callable[[str, np.ndarray, list[Any], Request], list[Stream]]
"""Streams of one topic's messages and times."""


def _pose(topic: str, t: np.ndarray, messages: list[Any], request: Request) -> list[Stream]:
    poses = [getattr(message.pose, "pose", message.pose) for message in messages]
    pos, quat = _xyz(p.position for p in poses), _xyzw(p.orientation for p in poses)
    return [Stream("pos", t, pos, topic), Stream("quat", t, quat, topic)]


def _transform(topic: str, t: np.ndarray, messages: list[Any], request: Request) -> list[Stream]:
    moves = [message.transform for message in messages]
    pos, quat = _xyz(m.translation for m in moves), _xyzw(m.rotation for m in moves)
    return [Stream("pos", t, pos, topic), Stream("quat", t, quat, topic)]


def _odometry(topic: str, t: np.ndarray, messages: list[Any], request: Request) -> list[Stream]:
    pos, quat = _pose(topic, t, messages, request)
    twists = [message.twist.twist for message in messages]
    vel, change = _xyz(twist.linear for twist in twists), "body to world"
    if all(m.child_frame_id in ("", m.header.frame_id) for m in messages):
        change = "as it is: child_frame_id names the world"
    else:
        vel = to_world(quat.values, vel)
    rates = _xyz(twist.angular for twist in twists)
    return [pos, quat, Stream("vel", t, vel, topic, change), Stream("ang_vel", t, rates, topic)]


def _twist(topic: str, t: np.ndarray, messages: list[Any], request: Request) -> list[Stream]:
    return [Stream("vel", t, _xyz(message.twist.linear for message in messages), topic)]


def _imu(topic: str, t: np.ndarray, messages: list[Any], request: Request) -> list[Stream]:
    rates = _xyz(message.angular_velocity for message in messages)
    acc = _xyz(message.linear_acceleration for message in messages)
    return [Stream("ang_vel", t, rates, topic), Stream("acc", t, acc, topic)]


def _target(topic: str, t: np.ndarray, messages: list[Any], request: Request) -> list[Stream]:
    rpy = rpy_of(_xyzw(message.orientation for message in messages))
    thrust = np.asarray([[message.thrust] for message in messages], np.float64)
    mask = np.asarray([int(message.type_mask) for message in messages])
    rpy[mask & IGNORE_ATTITUDE > 0] = np.nan
    thrust[mask & IGNORE_THRUST > 0] = np.nan
    scale, words = request.scale(None, HOVER)
    return [
        Stream("cmd_angles", t, rpy, topic, "to roll, pitch, yaw"),
        Stream("cmd_thrust", t, scale * thrust, topic, words),
    ]


def _battery(topic: str, t: np.ndarray, messages: list[Any], request: Request) -> list[Stream]:
    volts = np.asarray([[message.voltage] for message in messages], np.float64)
    return [Stream("battery", t, known_voltage(volts), topic)]


_FIELDS_OF: dict[str, Maker] = {
    "geometry_msgs/PoseStamped": _pose,
    "geometry_msgs/PoseWithCovarianceStamped": _pose,
    "geometry_msgs/TransformStamped": _transform,
    "nav_msgs/Odometry": _odometry,
    "geometry_msgs/TwistStamped": _twist,
    "sensor_msgs/Imu": _imu,
    "mavros_msgs/AttitudeTarget": _target,
    "sensor_msgs/BatteryState": _battery,
}
"""Types of messages that are read, and what makes streams of them."""
_TWIST = "geometry_msgs/TwistStamped"
"""A velocity in any frame."""
_OF_POSE = {kind for kind, made in _FIELDS_OF.items() if made in (_pose, _twist)}
"""Types of messages in which set points come, too."""

_PX4 = {"px4_msgs/" + "".join(part.title() for part in name.split("_")): name for name in TOPICS}
"""Types of PX4's messages, and their names in uORB."""
_OF_PX4 = {name: kind for kind, name in _PX4.items()}
"""The other way round."""


def _table(messages: list[Any]) -> dict[str, np.ndarray]:
    """Fields of PX4's messages over time, as a ULog file names them."""
    table: dict[str, np.ndarray] = {}
    for name in vars(messages[0]):
        values = [getattr(message, name) for message in messages]
        if np.ndim(values[0]) == 0 and np.isscalar(values[0]) and not isinstance(values[0], str):
            table[name] = np.asarray(values)
        elif isinstance(values[0], np.ndarray):
            for i in range(len(values[0])):
                table[f"{name}[{i}]"] = np.asarray([value[i] for value in values])
        elif name == "esc":  # an array of messages, one for each motor
            for i in range(len(values[0])):
                speeds = [value[i].esc_rpm for value in values]
                table[f"esc[{i}].esc_rpm"] = np.asarray(speeds)
    return table


NAMED = re.compile(rf"({'|'.join(FIELDS)})=(/\S+)")
"""How `--topic` names a field and its topic."""
