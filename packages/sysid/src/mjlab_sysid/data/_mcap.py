"""Records from MCAP files of ROS 2 or of JSON messages, read by the library `mcap`."""

import functools
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from mjlab_core.errors import FileError
from mjlab_core.io.files import printable, reading
from mjlab_core.lazy import from_extra
from mjlab_core.names import check_name

from mjlab_sysid.data.records import JOINT_SIGNALS, Record, arranged, elements, interpolated

STATES, COMMANDS, IMU, BASE = "/joint_states", "/joint_commands", "/imu", "/base_pose"
"""Topics: two of `sensor_msgs/JointState` (name, position, velocity, effort), one of `sensor_msgs/Imu`, and one of
`geometry_msgs/PoseStamped`."""
_BODY_TOPICS: dict[str, dict[str, tuple[str, ...]]] = {
  IMU: {"angular_velocity": ("angular_velocity",), "linear_acceleration": ("linear_acceleration",)},
  BASE: {"base_position": ("pose", "position"), "base_orientation": ("pose", "orientation")},
}

_MAX_MESSAGES = 5_000_000


def read_mcap(path: Path) -> list[Record]:
  """Return the one record in an MCAP file: measurements at their times, with the latest command before each.

  Raises:
    FileError: The file is damaged, lacks a topic, or messages of one topic differ in their joints.
    ModuleNotFoundError: The library is not installed; the message says how to get it.
  """
  with from_extra("mcap", "mjlab-sysid", "an MCAP file"):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
  series: dict[str, list[tuple[float, Any]]] = {STATES: [], COMMANDS: [], IMU: [], BASE: []}
  with reading("record", path), path.open("rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
    present: set[str] = set()
    for schema, channel, message in reader.iter_messages():
      present.add(printable(channel.topic, 80))
      if channel.topic not in series:
        continue
      if sum(map(len, series.values())) >= _MAX_MESSAGES:
        raise FileError(f"more than {_MAX_MESSAGES} messages")
      if channel.message_encoding == "json":
        content = json.loads(message.data)
      else:
        decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
        if decode is None:
          raise FileError(f"topic {channel.topic}: {printable(channel.message_encoding, 40)!r} is neither cdr nor json")
        content = decode(message.data)
      series[channel.topic].append((message.log_time * 1e-9, content))
    for topic in (STATES, COMMANDS):
      check_name("topic", topic, sorted(present))
    return [_merged(printable(path, 200), series)]


def _merged(source: str, series: dict[str, list[tuple[float, Any]]]) -> Record:
  joints, time, measured = _joint_series(STATES, series[STATES])
  commanded, sent, commands = _joint_series(COMMANDS, series[COMMANDS])
  # Rows before the first command have no target.
  first = int(np.searchsorted(time, sent[0]))
  time, measured = time[first:], {name: values[first:] for name, values in measured.items()}
  latest = np.searchsorted(sent, time, side="right") - 1
  names = tuple(dict.fromkeys((*joints, *commanded)))
  signals = {name: arranged(values, joints, names) for name, values in measured.items()}
  signals |= {f"{name}_target": arranged(values[latest], commanded, names) for name, values in commands.items()}
  for topic, paths in _BODY_TOPICS.items():
    at = np.array([stamp for stamp, _ in series[topic]])
    for name, path in paths.items() if len(at) else ():
      found = [functools.reduce(_get, path, message) for _, message in series[topic]]
      values = np.array([[_get(part, axis) for axis in elements(name, ())] for part in found], np.float64)
      body = Record(source=source, joints=(), time=at, signals={name: values})
      signals[name] = interpolated(name, time, body.time, values)
  return Record(source=source, joints=names, time=time - time[0] if len(time) else time, signals=signals)


def _joint_series(
  topic: str, messages: Iterable[tuple[float, Any]]
) -> tuple[tuple[str, ...], np.ndarray, dict[str, np.ndarray]]:
  messages = list(messages)
  joints = tuple(printable(name, 120) for name in _get(messages[0][1], "name"))
  if any(list(_get(message, "name")) != list(joints) for _, message in messages):
    raise FileError(f"topic {topic}: messages name different joints")
  signals = {}
  for name in dict.fromkeys(JOINT_SIGNALS.values()):
    rows = [_get(message, name, ()) for _, message in messages]
    if any(len(row) for row in rows):
      signals[name] = np.array(rows, np.float64)
  return joints, np.array([stamp for stamp, _ in messages]), signals


def _get(message: Any, name: str, *default: Any) -> Any:
  """Return a field of a decoded message: an attribute in ROS 2, an item in JSON."""
  if isinstance(message, dict):
    return message.get(name, *default) if default else message[name]
  return getattr(message, name, *default)
