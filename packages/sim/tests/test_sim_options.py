"""Options of a simulation, and refusals of wrong ones."""

from collections.abc import Callable
from typing import Any

import mujoco
import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sim import Simulation, SimulationCfg
from sim_world import MOTION, WORLD, MakeSim, assert_same

REFUSALS = [
  ({"timestep": -0.001}, "timestep must be positive, got -0.001"),
  ({"timestep": float("inf")}, "timestep must be finite"),
  ({"gravity": (0.0, float("nan"), 0.0)}, "gravity must be a number, got (0.0, nan, 0.0)"),
  ({"gravity": 9.81}, "gravity must be a tuple, got 9.81"),
  ({"impratio": 0.0}, "impratio must be positive"),
  ({"iterations": 2.5}, "iterations must be a whole number, got 2.5"),
  ({"tolerance": float("nan")}, "tolerance must be a number, got nan"),
  ({"nconmax": -1}, "nconmax must be at least 1, got -1"),
  ({"num_threads": -2}, "num_threads must not be negative, got -2"),
  ({"engine": "wrap"}, "engine 'wrap' does not exist. Nearest: warp"),
  ({"solver": "newtn"}, "solver 'newtn' does not exist. Nearest: newton"),
  ({"disableflags": ("contac",)}, "disableflags 'contac' does not exist. Nearest: contact"),
  ({"disableflags": ("mjndisable",)}, "disableflags 'mjndisable' does not exist"),
  ({"broadphase": "sap"}, "broadphase 'sap' does not exist"),
  ({"broadphase_filter": ("obbb",)}, "broadphase_filter 'obbb' does not exist"),
  ({"enableflags": ("enrgy",)}, "enableflags 'enrgy' does not exist. Nearest: energy"),
]
WARP_REFUSALS = [
  ({"solver": "pgs"}, "mjSOL_PGS is unsupported. Its solvers are 'newton' and 'cg'"),
  ({"integrator": "rk4"}, "choose 'implicitfast', 'implicit' or 'euler'"),
  ({"disableflags": ("midphase",)}, "mjDSBL_MIDPHASE is unsupported"),
  ({"enableflags": ("fwdinv",)}, "mjENBL_FWDINV is unsupported"),
]


@pytest.mark.parametrize(("options", "reason"), REFUSALS, ids=lambda value: str(value)[:40])
def test_wrong_options_are_refused_by_name_with_the_reason(make_sim: MakeSim, options: dict, reason: str) -> None:
  with pytest.raises(MjlabError) as refusal:
    make_sim(**options)
  assert reason in str(refusal.value)


@pytest.mark.parametrize(("options", "reason"), WARP_REFUSALS, ids=lambda value: str(value)[:40])
def test_options_beyond_mujoco_warp_are_refused_on_it_only(make_sim: MakeSim, options: dict, reason: str) -> None:
  with pytest.raises(MjlabError) as refusal:
    make_sim("warp", **options)
  assert reason in str(refusal.value)
  make_sim("native", **options).step()


def test_all_problems_come_in_one_message() -> None:
  cfg = SimulationCfg(timestep=-1.0, iterations=0, disableflags=("contac",))
  with pytest.raises(MjlabError, match=r"(?s)3 problems.*timestep.*iterations.*contac"):
    cfg.validate()


@pytest.mark.parametrize("option", ['integrator="RK4"', 'solver="PGS"'])
def test_options_of_the_model_beyond_mujoco_warp_are_refused(make_sim: MakeSim, option: str) -> None:
  spec = f"<mujoco><option {option}/><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
  with pytest.raises(MjlabError, match=option.split('"')[1]):
    make_sim("warp", spec=spec)
  make_sim("native", spec=spec).step()


def test_the_native_engine_is_refused_on_a_gpu() -> None:
  with pytest.raises(MjlabError, match=r"engine 'native' runs on a CPU.*engine 'auto'"):
    SimulationCfg(engine="native").engine_for("cuda")
  assert SimulationCfg().engine_for("cuda") == "warp"
  assert SimulationCfg().engine_for("cpu") == "native"
  assert SimulationCfg(engine="warp").engine_for("cpu") == "warp"


def test_devices_that_do_not_exist_are_refused() -> None:
  spec = mujoco.MjSpec.from_string(WORLD)
  with pytest.raises(MjlabError, match="device 'meta' is not supported"):
    Simulation(1, spec, device="meta")
  with pytest.raises(MjlabError, match="num_envs must be at least 1"):
    Simulation(0, spec, device="cpu")
  if not torch.cuda.is_available():
    with pytest.raises(MjlabError, match="torch finds no GPU; use 'cpu'"):
      Simulation(1, spec, device="cuda")


def test_masks_that_do_not_fit_are_refused_before_anything_changes(sim: Simulation) -> None:
  sim.step()
  before = sim.data.qpos.clone()
  bools = torch.ones(4, 1, dtype=torch.bool)
  for mask in (bools[:3, 0], torch.ones(4), torch.tensor([0, 1]), bools):
    with pytest.raises(MjlabError, match=r"reset: mask must be bool of shape \(4,\)"):
      sim.reset(mask)
    with pytest.raises(MjlabError, match="recompute_constants: mask must be bool"):
      sim.recompute_constants(mask)
  assert torch.equal(sim.data.qpos, before)


