"""Many MuJoCo worlds as PyTorch tensors: MuJoCo Warp on a GPU, MuJoCo's batch engine on a CPU."""

from mjlab_sim.config import NanGuardCfg, SimulationCfg
from mjlab_sim.contacts import Contacts
from mjlab_sim.errors import SimulationError
from mjlab_sim.fields import PER_WORLD
from mjlab_sim.nan_dump import Culprit, DivergedWorld, NanDump, Replay
from mjlab_sim.nan_guard import NanGuard
from mjlab_sim.rays import RayCaster, RayHits
from mjlab_sim.rendering import DataType, Images, Renderer
from mjlab_sim.simulation import Simulation
from mjlab_sim.step_graph import StepGraph
from mjlab_sim.torch_array import TorchArray

__all__ = [
  "PER_WORLD",
  "Contacts",
  "Culprit",
  "DataType",
  "DivergedWorld",
  "Images",
  "NanDump",
  "NanGuard",
  "NanGuardCfg",
  "RayCaster",
  "RayHits",
  "Renderer",
  "Replay",
  "Simulation",
  "SimulationCfg",
  "SimulationError",
  "StepGraph",
  "TorchArray",
]
