"""Gains, effort limits and delays drawn per world: they act in the simulation, and repeating them never drifts."""

from typing import Any

import mujoco
import pytest
import torch
from envs_hopper import Make, hopper_cfg
from mjlab_actuators import (
  ActuatorCfg,
  DcMotorActuatorCfg,
  EnvelopedPdActuatorCfg,
  IdealPdActuatorCfg,
  NativeDcMotorActuatorCfg,
  NativeMotorActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  TorqueSpeedEnvelope,
  XmlActuatorCfg,
)
from mjlab_core.errors import ConfigError, MjlabError
from mjlab_dr import Categorical, LogUniform, randomize_field
from mjlab_envs import mdp
from mjlab_managers import CurriculumTermCfg, EventTermCfg
from mjlab_scene import EntityArticulationCfg, EntityCfg, SceneCfg

WORLDS = 4
LIMIT = 5.0
PD: dict[str, Any] = {"stiffness": 20.0, "damping": 2.0}
GAINS: dict[str, Any] = {**PD, "effort_limit": LIMIT}
CURRENT: dict[str, Any] = {"torque_constant": 0.5, "resistance": 0.1, "inputs": ("position_target", "velocity_target")}
LAWS: dict[str, ActuatorCfg] = {
  "xml": XmlActuatorCfg(target_names_expr=("xml",)),
  "position": NativePositionActuatorCfg(target_names_expr=("position",), **GAINS),
  "velocity": NativeVelocityActuatorCfg(target_names_expr=("velocity",), damping=2.0, effort_limit=LIMIT),
  "motor": NativeMotorActuatorCfg(target_names_expr=("motor",), effort_limit=LIMIT),
  "native_dc": NativeDcMotorActuatorCfg(target_names_expr=("native_dc",), **CURRENT, **GAINS),
  "pd": IdealPdActuatorCfg(target_names_expr=("pd",), **GAINS),
  "dc": DcMotorActuatorCfg(target_names_expr=("dc",), saturation_effort=100.0, velocity_limit=1e3, **GAINS),
  "envelope": EnvelopedPdActuatorCfg(
    target_names_expr=("envelope",), envelope=TorqueSpeedEnvelope(10.0, 20.0, LIMIT, LIMIT), **PD
  ),
}
# Every other joint limits its actuators itself, too.
ITS_OWN = ('actuatorfrcrange="-5 5"', "")
ARM = """<mujoco><worldbody><body name="base">{}</body></worldbody>
<tendon><fixed name="rope" actuatorfrcrange="-5 5"><joint joint="xml" coef="1"/></fixed></tendon>
<actuator><position name="own" joint="xml" kp="20" kv="2" forcerange="-5 5"/></actuator></mujoco>""".format(
  "".join(
    f'<body pos="0 {k} 0"><joint name="{name}" axis="0 1 0" {ITS_OWN[k % 2]}/><geom size="0.1"/></body>'
    for k, name in enumerate(LAWS)
  )
)


def arm_cfg(*cfgs: ActuatorCfg, engine: str = "native", **events: Any) -> Any:
  robot = EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string(ARM), articulation=EntityArticulationCfg(actuators=cfgs))
  nothing: dict[str, Any] = {
    name: {} for name in ("actions", "commands", "observations", "rewards", "terminations", "metrics")
  }
  cfg = hopper_cfg(WORLDS, engine, events=events, **nothing)
  cfg.scene = SceneCfg(num_envs=WORLDS, entities={"robot": robot})
  return cfg


def drawn(
  parameter: str, values: Any, mode: Any = "startup", *, targets: Any = ".*", operation: Any = None, **params: Any
) -> EventTermCfg:
  randomizer = randomize_field(parameter, targets, values, operation=operation)
  return EventTermCfg(mdp.randomize, mode=mode, params={"randomizer": randomizer, **params})


def delays(lags: tuple[int, int], mode: Any = "startup", targets: Any = ".*") -> EventTermCfg:
  return drawn("delay", Categorical(tuple(range(lags[0], lags[1] + 1))), mode, targets=targets)


