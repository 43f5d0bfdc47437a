"""Action, command, curriculum, event, metrics, observation, recorder, reward and termination managers.

Managers know an environment only as the protocol `ManagerEnv`. Inside a step they work on masks over all worlds, in
fixed memory, and read nothing from the device. A whole step can therefore be recorded as one CUDA graph.
"""

from mjlab_managers.action_manager import ActionManager, ActionTerm, ActionTermCfg
from mjlab_managers.command_manager import CommandManager, CommandTerm, CommandTermCfg
from mjlab_managers.curriculum_manager import CurriculumManager, CurriculumTermCfg
from mjlab_managers.env import ManagerEnv
from mjlab_managers.event_manager import EventManager, EventMode, EventTermCfg
from mjlab_managers.manager import ManagerBase
from mjlab_managers.metrics_manager import MetricsManager, MetricsTermCfg
from mjlab_managers.observations.camera_noise import CameraNoiseCfg
from mjlab_managers.observations.deployment import ActionTargets, Reading, TermSource, sourced
from mjlab_managers.observations.noise import (
  ConstantNoiseCfg,
  GaussianNoiseCfg,
  NoiseCfg,
  NoiseModel,
  NoiseModelCfg,
  NoiseModelWithAdditiveBiasCfg,
  UniformNoiseCfg,
)
from mjlab_managers.observations.observation_cfg import ObservationGroupCfg, ObservationTermCfg
from mjlab_managers.observations.observation_manager import ObservationManager
from mjlab_managers.observations.observation_processing import TermLayout
from mjlab_managers.recorder_manager import RecorderManager, RecorderTerm, RecorderTermCfg
from mjlab_managers.reward_manager import RewardManager, RewardTermCfg
from mjlab_managers.termination_manager import TerminationManager, TerminationTermCfg
from mjlab_managers.terms.scene_entity import SceneEntityCfg
from mjlab_managers.terms.term import ManagerTermBase, ManagerTermBaseCfg

__all__ = [
  "ActionManager",
  "ActionTargets",
  "ActionTerm",
  "ActionTermCfg",
  "CameraNoiseCfg",
  "CommandManager",
  "CommandTerm",
  "CommandTermCfg",
  "ConstantNoiseCfg",
  "CurriculumManager",
  "CurriculumTermCfg",
  "EventManager",
  "EventMode",
  "EventTermCfg",
  "GaussianNoiseCfg",
  "ManagerBase",
  "ManagerEnv",
  "ManagerTermBase",
  "ManagerTermBaseCfg",
  "MetricsManager",
  "MetricsTermCfg",
  "NoiseCfg",
  "NoiseModel",
  "NoiseModelCfg",
  "NoiseModelWithAdditiveBiasCfg",
  "ObservationGroupCfg",
  "ObservationManager",
  "ObservationTermCfg",
  "Reading",
  "RecorderManager",
  "RecorderTerm",
  "RecorderTermCfg",
  "RewardManager",
  "RewardTermCfg",
  "SceneEntityCfg",
  "TermLayout",
  "TermSource",
  "TerminationManager",
  "TerminationTermCfg",
  "UniformNoiseCfg",
  "sourced",
]