def test_fields_that_cannot_differ_per_world_are_refused_with_the_nearest(sim: Simulation) -> None:
  with pytest.raises(MjlabError, match=r"per-world model field 'body_mss' does not exist.*Nearest: body_mass"):
    sim.expand_model_fields(["geom_friction", "body_mss"])
  assert not sim.is_expanded("geom_friction")


def test_none_keeps_the_options_of_the_model(make_sim: MakeSim) -> None:
  text = """<mujoco><option timestep="0.004" integrator="implicit" solver="CG" cone="elliptic" iterations="7"
    ls_iterations="8" tolerance="1e-5" impratio="3" gravity="1 2 3"><flag warmstart="disable" energy="enable"/></option>
    <worldbody/></mujoco>"""
  option = make_sim(spec=text, num_envs=1).mj_model.opt
  assert (option.timestep, option.iterations, option.ls_iterations) == (0.004, 7, 8)
  assert (option.integrator, option.solver, option.cone) == (2, 1, 1)
  assert (option.tolerance, option.impratio, option.gravity.tolist()) == (1e-5, 3.0, [1.0, 2.0, 3.0])
  assert option.disableflags == mujoco.mjtDisableBit.mjDSBL_WARMSTART.value
  assert option.enableflags == mujoco.mjtEnableBit.mjENBL_ENERGY.value


def test_an_option_that_is_set_wins_and_flags_add_up(make_sim: MakeSim) -> None:
  text = '<mujoco><option timestep="0.004" solver="CG"><flag warmstart="disable"/></option><worldbody/></mujoco>'
  spec = mujoco.MjSpec.from_string(text)
  chosen: dict[str, Any] = {"solver": "newton", "cone": "elliptic", "jacobian": "sparse", "gravity": (0.0, 0.0, -1.6)}
  cfg = SimulationCfg(timestep=0.001, iterations=5, disableflags=("contact",), enableflags=("energy",), **chosen)
  sim = Simulation(1, spec, cfg, "cpu")
  option = sim.mj_model.opt
  assert (sim.timestep, option.timestep, option.solver, option.cone, option.jacobian) == (0.001, 0.001, 2, 1, 1)
  assert (option.iterations, option.gravity.tolist()) == (5, [0.0, 0.0, -1.6])
  disable = mujoco.mjtDisableBit
  assert option.disableflags == disable.mjDSBL_WARMSTART.value | disable.mjDSBL_CONTACT.value
  assert spec.option.timestep == 0.004
  sim.close()


def test_a_sensor_that_mujoco_warp_would_get_wrong_is_refused_by_name(make_sim: MakeSim) -> None:
  spec = """<mujoco><worldbody><site name="zone"/><body name="ball"><freejoint/><geom size=".1"/></body></worldbody>
    <sensor><insidesite name="out" objtype="body" objname="ball" site="zone" enclosed="true"/></sensor></mujoco>"""
  with pytest.raises(MjlabError, match="sensor 'out': MuJoCo Warp knows no insidesite sensor with enclosed"):
    make_sim("warp", spec=spec)
  assert make_sim("native", spec=spec).data.sensordata[0, 0] > 0.09


@pytest.mark.warp
def test_a_model_beyond_mujoco_warp_is_refused_with_its_reason(make_sim: MakeSim) -> None:
  text = """<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>
    <actuator><pid name="p" joint="j"/></actuator></mujoco>"""
  try:
    mujoco.MjSpec.from_string(text).compile()
  except ValueError:
    pytest.skip("this MuJoCo has no pid actuators")
  with pytest.raises(MjlabError, match="MuJoCo Warp cannot run this model"):
    make_sim("warp", spec=text)


def test_a_closed_simulation_says_that_it_is_closed(sim: Simulation) -> None:
  sim.step()
  sim.close()
  sim.close()
  uses: list[Callable[[], object]] = [
    *(sim.step, sim.reset, sim.forward, sim.state_dict, sim.recompute_constants, sim.overflow_report),
    lambda: sim.version,
    lambda: sim.data.qpos,
    lambda: sim.data.xpos,
    lambda: sim.model.body_mass,
    lambda: sim.make_ray_caster(1),
    lambda: sim.load_state_dict({"data": {}, "model": {}}),
    lambda: sim.expand_model_fields(["body_mass"]),
    lambda: sim.capture(lambda: None)(),
  ]
  for use in uses:
    with pytest.raises(MjlabError, match="closed"):
      use()


def test_a_diverged_world_does_not_affect_the_others(
  make_sim: MakeSim, engine: str, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
  monkeypatch.chdir(tmp_path)
  sim, healthy = make_sim(engine), make_sim(engine)
  for s in (sim, healthy):
    s.data.qvel[:, 0] = 0.1
    s.step()
  sim.data.qpos[1, 0] = float("nan")
  sim.data.qvel[2, 18] = float("inf")
  for _ in range(5):
    sim.step()
    healthy.step()
  assert_same(sim, healthy, worlds=[0, 3])
  assert not torch.isfinite(sim.data.qpos[1]).all()
  assert not torch.isfinite(sim.data.qpos[2]).all()
  bad = torch.tensor([False, True, True, False])
  for s in (sim, healthy):
    s.reset(bad)
  for _ in range(3):
    for s in (sim, healthy):
      s.step()
  assert_same(sim, healthy, (*MOTION, "actuator_force"))
  assert not list(tmp_path.iterdir())
