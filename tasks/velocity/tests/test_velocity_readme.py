"""The README's examples run and print what they say; the tables of the reference are those of the configs."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mjlab_envs import ManagerBasedRlEnv
from mjlab_managers import UniformNoiseCfg
from mjlab_velocity.rough import rough_terrain
from velocity_facts import TASKS
from velocity_rollout import make_env

README, REFERENCE = (
  (Path(__file__).parents[1] / name).read_text(encoding="utf-8") for name in ("README.md", "REFERENCE.md")
)
COLUMNS = {
  "Go1 flat": "Mjlab-Velocity-Flat-Unitree-Go1",
  "Go1 rough": "Mjlab-Velocity-Rough-Unitree-Go1",
  "G1 flat": "Mjlab-Velocity-Flat-Unitree-G1",
  "G1 rough": "Mjlab-Velocity-Rough-Unitree-G1",
}


def tables(first: str, second: str) -> list[list[dict[str, str]]]:
  """Rows, by column, of each table whose first two columns are called so."""
  found = []
  for text in re.findall(rf"^\| {first} \| {second} \|.*\n(?:\|.*\n)+", README + REFERENCE, re.MULTILINE):
    rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in text.splitlines()]
    found.append([dict(zip(rows[0], row, strict=True)) for row in rows[2:]])
  return found


def table(first: str, second: str) -> list[dict[str, str]]:
  """The only such table."""
  (rows,) = tables(first, second)
  return rows


def name(cell: str) -> str:
  """The name in code that a cell begins with."""
  found = re.match(r"`([^`]+)`", cell)
  assert found, cell
  return found[1]


def names(cell: str) -> list[str]:
  return [text.replace(r"\|", "|") for text in re.findall(r"`([^`]+)`", cell)]


@pytest.fixture(scope="module")
def envs() -> dict[str, ManagerBasedRlEnv]:
  return {task: make_env(1, task=task) for task in TASKS}


def test_the_examples_run_and_print_what_they_say(capsys: pytest.CaptureFixture[str]) -> None:
  blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
  assert blocks
  for block in blocks:
    exec(compile(block, "README.md", "exec"), {})
    promised = [text.strip() for text in re.findall(r"print\(.*\)  # (.*)", block)]
    assert capsys.readouterr().out.splitlines() == promised


def test_tasks_have_the_sizes_of_their_table(envs: dict[str, ManagerBasedRlEnv]) -> None:
  rows = table("task", "robot")
  assert {name(row["task"]) for row in rows} == set(TASKS)
  for row in rows:
    env = envs[name(row["task"])]
    sizes = [sum(term.shape[0] for term in env.observation_manager.layout(group)) for group in ("actor", "critic")]
    assert [env.action_manager.total_action_dim, *sizes] == [
      int(row[c]) for c in ("actions", "actor sees", "critic sees")
    ]


def test_the_table_of_rewards_is_that_of_the_tasks() -> None:
  rows = table("term", "value")
  gates = {name(row["term"]): float(row["gate"]) if row["gate"] else None for row in rows}
  for column, task in COLUMNS.items():
    rewards = {term: cfg for term, cfg in TASKS[task].make().env.rewards.items() if cfg is not None}
    written = {name(row["term"]): float(row[column]) for row in rows if row[column]}
    assert written == {term: cfg.weight for term, cfg in rewards.items()}
    assert {term: gates[term] for term in rewards} == {t: cfg.params.get("threshold") for t, cfg in rewards.items()}


def test_the_table_of_terminations_is_that_of_the_tasks(envs: dict[str, ManagerBasedRlEnv]) -> None:
  rows = table("term", "ends an episode")
  for column, task in COLUMNS.items():
    manager = envs[task].termination_manager
    written = {name(row["term"]): row["as"] == "truncation" for row in rows if row[column] == "yes"}
    assert written == {term: manager.get_term_cfg(term).time_out for term in manager.active_terms}


def test_the_table_of_observations_is_that_of_the_tasks(envs: dict[str, ManagerBasedRlEnv]) -> None:
  rows = table("term", "Go1")
  for column, task in COLUMNS.items():
    env, robot = envs[task], column.split()[0]
    mine = [row for row in rows if "(rough)" not in row["term"] or TASKS[task].rough]
    for group, said in (("actor", "actor, uniform noise ±"), ("critic", "critic, no noise")):
      written = [(name(row["term"]), int(row[robot])) for row in mine if row[said] != "-"]
      assert written == [(term.name, term.shape[0]) for term in env.observation_manager.layout(group)]
    actor: Any = env.cfg.observations["actor"]
    for row in (row for row in mine if row["actor, uniform noise ±"] != "-"):
      noise, said = actor.terms[name(row["term"])].noise, row["actor, uniform noise ±"]
      size = 0.0 if said == "none" else float(said.split()[0])
      assert noise == (UniformNoiseCfg(n_min=-size, n_max=size) if size else None)


@pytest.mark.parametrize("robot", ["Go1", "G1"])
def test_scales_and_postures_are_those_of_the_tasks(robot: str, envs: dict[str, ManagerBasedRlEnv]) -> None:
  env = envs[COLUMNS[f"{robot} flat"]]
  term: Any = env.action_manager.get_term("joint_pos")
  joints = term.target_names

  def by_joint(rows: list[dict[str, str]], column: str) -> list[float]:
    patterns = [(p, float(row[column])) for row in rows if row["robot"] == robot for p in names(row["joints"])]
    values = [[value for pattern, value in patterns if re.fullmatch(pattern, joint)] for joint in joints]
    assert all(len(found) == 1 for found in values)
    return [found[0] for found in values]

  scales, postures = tables("robot", "joints")
  np.testing.assert_allclose(term.scale[0].numpy(), by_joint(scales, "scale [rad]"), rtol=2e-6)
  facts = TASKS[COLUMNS[f"{robot} flat"]].robot
  for gait in ("standing", "walking", "running"):
    np.testing.assert_allclose(by_joint(postures, gait), getattr(facts, gait))


def test_types_of_ground_have_the_shares_of_their_table() -> None:
  written = {name(row["type"]): float(row["share of worlds"]) for row in table("type", "share of worlds")}
  assert written == {kind: cfg.share for kind, cfg in rough_terrain().types.items()}


def test_all_sensors_and_events_are_in_their_tables() -> None:
  sensors = {sensor for row in table("sensor", "on") for sensor in names(row["sensor"])}
  events = {name(row["event"]): row for row in table("event", "when")}
  for task in TASKS.values():
    cfg = task.make().env
    assert set(cfg.scene.sensors) <= sensors
    robot = "G1" if task.robot.root == "pelvis" else "Go1"
    assert {event for event, row in events.items() if row[robot] != "-"} == set(cfg.events)
  used = {sensor for task in TASKS.values() for sensor in task.make().env.scene.sensors}
  assert used == sensors
