"""Designs of a robot as per-world parameters, as `tools/co_design.py` gives them to worlds."""

import co_design
import pytest
import torch
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_robots import go1_spec


def test_the_legs_of_a_world_are_those_of_a_model_compiled_with_its_design() -> None:
  factors = zip(co_design.RANGES, (1.1, 0.9, 1.5, 0.8), strict=True)
  design = {name: torch.tensor([1.0, value]) for name, value in factors}
  spec = go1_spec()
  for body in spec.bodies:
    if (part := body.name.rpartition("_")[2]) in ("thigh", "calf"):
      length = float(design[part][1])
      mass = length * float(design["density"][1])
      body.mass, body.inertia = body.mass * mass, body.inertia * mass * length**2
      for vector in (body.ipos, *(element.pos for element in (*body.bodies, *body.sites, *body.geoms))):
        vector[2] *= length
  expected = spec.compile()
  task = load_task(co_design.TASK)
  assert task.play is not None
  cfg = task.play(task.env)
  cfg.scene.num_envs = 2
  with ManagerBasedRlEnv(cfg, "cpu") as env:
    co_design.build(env, design)
    model, names = env.sim.model, env.sim.mj_model
    legs = {names.body(place).name.rpartition("/")[2]: place for place in range(names.nbody)}
    for name in (body.name for body in spec.bodies if body.name.endswith(("_thigh", "_calf"))):
      for field in ("body_mass", "body_inertia", "body_pos", "body_ipos", "body_subtreemass"):
        found = getattr(model, field)[1, legs[name]]
        wanted = torch.as_tensor(getattr(expected, field)[expected.body(name).id]).to(found)
        torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-7, msg=f"{name} {field}")
    for field, ratio in (("dof_armature", 0.64), ("actuator_forcerange", 0.8)):
      values = getattr(model, field).flatten(1)[:, -12:]
      assert (values[1] / values[0]).tolist() == pytest.approx([ratio] * 12)
