"""A cast begun one degree out of its plane: how far to the side the rope then is."""

import math

import numpy as np

import hyperflex as hf

cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
cast = hf.simulate(cable, hf.arm_swings(t_move=0.73, t_rest=0.53), arm=hf.Arm(length=0.105), duration=8.0)
askew = hf.sideways(cast, tilt=math.radians(1.0))
for until in (3.0, 8.0):
    print(f"up to {until:g} s: {1e2 * np.abs(askew.tip[askew.t <= until]).max():.1f} cm to the side at the tip")
assert np.abs(askew.tip[askew.t <= 3.0]).max() < 0.1

level = hf.sideways(cast, lean=math.radians(0.5))
print(f"a shaft half a degree off level: {1e2 * np.abs(level.tip).max():.1f} cm from the plane")

twice = hf.sideways(cast, tilt=math.radians(2.0))
assert np.allclose(twice.tip, 2.0 * askew.tip)  # linear: scale it

t, growth = askew.growth()
print(f"any deviation at the start has grown {growth[-1]:.1f} times at most by {t[-1]:g} s")
assert growth.max() >= 1.0
