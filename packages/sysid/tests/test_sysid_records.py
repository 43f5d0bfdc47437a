"""Records by name and in SI units from three formats, and one-line errors of wrong ones."""

import io
import json
import math
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from mjlab_core import FileError, MjlabError, UnknownNameError
from mjlab_sysid import Record, check_joints, read_records, uniform, write_record

ROWS = 40
JOINTS = ("hip", "knee")
AXES = {"x": 0.0, "y": 0.0, "z": 0.0}
UPRIGHT = {"w": 1.0, **AXES}


def record(**changes: Any) -> Record:
  """Two joints for 0.4 s, with an IMU; efforts of the knee alone."""
  random = np.random.default_rng(0)
  signals = {name: random.normal(size=(ROWS, 2)) for name in ("position_target", "position", "velocity", "effort")}
  signals["effort"][:, 0] = np.nan
  signals |= {name: random.normal(size=(ROWS, 3)) for name in ("angular_velocity", "linear_acceleration")}
  given: dict[str, Any] = {"source": "test", "joints": JOINTS, "time": 0.01 * np.arange(ROWS), "signals": signals}
  return Record(**(given | changes))


def same(one: Record, other: Record) -> None:
  assert one.joints == other.joints
  assert one.signals.keys() == other.signals.keys()
  np.testing.assert_allclose(one.time, other.time, atol=1e-9)
  for name, values in one.signals.items():
    np.testing.assert_allclose(values, other.signals[name], rtol=1e-7)


@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_a_written_record_is_read_again(tmp_path: Path, suffix: str) -> None:
  write_record(record(), tmp_path / f"a.{suffix}")
  (found,) = read_records([tmp_path / f"a.{suffix}"])
  same(record(), found)
  assert (found.period, found.num_rows, found.ignored) == (0.01, ROWS, ())
  assert found.has("effort", "knee")
  assert not found.has("effort", "hip")


def test_columns_come_in_any_order_and_unit_and_others_are_named(tmp_path: Path) -> None:
  lines = ["velocity/knee [rpm],temperature,position/hip [deg],time [ms],position/knee"]
  lines += [f"{60 * k},20,{90 * k},{10 * k},{k}" for k in range(3)]
  (tmp_path / "a.csv").write_text("\n".join(lines))
  (found,) = read_records([tmp_path / "a.csv"])
  assert found.ignored == ("temperature",)
  np.testing.assert_allclose(found.time, [0.0, 0.01, 0.02])
  np.testing.assert_allclose(found.of("position", ["hip", "knee"])[2], [math.pi, 2.0])
  np.testing.assert_allclose(found.of("velocity", ["knee"])[1], 2.0 * math.pi)


def test_arrays_name_their_units(tmp_path: Path) -> None:
  values: dict[str, Any] = {"position": np.full((3, 1), 180.0), "position_target": np.zeros((3, 1))}
  np.savez(
    tmp_path / "a.npz", time=np.arange(3), joints=["hip"], units=["position=deg", "time=ms"], extra=[1], **values
  )
  (found,) = read_records([tmp_path / "a.npz"])
  np.testing.assert_allclose(found.signals["position"], math.pi)
  assert found.period == 0.001
  assert found.ignored == ("extra",)


def test_each_segment_and_file_is_a_record(tmp_path: Path) -> None:
  text = "time,position,segment\n" + "".join(f"{k},0,{name}\n" for name in ("left", "right") for k in range(3))
  (tmp_path / "a.csv").write_text(text)
  found = read_records([tmp_path / "a.csv", tmp_path / "a.csv"])
  assert [part.num_rows for part in found] == [3, 3, 3, 3]
  assert found[1].source.endswith("a.csv, segment right")
  assert found[0].joints == ("joint",)


def test_rounded_times_give_the_period(tmp_path: Path) -> None:
  (tmp_path / "a.csv").write_text("time,position\n" + "".join(f"{k / 240:.6f},0\n" for k in range(2400)))
  (found,) = read_records([tmp_path / "a.csv"])
  assert math.isclose(found.period, 1 / 240, rel_tol=1e-6)


def write_mcap(path: Path, topics: dict[str, list[tuple[float, dict[str, Any]]]]) -> None:
  with path.open("wb") as file:
    writer = Writer(file)
    writer.start()
    for topic, messages in topics.items():
      channel = writer.register_channel(topic=topic, message_encoding="json", schema_id=0)
      for time, message in messages:
        stamp = round(time * 1e9)
        writer.add_message(channel, log_time=stamp, publish_time=stamp, data=json.dumps(message).encode())
    writer.finish()


