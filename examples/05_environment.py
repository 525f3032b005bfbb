"""Environments for learning: one rope with a peg, and 64 in free flight at once; an acceleration every 20 ms."""

import time

import numpy as np

import hyperflex as hf

DT, LONGEST, LINKS, MEMBERS = 0.02, 3.0, 20, 64  # s, s, links, environments in parallel
MARKERS = (5, 10, 15)  # joints that are seen
ARM = hf.Arm(length=0.3)
MOTOR = hf.MotorLimits(speed=8.0, acceleration=40.0, angles=(-1.2, 1.2))
PEG = hf.Peg(x=0.8, y=-0.9, radius=0.04)
TARGET, GATE = (0.4, -1.1), 0.3  # m: the tip's speed in +x counts where it crosses x = 0.4, if |y + 1.1| < 0.3
INSTANTS = np.linspace(0.0, 1.0, 9)  # of an interval, at which the tip's way past target and peg is looked at
LEAD, SWEEP = 1.5, 1.1  # rad: of the phase, of the arm


def random_rope(rng):
    """Return the rope of an episode, its length and friction drawn."""
    length, friction = rng.uniform(0.9, 1.1), rng.uniform(1e-4, 4e-4)
    return hf.Rope.uniform(length=length, mass=0.06 * length, n_links=LINKS, radius=0.0025, friction=friction)


def within_limits(action, angle, rate):
    """Return the acceleration nearest to `action` that the motor can give, and after which it can still brake."""
    most, half = MOTOR.acceleration, 0.5 * MOTOR.acceleration * DT
    middle = angle + 0.5 * DT * rate
    room = [np.maximum(way, 0.0) for way in (middle - MOTOR.angles[0], MOTOR.angles[1] - middle)]
    low, high = (np.minimum(np.sqrt(half**2 + 2.0 * most * way) - half, MOTOR.speed) for way in room)
    return np.clip(np.clip(action, (-low - rate) / DT, (high - rate) / DT), -most, most)


