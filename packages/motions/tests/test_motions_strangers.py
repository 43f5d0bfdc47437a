"""Hostile files: sizes are read before data, texts stay on one line, and every mistake is one error."""

import io
import json
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mjlab_core.errors import FileError, MjlabError
from mjlab_core.io.npz import Npz
from mjlab_motions import Motion, Statement, derived_arrays, find_clips, load_motion, read_motion, resample, save_motion
from mjlab_motions.clips import MAX_BYTES
from motions_robot import arrays_of, constant, npz, qpos_of, robot, wiggle

EVIL = "\x1b[2J\nerror: disk erased\r\x07"
PEAK = 32 * 2**20  # bytes
Member = tuple[bytes, int, int]
"""Deflated data, and the size and the checksum that the archive claims."""


def bomb(start: bytes, size: int) -> Member:
  """A member of `size` bytes, `start` and then zeros, in a few kilobytes for each gigabyte."""
  packer = zlib.compressobj(9, zlib.DEFLATED, -15)
  first = packer.compress(start) + packer.flush(zlib.Z_FULL_FLUSH)
  block = packer.compress(bytes(2**20)) + packer.flush(zlib.Z_FULL_FLUSH)
  return first + block * ((size - len(start)) // 2**20) + packer.flush(), size, 0


def header(shape: tuple[int, ...], dtype: str = "<f8") -> bytes:
  """The beginning of a `.npy`."""
  text = repr({"descr": dtype, "fortran_order": False, "shape": shape}).ljust(117) + "\n"
  return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def member(value: Any) -> Member:
  np.save(buffer := io.BytesIO(), value)
  data = buffer.getvalue()
  return zlib.compress(data, wbits=-15), len(data), zlib.crc32(data)


def archive(path: Path, members: dict[str, Member]) -> Path:
  body, directory = b"", b""
  for name, (data, size, checksum) in members.items():
    file = f"{name}.npy".encode()
    facts = struct.pack("<HHHHHIIIHH", 20, 0, 8, 0, 0, checksum, len(data), size, len(file), 0)
    directory += b"PK\x01\x02\x14\x00" + facts + struct.pack("<HHHII", 0, 0, 0, 0, len(body)) + file
    body += b"PK\x03\x04" + facts + file + data
  counts = struct.pack("<HHHHIIH", 0, 0, len(members), len(members), len(directory), len(body), 0)
  path.write_bytes(body + directory + b"PK\x05\x06" + counts)
  return path


def peak(call: Callable[[], object]) -> int:
  """Return the peak memory of a call [bytes]."""
  tracemalloc.start()
  try:
    call()
    return tracemalloc.get_traced_memory()[1]
  finally:
    tracemalloc.stop()


def refused(path: Path, message: str) -> None:
  with pytest.raises(MjlabError, match=message) as caught:
    read_motion(path, robot(), Statement(rate=50.0, quaternion="wxyz"))
  assert len(str(caught.value).splitlines()) == 1


# Class: the size of data is known only after it has been unpacked.
@pytest.mark.parametrize(
  ("start", "message"),
  [
    (header((2**28,)), "joint_pos has shape .* expected 2-d numbers"),
    (header((2**20, 2**8)), "joint_pos unpacks to 2048 MiB; the limit is for all numbers of a file 512 MiB"),
    (header((2**26, 8), "|i1"), "joint_pos unpacks to 4096 MiB"),
    (header((2**62, 2**62)), "joint_pos unpacks to"),
    (header((-1, 8)), "joint_pos is not a readable array"),
    (header((2, 3), "|O"), "joint_pos holds Python objects"),
    (b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**31), "joint_pos is not a readable array"),
    (header((2**20, 2**8))[:-60] + b"(" * 59 + b"\n", "joint_pos is not a readable array"),
  ],
)
def test_an_array_is_refused_by_its_header(tmp_path: Path, start: bytes, message: str) -> None:
  path = archive(tmp_path / "bomb.npz", {"joint_pos": bomb(start, 2**31)})
  assert path.stat().st_size < 4 * 2**20
  assert peak(lambda: refused(path, message)) < PEAK


