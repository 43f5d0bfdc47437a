"""Model fields with one value per world, their defaults, and the saved state of a simulation."""

from collections.abc import Iterable, Iterator, Mapping

import mujoco
import torch
from mjlab_core.mujoco.model_fields import PER_WORLD, SOURCES
from mjlab_core.state import refuse_state

from mjlab_sim.fields import closure, owner_of
from mjlab_sim.freshness import Freshness, ModelView
from mjlab_sim.tensors import plain

State = dict[str, dict[str, torch.Tensor]]


class WorldFields:
  """Model fields of all worlds.

  Args:
    fresh: The worlds.
    model: The compiled model.
  """

  def __init__(self, fresh: Freshness, model: mujoco.MjModel) -> None:
    self._fresh, self._mj_model = fresh, model
    self._view = ModelView(fresh)
    self.expanded: dict[str, None] = {}
    """Fields with one value per world, in the order in which they were expanded."""
    self._defaults: dict[str, torch.Tensor] = {}

  def missing(self, names: Iterable[str]) -> list[str]:
    """Return those of `names`, and of the fields that follow from them, that worlds still share.

    Raises:
      UnknownNameError: A name that cannot differ per world.
    """
    field_of = self._fresh.engine.model_field
    found = closure(list(names), self._mj_model)
    return [name for name in found if name not in self.expanded and field_of(name).numel() > 0]

  def expand(self, names: list[str]) -> None:
    """Give shared fields one value per world."""
    self._fresh.expand(names)
    self.expanded |= dict.fromkeys(names)

  def default(self, name: str) -> torch.Tensor:
    """Return the compiled value, (1, ...), as a fresh tensor, or that of each world where it was rebased."""
    if name in self._defaults:
      return self._defaults[name]
    view = self._view[name]
    value = torch.as_tensor(getattr(*owner_of(self._mj_model, name)), dtype=view.dtype, device=view.device)
    return value.reshape(1, *view.shape[1:]).clone()

  def rebase_default(self, name: str) -> None:
    """Make the present values of an expanded field the default of each world."""
    now = self._view[name].detach()
    self._defaults.setdefault(name, torch.empty_like(now)).copy_(now)

  def state_dict(self) -> State:
    """Return all that the next step depends on, as fresh tensors.

    Model fields that all worlds share are in it where they are not as compiled.
    """
    shared = closure(self._written_shared(), self._mj_model)
    return {
      "data": {name: field.clone() for name, field in self._fresh.state().items()},
      "model": self._values(self.expanded),
      "shared": self._values(name for name in shared if name not in self.expanded),
      "default": {name: field.clone() for name, field in self._defaults.items()},
    }

  def check(self, state: State) -> State:
    """Return a state with the parts that it may lack; raise MjlabError where it does not fit."""
    state = {"default": {}, "shared": {}, **state}
    refuse_state(
      f"saved state lacks '{kind}', it has: {', '.join(state)}" for kind in ("data", "model") if kind not in state
    )
    as_compiled = {name: self.default(name) for name in self._written_shared() if name not in state["model"]}
    state["shared"] = as_compiled | state["shared"]
    own = PER_WORLD & {*state["model"], *self.expanded}
    shared = PER_WORLD & {*state["shared"]} - {*self.expanded}
    here: dict[str, Mapping[str, torch.Tensor]] = {
      "data": self._fresh.state(),
      "model": {name: self._view[name] for name in own},
      "shared": {name: self._view[name] for name in shared},
      "default": self._defaults,
    }
    for kind, fields in here.items():
      refuse_state(self._problems(kind, state[kind], fields))
    return state

  def _problems(self, kind: str, saved: dict[str, torch.Tensor], here: Mapping[str, torch.Tensor]) -> Iterator[str]:
    """Yield the reasons why saved fields do not fit those here."""
    if differing := sorted(saved.keys() ^ here.keys()):
      yield f"saved {kind} fields are not those here; they differ by {', '.join(differing)}"
    for name, value in saved.items():
      shape = (1 if kind == "shared" else self._fresh.num_envs, *here[name].shape[1:])
      if shape != value.shape:
        yield f"saved {kind} field '{name}' has shape {tuple(value.shape)}, here it is {shape}"

  def load(self, state: State) -> bool:
    """Write a checked state; return True if other fields follow from a written field."""
    for name, value in state["data"].items():
      self._fresh.engine.data_field(name).copy_(value)
    for name, value in state["default"].items():
      self._defaults[name].copy_(value)
    self.load_model(state)
    self._fresh.note_write(model=True)
    return not SOURCES.isdisjoint(state["shared"] | state["model"])

  def load_model(self, state: State) -> None:
    """Write the model fields of a checked state."""
    for name, value in (state["shared"] | state["model"]).items():
      self._fresh.engine.model_field(name).copy_(value)

  def _written_shared(self) -> list[str]:
    """Return the fields that all worlds share and that are not as compiled; reads the device."""
    shared = [name for name in self._fresh.model_fields if name not in self.expanded]
    return [name for name in shared if not torch.equal(plain(self._fresh.model_fields[name]), self.default(name))]

  def _values(self, names: Iterable[str]) -> dict[str, torch.Tensor]:
    fields = {name: self._fresh.engine.model_field(name).detach().clone() for name in names}
    return {name: field for name, field in fields.items() if field.numel()}
