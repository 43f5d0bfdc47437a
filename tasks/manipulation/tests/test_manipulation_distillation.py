"""Students of the lift tasks: their teachers and their observations."""

from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest
from mjlab_core.errors import FileError
from mjlab_manipulation import (
  lift_cube,
  lift_cube_depth,
  lift_cube_depth_distill,
  lift_cube_ik,
  lift_cube_rgb,
  lift_cube_rgb_distill,
  lift_objects,
  lift_objects_depth,
  lift_objects_depth_distill,
  lift_objects_rgb,
  lift_objects_rgb_distill,
)
from mjlab_rl import (
  RslRlDistillationRunnerCfg,
  RslRlOnPolicyRunnerCfg,
  RunManifest,
  TaskCfg,
  TrainedPolicy,
)

# Student, task with the same images without a teacher, teacher.
TASKS: dict[str, tuple[Any, Any, Any]] = {
  "Mjlab-Lift-Cube-Yam-Depth-Distill": (lift_cube_depth_distill, lift_cube_depth, lift_cube),
  "Mjlab-Lift-Cube-Yam-Rgb-Distill": (lift_cube_rgb_distill, lift_cube_rgb, lift_cube),
  "Mjlab-Lift-Objects-Yam-Depth-Distill": (lift_objects_depth_distill, lift_objects_depth, lift_objects),
  "Mjlab-Lift-Objects-Yam-Rgb-Distill": (lift_objects_rgb_distill, lift_objects_rgb, lift_objects),
}
each_student = pytest.mark.parametrize("name", TASKS)


def teacher(task: TaskCfg[Any]) -> TrainedPolicy:
  run = RunManifest(task="Taught", env=task.env, agent=task.agent)
  return TrainedPolicy(path=Path("model_1.pt"), weights={}, shapes_seen=None, record=None, run=run, role="actor")


@each_student
def test_a_student_sees_and_is_what_learns_by_itself_and_its_teacher_acts_as_it_was_trained(name: str) -> None:
  make, by_itself, taught = TASKS[name]
  (entry,) = entry_points(group="mjlab.tasks", name=name)
  task, alone, agent = entry.load()(), by_itself(), make().agent
  assert task.env == make().env
  assert isinstance(agent, RslRlDistillationRunnerCfg)
  assert isinstance(alone.agent, RslRlOnPolicyRunnerCfg)
  assert agent.obs_groups == {"student": alone.agent.obs_groups["actor"], "teacher": ("teacher",)}
  assert (agent.student.cnn_cfg, agent.student.hidden_dims) == (alone.agent.actor.cnn_cfg, (256, 256, 128))
  assert {group: task.env.observations[group] for group in agent.obs_groups["student"]} == {
    group: alone.env.observations[group] for group in agent.obs_groups["student"]
  }
  assert task.env.events == alone.env.events
  (found,) = entry_points(group="mjlab.tasks", name=str(agent.teacher_task))
  assert found.load() is taught
  teacher(taught()).check(task.env, agent)


def test_a_teacher_that_acts_by_the_hand_or_lifts_other_things_is_refused() -> None:
  student: Any = lift_cube_depth_distill()
  with pytest.raises(FileError, match="order of actions was hand, gripper in its training and is joint_pos here"):
    teacher(lift_cube_ik()).check(student.env, student.agent)
  with pytest.raises(FileError, match=r"order of terms was joint_pos, .*, object_size, object_in_hand in its tr"):
    teacher(lift_objects()).check(student.env, student.agent)
