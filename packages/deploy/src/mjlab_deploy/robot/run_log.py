"""Log of a run: as MCAP with JSON messages, written by the library `mcap`, and as a plot, drawn by Matplotlib."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mjlab_deploy.arrays import write_arrays
from mjlab_deploy.errors import library, reading

_COLUMNS = 4
STATES, COMMANDS, OPERATOR = "/joint_states", "/joint_commands", "/operator_commands"
"""Topics; the first two have the fields of `sensor_msgs/JointState`, which `mjlab-sysid` reads too."""


def write_log(path: Path, joints: Sequence[str], rows: Mapping[str, np.ndarray]) -> None:
  """Write the rows of a run as .mcap if the path ends so, or else as .npz.

  Raises:
    DeployError: The file cannot be written, or a library is not installed.
  """
  if path.suffix == ".mcap":
    write_mcap(path, joints, rows)
  else:
    with reading(path):
      write_arrays(path, rows)


def write_mcap(path: Path, joints: Sequence[str], rows: Mapping[str, np.ndarray]) -> None:
  """Write one message of each topic per row.

  Args:
    path: File to write.
    joints: Names of the joints.
    rows: "time" (rows,) [s], "position", "velocity" and "target" (rows, joints); others go to the operator's topic.

  Raises:
    DeployError: The library is not installed, or the file cannot be written.
  """
  mcap = library("mcap.writer", "an MCAP log needs the extra 'mcap' of mjlab-deploy")
  others = [name for name in rows if name not in ("time", "position", "velocity", "target")]
  with reading(path), path.open("wb") as file:
    writer = mcap.Writer(file)
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


def plot_joints(path: Path, joints: Sequence[str], rows: Mapping[str, np.ndarray]) -> None:
  """Draw target and position of each joint over time.

  Args:
    path: Picture to write: .png, .svg or .pdf.
    joints: Names of the joints.
    rows: "time" (rows,) [s], "position" and "target" (rows, joints), "is_policy" (rows,), as in the log of a run.

  Raises:
    DeployError: Matplotlib is not installed, or the picture cannot be written.
  """
  matplotlib = library("matplotlib.figure", "a plot needs the extra 'plot' of mjlab-deploy")
  count = max(1, min(_COLUMNS, len(joints)))
  lines = -(-len(joints) // count)
  figure = matplotlib.Figure(figsize=(3.2 * count, 1.0 + 1.9 * lines), layout="constrained")
  axes = figure.subplots(lines, count, sharex=True, squeeze=False).ravel()
  time, starts = rows["time"], np.flatnonzero(rows["is_policy"] > 0)
  for axis in axes[len(joints) :]:
    axis.axis("off")
  for axis, name, target, position in zip(axes, joints, rows["target"].T, rows["position"].T, strict=False):
    axis.plot(time, target, color="tab:orange", linewidth=1.0, label="target")
    axis.plot(time, position, color="tab:blue", linewidth=1.0, label="position")
    for start in time[starts[:1]]:
      axis.axvline(start, color="0.6", linewidth=0.8, linestyle=":")
    axis.set_title(name, fontsize=8)
    axis.tick_params(labelsize=7, labelbottom=True)
    axis.grid(alpha=0.3)
  figure.supxlabel("time [s]", fontsize=8)
  handles, labels = axes[0].get_legend_handles_labels()
  figure.legend(handles, labels, loc="outside upper right", ncols=2, fontsize=8)
  figure.suptitle("Joints [rad, m]; the policy begins at the dotted line", x=0.01, ha="left", fontsize=9)
  with reading(path, ValueError):
    figure.savefig(path, dpi=110)
