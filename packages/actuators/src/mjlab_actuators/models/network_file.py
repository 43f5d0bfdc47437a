"""Actuator networks in files, read without executing Python code of the file."""

import warnings
import zipfile
from pathlib import Path
from typing import Literal

import torch
from mjlab_core import FileError, reading

Activation = Literal["softsign", "elu", "relu", "tanh"]
"""Function between the linear layers of a network that is stored as a plain state dict."""

ACTIVATIONS: dict[str, type[torch.nn.Module]] = {
  "softsign": torch.nn.Softsign,
  "elu": torch.nn.ELU,
  "relu": torch.nn.ReLU,
  "tanh": torch.nn.Tanh,
}


def load_network(
  path: str | Path, *, num_inputs: int, activation: Activation, device: torch.device | str = "cpu"
) -> torch.nn.Module:
  """Return a network from rows (m, num_inputs) to (m, 1), in evaluation mode, without gradients.

  Args:
    path: A TorchScript archive, or a state dict saved by `torch.save` whose 2-D `*.weight` and 1-D `*.bias` entries are
      linear layers in order. The latter is read with `weights_only`, so that nothing in it is executed.
    num_inputs: Width that the network must have.
    activation: Function between the layers of a state dict; a TorchScript archive has its own.
    device: Device of the network.

  Raises:
    FileError: The file does not exist, is neither of the two, or holds a network of another width.
  """
  with reading("network file", path) as file:
    if _is_torchscript(file):
      with warnings.catch_warnings():
        # Torch advises against new archives, but many networks are stored in them.
        warnings.filterwarnings("ignore", message=".*torch.jit.load", category=FutureWarning)
        network = torch.jit.load(str(file), map_location=device)
    else:
      state = torch.load(file, map_location="cpu", weights_only=True)
      network = _from_state_dict(state, activation).to(device)
    network = network.eval()
    for parameter in network.parameters():
      parameter.requires_grad_(False)
    try:
      output = network(torch.zeros(2, num_inputs, device=device))
    except RuntimeError as error:
      # TorchScript puts its own traceback before the reason.
      raise FileError(f"does not take {num_inputs} inputs: {str(error).strip().splitlines()[-1]}") from error
    if output.shape != (2, 1):
      raise FileError(f"makes {tuple(output.shape)} of two rows; it must make one number of each, (2, 1)")
  return network


def _is_torchscript(path: Path) -> bool:
  if not zipfile.is_zipfile(path):
    return False
  with zipfile.ZipFile(path) as archive:
    return any("/code/" in name for name in archive.namelist())


def _from_state_dict(state: dict[str, torch.Tensor], activation: Activation) -> torch.nn.Module:
  left = dict(state)
  layers: list[torch.nn.Module] = []
  for name, weight in state.items():
    if not name.endswith("weight"):
      continue
    del left[name]
    bias_name = name.removesuffix("weight") + "bias"
    bias = left.pop(bias_name, None)
    if weight.dim() != 2:
      raise FileError(f"{name!r} of shape {tuple(weight.shape)} is not a linear layer")
    layer = torch.nn.Linear(weight.shape[1], weight.shape[0], bias=bias is not None)
    layer.load_state_dict({"weight": weight} if bias is None else {"weight": weight, "bias": bias})
    layers += [layer, ACTIVATIONS[activation]()]
  if left or not layers:
    raise FileError(f"not a chain of linear layers; it also has: {', '.join(left) or 'nothing at all'}")
  return torch.nn.Sequential(*layers[:-1])