def observe(lengths, state):
    """Return what is seen (..., 12): arm angle and rate, tip place and velocity, marker places; rad, m, s."""
    angle, rate, q = np.asarray(state.arm_angle), np.asarray(state.arm_rate), state.q
    across = np.stack([np.cos(q), np.sin(q)], axis=-1)
    along = np.stack([np.sin(q), -np.cos(q)], axis=-1)
    joints = ARM.tip(angle)[..., None, :] + np.cumsum(lengths[..., None] * along, axis=-2)  # (..., n, 2)
    turning = ARM.length * rate[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    velocity = turning + ((lengths * state.qd)[..., None] * across).sum(axis=-2)
    markers = joints[..., np.array(MARKERS) - 1, :].reshape(*angle.shape, -1)
    return np.concatenate([angle[..., None], rate[..., None], joints[..., -1, :], velocity, markers], axis=-1)


def judge(before, after):
    """Return the reward, m/s, and whether the tip touched the peg between two observations (..., 12)."""
    s = INSTANTS[:, None]
    (x0, v0), (x1, v1) = ((seen[..., None, 2:4], DT * seen[..., None, 4:6]) for seen in (before, after))
    bend, twist = x1 - x0 - v0, v1 - v0  # the tip's way is a cubic with these places and velocities at its ends
    way = x0 + v0 * s + (3.0 * bend - twist) * s**2 + (twist - 2.0 * bend) * s**3
    gap = np.hypot(way[..., 0] - PEG.x, way[..., 1] - PEG.y).min(axis=-1) - PEG.radius - 0.0025
    at = np.clip((TARGET[0] - x0[..., 0, 0]) / np.where(x1 > x0, x1 - x0, 1.0)[..., 0, 0], 0.0, 1.0)  # when it crosses
    height = (1.0 - at) * x0[..., 0, 1] + at * x1[..., 0, 1]
    crossed = (x0[..., 0, 0] < TARGET[0]) & (x1[..., 0, 0] >= TARGET[0]) & (abs(height - TARGET[1]) < GATE)
    speed = ((1.0 - at) * v0[..., 0, 0] + at * v1[..., 0, 0]) / DT
    return np.where(crossed, speed, 0.0), gap < 1e-4


class RopeEnv:
    """One rope beside the peg; `reset` and `step` return what Gymnasium's do."""

    def reset(self, seed=None):
        """Begin an episode with a rope of its own; the same seed gives the same rope."""
        if seed is not None or not hasattr(self, "rng"):
            self.rng = np.random.default_rng(seed)
        self.rope = random_rope(self.rng)
        self.stepper = hf.Stepper(self.rope, arm=ARM, pegs=[PEG], refine=False)
        self.state = self.stepper.start()
        self.seen = observe(self.rope.length, self.state)
        return self.seen, {"rope": self.rope}

    def step(self, action):
        """Turn the arm with `action`, rad/s^2, for an interval."""
        given = float(within_limits(action, self.state.arm_angle, self.state.arm_rate))
        self.state = self.stepper.step(self.state, given, dt=DT)
        before, self.seen = self.seen, observe(self.rope.length, self.state)
        reward, touched = judge(before, self.seen)
        return self.seen, float(reward), bool(touched), self.state.t > LONGEST - 0.5 * DT, {"acceleration": given}


class BatchRopeEnv:
    """Many ropes in free flight, each of which ends where its tip comes to the peg, and then begins anew."""

    def reset(self, seed=None):
        """Begin all episodes."""
        self.rng = np.random.default_rng(seed)
        ropes = [random_rope(self.rng) for _ in range(MEMBERS)]
        self.stepper = hf.BatchStepper(ropes, arm=ARM)
        self.state, self.steps = self.stepper.start(), np.zeros(MEMBERS, dtype=int)
        self.lengths = np.array([rope.length for rope in ropes])
        self.seen = observe(self.lengths, self.state)
        return self.seen, {}

    def step(self, actions):
        """Turn the arms with `actions` (64,); what has ended begins anew, its last observation is in the last value."""
        given = within_limits(actions, self.state.arm_angle, self.state.arm_rate)
        self.state, self.steps = self.stepper.step(self.state, given, dt=DT), self.steps + 1
        before, self.seen = self.seen, observe(self.lengths, self.state)
        rewards, touched = judge(before, self.seen)
        failed = self.state.codes != 0
        over = failed | (self.steps >= round(LONGEST / DT))
        last, ended = self.seen, touched | over
        if ended.any():
            ropes = [random_rope(self.rng) for _ in range(ended.sum())]
            self.state = self.stepper.restart(self.state, ended, ropes)
            self.lengths[ended], self.steps[ended] = [rope.length for rope in ropes], 0
            self.seen = observe(self.lengths, self.state)
        return self.seen, np.where(failed, 0.0, rewards), touched, over, {"last": last, "failed": failed}


def swing_up(seen):
    """Return a bang-bang acceleration: to the side to which the phase of the tip's swing points, as fast as can be."""
    angle, rate, x, v = seen[..., 0], seen[..., 1], seen[..., 2], seen[..., 4]
    phase = np.arctan2(x, 0.25 * v)
    side = np.where(np.cos(phase + LEAD) >= 0.0, 1.0, -1.0)
    return MOTOR.acceleration * np.sign(SWEEP * side - angle - rate * abs(rate) / (2.0 * MOTOR.acceleration))


# The batch swings up, better than chance; and what it does in free flight is what one environment does.
rng, batch = np.random.default_rng(1), BatchRopeEnv()
batch.reset(0)
for name, policy in (("swing-up", swing_up), ("chance", lambda seen: rng.uniform(-40.0, 40.0, MEMBERS))):
    seen, _ = batch.reset(0)
    total, touches, begin = np.zeros(MEMBERS), 0, time.perf_counter()
    for _ in range(round(LONGEST / DT) - 1):
        seen, rewards, touched, _, _ = batch.step(policy(seen))
        total, touches = total + rewards, touches + touched.sum()
    rate = MEMBERS * (round(LONGEST / DT) - 1) / (time.perf_counter() - begin)
    print(f"{name}: {total.mean():.1f} m/s in {LONGEST:g} s, {touches} tips at the peg, {rate:.0f} steps/s")
    if policy is swing_up:
        reached = total.mean()
assert reached > 2.0 * total.mean()
assert touches < MEMBERS

one = RopeEnv()
alone, _ = one.reset(0)
many, _ = batch.reset(0)  # its first rope is the same
worst = 0.0
for _ in range(100):
    actions = swing_up(many)
    many, _, touched, over, info = batch.step(actions)
    alone, _, end, late, _ = one.step(actions[0])
    worst = max(worst, abs(info["last"][0, 2:4] - alone[2:4]).max())
    assert (end, late) == (touched[0], over[0])
print(f"after {one.state.t:.2f} s the tip of one environment is within {1e3 * worst:.1g} mm of the batch's")
assert worst < 5e-3  # a rope that swings is chaotic: errors of 1e-6 m grow a thousandfold in 2 s

count, begin = 0, time.perf_counter()
for _ in range(5):
    alone, info = one.reset(3)
    first, end, late = info["rope"].total_length, False, False
    while not (end or late):
        alone, _, end, late, _ = one.step(swing_up(alone))
        count += 1
print(f"one environment: {count / (time.perf_counter() - begin):.0f} steps/s")
assert first == RopeEnv().reset(3)[1]["rope"].total_length
