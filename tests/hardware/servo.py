"""A motor in a few lines, in place of a Plant, for tests of protocols and guards: it costs next to nothing."""

import math

from hyperflex.hardware.emulate import MotorModel


class Servo:
    """Follows its goal with a first-order lag of 5 ms; without torque it does not move.

    `goals` came at times, s; `path` are times and angles of the shaft.
    """

    def __init__(self, angle=0.0):
        self.t, self.angle, self.rate, self.torque, self.voltage, self.temperature = 0.0, angle, 0.0, 0.0, 24.0, 25.0
        self.enabled, self.goals, self.path, self._goal = False, [], [(0.0, angle)], angle
        self.switched_off = None  # when last
        self.model = MotorModel()
        self.on_goal = lambda goal: None

    def set_goal(self, goal):
        self._goal = goal.angle
        self.goals.append((self.t, goal))
        self.on_goal(goal)

    def set_enabled(self, on):
        if self.enabled and not on:
            self.switched_off = self.t
        if on and not self.enabled:
            self._goal = self.angle
        self.enabled = on

    def advance(self, t):
        before = self.angle
        if self.enabled and t > self.t:
            self.angle += (self._goal - self.angle) * -math.expm1((self.t - t) / 0.005)
            self.rate = (self.angle - before) / (t - self.t)
        self.t = max(t, self.t)
        if self.angle != before:
            self.path.append((self.t, self.angle))

    def impose(self, **values):
        vars(self).update(values)

    def warm(self):
        pass
