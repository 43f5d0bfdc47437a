"""The last states of every world, and copies of them from when a world diverged."""

import copy
import json
from collections import deque
from pathlib import Path

import mujoco
import numpy as np
import torch

from mjlab_sim.config import NanGuardCfg
from mjlab_sim.nan.dump import FORMAT, NanDump, write_dump
from mjlab_sim.simulation import Simulation
from mjlab_sim.tensors import plain


class NanGuard:
  """Memory on the device for the replay of a divergence, written to a file on request.

  `record` stores the state and controls that a physics step starts from; `keep` copies the memory of worlds that
  diverged, with their model fields, before they restart. Neither waits for the device. `report` does: it is called
  once per log interval, and writes the file.

  Args:
    sim: The worlds.
    decimation: Physics steps per environment step.
    cfg: How much is kept.
  """

  def __init__(self, sim: Simulation, decimation: int, cfg: NanGuardCfg) -> None:
    self._sim = sim
    self._cfg = copy.copy(cfg)
    n, dtype, slots = sim.num_envs, sim.dtype, cfg.max_envs_to_dump
    fields = sim._fresh.state()
    self._layout = {name: tuple(field.shape[1:]) for name, field in fields.items()}
    # State stays in its memory, so that these views stay good.
    self._fields = [field.view(n, -1) for field in fields.values()]
    width = sum(field.shape[1] for field in self._fields)
    with sim.device:
      self._step = torch.zeros(decimation, n, width, dtype=dtype)
      self._ring = torch.zeros(cfg.buffer_size, decimation, n, width, dtype=dtype)
      # A world that is not kept is written to the last slot, which is not read.
      self._kept = torch.zeros(slots + 1, decimation * cfg.buffer_size, width, dtype=dtype)
      self._last = torch.zeros(slots + 1, width + sim.mj_model.nv, dtype=dtype)
      self._tags = torch.zeros(slots + 1, 2, dtype=torch.int64)
      self._num_steps = torch.zeros(1, dtype=torch.int64)
      self._num_kept = torch.zeros((), dtype=torch.int64)
      self._diverged = torch.zeros(n, dtype=torch.bool)
      # Worlds that diverged since the last report, however often.
      self._since_report = torch.zeros(n, dtype=torch.bool)
      self._order = torch.arange(cfg.buffer_size)
      self._ranks = torch.arange(min(slots, n))
      # Among many worlds the first by number are found.
      self._priority = torch.arange(n, 0, -1)
    # On a CPU the host knows the slot that is due. NumPy writes straight to it, and starts faster than torch.
    self._on_host = sim.device.type == "cpu"
    if self._on_host:
      self._host_fields = [field.numpy() for field in self._fields]
      # The slot that is due is the first.
      self._host_slots = deque(list(slot.numpy()) for slot in self._ring)
    self._model: dict[str, torch.Tensor] = {}
    self._num_reports = 0

  @property
  def num_bytes(self) -> int:
    """Memory on the device [B]."""
    return sum(value.nbytes for value in vars(self).values() if isinstance(value, torch.Tensor))

  def record(self, substep: int) -> None:
    """Store the state before physics step `substep` of an environment step; the last one completes the step."""
    is_last = substep == len(self._step) - 1
    if self._on_host:
      np.concatenate(self._host_fields, axis=1, out=self._host_slots[0][substep])
      if is_last:
        self._host_slots.rotate(-1)
    else:
      self._pack(self._step[substep])
      if is_last:
        self._ring.index_copy_(0, self._num_steps % len(self._ring), self._step[None])
    if is_last:
      self._num_steps += 1

  def keep(self, diverged: torch.Tensor) -> None:
    """Copy the memory of worlds that diverged in this environment step; call it before they are reset.

    Args:
      diverged: Worlds whose state is not finite, bool (num_envs,).
    """
    # Looking costs nothing on a CPU; a recording cannot look, and does the work in every step.
    if self._on_host and not diverged.numpy().any():
      self._diverged.zero_()
      return
    fresh = diverged & ~self._diverged
    self._diverged.copy_(diverged)
    self._since_report |= fresh
    found, worlds = torch.topk(fresh * self._priority, len(self._ranks))
    slots = torch.where(found > 0, self._num_kept + self._ranks, len(self._kept) - 1).clamp_(max=len(self._kept) - 1)
    newest_last = (self._num_steps + self._order) % self._cfg.buffer_size
    history = self._ring[:, :, worlds][newest_last]
    self._kept.index_copy_(0, slots, history.flatten(0, 1).transpose(0, 1))
    now = self._pack()
    self._last.index_copy_(0, slots, torch.cat([now[worlds], self._sim.data.qacc[worlds]], dim=1))
    self._tags.index_copy_(0, slots, torch.stack([worlds, self._num_steps.expand_as(worlds)], dim=1))
    for name in self._sim.expanded_fields:
      field = plain(self._sim._engine.model_field(name))
      if name not in self._model:
        # A field may be expanded at any time, and the first step after that may run in inference mode.
        with torch.inference_mode(False):
          self._model[name] = torch.zeros(len(self._kept), *field.shape[1:], dtype=field.dtype, device=field.device)
      self._model[name].index_copy_(0, slots, field[worlds])
    self._num_kept += fresh.sum()

  def report(self, run_dir: Path | None = None) -> list[str]:
    """Return one sentence for each divergence since the last report, and write a file if there is a folder for it.

    Reads the device. A file that cannot be written is a sentence, not an error. After `max_dumps` reports there are
    no more.

    Args:
      run_dir: Folder of a run, whose `nan_dumps` is the folder where the config names none.
    """
    total = int(self._num_kept)
    self._num_kept.zero_()
    num_worlds = int(self._since_report.sum()) if total else 0
    self._since_report.zero_()
    if not total or self._num_reports == self._cfg.max_dumps:
      return []
    self._num_reports += 1
    contents = self._contents(min(total, len(self._kept) - 1))
    worlds = NanDump(contents).worlds
    lines = [f"world {world.index} diverged: {world.describe_first()}" for world in worlds]
    if more := num_worlds - len({world.index for world in worlds}):
      lines.append(f"{more} more world{'s' * (more > 1)} of {self._sim.num_envs} diverged")
    if total > num_worlds:
      lines.append(f"they diverged {total} times in all")
    folder = self._cfg.output_dir or (run_dir and run_dir / "nan_dumps")
    if folder is not None:
      try:
        path = write_dump(Path(folder), contents)
        lines.append(f"their last states are in {path}; look at them with: viz-nan {path}")
      except OSError as error:
        lines.append(f"the NaN dump could not be written: {error}")
    if self._num_reports == self._cfg.max_dumps:
      lines.append("worlds that diverge from now on are only counted (--env.sim.nan-guard.max-dumps)")
    return lines

  def _pack(self, out: torch.Tensor | None = None) -> torch.Tensor:
    return torch.cat([field.to(self._step.dtype) for field in self._fields], dim=1, out=out)

  def _contents(self, count: int) -> dict[str, np.ndarray]:
    model = np.empty(mujoco.mj_sizeModel(self._sim.mj_model), dtype=np.uint8)
    mujoco.mj_saveModel(self._sim.mj_model, None, model)
    about = {
      "format": FORMAT,
      "mujoco": mujoco.__version__,
      "engine": self._sim.engine,
      "decimation": len(self._step),
      "layout": self._layout,
    }
    return {
      "about": np.array(json.dumps(about)),
      "mjb": model,
      "worlds": self._tags[:count].cpu().numpy(),
      "states": self._kept[:count].cpu().numpy(),
      "last": self._last[:count].cpu().numpy(),
      **{f"model/{name}": field[:count].cpu().numpy() for name, field in self._model.items()},
    }
