"""Files of worlds that diverged: the first bad number, and a replay in MuJoCo C."""

import contextlib
import copy
import itertools
import json
import os
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
from mjlab_core import AtomicWrite, FileError, reading

from mjlab_sim.fields import owner_of, put

FORMAT = "mjlab NaN dump 2"

# State that a physics step computes; the rest is only ever written from outside.
_INTEGRATED = ("qpos", "qvel", "act", "qacc_warmstart", "time")
# MuJoCo's limit for a bad state (mjMAXVAL).
_BOUND = 1e10


@dataclass(kw_only=True, frozen=True)
class Replay:
  """Stored steps of a diverged world, run again in MuJoCo C."""

  diverged_at: int | None
  """Physics step after which MuJoCo C's state was not finite, or beyond 1e10, either; None if there is none."""
  qpos: np.ndarray
  """Positions after each physics step, (steps, nq)."""
  error: float
  """Largest difference of a position to the recorded one, over steps after which both are good."""


class DivergedWorld:
  """The last states of one world, oldest first, since its last reset.

  Args:
    dump: The file it is from.
    row: Row of the world in the file.
  """

  def __init__(self, dump: "NanDump", row: int) -> None:
    self._dump = dump
    self.index, self.env_step = (int(number) for number in dump.contents["worlds"][row])
    """Number of the world, and environment steps of the simulation, including the one in which it diverged."""
    fields = dump.fields("state", row)
    time = fields["time"][: -1 : dump.decimation]
    # Steps before the begin of the run have no state. Steps before a reset have a later time.
    begins = np.flatnonzero(np.diff(time) <= 0) + 1
    first = max(begins.max(initial=0), len(time) - self.env_step) * dump.decimation
    self.states = {name: values[first:] for name, values in fields.items()}
    """Fields of MjData before each physics step and after the last, (num_steps + 1, ...)."""
    self.qacc: np.ndarray = dump.contents["qacc"][row]
    """Acceleration of the last physics step, (nv,)."""
    self.model_fields = dump.fields("model", row)
    """Model fields that were expanded, with the values of this world."""

  @property
  def num_steps(self) -> int:
    """Physics steps stored."""
    return len(self.states["time"]) - 1

  def describe_first(self) -> str:
    """Return the first number that was not finite or beyond 1e10, in a sentence.

    Controls and forces come before the state that they act on.
    """
    last = self.num_steps
    for step in range(last + 1):
      numbers = {name: values[step] for name, values in self.states.items()}
      if step == last:
        numbers["qacc"] = self.qacc
      for name in sorted(numbers, key=lambda name: name in _INTEGRATED):
        for index in np.flatnonzero(~(np.abs(numbers[name]) <= _BOUND)):
          element, value = _element(self._dump.model, name, int(index)), numbers[name].flat[index]
          return f"{name} of {element} was {value:.3g} {self.when(step)}{self._cause(name, step)}"
    return "no stored number is beyond 1e10"

  def _cause(self, name: str, step: int) -> str:
    if step == self.num_steps:
      return ""
    if name not in _INTEGRATED:
      return ": it was written so"
    if step % self._dump.decimation == 0:
      return ": an event, a reset or a command wrote it so, or the step before left it so"
    return ""

  def when(self, step: int) -> str:
    """Return the time of a stored state in words."""
    decimation = self._dump.decimation
    if step == self.num_steps:
      return f"after physics step {decimation} of {decimation} of environment step {self.env_step}"
    env_step = self.env_step - (self.num_steps - 1 - step) // decimation
    return f"before physics step {step % decimation + 1} of {decimation} of environment step {env_step}"

  def replay(self) -> Replay:
    """Run the stored steps again in MuJoCo C, from the first stored state of each environment step that is finite."""
    model = self._make_model()
    data = mujoco.MjData(model)
    qpos, error, diverged_at = [], 0.0, None
    for step in range(self.num_steps):
      begins = step % self._dump.decimation == 0
      for name, values in self.states.items():
        # Events may write the state between environment steps; within one it is MuJoCo C's own.
        if name not in _INTEGRATED or (begins and np.isfinite(values[step]).all()):
          put(data, name, values[step])
      with contextlib.ExitStack() as stack:
        # MuJoCo reports by print and by a file in the working folder that a world diverged, which is known here.
        stack.callback(mujoco.set_mju_user_warning, mujoco.get_mju_user_warning())
        mujoco.set_mju_user_warning(lambda _: None)
        mujoco.mj_step(model, data)
      is_good = (np.abs(np.concatenate((data.qpos, data.qvel, data.qacc))) <= _BOUND).all()
      after = self.states["qpos"][step + 1]
      if is_good and np.isfinite(after).all():
        error = max(error, float(np.abs(data.qpos - after).max()))
      if diverged_at is None and not is_good:
        diverged_at = step
      qpos.append(data.qpos.copy())
    return Replay(diverged_at=diverged_at, qpos=np.array(qpos), error=error)

  def _make_model(self) -> mujoco.MjModel:
    """Return the model with the world's values, and without MuJoCo C's silent restart of a world that diverged."""
    model = copy.copy(self._dump.model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value
    for name, value in self.model_fields.items():
      put(*owner_of(model, name), value)
    recomputed = copy.copy(model)
    mujoco.mj_setConst(recomputed, mujoco.MjData(recomputed))
    # Engines do not show this derived constant per world. It follows if the others were recomputed.
    if np.allclose(recomputed.dof_invweight0, model.dof_invweight0, rtol=1e-4):
      model.dof_M0[:] = recomputed.dof_M0
    return model


class NanDump:
  """A dump, as `NanGuard` writes it.

  Args:
    contents: The arrays of the file.
  """

  def __init__(self, contents: dict[str, np.ndarray]) -> None:
    self.contents = contents
    about = json.loads(str(contents["about"]))
    self.engine: str = about["engine"]
    """Engine that diverged."""
    self.decimation: int = about["decimation"]
    """Physics steps per environment step."""
    self.worlds = [DivergedWorld(self, row) for row in range(len(contents["worlds"]))]

  @classmethod
  def load(cls, path: str | os.PathLike[str]) -> "NanDump":
    """Read a file without running anything in it.

    Raises:
      FileError: there is no such file, it is no dump, or MuJoCo is of another version than the one it is from.
    """
    with reading("NaN dump", path):
      # NumPy would take anything else for a pickle, and advise to load it unsafely.
      if not zipfile.is_zipfile(path):
        raise FileError("not an .npz file")
      with np.load(path, allow_pickle=False) as file:
        contents = {name: file[name] for name in file.files}
      about = json.loads(str(contents["about"]))
      for name, here in (("format", FORMAT), ("mujoco", mujoco.__version__)):
        if about[name] != here:
          raise FileError(f"{name} is '{about[name]}', here it is '{here}'")
      return cls(contents)

  @cached_property
  def model(self) -> mujoco.MjModel:
    """The model that all worlds began with."""
    return mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": self.contents["mjb"].tobytes()})

  def fields(self, kind: Literal["state", "model"], row: int) -> dict[str, np.ndarray]:
    """Return the stored fields of MjData or MjModel of one world, by name."""
    stored = ((name.partition("/"), values) for name, values in self.contents.items())
    return {name: values[row] for (found, _, name), values in stored if found == kind}


def write_dump(folder: Path, contents: dict[str, np.ndarray]) -> Path:
  """Write a dump into a folder under a name that is still free; the file appears whole or not at all."""
  step = int(contents["worlds"][0, 1])
  path, copies = folder / f"nan_dump_step_{step}.npz", itertools.count(2)
  while path.exists():
    path = folder / f"nan_dump_step_{step}_{next(copies)}.npz"
  with AtomicWrite(path) as temporary:
    np.savez_compressed(temporary, allow_pickle=False, **contents)
  return path


def _element(model: mujoco.MjModel, field: str, index: int) -> str:
  """Return the element that a number of a field belongs to, by name where it has one."""
  mocap = np.flatnonzero(model.body_mocapid >= 0)
  owners = {
    **dict.fromkeys(("qvel", "qacc", "qacc_warmstart", "qfrc_applied"), ("joint", model.dof_jntid)),
    "qpos": ("joint", np.repeat(np.arange(model.njnt), np.diff([*model.jnt_qposadr, model.nq]))),
    "act": ("actuator", np.repeat(np.arange(model.nu), model.actuator_actnum)),
    "ctrl": ("actuator", np.arange(model.nu)),
    "xfrc_applied": ("body", np.repeat(np.arange(model.nbody), 6)),
    "mocap_pos": ("body", np.repeat(mocap, 3)),
    "mocap_quat": ("body", np.repeat(mocap, 4)),
  }
  if field not in owners:
    return f"entry {index}"
  kind, elements = owners[field]
  number = int(elements[index])
  name = getattr(model, kind)(number).name
  return f"{kind} '{name}'" if name else f"{kind} {number}"
