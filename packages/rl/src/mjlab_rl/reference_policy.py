"""Policies for other runners: the network alone, from observations to actions, with the metadata of mjlab 1.x."""

import warnings
from pathlib import Path
from typing import Any

import onnx
import torch
from mjlab_core.files import AtomicWrite
from mjlab_deploy import DeployError, Description
from mjlab_deploy.other_formats import onnx_metadata, unitree_deploy_yaml


def write_for_others(folder: Path, network: Any, description: Description) -> Path:
  """Write `policy.onnx` with metadata, and `deploy.yaml` if Unitree's runner knows all that the policy needs.

  Args:
    folder: Folder to write; replaced.
    network: The policy's network, a model of rsl-rl.
    description: Contents of the policy's `bundle.json`.

  Returns:
    The folder.
  """
  exported: Any = network.as_onnx(verbose=False).to("cpu").eval()
  with warnings.catch_warnings():
    # The exporter's own.
    warnings.simplefilter("ignore")
    program = torch.onnx.export(
      exported,
      exported.get_dummy_inputs(),
      None,
      input_names=exported.input_names,
      output_names=exported.output_names,
      opset_version=18,
      dynamo=True,
      verbose=False,
    )
  assert program is not None
  model = program.model_proto
  onnx.helper.set_model_props(model, onnx_metadata(description))
  with AtomicWrite(folder) as made:
    made.mkdir()
    onnx.save(model, made / "policy.onnx")
    try:
      (made / "deploy.yaml").write_text(unitree_deploy_yaml(description), encoding="utf-8")
    except DeployError as error:
      (made / "NO_DEPLOY_YAML.txt").write_text(f"{error}\n", encoding="utf-8")
  return folder