def test_states_have_the_command_before_them_in_an_mcap_file(tmp_path: Path) -> None:
  states = [(0.01 * k, {"name": ["hip", "knee"], "position": [k, -k], "velocity": [1, 2]}) for k in range(10)]
  # Commands of the joints in another order, half as often.
  commands = [(0.02 * k + 0.005, {"name": ["knee", "hip"], "position": [10 * k, 20 * k]}) for k in range(5)]
  imu = [
    (0.01 * k, {"angular_velocity": {"x": k, "y": 0, "z": 0}, "linear_acceleration": {"x": 0, "y": 0, "z": 9.8}})
    for k in range(10)
  ]
  write_mcap(tmp_path / "a.mcap", {"/joint_states": states, "/joint_commands": commands, "/imu": imu})
  (found,) = read_records([tmp_path / "a.mcap"])
  assert found.joints == JOINTS
  assert found.num_rows == 9
  np.testing.assert_allclose(found.of("position", JOINTS)[3], [4.0, -4.0])
  np.testing.assert_allclose(found.of("position_target", JOINTS)[3], [20.0, 10.0])
  np.testing.assert_allclose(found.signals["angular_velocity"][3], [4.0, 0.0, 0.0])
  # The base has another clock, here half as fast; q and -q are one orientation.
  turned = {"x": 0.0, "y": 0.0, "z": -math.sin(0.1), "w": -math.cos(0.1)}
  base = [
    (0.02 * k, {"pose": {"position": {"x": 2 * k, "y": 0, "z": 1}, "orientation": turned if k % 2 else UPRIGHT}})
    for k in range(6)
  ]
  topics = {"/joint_states": states, "/joint_commands": commands, "/base_pose": base}
  write_mcap(tmp_path / "c.mcap", topics)
  (free,) = read_records([tmp_path / "c.mcap"])
  np.testing.assert_allclose(free.signals["base_position"][3], [4.0, 0.0, 1.0], atol=1e-9)
  half = [math.cos(0.05), 0.0, 0.0, math.sin(0.05)]
  np.testing.assert_allclose(np.abs(free.signals["base_orientation"][2]), half, atol=1e-3)
  # Motion capture that has lost the body writes zeros.
  topics["/base_pose"] = [(time, {"pose": {"position": AXES, "orientation": {"w": 0.0, **AXES}}}) for time, _ in base]
  write_mcap(tmp_path / "d.mcap", topics)
  with pytest.raises(FileError, match=r"d\.mcap: base_orientation is not a unit quaternion"):
    read_records([tmp_path / "d.mcap"])
  write_mcap(tmp_path / "b.mcap", {"/joint_state": states})
  with pytest.raises(FileError, match=r"b\.mcap: topic '/joint_states' does not exist\. Nearest: /joint_state"):
    read_records([tmp_path / "b.mcap"])


def test_gaps_and_uneven_rows_are_resampled_with_a_warning() -> None:
  whole = record()
  keep = np.r_[0:10, 20:ROWS]
  gap = record(time=whole.time[keep], signals={name: values[keep] for name, values in whole.signals.items()})
  with pytest.warns(UserWarning, match=r"test: 1 gaps, the longest of 0\.11 s, while rows are 0\.01 s apart"):
    parts = uniform(gap)
  assert [part.num_rows for part in parts] == [10, 20]
  time = 0.002 * np.arange(200) + np.random.default_rng(1).uniform(0.0, 0.001, 200)
  sine = {"position": np.sin(5.0 * time)[:, None], "position_target": np.arange(200.0)[:, None]}
  with pytest.warns(UserWarning, match="% of the rows are not"):
    (part,) = uniform(Record(source="test", joints=("hip",), time=time, signals=sine), period=0.01)
  np.testing.assert_allclose(part.signals["position"][:, 0], np.sin(5.0 * part.time), atol=1e-3)
  # Targets are held, never blended.
  assert set(part.signals["position_target"].ravel()) <= set(map(float, range(200)))


def test_even_rows_stay_as_they_are() -> None:
  with warnings.catch_warnings():
    warnings.simplefilter("error")
    (part,) = uniform(record())
  same(part, record())


