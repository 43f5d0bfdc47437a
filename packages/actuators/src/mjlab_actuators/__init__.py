"""Actuator models for batched MuJoCo: native servos, ideal PD, delay."""
