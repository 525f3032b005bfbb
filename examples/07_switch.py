"""A rope's tip strikes a switch behind the edge of a wall, which the rope must not touch on its way."""

import numpy as np

import hyperflex as hf

rope, arm = hf.Rope.uniform(length=1.0, mass=0.06, n_links=32, radius=0.0025, friction=2e-4), hf.Arm(length=0.105)
wall = hf.Wall(0.334, -1.5, 0.334, -0.89)
switch = hf.TipTarget(0.416, -1.015, least_speed=3.0)  # 8 cm behind the wall, 12 cm below its edge
conditions = hf.Conditions(obstacles=[wall])
plan = hf.plan_whip(rope, arm, switch, conditions=conditions, time_budget=60.0)
print(plan)
assert plan.success, plan.message
print(f"{plan.outcome.speed:.1f} m/s at {plan.outcome.t:.2f} s, {1e3 * plan.outcome.miss:.1f} mm off")
assert plan.outcome.clearance > 0.0
print(f"the rope keeps {1e3 * plan.outcome.clearance:.0f} mm from wall, arm and shaft until then")

impact = plan.impact(radius=0.01)
print(f"a switch of 10 mm takes up {1e3 * impact.impulse:.1f} mN s" if impact.success else impact.message)

t = np.arange(0.0, plan.outcome.t, 1e-3)
free = hf.simulate(rope=rope, motion=plan.motion, arm=arm, t_eval=t, duration=float(t[-1]))  # with no wall there
at_wall = np.diff(np.sign(free.joints[..., 0] - wall.x), axis=1) != 0.0
assert (free.joints[:, 1:, 1][at_wall] > wall.y2).all()  # every link that crosses the wall's line is above its edge