@pytest.mark.parametrize(
  ("text", "message"),
  [
    ("", "column 'time' does not exist"),
    ("time,position\n", r"a\.csv: no rows below the header"),
    ("tme,position\n0,0\n", "line 1: column 'time' does not exist. Nearest: tme"),
    ("time,temperature\n0,0\n", "no column of a joint"),
    ("time,position/a,position/a\n0,0,0\n", "line 1: column 'position/a' is there twice"),
    ("time,position [degrees]\n0,0\n", r"column 'position \[degrees\]': unit of position 'degrees' does not exist"),
    ("time,position,velocity\n0,0,0\n1,0\n", "line 3: 2 fields, but the header has 3"),
    ("time,position\n0,0\n\n1,fast\n", r"a\.csv: line 4, column 'position': 'fast' is not a finite number"),
    ("time,position\n0,nan\n", "line 2, column 'position': 'nan' is not a finite number"),
    ("time,position\n0,0\n", "1 rows; a record has at least two"),
    ("time,position\n2,0\n1,0\n", r"row 2: time 1 s is not after that of the previous row; sort the rows"),
    ("time,position\n1,0\n1,0\n", r"row 2: time 1 s is not after that of the previous row; sort the rows"),
  ],
)
def test_a_wrong_csv_is_refused_by_line_and_column(tmp_path: Path, text: str, message: str) -> None:
  path = tmp_path / "a.csv"
  path.write_text(text)
  with pytest.raises(FileError, match=message) as raised:
    read_records([path])
  assert "\n" not in str(raised.value)


def test_other_files_are_refused_by_name(tmp_path: Path) -> None:
  for name, content, message in (
    ("nowhere.csv", None, r"nowhere\.csv: no such file"),
    ("a.txt", b"", r"a\.txt: ending '\.txt' does not exist"),
    ("b.csv", b"time,\xff\xfe", r"b\.csv: .*codec can't decode"),
    ("c.npz", b"PK\x03\x04 not really", r"c\.npz: File is not a zip file"),
    ("d.mcap", b"\x89MCAP0\r\n" + bytes(50), r"record .*d\.mcap: "),
  ):
    if content is not None:
      (tmp_path / name).write_bytes(content)
    with pytest.raises(FileError, match=message) as raised:
      read_records([tmp_path / name])
    assert "\n" not in str(raised.value)


def test_a_hostile_archive_is_refused_before_its_data_are_read(tmp_path: Path) -> None:
  header = io.BytesIO()
  np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 10**6)})
  with zipfile.ZipFile(tmp_path / "bomb.npz", "w") as archive:
    archive.writestr("time.npy", header.getvalue())
  with pytest.raises(FileError, match=r"time unpacks to .* MiB; the limit is for all numbers of a file 1024 MiB"):
    read_records([tmp_path / "bomb.npz"])
  np.savez(tmp_path / "objects.npz", time=np.array([{}], dtype=object))
  with pytest.raises(FileError, match="time holds Python objects, which are not read"):
    read_records([tmp_path / "objects.npz"])
  np.savez(tmp_path / "nan.npz", time=np.arange(3.0), joints=["hip"], position=[[0.0], [np.nan], [0.0]])
  with pytest.raises(FileError, match="row 2: position of 'hip' is not a finite number"):
    read_records([tmp_path / "nan.npz"])
  np.savez(tmp_path / "order.npz", time=np.arange(3.0), joints=["hip"], position=np.zeros((1, 3)))
  with pytest.raises(FileError, match=r"signal 'position' is \(1, 3\), expected \(3, 1\)"):
    read_records([tmp_path / "order.npz"])


def test_names_and_units_are_checked_against_a_robot() -> None:
  ranges = {"hip": (-1.0, 1.0), "knee": (-math.inf, math.inf)}
  degrees = dict(record().signals) | {"position": 57.3 * np.ones((ROWS, 2))}
  with pytest.raises(FileError, match=r"positions of 'hip' reach 57\.3, its range is \[-1, 1\]; name the unit"):
    check_joints(record(signals=degrees), ranges)
  with pytest.raises(UnknownNameError, match=r"joint 'hip' does not exist\. Nearest: hips"):
    check_joints(record(), {"hips": (-1.0, 1.0)})
  check_joints(record(signals={"position": np.zeros((ROWS, 2))}), ranges)


def test_a_missing_signal_is_named(tmp_path: Path) -> None:
  (tmp_path / "a.csv").write_text("time,position,velocty\n0,0,0\n1,0,0\n")
  (found,) = read_records([tmp_path / "a.csv"])
  with pytest.raises(FileError, match="joint 'joint' has no signal 'velocity'; not read: velocty"):
    found.of("velocity", found.joints)
  with pytest.raises(MjlabError, match="pattern 'hip' matches no joint"):
    found.select("hip")
