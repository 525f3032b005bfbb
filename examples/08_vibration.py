"""Hold a two-link pendulum 20 degrees above the horizontal by vibrating its pivot, and push its tip."""

import math

import hyperflex as hf

rope = hf.Rope(length=[0.15, 0.15], mass=[0.03, 0.03], friction=2e-4)
tilt = math.radians(110.0)

plan = hf.plan_vibration(rope, tilt, stiffness=0.8)
held = plan.posture
print(held)
print(f"slow motions at {held.frequencies.round(2)} Hz, tip {held.stiffness(tilt + 0.5 * math.pi):.2f} N/m across")

run = held.simulate(2.0)  # the rope itself, without averaging
x, y = (run.tip - run.base).mean(axis=0)
print(f"simulated: mean tilt {math.degrees(math.atan2(x, -y)):.1f} degrees")
assert abs(math.atan2(x, -y) - tilt) < 0.02 * tilt

arm = hf.plan_vibration(rope, tilt, hf.MotorLimits(), arm=hf.Arm(length=0.1))
print(arm.message)  # the motor of the casts is far too slow
assert not arm.success
