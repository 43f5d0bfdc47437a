"""The last states of every world, and copies of them from when a world diverged."""

import copy
import json
import math
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
    cfg: Sizes of the memory and of files.
  """

  def __init__(self, sim: Simulation, decimation: int, cfg: NanGuardCfg) -> None:
    self._sim = sim
    self._cfg = copy.copy(cfg)
    n, dtype = sim.num_envs, sim.dtype
    fields = sim._fresh.state()
    self._shapes = {name: tuple(field.shape[1:]) for name, field in fields.items()}
    # State stays in its memory, so that these views stay good.
    self._fields = [field.view(n, -1) for field in fields.values()]
    width = sum(field.shape[1] for field in self._fields)
    with sim.device:
      self._step = torch.zeros(decimation, n, width, dtype=dtype)
      self._ring = torch.zeros(cfg.buffer_size, decimation, n, width, dtype=dtype)
      self._num_steps = torch.zeros(1, dtype=torch.int64)
      self._num_kept = torch.zeros((), dtype=torch.int64)
      self._diverged = torch.zeros(n, dtype=torch.bool)
      # Worlds that diverged since the last report, however often.
      self._since_report = torch.zeros(n, dtype=torch.bool)
      self._order = torch.arange(cfg.buffer_size)
      self._ranks = torch.arange(min(cfg.max_envs_to_dump, n))
      # Among many worlds the first by number are found.
      self._priority = torch.arange(n, 0, -1)
    self._kept: dict[str, torch.Tensor] = {}
    """Arrays of the next file, (max_envs_to_dump + 1, ...). Worlds that are not kept are written to the last row."""
    self._on_host = sim.device.type == "cpu"
    if self._on_host:
      # NumPy starts faster than torch.
      self._host_fields = [field.numpy() for field in self._fields]
      self._host_ring, self._host_num_steps = self._ring.numpy(), self._num_steps.numpy()
    self._num_reports = 0

  @property
  def num_bytes(self) -> int:
    """Memory on the device [B]."""
    values = [*vars(self).values(), *self._kept.values()]
    return sum(value.nbytes for value in values if isinstance(value, torch.Tensor))

  def record(self, substep: int) -> None:
    """Store the state before physics step `substep` of an environment step; the last one completes the step."""
    is_last = substep == len(self._step) - 1
    if self._on_host:
      slot = self._host_num_steps[0] % len(self._host_ring)
      np.concatenate(self._host_fields, axis=1, out=self._host_ring[slot, substep])
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
    unused = self._cfg.max_envs_to_dump
    rows = torch.where(found > 0, self._num_kept + self._ranks, unused).clamp_(max=unused)
    newest_last = (self._num_steps + self._order) % len(self._ring)
    history = self._ring[:, :, worlds][newest_last].flatten(0, 1)
    values = {
      "worlds": torch.stack([worlds, self._num_steps.expand_as(worlds)], dim=1),
      "states": torch.cat([history, self._pack()[None, worlds]]).transpose(0, 1),
      "qacc": self._sim.data.qacc[worlds],
    }
    for name in self._sim.expanded_fields:
      values[f"model/{name}"] = plain(self._sim._engine.model_field(name))[worlds]
    for name, value in values.items():
      if name not in self._kept:
        # A field may be expanded at any time, and the first step after that may run in inference mode.
        with torch.inference_mode(False):
          self._kept[name] = torch.zeros(unused + 1, *value.shape[1:], dtype=value.dtype, device=value.device)
      self._kept[name].index_copy_(0, rows, value)
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
    contents = self._contents(min(total, self._cfg.max_envs_to_dump))
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
    }
    kept = {name: values[:count].cpu() for name, values in self._kept.items()}
    states = kept.pop("states").split([math.prod(shape) for shape in self._shapes.values()], dim=-1)
    for (name, shape), values in zip(self._shapes.items(), states, strict=True):
      kept[f"state/{name}"] = values.unflatten(-1, shape) if shape else values.squeeze(-1)
    contents = {name: values.numpy() for name, values in kept.items()}
    return {"about": np.array(json.dumps(about)), "mjb": model, **contents}