def test_a_name_that_unpacks_to_gigabytes_is_refused_by_its_header(tmp_path: Path) -> None:
  arrays = {name: member(value) for name, value in arrays_of(wiggle(), tmp_path / "arrays.npz").items()}
  text = bomb(header((), "<U500000000"), 2**31)
  assert (
    peak(lambda: refused(archive(tmp_path / "a.npz", {**arrays, "root_body": text}), "the limit is for a text")) < PEAK
  )
  names = bomb(header((2**29,), "<U1"), 2**31)
  path = archive(tmp_path / "a.npz", {**arrays, "joint_names": names})
  assert peak(lambda: refused(path, "joint_names unpacks to 2048 MiB; the limit is for a text 1 MiB")) < PEAK


def test_a_member_that_is_not_needed_is_not_unpacked(tmp_path: Path) -> None:
  arrays = {name: member(value) for name, value in arrays_of(wiggle(), tmp_path / "arrays.npz").items()}
  pictures = bomb(header((3 * 2**27,)), 3 * 2**30)
  path = archive(tmp_path / "clip.npz", {"pictures": pictures, **arrays, "joint_vel": pictures})
  assert peak(lambda: read_motion(path, robot())) < PEAK


def test_an_array_that_is_shorter_than_its_header_says_is_refused(tmp_path: Path) -> None:
  path = archive(tmp_path / "short.npz", {"joint_pos": bomb(header((2**20, 60)), 2**20)})
  refused(path, "joint_pos is not a readable array")


@pytest.mark.parametrize("name", ["large.csv", "large.npz", "library.json"])
def test_a_file_larger_than_the_limit_is_not_opened(tmp_path: Path, name: str) -> None:
  path = tmp_path / name
  save_motion(wiggle(), tmp_path / "clip.npz")
  with path.open("wb") as file:
    file.truncate(3 * 2**30)  # a hole, which takes no space
  if path.suffix == ".json":
    with pytest.raises(FileError, match="3072 MiB is more than the 1 MiB"):
      find_clips(str(tmp_path))
  else:
    assert peak(lambda: refused(path, "3072 MiB is more than the 512 MiB")) < PEAK


def test_a_line_of_a_csv_has_a_limit(tmp_path: Path) -> None:
  path = tmp_path / "wide.csv"
  path.write_text("1," * 200_000)
  refused(path, "a line has 400,000 characters; the limit is 65,536")


# Class: a rate out of bounds becomes a length that no memory holds.
@pytest.mark.parametrize("rate", [1e-9, 1e-320, 0.0, -50.0, 0.999, 10_001.0, 1e300, np.inf, np.nan])
def test_a_rate_out_of_bounds_is_refused_from_every_source(tmp_path: Path, rate: float) -> None:
  ours = arrays_of(wiggle(), tmp_path / "arrays.npz")
  theirs = {name: ours[name] for name in ("joint_pos", "joint_vel", "body_pos_w", "body_quat_w", "joint_names")}
  qpos = qpos_of(wiggle())
  np.savetxt(tmp_path / "clip.csv", qpos, delimiter=",")
  for arrays in (ours, theirs):
    with pytest.raises(MjlabError, match=r"rate must be"):
      read_motion(npz(tmp_path / "clip.npz", **arrays | {"fps": np.array([rate])}), robot())
  with pytest.raises(MjlabError, match=r"rate must be"):
    read_motion(tmp_path / "clip.csv", robot(), Statement(rate=rate))
  with np.errstate(all="ignore"):
    times = np.arange(60) / np.float64(rate)
  with pytest.raises(MjlabError, match=r"rate must be|not evenly spaced"):
    read_motion(npz(tmp_path / "clip.npz", qpos=qpos, times=times), robot())
  with pytest.raises(MjlabError, match=r"rate must be"):
    resample(wiggle(), rate)


def test_resampling_refuses_more_frames_than_a_motion_may_have() -> None:
  slow = wiggle(frames=201, rate=1.0)
  with pytest.raises(MjlabError, match=r"has 2,000,001 frames at 10000 Hz; the limit is 1,000,000"):
    resample(slow, 10_000.0)


