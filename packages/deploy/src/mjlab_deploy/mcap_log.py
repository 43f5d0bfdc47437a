"""Log of a run as MCAP with JSON messages, written by the library `mcap`."""

import importlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mjlab_deploy.errors import DeployError

STATES, COMMANDS, OPERATOR = "/joint_states", "/joint_commands", "/operator_commands"
"""Topics; the first two have the fields of `sensor_msgs/JointState`, which `mjlab-sysid` reads too."""


def write_mcap(path: Path, joints: Sequence[str], rows: Mapping[str, np.ndarray]) -> None:
  """Write one message of each topic per row.

  Args:
    path: File to write.
    joints: Names of the joints.
    rows: "time" (rows,) [s], "position", "velocity" and "target" (rows, joints); others go to the operator's topic.

  Raises:
    DeployError: The library is not installed, or the file cannot be written.
  """
  try:
    library = importlib.import_module("mcap.writer")
  except ModuleNotFoundError as error:
    raise DeployError("an MCAP log needs the library mcap: install mjlab-deploy with its extra 'mcap'") from error
  others = [name for name in rows if name not in ("time", "position", "velocity", "target")]
  try:
    with path.open("wb") as file:
      writer = library.Writer(file)
      writer.start()
      schema = writer.register_schema(name="json", encoding="jsonschema", data=b'{"type": "object"}')
      channels = {
        topic: writer.register_channel(topic=topic, message_encoding="json", schema_id=schema)
        for topic in (STATES, COMMANDS, OPERATOR)
      }
      for i, time in enumerate(rows["time"]):
        state = {name: rows[name][i].tolist() for name in ("position", "velocity")}
        messages = {
          STATES: {"name": list(joints), **state},
          COMMANDS: {"name": list(joints), "position": rows["target"][i].tolist()},
          OPERATOR: {name: rows[name][i].tolist() for name in others},
        }
        for topic, message in messages.items():
          # A command answers to a state, so it comes after it.
          stamp = round(float(time) * 1e9) + (topic == COMMANDS)
          data = json.dumps(message).encode()
          writer.add_message(channels[topic], log_time=stamp, publish_time=stamp, data=data)
      writer.finish()
  except OSError as error:
    raise DeployError(f"{path}: {error.strerror or error}") from error
