"""A torque-driven arm under a controller of your own: hold the arm at 0.5 rad while the rope swings."""

import hyperflex as hf

rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=20, radius=0.002, friction=1e-4)
arm = hf.Arm(length=0.2, inertia=2e-3, mass=0.1, com=0.1, friction=1e-3, torque_limit=1.0)


def controller(t, arm_angle, arm_rate, q, qd):
    """Proportional and derivative control, with the weight of the arm taken off; torque in N m."""
    return 5.0 * (0.5 - arm_angle) - 0.2 * arm_rate + 0.1 * 9.81 * 0.1 * 0.479


run = hf.simulate(rope, arm=arm, torque=controller, control_rate=200.0, duration=6.0)
print(f"arm at {run.arm_angle[-1]:.3f} rad, torque {run.motor_torque[-1]:.3f} N m")
assert abs(run.arm_angle[-1] - 0.5) < 0.05

again = hf.simulate(run.setup)  # the set-up holds the torque that was applied
assert abs(again.q - run.q).max() == 0.0
