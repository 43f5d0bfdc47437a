"""Many MuJoCo worlds as PyTorch tensors: MuJoCo Warp on a GPU, MuJoCo's batch engine on a CPU."""

from mjlab_core.mujoco.model_fields import PER_WORLD
from mjlab_core.torch_internals import version_of

from mjlab_sim.config import NanGuardCfg, SimulationCfg
from mjlab_sim.nan.dump import DivergedWorld, NanDump, Replay
from mjlab_sim.nan.guard import NanGuard
from mjlab_sim.rays import RayHits
from mjlab_sim.rendering import DataType, Images
from mjlab_sim.sensing import RayCaster, Renderer
from mjlab_sim.simulation import Simulation
from mjlab_sim.step_graph import StepGraph
from mjlab_sim.tensors import TorchArray

__all__ = [
  "PER_WORLD",
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
  "StepGraph",
  "TorchArray",
  "version_of",
]
