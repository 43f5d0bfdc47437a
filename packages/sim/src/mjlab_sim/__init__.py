"""Many MuJoCo worlds as PyTorch tensors: MuJoCo Warp on a GPU, MuJoCo's batch engine on a CPU."""

from mjlab_sim.config import SimulationCfg
from mjlab_sim.errors import SimulationError
from mjlab_sim.fields import PER_WORLD
from mjlab_sim.rays import RayCaster, RayHits
from mjlab_sim.simulation import Simulation, StepGraph
from mjlab_sim.torch_array import TorchArray

__all__ = [
  "PER_WORLD",
  "RayCaster",
  "RayHits",
  "Simulation",
  "SimulationCfg",
  "SimulationError",
  "StepGraph",
  "TorchArray",
]