# Class: a text of a file ends in a traceback or leaves its line.
@pytest.mark.parametrize(
  ("metadata", "message"),
  [
    ("[" * 100_000 + "]" * 100_000, ""),
    ('{"a":' * 100_000 + "1" + "}" * 100_000, ""),
    ('{"format": "mjlab-motion", "version": 1, "x": ' + "[" * 100_000 + "]" * 100_000 + "}", ""),
    ("{", ""),
    ("7", ""),
    ('{"format": 3}', ""),
    ('{"format": "mjlab-motion"}', "written in version None of the format, this reads version 1"),
    ('{"format": "mjlab-motion", "version": 2}', "written in version 2 of the format"),
    ('{"format": "mjlab-motion", "version": "1"}', r"Expected `int \| null`, got `str` - at `\$.version`"),
    ('{"format": "mjlab-motion", "version": 1, "name": 5}', r"Expected `str`, got `int` - at `\$.name`"),
    ('{"format": "mjlab-motion", "version": 1, "history": {}}', "Expected `array`, got `object`"),
    ('{"format": "mjlab-motion", "version": 1, "history": ["a", null]}', "Expected `str`, got `null`"),
  ],
)
def test_metadata_are_right_or_refused_or_those_of_another_format(tmp_path: Path, metadata: str, message: str) -> None:
  path = tmp_path / "odd.npz"
  npz(path, **arrays_of(wiggle(), path) | {"metadata": np.array(metadata)})
  if message:
    refused(path, message)
  else:
    # The arrays alone are those of another tool.
    assert read_motion(path, robot()).num_frames == 60
    with pytest.raises(FileError, match="not a motion file"):
      load_motion(path)


def test_texts_of_a_motion_have_neither_line_breaks_nor_control_characters(tmp_path: Path) -> None:
  names = (*constant().joint_names[:-1], EVIL)
  evil = constant().changed(EVIL, name=EVIL, source=EVIL, license=EVIL, root_body=EVIL, joint_names=names)
  save_motion(evil, tmp_path / "evil.npz")
  for motion in (evil, load_motion(tmp_path / "evil.npz")):
    words = (motion.name, motion.source, motion.license, motion.root_body, *motion.joint_names, *motion.history)
    assert all(word.isprintable() for word in words)
    assert motion.name.strip() == "[2J error: disk erased"
  metadata = {"format": "mjlab-motion", "version": 1, "name": EVIL, "source": EVIL, "history": [EVIL]}
  texts = {"metadata": np.array(json.dumps(metadata)), EVIL: np.zeros(3)}
  npz(tmp_path / "evil.npz", **arrays_of(wiggle(), tmp_path / "evil.npz") | texts)
  assert read_motion(tmp_path / "evil.npz", robot()).history[0].isprintable()
  assert Npz(tmp_path / "evil.npz", MAX_BYTES).names.isprintable()


def test_mutated_files_end_in_one_error_or_a_motion(tmp_path: Path) -> None:
  rng = np.random.default_rng(0)
  save_motion(wiggle(9), tmp_path / "ours.npz", derived_arrays(wiggle(9), robot()))
  np.savetxt(tmp_path / "table.csv", rng.normal(size=(5, 12)), delimiter=",")
  outcomes = []
  for name in ("ours.npz", "table.csv"):
    whole = (tmp_path / name).read_bytes()
    for _ in range(300):
      data = bytearray(whole)
      for _ in range(rng.integers(1, 8)):
        at = int(rng.integers(len(data)))
        kind = rng.integers(3)
        data[at : at + (kind == 1) * int(rng.integers(40))] = rng.bytes(int(rng.integers(1, 9))) if kind else b""
        data[at % len(data)] = rng.integers(256)
      path = tmp_path / f"mutated{Path(name).suffix}"
      path.write_bytes(data)
      try:
        outcomes.append(read_motion(path, robot(), Statement(rate=50.0, quaternion="wxyz")))
      except MjlabError as error:
        outcomes.append(error)
  assert len(outcomes) == 600
  assert {isinstance(outcome, Motion) for outcome in outcomes} == {True, False}
