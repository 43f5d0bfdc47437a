"""Off-policy learning: a replay memory on the device, and soft actor-critic with distributional critics."""

from mjlab_rl.offpolicy.config import OffPolicyModelCfg, OffPolicyRunnerCfg, SacCfg
from mjlab_rl.offpolicy.presets import PRESETS, fastsac, flashsac, with_agent

__all__ = ["PRESETS", "OffPolicyModelCfg", "OffPolicyRunnerCfg", "SacCfg", "fastsac", "flashsac", "with_agent"]
