"""Actuator models for batched MuJoCo: native servos, PD, motors, networks, wrapped MJCF, delay."""

from mjlab_actuators.actuator import Actuator, ActuatorCmd, ActuatorGroup, Column, CommandField
from mjlab_actuators.actuator_cfg import ActuatorCfg, PerTarget
from mjlab_actuators.actuator_parameter import ActuatorDelay, ActuatorParameter, ParameterName
from mjlab_actuators.actuator_set import ActuatorSet
from mjlab_actuators.models.dc_motor import DcMotor, DcMotorActuatorCfg, clip_to_dc_motor
from mjlab_actuators.models.envelope import UNITREE_ENVELOPES, EnvelopedPd, EnvelopedPdActuatorCfg, TorqueSpeedEnvelope
from mjlab_actuators.models.ideal_pd import IdealPd, IdealPdActuatorCfg
from mjlab_actuators.models.learned_mlp import LearnedMlp, LearnedMlpActuatorCfg
from mjlab_actuators.models.motor_design import (
  PdGains,
  gains_from_frequency,
  reflected_inertia,
  reflected_inertia_of_stages,
)
from mjlab_actuators.models.native import (
  NativeMotorActuatorCfg,
  NativePd,
  NativePdActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  PassThrough,
)
from mjlab_actuators.models.native_dc_motor import NativeDcMotorActuatorCfg
from mjlab_actuators.models.native_general import NativeGeneralActuatorCfg
from mjlab_actuators.models.native_muscle import NativeMuscleActuatorCfg
from mjlab_actuators.transmission import SiteGear, Target, Transmission, targets_of
from mjlab_actuators.xml import XmlActuatorCfg, command_fields_of

__all__ = [
  "UNITREE_ENVELOPES",
  "Actuator",
  "ActuatorCfg",
  "ActuatorCmd",
  "ActuatorDelay",
  "ActuatorGroup",
  "ActuatorParameter",
  "ActuatorSet",
  "Column",
  "CommandField",
  "DcMotor",
  "DcMotorActuatorCfg",
  "EnvelopedPd",
  "EnvelopedPdActuatorCfg",
  "IdealPd",
  "IdealPdActuatorCfg",
  "LearnedMlp",
  "LearnedMlpActuatorCfg",
  "NativeDcMotorActuatorCfg",
  "NativeGeneralActuatorCfg",
  "NativeMotorActuatorCfg",
  "NativeMuscleActuatorCfg",
  "NativePd",
  "NativePdActuatorCfg",
  "NativePositionActuatorCfg",
  "NativeVelocityActuatorCfg",
  "ParameterName",
  "PassThrough",
  "PdGains",
  "PerTarget",
  "SiteGear",
  "Target",
  "TorqueSpeedEnvelope",
  "Transmission",
  "XmlActuatorCfg",
  "clip_to_dc_motor",
  "command_fields_of",
  "gains_from_frequency",
  "reflected_inertia",
  "reflected_inertia_of_stages",
  "targets_of",
]
