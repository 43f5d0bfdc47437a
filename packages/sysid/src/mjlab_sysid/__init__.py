"""System identification: from records of a robot to the parameters of its simulation."""

from mjlab_sysid.data.reading import read_records
from mjlab_sysid.data.records import Record, check_joints, uniform, write_record
from mjlab_sysid.excitation import Excitation, ExcitationCfg, Peak, design_excitation
from mjlab_sysid.identified import Estimate, Identified, Information, Trace
from mjlab_sysid.identify import Progress, identify
from mjlab_sysid.motors.motor_fit import FitProgress, MotorFit, MotorFitCfg, fit_motor, require_matplotlib
from mjlab_sysid.motors.motor_model import MotorModel
from mjlab_sysid.parameters import FitTerm, Parameter, Range, parse_term
from mjlab_sysid.problem import IdentifyCfg
from mjlab_sysid.report import write_report
from mjlab_sysid.robot import Robot, robot_on_ground, robot_on_stand

__all__ = [
  "Estimate",
  "Excitation",
  "ExcitationCfg",
  "FitProgress",
  "FitTerm",
  "Identified",
  "IdentifyCfg",
  "Information",
  "MotorFit",
  "MotorFitCfg",
  "MotorModel",
  "Parameter",
  "Peak",
  "Progress",
  "Range",
  "Record",
  "Robot",
  "Trace",
  "check_joints",
  "design_excitation",
  "fit_motor",
  "identify",
  "parse_term",
  "read_records",
  "require_matplotlib",
  "robot_on_ground",
  "robot_on_stand",
  "uniform",
  "write_record",
  "write_report",
]