def forces(env: Any, *, target: float) -> torch.Tensor:
  """Force of the actuators on every joint at rest in the default pose, all targets alike, (WORLDS, joints)."""
  robot = env.scene["robot"]
  robot.write_default_state()
  for name in ("position", "velocity", "effort"):
    getattr(robot, f"set_joint_{name}_target")(torch.full((1, len(LAWS)), target))
  env.scene.write_ctrl()
  env.sim.step()
  return robot.data.qfrc_actuator.double().clone()


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_an_effort_limit_lets_as_much_more_or_less_through_in_the_simulation(
  make: Make, engine: str, factor: float
) -> None:
  once = make(arm_cfg(*LAWS.values(), engine=engine))
  torch.testing.assert_close(forces(once, target=50.0), torch.full((WORLDS, len(LAWS)), LIMIT).double())
  event = drawn("effort_limit", (factor, factor))
  env = make(arm_cfg(*LAWS.values(), engine=engine, limits=event))
  for sign in (1.0, -1.0):
    expected = torch.full((WORLDS, len(LAWS)), sign * factor * LIMIT).double()
    torch.testing.assert_close(forces(env, target=sign * 50.0), expected)


@pytest.mark.parametrize("parameter", ["stiffness", "damping"])
def test_gains_act_in_the_simulation(make: Make, parameter: str) -> None:
  names = [name for name in LAWS if name != "motor" and not (name == "velocity" and parameter == "stiffness")]
  event = drawn(parameter, (1.5, 1.5), targets=tuple(names))
  plain, env = make(arm_cfg(*LAWS.values())), make(arm_cfg(*LAWS.values(), gains=event))
  robot = env.scene["robot"]
  # Velocity targets for dampings, positions for stiffness; the models that damp towards zero are seen when moving.
  wanted = {"stiffness": (0.01, 0.0), "damping": (0.0, 0.02)}[parameter]
  got = []
  for environment in (plain, env):
    arm = environment.scene["robot"]
    still = torch.zeros(1, len(LAWS))
    arm.write_joint_state(still - wanted[0], still - wanted[1])
    for name in ("position", "velocity", "effort"):
      getattr(arm, f"set_joint_{name}_target")(still)
    environment.scene.write_ctrl()
    environment.sim.step()
    got.append(arm.data.qfrc_actuator.clone())
  for name in names:
    joint = robot.joint_names.index(name)
    # The native DC motor brakes by its back EMF besides.
    if name != "native_dc" or parameter == "stiffness":
      ratio = got[1][:, joint] / got[0][:, joint]
      torch.testing.assert_close(ratio, torch.full_like(ratio, 1.5), rtol=1e-2, atol=0.0)
    assert (got[1][:, joint] > got[0][:, joint]).all()


def stored(env: Any) -> dict[str, torch.Tensor]:
  """Everything that randomisation of actuators may write."""
  fields = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "jnt_actfrcrange", "tendon_actfrcrange")
  found = {field: getattr(env.sim.model, field).clone() for field in fields}
  for model in env.scene["robot"].actuators.groups:
    for name in model.group.parameter_names:
      found[f"{type(model).__name__}.{name}"] = getattr(model, name).clone()
  return found


