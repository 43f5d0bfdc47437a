"""Networks with images and recurrent layers: hidden states, shared encoders, training and export."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import rl_learners
import torch
from mjlab_core import seed_everything
from mjlab_core.errors import ConfigError, FileError, UnknownNameError
from mjlab_rl import (
  CheckpointPolicy,
  MjlabDistillationRunner,
  MjlabOnPolicyRunner,
  RslRlDistillationRunnerCfg,
  RslRlModelCfg,
  RslRlOnPolicyRunnerCfg,
  RslRlVecEnvWrapper,
  TaskCfg,
  train,
)
from mjlab_rl.models.networks import Gaussian, ImageModel
from mjlab_rl.models.spatial_softmax import SpatialSoftmaxCNNModel
from rl_learners import QUIET, agent, assert_no_waits, assert_resumes_exactly, exported
from rl_point_env import PointEnv, PointEnvCfg, PointSceneCfg
from rsl_rl.modules import GaussianDistribution
from rsl_rl.utils import split_and_pad_trajectories
from tensordict import TensorDict

CNN = {"output_channels": (4, 4), "kernel_size": (3, 3), "stride": (2, 2), "padding": "zeros"}
SOFTMAX = "mjlab_rl.models.spatial_softmax:SpatialSoftmaxCNNModel"
GROUPS = {"net": ["speed", "camera"]}
each_kind = pytest.mark.parametrize("kind", [ImageModel, SpatialSoftmaxCNNModel])
each_memory = pytest.mark.parametrize("rnn_type", [None, "gru", "lstm"])


class SeenPoint(PointEnv):
  """The point as a bright spot on 8 x 8 pixels, and its `speed`, which the image does not show."""

  pixels = 8

  def get_observations(self) -> dict[str, torch.Tensor]:
    place = torch.linspace(-1, 1, self.pixels)
    row = torch.exp(-8.0 * (place - self.state[:, :1]).square())
    image = row[:, None, None, :] * torch.exp(-8.0 * place.square())[:, None]
    return {**super().get_observations(), "camera": image, "speed": self.state[:, 1:].clone()}


class SharplySeenPoint(SeenPoint):
  pixels = 12


def observations(steps: tuple[int, ...], seed: int = 0) -> TensorDict:
  generator = torch.Generator().manual_seed(seed)
  shapes = {"speed": (1,), "camera": (1, 8, 8)}
  seen = {name: torch.rand(*steps, *shape, generator=generator) for name, shape in shapes.items()}
  return TensorDict(seen, batch_size=list(steps))


def model(kind: type[ImageModel], rnn_type: Any, **options: Any) -> ImageModel:
  torch.manual_seed(0)
  options = {"cnn_cfg": copy.deepcopy(CNN), "rnn_hidden_dim": 6, "rnn_num_layers": 2, **options}
  return kind(observations((3,)), GROUPS, "net", 2, hidden_dims=(8,), rnn_type=rnn_type, **options)


def seeing(rnn_type: Any = None, class_name: str = SOFTMAX, **changes: Any) -> RslRlOnPolicyRunnerCfg:
  cfg = agent()
  sees = {"class_name": class_name, "cnn_cfg": copy.deepcopy(CNN), "rnn_type": rnn_type, "rnn_hidden_dim": 6}
  cfg.actor = replace(cfg.actor, **sees)
  cfg.obs_groups = {"actor": ("speed", "camera"), "critic": ("critic",)}
  cfg.algorithm.num_learning_epochs, cfg.algorithm.num_mini_batches = 1, 2
  for name, value in changes.items():
    setattr(cfg, name, value)
  return cfg


def critic_that_sees(cfg: RslRlOnPolicyRunnerCfg, rnn_type: Any, *, shared: bool) -> RslRlOnPolicyRunnerCfg:
  cfg.critic = replace(cfg.actor, distribution_cfg=None, rnn_type=rnn_type)
  cfg.obs_groups = {"actor": ("speed", "camera"), "critic": ("critic", "camera")}
  cfg.algorithm.share_cnn_encoders = shared
  return cfg


def runner(cfg: RslRlOnPolicyRunnerCfg, directory: Path | None = None) -> MjlabOnPolicyRunner:
  return rl_learners.runner(directory, cfg, env=SeenPoint)


@each_kind
@each_memory
def test_actions_depend_on_images_and_vectors_of_the_same_world(kind: type[ImageModel], rnn_type: Any) -> None:
  network = model(kind, rnn_type)
  seen = observations((3,)).requires_grad_()
  network(seen)[1].sum().backward()
  for group in GROUPS["net"]:
    gradient: Any = seen[group].grad
    assert gradient[1].abs().amax() > 0.0
    assert gradient[[0, 2]].abs().amax() == 0.0


@each_kind
@pytest.mark.parametrize("rnn_type", ["gru", "lstm"])
def test_only_worlds_that_are_done_lose_their_hidden_state(kind: type[ImageModel], rnn_type: str) -> None:
  network = model(kind, rnn_type)
  first, second = observations((3,), 1), observations((3,), 2)
  outputs = []
  with torch.no_grad():
    for dones in ([0, 1, 0], [1, 1, 1], [0, 0, 0]):
      network.reset()
      network(first)
      network.reset(torch.tensor(dones))
      outputs.append(network(second))
  forgot, blank, remembered = outputs
  assert torch.equal(forgot[1], blank[1])
  assert torch.equal(forgot[[0, 2]], remembered[[0, 2]])
  assert (blank - remembered).abs().amin() > 0.0


@each_kind
@each_memory
def test_whole_trajectories_give_the_outputs_of_their_steps(kind: type[ImageModel], rnn_type: Any) -> None:
  network = model(kind, rnn_type)
  seen, dones = observations((5, 3)), torch.zeros(5, 3, 1, dtype=torch.uint8)
  dones[1, 0] = dones[3, 2] = 1
  steps: list[torch.Tensor] = []
  blank = torch.zeros(2, 5, 6)
  with torch.no_grad():
    for step in range(5):
      steps.append(network(seen[step]))
      network.reset(dones[step, :, 0])
    padded, masks = split_and_pad_trajectories(seen, dones)
    whole = network(padded, masks=masks, hidden_state=(blank, blank) if rnn_type == "lstm" else blank)
  # Three worlds, two of them with a reset.
  assert padded.shape == (5, 5)
  torch.testing.assert_close(whole, torch.stack(steps))


@pytest.mark.parametrize("class_name", ["CNNModel", SOFTMAX])
@pytest.mark.parametrize("critic", ["vectors", "own encoders", "shared encoders", "shared encoders, no memory"])
@each_memory
def test_all_networks_with_images_are_trained(class_name: str, critic: str, rnn_type: Any) -> None:
  cfg = seeing(rnn_type, class_name)
  if critic != "vectors":
    memory = None if "no memory" in critic else rnn_type
    critic_that_sees(cfg, memory, shared="shared" in critic)
  trained = runner(cfg)
  before = {name: copy.deepcopy(network.state_dict()) for name, network in trained.networks.items()}
  trained.learn(2, init_at_random_ep_len=True)
  for name, network in trained.networks.items():
    for key, value in network.state_dict().items():
      assert value.isfinite().all(), (name, key)
      if "weight" in key:
        assert not torch.equal(value, before[name][key]), (name, key)
  if critic != "vectors":
    ours, theirs = (network.cnns for network in trained.networks.values())
    assert (ours is theirs) == ("shared" in critic)
  states = [network.get_hidden_state() is not None for network in trained.networks.values()]
  assert states == [rnn_type is not None, rnn_type is not None and critic in ("own encoders", "shared encoders")]


def test_shared_encoders_are_learned_once_and_saved_with_the_actor() -> None:
  """rsl-rl gives its optimiser every weight of shared encoders twice, and torch warns."""
  shared, own = (runner(critic_that_sees(seeing(), None, shared=shared)) for shared in (True, False))
  numbers = [[id(p) for p in made.alg.optimizer.param_groups[0]["params"]] for made in (shared, own)]
  assert len(numbers[0]) == len(set(numbers[0])) == len(numbers[1]) - 4
  assert not any(name.startswith("cnns") for name in shared.networks["critic"].state_dict())
  shared.networks["critic"](shared.env.get_observations()).sum().backward()
  # Gradients of the critic reach them.
  encoders = [p for name, p in shared.networks["actor"].named_parameters() if name.startswith("cnns")]
  assert len(encoders) == 4
  assert all(p.grad is not None and p.grad.abs().amax() > 0.0 for p in encoders)


@pytest.mark.parametrize("shared", [False, True])
def test_two_iterations_and_two_more_are_four_bit_for_bit(tmp_path: Path, shared: bool) -> None:
  assert_resumes_exactly(lambda folder: runner(critic_that_sees(seeing("gru"), "gru", shared=shared), folder), tmp_path)


@each_memory
def test_a_rollout_with_images_never_waits_for_the_device(rnn_type: Any) -> None:
  assert_no_waits(runner(seeing(rnn_type)))


def test_a_rollout_stores_each_image_once_and_only_groups_of_networks() -> None:
  trained = runner(critic_that_sees(seeing(), None, shared=False))
  stored: Any = trained.alg.storage.observations
  assert (stored["camera"].shape, stored["camera"].dtype) == ((6, 4, 1, 8, 8), torch.float32)
  sizes = {key: value.untyped_storage().nbytes() for key, value in stored.items()}
  assert sizes == {"critic": 6 * 4 * 3 * 4, "speed": 6 * 4 * 4, "camera": 6 * 4 * 64 * 4}


def test_an_unknown_group_is_refused_with_the_nearest_name() -> None:
  message = r"agent\.obs_groups\['actor'\]: observation group 'camra' .* Nearest: camera"
  with pytest.raises(UnknownNameError, match=message):
    runner(seeing(obs_groups={"actor": ("speed", "camra"), "critic": ("critic",)}))


def test_images_take_the_memory_that_the_readme_gives() -> None:
  stored: Any = runner(seeing(num_steps_per_env=2)).alg.storage.observations["camera"]
  per_value = stored.untyped_storage().nbytes() / stored.numel()
  text = " ".join((Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8").split())
  assert f"4096 worlds x 24 steps x 3 x 32 x 32 take {4096 * 24 * 3 * 32 * 32 * per_value / 1e9:.2f} GB" in text


@pytest.mark.parametrize(("class_name", "rnn_type"), [(SOFTMAX, None), (SOFTMAX, "gru"), ("CNNModel", "lstm")])
def test_an_exported_policy_acts_as_its_checkpoint(tmp_path: Path, class_name: str, rnn_type: Any) -> None:
  cfg = seeing(rnn_type, class_name)
  trained = runner(cfg, tmp_path)
  trained.learn(1)
  env = SeenPoint(PointEnvCfg(scene=PointSceneCfg(num_envs=3), seed=4))
  policy = CheckpointPolicy(env, cfg)
  policy.load(tmp_path / "model_1.pt")
  read = exported(policy, cfg, env, tmp_path)
  with torch.no_grad():
    for step in range(4):
      seen = env.get_observations()
      actions = policy(seen)
      torch.testing.assert_close(read(seen), actions, atol=1e-5, rtol=1e-4)
      env.step(actions)
      for acting in (policy, read):
        acting.reset(torch.tensor([False, step == 1, False]))
  with pytest.raises(FileError, match=r"policy\.onnx: .* input: camera .* Got: 12 Expected: 8"):
    read(SharplySeenPoint(env.cfg).get_observations())


class RenamedPoint(PointEnv):
  """The point with its observations under the name that exported networks give to their first input."""

  def get_observations(self) -> dict[str, torch.Tensor]:
    seen = super().get_observations()
    return {"obs": seen["actor"], "critic": seen["critic"]}


def test_a_group_may_have_the_name_of_the_input_of_an_exported_network(tmp_path: Path) -> None:
  cfg = RslRlOnPolicyRunnerCfg(logger="none", obs_groups={"actor": ("obs",), "critic": ("critic",)})
  env = RenamedPoint(PointEnvCfg(scene=PointSceneCfg(num_envs=1), seed=4))
  policy = CheckpointPolicy(env, cfg)
  read = exported(policy, cfg, env, tmp_path)
  seen = env.get_observations()
  with torch.no_grad():
    torch.testing.assert_close(read(seen), policy(seen))


def test_a_recurrent_student_with_images_learns_from_a_teacher_with_vectors() -> None:
  cfg = RslRlDistillationRunnerCfg(
    num_steps_per_env=6, logger="none", obs_groups={"student": ("actor", "camera"), "teacher": ("actor",)}
  )
  cfg.student = replace(seeing("gru").actor, distribution_cfg=cfg.student.distribution_cfg)
  cfg.teacher, cfg.algorithm.gradient_length = RslRlModelCfg(hidden_dims=(8,)), 3
  seed_everything(0)
  wrapped = RslRlVecEnvWrapper(SeenPoint(PointEnvCfg(scene=PointSceneCfg(num_envs=4), seed=3)))
  made = MjlabDistillationRunner(wrapped, cfg, None, "cpu", console=QUIET)
  made._distillation.teacher_loaded = True
  made.learn(3)
  assert_no_waits(made)
  assert all(value.isfinite().all() for value in made.networks["student"].state_dict().values())


def test_more_mini_batches_than_worlds_are_refused_for_recurrent_networks() -> None:
  """rsl-rl divides trajectories by worlds: some batches would be empty."""
  cfg = seeing("gru")
  cfg.algorithm.num_mini_batches = 5
  with pytest.raises(ConfigError, match=r"num_mini_batches is 5; .* has 1 to 4 for a recurrent network"):
    runner(cfg)
  cfg.actor.rnn_type = None
  runner(cfg).learn(1)


@pytest.mark.parametrize(
  ("change", "message"),
  [
    ({"padding": "zeroes"}, r"agent\.actor\.cnn_cfg\.padding 'zeroes' does not exist. Nearest: zeros"),
    ({"activation": "ellu"}, r"agent\.actor\.cnn_cfg\.activation 'ellu' does not exist"),
    ({"norm": ("batch", "group")}, r"agent\.actor\.cnn_cfg\.norm 'group' does not exist. All 3: none, batch, layer"),
    ({"stride": (2, 0)}, r"agent\.actor\.cnn_cfg\.stride must be at least 1, got \(2, 0\)"),
    ({"temperature": 0.0}, r"agent\.actor\.cnn_cfg\.temperature must be positive, got 0\.0"),
    ({"kernel_size": (3,)}, r"agent\.actor\.cnn_cfg\.kernel_size has 1 values, output_channels 2"),
    ({"kernel_size": None}, r"agent\.actor\.cnn_cfg\.kernel_size must be a whole number or be a tuple, got None"),
    ({"output_channels": 4}, r"agent\.actor\.cnn_cfg\.output_channels must be a tuple, got 4"),
    ({"colour": 1}, "unexpected keyword argument 'colour'"),
  ],
)
def test_impossible_settings_of_an_encoder_are_refused_by_their_flag(change: dict[str, Any], message: str) -> None:
  cfg = seeing()
  assert cfg.actor.cnn_cfg is not None
  cfg.actor.cnn_cfg |= change
  with pytest.raises(ConfigError, match=message):
    runner(cfg)
  if "colour" not in change:
    cfg.actor.cnn_cfg = {"camera": cfg.actor.cnn_cfg}
    with pytest.raises(ConfigError, match=r"agent\.actor\.cnn_cfg\.camera\."):
      runner(cfg)


def test_encoders_of_a_network_without_images_are_refused() -> None:
  with pytest.raises(ConfigError, match=r"agent\.actor\.cnn_cfg is given, but agent\.actor\.class_name 'MLPModel'"):
    runner(seeing(class_name="MLPModel"))
  cfg = seeing()
  cfg.algorithm.share_cnn_encoders = True
  with pytest.raises(ConfigError, match=r"share_cnn_encoders is on, but agent\.critic\.class_name 'MLPModel'"):
    runner(cfg)


@each_kind
def test_a_policy_trained_with_another_image_size_is_refused(kind: type[ImageModel], tmp_path: Path) -> None:
  cfg = seeing(class_name=f"{kind.__module__}:{kind.__name__}", max_iterations=1)
  # The weights fit images of any size.
  cfg.actor.cnn_cfg = CNN | ({"global_pool": "max"} if kind is ImageModel else {})
  task = TaskCfg(env=PointEnvCfg(), agent=cfg)
  options: Any = {"name": "Point", "console": QUIET}
  trained = train(task, make_env=SeenPoint, log_root=tmp_path / "logs", **options).checkpoint
  assert trained is not None
  other = tmp_path / "other"
  message = "observation group 'camera' was 1 x 8 x 8 in its training and is 1 x 12 x 12 here"
  student = RslRlDistillationRunnerCfg(max_iterations=1, num_steps_per_env=8, logger="none")
  student.obs_groups = {"student": ("actor",), "teacher": ("speed", "camera")}
  cases: list[tuple[Any, str]] = [(cfg, "init_from"), (cfg, "resume"), (student, "teacher")]
  for learner_cfg, beginning in cases:
    options[beginning], longer = trained, replace(task, agent=replace(learner_cfg, max_iterations=2))
    with pytest.raises(FileError, match=message):
      train(longer, make_env=SharplySeenPoint, log_root=other, **options)
    assert train(longer, make_env=SeenPoint, log_root=None, **options)
    del options[beginning]
  assert not other.exists()
  with pytest.raises(FileError, match=message):
    CheckpointPolicy(SharplySeenPoint(PointEnvCfg()), cfg).load(trained)


def test_actions_are_sampled_as_by_rsl_rl_bit_for_bit() -> None:
  draws = []
  for kind in (GaussianDistribution, Gaussian):
    distribution = kind(3, init_std=0.7)
    distribution.update(torch.linspace(-2.0, 2.0, 15, requires_grad=True).view(5, 3))
    torch.manual_seed(0)
    draws.append(distribution.sample())
  assert torch.equal(*draws)
  assert not draws[1].requires_grad
