"""The figures of one training iteration."""

from dataclasses import dataclass, field


@dataclass(kw_only=True)
class IterationReport:
  """What one iteration did. Everybody who shows or stores progress reads only this."""

  iteration: int
  """Index of the iteration, from 0 over all resumes."""
  end: int
  """Iterations in all."""
  total_steps: int
  """Environment steps since the start of the run, all worlds together."""
  steps_per_second: float
  """Environment steps of all worlds per second of this iteration."""
  collect_time: float
  """Time of the rollout [s]."""
  learn_time: float
  """Time of the update [s]."""
  elapsed: float
  """Training time since the start of the run, resumes included [s]."""
  eta: float
  """Expected time to the last iteration [s]."""
  mean_reward: float | None
  """Mean return of the last 100 finished episodes; None before the first."""
  mean_episode_length: float | None
  """Mean length of the last 100 finished episodes [steps]; None before the first."""
  scalars: dict[str, float] = field(default_factory=dict)
  """Every logged value by its tag, those above included."""