def test_a_hundred_repeats_end_where_one_does_and_touch_masked_worlds_only(make: Make) -> None:
  events: dict[str, Any] = {
    "limits": drawn("effort_limit", LogUniform(0.5, 2.0), "reset"),
    "kp": drawn("stiffness", (0.8, 1.2), "reset", targets=("xml", "position", "pd", "dc", "native_dc")),
    "kd": drawn("damping", (1.0, 3.0), "reset", operation="absolute", targets=("position", "velocity", "pd")),
  }
  env = make(arm_cfg(*LAWS.values(), **events))
  mask = torch.tensor([True, False, True, True])
  env.event_manager.apply("reset", torch.ones(WORLDS, dtype=torch.bool))
  before = stored(env)
  for _ in range(100):
    env.event_manager.apply("reset", mask)
  after = stored(env)
  plain = stored(make(arm_cfg(*LAWS.values())))
  changed = set()
  for name, values in after.items():
    rows = values.shape[0] == WORLDS
    if rows:
      assert torch.equal(values[1], before[name][1]), name
      assert not torch.equal(values[0], before[name][0]) or torch.equal(values[0], plain[name][0]), name
    default = plain[name]
    touched = values != default
    ratio = (values / default)[touched]
    if touched.any():
      changed.add(name)
      assert ratio.min() >= 0.5 - 1e-6, name
      assert ratio.max() <= 2.0 + 1e-6, name
  assert {"actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "jnt_actfrcrange"} <= changed
  assert {"IdealPd.stiffness", "IdealPd.damping", "IdealPd.effort_limit", "DcMotor.effort_limit"} <= changed
  assert {"EnvelopedPd.motoring_effort", "EnvelopedPd.braking_effort"} <= changed
  assert not {"tendon_actfrcrange", "DcMotor.damping", "DcMotor.saturation_effort"} & changed
  pd = env.scene["robot"].actuators.groups
  kd = next(model.damping for model in pd if type(model).__name__ == "IdealPd")
  assert ((kd >= 1.0) & (kd <= 3.0)).all()
  assert kd[[0, 2, 3]].unique().numel() == 3


def test_a_factor_of_one_is_exactly_what_was_compiled(make: Make) -> None:
  events: dict[str, Any] = {
    "limits": drawn("effort_limit", (1.0, 1.0)),
    "kp": drawn("stiffness", (1.0, 1.0), targets=("xml", "position", "pd", "dc", "envelope", "native_dc")),
    "kd": drawn("damping", (2.0, 2.0), operation="absolute", targets=("xml", "velocity", "pd")),
  }
  plain, env = stored(make(arm_cfg(*LAWS.values()))), stored(make(arm_cfg(*LAWS.values(), **events)))
  for name, values in env.items():
    assert torch.equal(values, plain[name].expand_as(values)), name


def test_values_of_a_parameter_are_those_that_were_written(make: Make) -> None:
  names = ("xml", "position", "pd", "dc", "native_dc", "envelope")
  env = make(arm_cfg(*LAWS.values(), kp=drawn("stiffness", (0.8, 1.2), "reset", targets=names)), begun=False)
  parameter = env.event_manager.get_term_cfg("kp").func.field._quantity
  assert torch.equal(parameter.values(), parameter.default.expand(WORLDS, -1))
  factor = torch.linspace(0.5, 2.0, WORLDS * len(names)).view(WORLDS, -1)
  parameter.scale(factor, torch.tensor([True, True, False, True]))
  factor[2] = 1.0
  torch.testing.assert_close(parameter.values(), factor.to(parameter.default.dtype) * parameter.default)


def test_a_curriculum_widens_the_range_of_a_gain(make: Make) -> None:
  cfg = arm_cfg(
    LAWS["pd"],
    kp=drawn("stiffness", (0.5, 1.5), "step", targets="pd"),
    kd=drawn("damping", (4.0, 4.0), "step", targets="pd", operation="absolute"),
  )
  cfg.curriculum = {
    name: CurriculumTermCfg(mdp.widen_randomization, params={"event": name, "steps": (2, 12)}) for name in ("kp", "kd")
  }
  env = make(cfg)
  (model,) = env.scene["robot"].actuators.groups
  spread = []
  for step in range(20):
    env.step(torch.zeros(WORLDS, 0))
    share = min(1.0, max(0.0, (step + 1 - 2) / 10))
    spread.append((model.stiffness / 20.0 - 1.0).abs().max().item())
    assert spread[-1] <= 0.5 * share + 1e-6
    torch.testing.assert_close(model.damping, torch.full_like(model.damping, 2.0 + 2.0 * share))
  assert max(spread[11:]) > 0.3


def test_a_list_of_two_numbers_is_a_range(make: Make) -> None:
  env = make(arm_cfg(LAWS["pd"], kp=drawn("stiffness", [2.0, 2.0], targets="pd")))
  (model,) = env.scene["robot"].actuators.groups
  assert (model.stiffness == 40.0).all()


def test_the_limit_of_a_tendon_follows_its_actuators(make: Make, engine: str) -> None:
  motor = NativeMotorActuatorCfg(target_names_expr=("rope",), transmission_type="tendon", effort_limit=LIMIT)
  event = drawn("effort_limit", (2.0, 2.0), transmission_type="tendon", targets="rope")
  env = make(arm_cfg(motor, engine=engine, limits=event))
  env.scene["robot"].set_tendon_effort_target(torch.full((WORLDS, 1), 50.0))
  env.scene.write_ctrl()
  env.sim.step()
  row = env.sim.mj_model.actuator("robot/rope").id
  torch.testing.assert_close(env.sim.data.actuator_force[:, row].double(), torch.full((WORLDS,), 2 * LIMIT).double())


def late(kind: str, lag: tuple[int, int], **options: Any) -> ActuatorCfg:
  delay: dict[str, Any] = {"delay_min_lag": lag[0], "delay_max_lag": lag[1], **options}
  if kind == "motor":
    return NativeMotorActuatorCfg(target_names_expr=("motor", "dc"), **delay)
  return IdealPdActuatorCfg(target_names_expr=("pd",), stiffness=0.0, damping=0.0, **delay)


def lags_seen(env: Any, joint: str, substeps: int = 12) -> torch.Tensor:
  """Age of the effort that reaches the joint in each substep, (substeps, WORLDS)."""
  robot = env.scene["robot"]
  column = env.sim.mj_model.actuator(f"robot/{joint}").id
  ages = []
  for k in range(substeps):
    robot.set_joint_effort_target(torch.full((1, len(LAWS)), float(k)))
    env.scene.write_ctrl()
    ages.append(k - env.sim.data.ctrl[:, column].clone())
  return torch.stack(ages)


@pytest.mark.parametrize("options", [{}, {"delay_hold_prob": 0.5}, {"delay_update_period": 3}])
def test_a_lag_from_outside_is_kept_through_redraws_and_resets(make: Make, options: dict[str, Any]) -> None:
  event = delays((2, 4), targets=("motor", "dc", "pd"))
  env = make(arm_cfg(late("motor", (1, 5), **options), late("pd", (0, 6), **options), delay=event))
  seen = {}
  for joint in ("motor", "dc", "pd"):
    env.reset()
    ages = lags_seen(env, joint)[6:]
    assert torch.equal(ages, ages[:1].expand_as(ages)), joint
    assert ((ages >= 2) & (ages <= 4)).all()
    seen[joint] = ages[0]
  # Targets of one model share their delay.
  assert torch.equal(seen["motor"], seen["dc"])
  assert torch.cat((seen["motor"], seen["pd"])).unique().numel() > 1


def test_lags_are_drawn_again_in_masked_worlds_only(make: Make) -> None:
  event = delays((0, 9), "reset", targets=("pd",))
  env = make(arm_cfg(late("pd", (0, 9)), delay=event))
  (model,) = env.scene["robot"].actuators.groups
  everyone, one = torch.ones(WORLDS, dtype=torch.bool), torch.tensor([False, True, False, False])
  env.event_manager.apply("reset", everyone)
  kept, mine = model.delay.lag.clone(), set()
  for _ in range(100):
    env.event_manager.apply("reset", one)
    assert torch.equal(model.delay.lag[~one], kept[~one])
    mine.add(int(model.delay.lag[1]))
  assert mine == set(range(10))


SOME = (0.8, 1.2)


@pytest.mark.parametrize(
  ("parameter", "values", "options", "message"),
  [
    ("stifness", SOME, {}, "field 'stifness' does not exist. Nearest: stiffness"),
    ("stiffness", (1.2, 0.8), {}, r"stiffness.* must not fall, got \(1.2, 0.8\)"),
    ("stiffness", 0.8, {}, r"0\.8 is neither two numbers, \(lo, hi\), nor a distribution"),
    ("stiffness", SOME, {"operation": "multiply"}, "operation 'multiply' does not exist. .*scale"),
    ("stiffness", SOME, {"targets": "elbow"}, "pattern 'elbow' matches no driven joint"),
    ("stiffness", SOME, {"targets": "motor"}, "stiffness of joint 'motor': its actuator has none"),
    ("stiffness", SOME, {"targets": "pd"}, "stiffness of joint 'pd': it is zero"),
    ("effort_limit", SOME, {"targets": "pd"}, "effort_limit of joint 'pd': it was not given"),
    ("effort_limit", SOME, {"targets": "motor"}, "effort_limit of joint 'motor': its actuator has none"),
    ("delay", Categorical((1.5, 2)), {"targets": ("motor", "dc")}, "must be whole numbers"),
    ("delay", Categorical((0, 4)), {"targets": "motor"}, "'motor' shares its delay with dc; name all of them"),
    ("delay", Categorical((0, 4)), {"targets": ("motor", "dc")}, "lags in .0, 4. for 'motor', whose config has"),
    ("delay", Categorical((2,)), {"targets": ("pd",)}, "delay_min_lag 2 and delay_max_lag 2; widen those"),
  ],
)
def test_what_would_have_no_effect_is_refused_by_name_at_build(
  make: Make, parameter: str, values: Any, options: dict[str, Any], message: str
) -> None:
  with pytest.raises(MjlabError, match=message):
    make(arm_cfg(late("motor", (1, 3)), late("pd", (2, 2)), event=drawn(parameter, values, **options)))


def test_a_gain_that_may_become_negative_is_refused_at_build(make: Make) -> None:
  with pytest.raises(MjlabError, match=r"'pd' may get stiffness -.*, below the physical minimum 0"):
    make(arm_cfg(LAWS["pd"], event=drawn("stiffness", (-0.1, 0.8), targets="pd")))


def test_two_events_for_one_number_are_refused(make: Make) -> None:
  a, b = drawn("stiffness", SOME, targets="pd"), drawn("stiffness", SOME, targets=("pd", "dc"))
  with pytest.raises(ConfigError, match="stiffness of joint 'pd' is written by event"):
    make(arm_cfg(*LAWS.values(), a=a, b=b))


def test_one_event_serves_rows_of_models_and_of_actuators(make: Make) -> None:
  events: dict[str, Any] = {
    "kp": drawn("stiffness", (1.0, 3.0), targets="pd", operation="add"),
    "late": delays((3, 3), targets=("motor", "dc")),
    "damping": drawn("dof_damping", (0.1, 0.2), targets="pd"),
  }
  pd, motor = make(arm_cfg(LAWS["pd"], late("motor", (0, 5)), **events)).scene["robot"].actuators.groups
  assert ((pd.stiffness >= 21.0) & (pd.stiffness <= 23.0)).all()
  assert pd.stiffness.unique().numel() == WORLDS
  assert (motor.delay.lag == 3).all()


def test_claims_follow_the_parameters_of_an_event(make: Make) -> None:
  a, b = (drawn("stiffness", (2.0, 2.0), "reset", targets=target) for target in ("pd", "dc"))
  env = make(arm_cfg(LAWS["pd"], LAWS["dc"], LAWS["envelope"], a=a, b=b))
  with pytest.raises(ConfigError, match="term 'b': stiffness of joint 'pd' is written by event 'a' too"):
    env.event_manager.set_params("b", randomizer=randomize_field("stiffness", "pd", (2.0, 2.0)))
  env.event_manager.set_params("a", randomizer=randomize_field("stiffness", "envelope", (2.0, 2.0)))
  env.event_manager.set_params("b", randomizer=randomize_field("stiffness", "pd", (4.0, 4.0)))
  env.event_manager.apply("reset", torch.ones(WORLDS, dtype=torch.bool))
  pd, _, envelope = env.scene["robot"].actuators.groups
  assert (pd.stiffness == 80.0).all()
  assert (envelope.stiffness == 40.0).all()


def test_an_event_on_the_raw_field_of_a_gain_is_refused_beside_one_on_the_gain(make: Make) -> None:
  raw = drawn("actuator_forcerange", (0.5, 1.0), targets="position", operation="scale")
  limits = drawn("effort_limit", (0.8, 1.2), targets="position")
  for first, second in ((raw, limits), (limits, raw)):
    with pytest.raises(ConfigError, match=r"actuator_forcerange of .*'position' is written by"):
      make(arm_cfg(*LAWS.values(), a=first, b=second))


def test_an_entity_without_actuators_has_none_to_randomise(make: Make) -> None:
  with pytest.raises(ConfigError, match=r"entity 'robot': .*no actuators are configured for it"):
    make(arm_cfg(a=drawn("stiffness", (0.8, 1.2))))
