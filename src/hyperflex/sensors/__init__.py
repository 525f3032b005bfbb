"""Sensor models with derivatives, for identification and filters."""

from hyperflex.sensors.accelerometer import Accelerometer
from hyperflex.sensors.motor_torque import MotorTorque
from hyperflex.sensors.posture import Angles, Markers, PostureSensor, lever_arms
from hyperflex.sensors.sensor import Measurement, Sensor

__all__ = ["Accelerometer", "Angles", "Markers", "Measurement", "MotorTorque", "PostureSensor", "Sensor", "lever_arms"]
