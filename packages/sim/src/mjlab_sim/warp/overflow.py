"""Demand for MuJoCo Warp's buffers: high-water marks on the device, and the sizes that follow from them."""

from collections.abc import Mapping
from typing import Any

import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp

from mjlab_sim.config import SimulationCfg
from mjlab_sim.warp import engine_kernels as kernels
from mjlab_sim.warp.buffers import grown

_Kind = mjw.OverflowType
_DROPPED = _Kind.BROADPHASE | _Kind.NARROWPHASE | _Kind.CCD
_BUFFERS = {
  "nconmax": (_DROPPED, "contacts on average"),
  "njmax": (_Kind.NEFC | _Kind.NJMAX_NNZ, "constraint rows"),
  "contact_sensor_maxmatch": (_Kind.CONTACT_MATCH, "contacts of one sensor"),
}
"""The overflow bits of each setting, and the unit of the setting."""
_LIMITS = {
  _Kind.HFIELD: "a geom covers more height-field cells than MuJoCo Warp looks at; use coarser cells",
  _Kind.EPA_HORIZON: "convex collision gave up on a deep contact",
  _Kind.TACTILE: "a tactile sensor touches more geoms than MuJoCo Warp looks at",
}
"""Limits of MuJoCo Warp that no setting raises."""


class Overflow:
  """High-water marks since the simulation was made.

  Each line of advice is twice the high-water mark. The next line follows only when the mark has outgrown it. Sizes that
  are "auto" follow the demand instead. A GPU is not waited for: its marks arrive some steps later.
  """

  def __init__(self, d: mjw.Data, cfg: SimulationCfg) -> None:
    self._d: Any = d
    device = d.qpos.device
    self._seen: Any = wp.zeros(d.nworld, dtype=wp.int32, device=device)
    self._most: Any = wp.zeros(3, dtype=wp.int32, device=device)
    self._growing = [name for name in ("nconmax", "njmax") if getattr(cfg, name) == "auto"]
    self._news: list[str] = []
    if device.is_cuda:
      # An event that was never recorded counts as done.
      self._most_torch, self._arrival = wp.to_torch(self._most), torch.cuda.Event()
      self._arrived = torch.zeros(3, dtype=torch.int32, pin_memory=True)
    self._fits = {
      "nconmax": d.naconmax // d.nworld,
      "njmax": d.njmax,
      "contact_sensor_maxmatch": cfg.contact_sensor_maxmatch,
    }
    self._advised = dict(self._fits)
    self._said: set[int] = set()

  def count(self) -> None:
    """Note the demand of the physics step just done."""
    d = self._d
    wp.launch(
      kernels.count_overflow,
      dim=d.nworld,
      inputs=[d.overflow, d.nefc, d.nacon, d.ncollision],
      outputs=[self._seen, self._most],
    )

  @property
  def sizes(self) -> dict[str, int]:
    """Present sizes of the buffers, by setting."""
    return {name: self._fits[name] for name in ("nconmax", "njmax")}

  def wanted(self, at_least: Mapping[str, int]) -> dict[str, int]:
    """Return larger sizes for buffers that are nearly full, or smaller than `at_least`; none if all have room."""
    if not self._growing:
      return {}
    demand = self._demand()
    sizes = self.sizes
    for name in self._growing:
      sizes[name] = max(grown(sizes[name], demand[name]), at_least.get(name, 0))
    return sizes if sizes != self.sizes else {}

  def note_growth(self, sizes: Mapping[str, int]) -> None:
    """Note the present sizes; reads the device."""
    seen, grew = self._seen.numpy(), [name for name in self._growing if sizes[name] > self._fits[name]]
    changes = ", ".join(f"{name} from {self._fits[name]} to {sizes[name]}" for name in grew)
    bits = sum(int(_BUFFERS[name][0]) for name in grew)
    lost = _count(seen, bits)
    # Contacts that did not fit since the last physics step are computed again before they are used.
    self._d.overflow.zero_()
    self._seen.assign(seen & ~bits)
    self._fits |= sizes
    self._advised |= sizes
    settings = " ".join(f"--env.sim.{name} {sizes[name]}" for name in self._growing)
    dropped = f", after {lost} of {self._d.nworld} worlds had lost contacts" if lost else ""
    self._news.append(f"buffers grew: {changes}{dropped}. A repeat to the last bit needs {settings}.")

  def _demand(self) -> dict[str, int]:
    """Return the demand of this moment; on a GPU that of the steps whose high-water marks have arrived."""
    d = self._d
    if not d.qpos.device.is_cuda:
      return self._per_setting(*(max(count.list()) for count in (d.nefc, d.nacon, d.ncollision)))
    if not self._arrival.query():
      return dict.fromkeys(self._growing, 0)
    demand = self._per_setting(*self._arrived.tolist())
    self._arrived.copy_(self._most_torch, non_blocking=True)
    self._arrival.record()
    return demand

  def _per_setting(self, rows: int, contacts: int, pairs: int) -> dict[str, int]:
    d = self._d
    if pairs > d.naconmax > 0:
      # Pairs that did not fit were not searched; they would have as many contacts as the others.
      contacts = contacts * pairs // d.naconmax
    return {"nconmax": -(-max(contacts, pairs) // d.nworld), "njmax": rows, "contact_sensor_maxmatch": 0}

  def report(self) -> list[str]:
    """Return the lines that are new since the last call. Reads the device."""
    d, fits, seen = self._d, self._fits, self._seen.numpy()
    counted = self._per_setting(*self._most.list())
    wanted, needs = {}, []
    for name, (bits, unit) in _BUFFERS.items():
      if count := _count(seen, bits):
        # The buffers of convex collision, of sparse matrices and of sensors overflow without a count.
        wanted[name] = max(counted[name], fits[name] + 1)
        needs.append(f"{count} of {d.nworld} worlds needed at least {wanted[name]} {unit} ({name} is {fits[name]})")
    if "nconmax" in wanted and 2 * counted["njmax"] > fits["njmax"]:
      # Contacts were dropped before their rows were counted.
      wanted.setdefault("njmax", counted["njmax"])
    lines, self._news = self._news, []
    if any(count > self._advised[name] for name, count in wanted.items()):
      self._advised |= {name: max(self._advised[name], -(-2 * count // 8) * 8) for name, count in wanted.items()}
      settings = " ".join(f"--env.sim.{name.replace('_', '-')} {self._advised[name]}" for name in wanted)
      lines.append(f"buffers overflowed and contacts were dropped: {'; '.join(needs)}. Set {settings}.")
    for bit, what in _LIMITS.items():
      count = _count(seen, bit)
      if count and bit not in self._said:
        self._said.add(bit)
        lines.append(f"{what}: {count} of {d.nworld} worlds.")
    return lines


def _count(seen: np.ndarray, bits: int) -> int:
  return int(np.count_nonzero(seen & int(bits)))
