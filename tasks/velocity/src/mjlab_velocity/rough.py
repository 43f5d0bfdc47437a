"""Velocity task on rough ground: terrain, height scan, terrain levels."""

from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import (
  CurriculumTermCfg,
  EventTermCfg,
  ObservationTermCfg,
  TerminationTermCfg,
  UniformNoiseCfg,
)
from mjlab_sensors import ContactMatch, ContactSensorCfg, FrameMatch, GridPatternCfg, RayCastSensorCfg
from mjlab_terrain import (
  FlatCfg,
  PyramidSlopeCfg,
  PyramidStairsCfg,
  RandomRoughCfg,
  TerrainGridCfg,
  WavesCfg,
)

from mjlab_velocity import mdp as velocity
from mjlab_velocity.legged import LeggedRobot, flat_env, play_flat

RIM = 0.2  # m, level edge of tiles made of height fields
SCAN_DISTANCE = 5.0  # m
SCAN_NOISE = 0.1  # m, before scaling


def rough_terrain() -> TerrainGridCfg:
  """Return ten levels of seven kinds of ground, each kind with its share of worlds."""
  return TerrainGridCfg(
    tile_size=(8.0, 8.0),
    rows=10,
    layout="curriculum",
    border_width=20.0,
    types={
      "flat": FlatCfg(share=0.2),
      "stairs_up": PyramidStairsCfg(share=0.2, step_height=(0.0, 0.1)),
      "stairs_down": PyramidStairsCfg(share=0.2, step_height=(0.0, 0.1), inverted=True),
      "slope_up": PyramidSlopeCfg(share=0.1, slope=(0.0, 1.0), curved=True, border=RIM),
      "slope_down": PyramidSlopeCfg(share=0.1, slope=(0.0, 1.0), curved=True, border=RIM, inverted=True),
      # The hardest level is as rough as heights of 2 to 10 cm in steps of 2 cm.
      "random_rough": RandomRoughCfg(share=0.1, amplitude=(0.0, 0.05), border=RIM),
      "waves": WavesCfg(share=0.1, amplitude=(0.0, 0.2), border=RIM),
    },
  )


def rough_env(robot: LeggedRobot, *, scan_body: str) -> ManagerBasedRlEnvCfg:
  """Return the flat task on tiles that become harder with success, with a scan of the ground around `scan_body`."""
  cfg = flat_env(robot)
  cfg.scene.terrain = rough_terrain()
  cfg.scene.max_init_terrain_level = 5
  cfg.sim.contact_sensor_maxmatch = 128
  cfg.scene.sensors["terrain_scan"] = RayCastSensorCfg(
    frames=FrameMatch(type="body", pattern=scan_body, entity="robot"),
    pattern=GridPatternCfg(size=(1.6, 1.0), resolution=0.1),
    alignment="yaw",
    max_distance=SCAN_DISTANCE,
    # The steepest slope rises to the height of the body within the scan, so rays start above the body.
    start_height=1.0,
    geom_groups=(0,),
  )
  for group in cfg.observations.values():
    assert group is not None
    group.terms["height_scan"] = ObservationTermCfg(
      mdp.height_scan,
      noise=UniformNoiseCfg(n_min=-SCAN_NOISE, n_max=SCAN_NOISE),
      scale=1.0 / SCAN_DISTANCE,
      params={"sensor": "terrain_scan"},
    )
  cfg.terminations["out_of_terrain_bounds"] = TerminationTermCfg(velocity.out_of_terrain_bounds, time_out=True)
  cfg.curriculum["terrain_levels"] = CurriculumTermCfg(velocity.terrain_levels, params={"command": "twist"})
  return cfg


def self_collision(root: str) -> ContactSensorCfg:
  """Return a sensor of the strongest contact of the robot with itself over the substeps of a step."""
  robot = ContactMatch(mode="subtree", pattern=root, entity="robot")
  return ContactSensorCfg(
    primary=robot, secondary=robot, fields=("found", "force"), reduce="maxforce", history_length="decimation"
  )


def ground_contact(primary: ContactMatch) -> ContactSensorCfg:
  """Return a sensor of the strongest contact of each `primary` with the ground over the substeps of a step."""
  return ContactSensorCfg(
    primary=primary,
    secondary=ContactMatch(mode="body", pattern="terrain"),
    fields=("found", "force"),
    reduce="maxforce",
    history_length="decimation",
  )


def play_rough(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """Turn a rough training config into one for watching: fewer tiles in random order, another tile in each episode."""
  cfg = play_flat(cfg)
  cfg.terminations["out_of_terrain_bounds"] = None
  if isinstance(cfg.scene.terrain, TerrainGridCfg):
    cfg.scene.terrain.layout = "random"
    cfg.scene.terrain.rows = cfg.scene.terrain.columns = 5
    cfg.scene.terrain.border_width = 10.0
    cfg.scene.max_init_terrain_level = None
  # The tile is drawn before the place on it.
  cfg.events = {"randomize_terrain": EventTermCfg(velocity.randomize_terrain, mode="reset"), **cfg.events}
  return cfg
