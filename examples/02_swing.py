"""A real pendulum is a rope of one link: its period at a large amplitude, and the energy that friction takes."""

import numpy as np

import hyperflex as hf

pendulum = hf.Rope(length=[0.3], mass=[0.2], com=[0.25], inertia=[1e-3], friction=2e-4)
run = hf.simulate(pendulum, duration=20.0, q0=[2.0])

top = np.flatnonzero(np.diff(np.sign(run.qd[:, 0])) < 0)
print("amplitudes:", np.round(run.q[top[:5], 0], 3))
lost = run.dissipated_energy[-1]
energy = run.kinetic_energy + run.potential_energy
print(f"lost to friction {lost * 1e3:.1f} mJ, missing from the energy {(energy[0] - energy[-1]) * 1e3:.1f} mJ")
assert abs(energy[0] - energy[-1] - lost) < 1e-3 * lost
