"""The manager-based environment and its generic term library."""

from mjlab_envs.env import ManagerBasedRlEnv, Observations
from mjlab_envs.env_cfg import ManagerBasedRlEnvCfg

__all__ = ["ManagerBasedRlEnv", "ManagerBasedRlEnvCfg", "Observations"]
