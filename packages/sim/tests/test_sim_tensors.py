"""`sim.data.qpos` and `sim.model.body_mass` are tensors like any other, over the engine's own memory."""

import pytest
import torch
from mjlab_sim import Simulation, TorchArray
from sim_world import MakeSim


def test_a_field_is_a_tensor_of_the_engines_precision_in_fixed_memory(sim: Simulation, engine: str) -> None:
  qpos = sim.data.qpos
  assert isinstance(qpos, TorchArray)
  assert isinstance(qpos, torch.Tensor)
  assert qpos.dtype == sim.dtype == (torch.float64 if engine == "native" else torch.float32)
  assert qpos.device == sim.device == torch.device("cpu")
  sim.step()
  sim.reset()
  sim.step()
  assert sim.data.qpos is qpos
  for name in ("xpos", "sensordata", "cvel"):
    first = getattr(sim.data, name)
    address = first.data_ptr()
    sim.step()
    assert getattr(sim.data, name).data_ptr() == address


def test_operations_give_plain_tensors(sim: Simulation) -> None:
  qpos, qvel = sim.data.qpos, sim.data.qvel
  results = [qpos + 1, 2.0 * qpos, -qpos, qpos[:, :3], qpos.clone(), qpos.reshape(-1), torch.sin(qpos), qpos == qpos]
  results += [torch.cat([qpos, qvel], -1), torch.stack([qpos, qpos]), torch.where(qpos > 0, qpos, 0.0)]
  results += [torch.cat([qpos[:, :1], torch.zeros(4, 1, dtype=sim.dtype)], -1), qpos.sum()]
  for result in results:
    assert type(result) is torch.Tensor
  assert type(torch.nn.functional.pad(qpos, (0, 1))) is torch.Tensor


def test_in_place_operators_write_to_the_simulation(sim: Simulation) -> None:
  before = sim.data.qpos.clone()
  view = sim.data.qpos[:, :3]
  sim.data.qpos += 1
  assert torch.equal(view, before[:, :3] + 1)
  sim.data.qpos -= 1
  sim.data.qvel[1:3, 2] = 0.5
  assert sim.data.qvel[:, 2].tolist() == [0.0, 0.5, 0.5, 0.0]
  sim.data.ctrl = torch.full((4, 3), 0.25)
  assert (sim.data.ctrl == 0.25).all()
  sim.data.ctrl = 0.5 * torch.ones(3)
  assert (sim.data.ctrl == 0.5).all()
  sim.model.body_mass *= 2.0
  assert torch.equal(sim.model.body_mass, 2.0 * sim.default_field("body_mass"))


def test_a_field_first_read_in_inference_mode_can_be_written_outside_of_it(make_sim: MakeSim, engine: str) -> None:
  with torch.inference_mode():
    sim = make_sim(engine)
    _ = sim.data.ctrl, sim.data.xpos, sim.model.geom_friction
    sim.expand_model_fields(["dof_damping"])
    sim.step()
  sim.data.ctrl += 0.1
  sim.model.geom_friction[0, 1, 0] = 0.5
  sim.model.dof_damping[:, 18] = 0.5
  sim.data.qpos[:, 21] += 0.1
  sim.step()
  assert not sim.data.xpos.is_inference()
  height = sim.data.site_xpos[:, 0, 2].clone()
  with torch.inference_mode():
    sim.model.site_pos[0, 0, 2] += 0.1
  torch.testing.assert_close(sim.data.site_xpos[:, 0, 2], height + 0.1, rtol=1e-4, atol=1e-3)


def test_gradients_stay_outside(sim: Simulation) -> None:
  weight = torch.ones(3, dtype=sim.dtype, requires_grad=True)
  (sim.data.qpos[:, :3] * weight).sum().backward()
  assert weight.grad is not None
  assert not sim.data.qpos.requires_grad


def test_an_unknown_field_is_named_with_the_nearest(sim: Simulation) -> None:
  with pytest.raises(AttributeError, match=r"data field 'qposs' does not exist.*Nearest: qpos"):
    _ = sim.data.qposs
  with pytest.raises(AttributeError, match=r"per-world model field 'body_mas' does not exist.*body_mass"):
    _ = sim.model.body_mas
  with pytest.raises(AttributeError, match=r"'jnt_type' does not exist.*read them from sim.mj_model"):
    _ = sim.model.jnt_type
  with pytest.raises(AttributeError, match=r"'opt.gravty' does not exist.*opt.gravity"):
    _ = sim.model.opt.gravty
