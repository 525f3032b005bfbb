"""The paper's cast: with 0.53 s of rest between the strokes it pumps up, with 0.34 s it does not."""

import hyperflex as hf

cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
reach = {}
for rest in (0.53, 0.34):
    run = hf.simulate(cable, hf.arm_swings(t_move=0.73, t_rest=rest), arm=hf.Arm(length=0.105), duration=14.0)
    reach[rest] = float(abs(run.tip[run.t >= 10.0, 0]).max())
    print(f"rest {rest:.2f} s: the tip reaches {reach[rest]:.2f} m to the side from 10 s on")
assert reach[0.53] > 1.6 * reach[0.34]
