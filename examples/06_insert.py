"""A rope's tip goes through a slot between two walls: planned, and run again from the plan's own file."""

import tempfile
from pathlib import Path

import hyperflex as hf

rope = hf.Rope.uniform(length=1.0, mass=0.06, n_links=16, radius=0.0025, friction=5e-4)
slot = hf.Slot(x=-0.35, y=-0.85, direction=-2.4, width=0.025, depth=0.04)
plan = hf.plan_insert(rope, hf.Arm(length=0.1), slot, samples=50, time_budget=120.0)
print(plan)
print(f"success probability with a slot 2 mm and strokes 2 ms off: {plan.success_probability}")
assert plan.success, plan.message

with tempfile.TemporaryDirectory() as folder:
    plan.to_toml(Path(folder) / "insert.toml")
    run = hf.simulate(hf.Setup.from_toml(Path(folder) / "insert.toml"))
inside = (run.tip - slot.point) @ slot.axes[0]
print(f"the tip comes {1e3 * inside.max():.0f} mm deep, {1e3 * slot.depth:g} mm are required")
assert inside.max() > slot.depth
