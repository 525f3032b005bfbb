"""Assignment of identical markers: jointly, with gaps and clutter; and their first order."""

from itertools import permutations

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.vision import Blobs, RopeMotion, assign_markers, order_markers
from tests.vision.ropes import ARCS

NOISE = 0.5  # px


def observed(places, covariances=None):
    many = len(places)
    each = np.tile(NOISE**2 * np.eye(2), (many, 1, 1)) if covariances is None else covariances
    zeros = np.zeros(many)
    return Blobs(np.asarray(places, float).reshape(-1, 2), each, np.zeros((many, 2)), zeros + 1, zeros > 1)


def each(std, count):
    return std**2 * np.eye(2 * count)


def test_it_is_the_cheapest_of_all_assignments():
    """Against all permutations of six, by their log-likelihood, where predictions overlap."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        mean = rng.uniform(0.0, 60.0, (6, 2))
        variances = rng.uniform(20.0, 80.0, 6)
        spread = np.diag(np.repeat(variances, 2))
        seen = observed(rng.permutation(mean + rng.normal(0.0, 3.0, (6, 2))))
        got = assign_markers(seen, mean, spread, gate=55.0).indices

        def cost(order, mean=mean, variances=variances, seen=seen):
            off = seen.places[list(order)] - mean
            return float(np.sum(off**2 / (variances + NOISE**2)[:, None]))

        best = min(permutations(range(6)), key=cost)
        clear = sorted(cost(order) for order in permutations(range(6)))[1] - cost(best) > 1.0
        assert got.tolist() == list(best) or not clear or cost(got) < cost(best) + 1e-9


def test_gaps_and_clutter():
    mean = np.column_stack([np.arange(10) * 60.0, 100.0 + np.zeros(10)])
    rng = np.random.default_rng(1)
    keep = np.array([0, 1, 2, 4, 5, 7, 8, 9])
    truth = mean + rng.normal(0.0, 2.0, (10, 2))
    seen = observed(np.vstack([[[33.0, 300.0]], truth[keep][::-1], [[500.0, -40.0]]]))
    got = assign_markers(seen, mean, each(3.0, 10))
    assert got.indices.tolist() == [8, 7, 6, -1, 5, 4, -1, 3, 2, 1]
    assert np.isnan(got.places[[3, 6]]).all()
    assert np.allclose(got.places[keep], truth[keep])


def test_a_whole_rope_that_is_off_is_reported_by_its_joint_covariance():
    """All predictions are 70 px to the left of the truth, more than the spacing of 60 px, and something lies where the
    first marker is expected: each alone takes a neighbour, together they are right by the rope's shape."""
    count = 8
    mean = np.column_stack([np.arange(count) * 60.0, 15.0 * np.sin(2.0 * np.arange(count))])
    common = 40.0**2 * np.kron(np.ones((count, count)), np.diag([1.0, 0.2]))
    prior = common + 2.0**2 * np.eye(2 * count)
    seen = observed(np.vstack([mean + np.array([70.0, 3.0]), [[10.0, 0.0]]]))
    together = assign_markers(seen, mean, prior)
    assert together.indices.tolist() == list(range(count))
    alone = assign_markers(seen, mean, prior * np.kron(np.eye(count), np.ones((2, 2))))
    assert (alone.indices != np.arange(count)).all()


@pytest.fixture(scope="module")
def motions():
    """Ropes of 2 m swung at four rhythms up to tip speeds of 20 to 30 m/s."""
    rope = hf.Rope.uniform(length=2.0, mass=0.1, n_links=50, radius=0.003, friction=1e-3)
    arm = hf.Arm(length=0.3)
    t = np.arange(0.0, 6.0, 0.005)
    rhythms = ((0.73, 0.53), (0.6, 0.4), (0.5, 0.6), (0.9, 0.3))
    runs = [hf.simulate(rope, hf.arm_swings(*r), arm=arm, duration=6.0, t_eval=t) for r in rhythms]
    return [RopeMotion.from_trajectory(run) for run in runs]


def pose(motions, rng, missing=0, clutter=0):
    """Return places in random order (M, 2), the truth (K,) and the origin, of a random pose."""
    motion = motions[rng.integers(len(motions))]
    joints = motion.places([rng.uniform(0.5, 6.0)], np.concatenate([[0.0], ARCS]))[0, :, :2]
    seen = joints[1:] + rng.normal(0.0, 0.002, (10, 2))
    keep = np.ones(10, bool)
    keep[rng.choice(10, missing, replace=False)] = False
    places = np.concatenate([seen[keep], joints[0] + rng.uniform(-2.0, 2.0, (clutter, 2))])
    shuffled = rng.permutation(len(places))
    truth = np.full(10, -1)
    truth[keep] = np.argsort(shuffled)[: keep.sum()]
    return places[shuffled], truth, joints[0]


@pytest.mark.parametrize(
    ("missing", "clutter", "least", "wrong"), [(0, 0, 0.95, 0.0), (2, 2, 0.85, 0.01)], ids=["whole", "two missing"]
)
def test_first_order_of_random_poses(motions, missing, clutter, least, wrong):
    """How often it is right in 200 poses, and how often it is wrong and claims to be certain."""
    rng, right, certain = np.random.default_rng(1), [], []
    for _ in range(200):
        places, truth, origin = pose(motions, rng, missing, clutter)
        found = order_markers(places, ARCS, origin)
        right.append(bool((found.indices == truth).all()))
        certain.append(found.certain)
    assert np.mean(right) >= least
    assert np.mean(np.array(certain) & ~np.array(right)) <= wrong
    assert missing or np.mean(certain) > 0.75


def test_order_of_a_hanging_rope_and_of_none():
    places = np.column_stack([np.zeros(10), -ARCS])
    found = order_markers(places[::-1], ARCS, (0.0, 0.0))
    assert found.indices.tolist() == list(range(9, -1, -1))
    assert found.certain
    nothing = order_markers(np.zeros((0, 2)), ARCS, (0.0, 0.0))
    assert nothing.indices.tolist() == [-1] * 10
    assert not nothing.certain


def test_the_order_obeys_the_rope_s_length():
    """Two roots: a marker beyond the reach of its arc is none."""
    found = order_markers(np.array([[0.0, -0.2], [0.0, -0.95]]), [0.2, 0.4], np.zeros(2))
    assert found.indices.tolist() == [0, -1]


@pytest.mark.parametrize("away", [0.15, 0.27, 0.4], ids=["one off", "two off", "three off"])
def test_a_rope_at_the_end_of_an_arm_is_not_taken_for_one_at_its_axis(away):
    """Evenly spaced markers: from the axis, an order one, two or three places off is the only one within reach."""
    swung = 0.3 + 0.4 * ARCS
    line = np.cumsum(np.gradient(ARCS)[:, None] * np.stack([np.sin(swung), -np.cos(swung)], axis=1), axis=0)
    found = order_markers(line + np.array([0.3 * away, -away]), ARCS, np.zeros(2))
    assert found.indices.tolist() == list(range(10))
    assert not found.anchored
    assert order_markers(line, ARCS, np.zeros(2)).anchored
