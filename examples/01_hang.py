"""A rope that hangs and sways: its slowest frequency is that of the hanging string, 1.2024 sqrt(g / L)."""

import numpy as np

import hyperflex as hf

rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=40, friction=0.0)
heights = 1.0 - np.cumsum(rope.length)  # of the joints above the tip, m
shape = 1e-3 * (1.0 - 0.5 * heights)  # roughly the slowest mode, small

run = hf.simulate(rope, duration=8.0, q0=shape, tol=1e-8)
x = run.tip[:, 0]
crossings = run.t[1:][np.diff(np.sign(x)) != 0]
period = 2.0 * float(np.diff(crossings).mean())

string = 2.0 * np.pi / (1.2024 * np.sqrt(9.81 / 1.0))
print(f"period of the rope {period:.3f} s, of the string {string:.3f} s")
assert abs(period / string - 1.0) < 0.02  # other modes disturb the crossings, and 40 links are not a string
