"""How far a chain of links is from the rope that it stands for, and the same rope with other links."""

import numpy as np

import hyperflex as hf

cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
run = hf.simulate(cable, hf.arm_swings(), arm=hf.Arm(), duration=4.0, extrapolate=True)
off = np.linalg.norm(run.tip - run.limit[:, -1], axis=1)
print(
    f"after 4 s the tip of 50 links is {1e3 * off[-1]:.1f} mm off the limit (known to {1e3 * run.limit_error[-1]:.1f})"
)

fine = hf.with_links(cable, 800)
truth = hf.simulate(fine, hf.arm_swings(), arm=hf.Arm(), duration=4.0)
away = np.linalg.norm(run.limit[:, -1] - truth.tip, axis=1)
print(
    f"friction of a joint {cable.friction[1]:.2g} -> {fine.friction[1]:.2g} N m s/rad; 800: {1e3 * away[-1]:.2f} mm off"
)
assert (away < run.limit_error).all()
