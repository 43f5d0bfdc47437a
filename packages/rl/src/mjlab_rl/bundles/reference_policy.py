"""Policies for other runners: the network alone, from observations to actions, with the metadata of mjlab 1.x."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from mjlab_core.io.files import AtomicWrite
from mjlab_deploy import DeployError, Description
from mjlab_deploy.formats.other_formats import REFERENCE_OUTPUTS, onnx_metadata, unitree_deploy_yaml
from torch import nn

from mjlab_rl.bundles.policy_graph import export_onnx


def write_for_others(folder: Path, env: Any, network: Any, description: Description) -> Path:
  """Write files for other runners.

  `policy.onnx` has the metadata of mjlab 1.x. If the policy follows a clip, the network also takes `time_step` and
  returns the clip's frame, as BeyondMimic's does, and `motion.npz` holds the clip for runners that take a pair of
  files, such as LeRobot's. `deploy.yaml` is written if Unitree's runner has all terms of the policy.

  Args:
    folder: Folder to write; replaced.
    env: Environment of the policy.
    network: The policy's network, a model of rsl-rl.
    description: Contents of the policy's `bundle.json`.

  Returns:
    The folder.
  """
  exported: Any = network.as_onnx(verbose=False).to("cpu").eval()
  module, inputs = exported, tuple(exported.get_dummy_inputs())
  input_names, output_names = list(exported.input_names), list(exported.output_names)
  metadata = onnx_metadata(description)
  clip: dict[str, Any] = {}
  if (motion := description.motion) is not None:
    term = env.command_manager.get_term(motion.name)
    clip.update(fps=np.array([motion.rate]), **term.reference_arrays())
    followed = list(term.cfg.bodies)
    metadata["body_names"] = ",".join(followed)
    columns = [list(clip["body_names"]).index(body) for body in followed]
    module = _WithClip(exported, clip, columns)
    inputs = (*inputs, torch.zeros(1, 1))
    input_names, output_names = [*input_names, "time_step"], [*output_names, *REFERENCE_OUTPUTS]
  model = export_onnx(module, inputs, input_names, output_names)
  onnx.helper.set_model_props(model, metadata)
  with AtomicWrite(folder) as made:
    made.mkdir()
    onnx.save(model, made / "policy.onnx")
    if clip:
      np.savez_compressed(made / "motion.npz", **clip)
    try:
      (made / "deploy.yaml").write_text(unitree_deploy_yaml(description), encoding="utf-8")
    except DeployError as error:
      (made / "NO_DEPLOY_YAML.txt").write_text(f"{error}\n", encoding="utf-8")
  return folder


class _WithClip(nn.Module):
  """Network with the frames of a clip, which `time_step` selects; steps after the end show the last frame."""

  def __init__(self, network: nn.Module, clip: Mapping[str, np.ndarray], bodies: list[int]) -> None:
    super().__init__()
    self.network = network
    for name in REFERENCE_OUTPUTS:
      value = clip[name][:, bodies] if name.startswith("body_") else clip[name]
      self.register_buffer(f"clip_{name}", torch.from_numpy(np.ascontiguousarray(value)).float())
    self._last = len(clip["joint_pos"]) - 1

  def forward(self, *inputs: torch.Tensor) -> tuple[torch.Tensor, ...]:
    result = self.network(*inputs[:-1])
    frame = inputs[-1].reshape(-1).long().clamp(0, self._last)
    shown = [getattr(self, f"clip_{name}")[frame] for name in REFERENCE_OUTPUTS]
    return (*(result if isinstance(result, tuple) else (result,)), *shown)
