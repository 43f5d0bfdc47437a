"""Robot with hips and knees held by position servos, and wheels driven by velocity servos."""

import mujoco
from mjlab_actuators import NativePositionActuatorCfg, NativeVelocityActuatorCfg
from mjlab_scene import EntityArticulationCfg, EntityCfg, InitialStateCfg

WHEEL_RADIUS = 0.06
THIGH, SHIN = 0.16, 0.17
HEIGHT = WHEEL_RADIUS + THIGH + SHIN
LEG = """
<body name="{side}_thigh" pos="0 {y} 0">
  <joint name="{side}_hip" axis="0 1 0" range="-1.26 1.26"/>
  <geom type="capsule" fromto="0 0 -0.02 0 0 -0.14" size="0.02" mass="0.6"/>
  <body name="{side}_shin" pos="0 0 -{thigh}">
    <joint name="{side}_knee" axis="0 1 0" range="-2.5 2.5"/>
    <geom type="capsule" fromto="0 0 -0.02 0 0 -0.15" size="0.015" mass="0.4"/>
    <body name="{side}_tire" pos="0 0 -{shin}">
      <joint name="{side}_wheel" axis="0 1 0"/>
      <geom name="{side}_tire" type="cylinder" size="{radius} 0.01" zaxis="0 1 0" mass="0.35"/>
    </body>
  </body>
</body>"""


def robot_spec() -> mujoco.MjSpec:
  legs = "".join(
    LEG.format(side=side, y=y, thigh=THIGH, shin=SHIN, radius=WHEEL_RADIUS)
    for side, y in (("left", 0.15), ("right", -0.15))
  )
  return mujoco.MjSpec.from_string(f"""
    <mujoco><compiler angle="radian" autolimits="true"/><default><joint armature="0.005" damping="0.02"/></default>
    <worldbody><body name="base"><freejoint/><site name="imu"/>
      <geom name="trunk" type="box" size="0.07 0.1 0.08" pos="0 0 0.08" mass="2.5"/>{legs}
    </body></worldbody>
    <sensor><gyro name="gyro" site="imu"/></sensor></mujoco>""")


def robot() -> EntityCfg:
  legs = NativePositionActuatorCfg(
    target_names_expr=(".*_hip", ".*_knee"), stiffness=40.0, damping=1.0, effort_limit=16.0
  )
  wheels = NativeVelocityActuatorCfg(target_names_expr=(".*_wheel",), damping=1.0, effort_limit=1.7)
  return EntityCfg(
    spec_fn=robot_spec,
    init_state=InitialStateCfg(pos=(0.0, 0.0, HEIGHT)),
    articulation=EntityArticulationCfg(actuators=(legs, wheels), soft_joint_pos_limit_factor=0.9),
  )
