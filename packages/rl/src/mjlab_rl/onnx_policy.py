"""Policies exported to ONNX, run on the host."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from mjlab_core import printable, unknown
from mjlab_core.errors import FileError
from mjlab_core.files import reading

from mjlab_rl.checkpoint import refuse, shape_problems
from mjlab_rl.config import RslRlBaseRunnerCfg
from mjlab_rl.env_protocol import RlEnv
from mjlab_rl.onnx_metadata import metadata_differences

_MAX_BYTES = 2**30


class OnnxPolicy:
  """A network exported with `export_policy_to_onnx`, or by mjlab 1.x, run by ONNX's reference evaluator: slow.

  Inputs are read by name: "obs", the image groups, "time_step" (the step of a motion), and recurrent states "NAME_in"
  with an output "NAME_out". Outputs other than "actions" and the states are ignored. Metadata is compared with the
  environment.

  Args:
    path: The file.
    agent: Configuration of the learner: the observation groups that the network sees.
    env: Environment that it acts in.

  Raises:
    FileError: It cannot be read, an input has another name, or it does not fit the environment.
  """

  def __init__(self, path: Path, agent: RslRlBaseRunnerCfg, env: RlEnv) -> None:
    import onnx
    from onnx.reference import ReferenceEvaluator

    self._path, self._env = path, env
    self._groups = list(agent.obs_groups[agent.policy])
    self._clip = agent.clip_actions
    self._are_worlds_alone: bool | None = None
    with reading("policy", path, _MAX_BYTES):
      try:
        model = onnx.load(path)
        self._network = ReferenceEvaluator(model)
      except Exception as error:
        raise FileError(f"not an ONNX network ({printable(error, 200)})") from error
      constants = {value.name for value in model.graph.initializer}
      self._shapes = {
        value.name: [d.dim_value for d in value.type.tensor_type.shape.dim]
        for value in model.graph.input
        if value.name not in constants
      }
      self._dtypes = {
        value.name: onnx.helper.tensor_dtype_to_np_dtype(value.type.tensor_type.elem_type)
        for value in model.graph.input
      }
      self._outputs = [value.name for value in model.graph.output]
      self._read_inputs()
      metadata = {item.key: item.value for item in model.metadata_props}
      refuse(f"policy {path}:", metadata_differences(metadata, env, self._groups))
    self.reset(None)

  def _read_inputs(self) -> None:
    """Find the meaning of each input and output by its name."""
    left = list(self._shapes)
    self._images = [
      group for group in self._groups if group in left and group != "obs" and len(self._shapes[group]) == 4
    ]
    memory = [name for name in left if name.endswith("_in") and f"{name[:-3]}_out" in self._outputs]
    left = [name for name in left if name not in (*self._images, *memory, "time_step")]
    if len(left) == 1 and len(self._shapes[left[0]]) == 2:
      self._input = left[0]
    elif "obs" in left:
      self._input = "obs"
    else:
      raise FileError(f"has no input 'obs' among its inputs: {printable(', '.join(self._shapes), 200) or 'none'}")
    if others := [name for name in left if name != self._input]:
      known = ["obs", "time_step", *self._groups, "h_in", "c_in"]
      raise FileError(unknown("meaning of input", printable(others[0], 80), known))
    self._memory_names = {name: f"{name[:-3]}_out" for name in memory}
    if any(len(self._shapes[name]) != 3 or not all(self._shapes[name][::2]) for name in memory):
      raise FileError(f"recurrent states must be (layers, worlds, width): {printable(memory, 200)}")
    actions = [name for name in self._outputs if name not in self._memory_names.values()]
    if not actions:
      raise FileError("has no output for actions")
    self._action = "actions" if "actions" in actions else actions[0]

  def __call__(self, observations: Mapping[str, torch.Tensor]) -> torch.Tensor:
    """Return actions (num_envs, num_actions) for observations by group.

    Raises:
      FileError: The network does not take such observations or does not return such actions.
    """
    with reading("policy", self._path):
      vectors = [observations[group] for group in self._groups if group not in self._images]
      seen = torch.cat(vectors, dim=-1)
      width = self._shapes[self._input][-1] if self._shapes[self._input] else 0
      if width not in (0, seen.shape[-1]):
        raise FileError(f"does not fit: it takes {width} observations, here are {seen.shape[-1]}")
      feed = {self._input: seen, **{group: observations[group] for group in self._images}}
      now = [feed[group].shape[1:] for group in self._images]
      trained = [self._shapes[group][1:] for group in self._images]
      refuse(f"policy {self._path}:", shape_problems(self._images, trained, now))
      if "time_step" in self._shapes:
        feed["time_step"] = self._time_step()[:, None]
      arrays = {name: value.cpu().numpy().astype(self._dtypes[name]) for name, value in feed.items()}
      actions = self._actions(arrays, len(seen))
      result = torch.from_numpy(actions).to(seen.device)
      return result if self._clip is None else result.clamp(-self._clip, self._clip)

  def _time_step(self) -> torch.Tensor:
    """Return the frame of the motion that each world follows, or the step of its episode, (num_envs,)."""
    manager: Any = getattr(self._env, "command_manager", None)
    for name in getattr(manager, "active_terms", ()):
      if isinstance(frame := getattr(manager.get_term(name), "frame", None), torch.Tensor):
        return frame
    return self._env.episode_length_buf

  def _actions(self, feed: dict[str, np.ndarray], count: int) -> np.ndarray:
    """Run all worlds together where the network allows that, and each alone where it was exported for one."""
    if self._are_worlds_alone is None and count > 1:
      self._are_worlds_alone = not self._is_batched(feed, count)
    if not self._are_worlds_alone:
      actions, memory = self._run(feed, slice(None))
    else:
      rows = [self._run({name: value[i : i + 1] for name, value in feed.items()}, [i]) for i in range(count)]
      actions = np.concatenate([row[0] for row in rows])
      memory = {name: np.concatenate([row[1][name] for row in rows], axis=1) for name in self._memory}
    self._memory = memory
    return actions

  def _is_batched(self, feed: dict[str, np.ndarray], count: int) -> bool:
    """Return True if the last world alone gets the actions that it gets among all."""
    if self._images or "time_step" in feed:
      return False
    alone, _ = self._run({name: value[-1:] for name, value in feed.items()}, [count - 1])
    try:
      together, _ = self._run(feed, slice(None))
    except Exception:
      return False
    return np.allclose(together[-1:], alone, rtol=1e-4, atol=1e-5, equal_nan=True)

  def _run(self, feed: dict[str, np.ndarray], worlds: Any) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    memory = {name: value[:, worlds] for name, value in self._memory.items()}
    with np.errstate(all="ignore"):
      values = dict(zip(self._outputs, self._network.run(None, {**feed, **memory}), strict=True))
    count = len(feed[self._input])
    actions, wanted = np.asarray(values[self._action]), (count, self._env.action_manager.total_action_dim)
    if actions.shape != wanted or not np.issubdtype(actions.dtype, np.floating):
      raise FileError(f"does not fit: its actions are {actions.dtype} {actions.shape}, the environment takes {wanted}")
    states = {name: np.asarray(values[output], np.float32) for name, output in self._memory_names.items()}
    for name, state in states.items():
      if state.shape != memory[name].shape:
        raise FileError(f"does not fit: '{name}' is {memory[name].shape} and comes back as {state.shape}")
    return actions.astype(np.float32), states

  def reset(self, dones: torch.Tensor | None) -> None:
    """Clear the recurrent states of these worlds, bool (num_envs,); None: of all."""
    if dones is None:
      shape = {name: (self._shapes[name][0], self._env.num_envs, self._shapes[name][2]) for name in self._memory_names}
      self._memory = {name: np.zeros(size, np.float32) for name, size in shape.items()}
    else:
      worlds = dones.cpu().numpy().astype(bool)
      for memory in self._memory.values():
        memory[:, worlds] = 0.0
