"""The sweep with contacts against dense matrices, and the search for closest points against a fine sampling."""

import numpy as np
import pytest

from hyperflex.core.contact import gaps
from hyperflex.core.contact import sweep as sweeps
from hyperflex.core.contact.arrays import TOUCH
from tests.core.helpers import chain_of
from tests.reference import dense
from tests.reference.cases import random_links, random_state

SIZES = [1, 2, 5, 50]


class Case:
    """A random chain with random impulses of joints and contacts; some links have two contacts, some none."""

    def __init__(self, n: int, seed: int) -> None:
        rng = np.random.default_rng([n, seed])
        self.links, self.q = random_links(n, seed), random_state(n, seed).q
        self.joint = np.stack([rng.normal(size=n) * 1e-3, rng.uniform(0.0, 1e-4, n)], axis=1)
        across = dense.directions(self.q)[1]
        self.way = across + 0.1 * rng.normal(size=(n, 2))  # along which forces turn a link
        self.turned = across + 0.1 * rng.normal(size=(n, 2))  # in which it turns
        self.steady = rng.uniform(-3.0, 3.0, (n, 2))
        self.slope = rng.uniform(-0.5, 1.0, n) * self.links.inertia
        self.own = rng.normal(size=n) * 1e-3
        self.base, self.tip = rng.normal(size=3), rng.normal(size=2) * 1e-3
        self.at = rng.integers(0, n, max(1, n // 2))
        self.place = rng.uniform(0.0, 1.0, self.at.size) * self.links.length[self.at]
        self.b = rng.normal(size=(self.at.size, 2, 2)) * 0.05 + 30.0 * np.eye(2)  # no symmetry, and stiff
        self.c = rng.normal(size=(self.at.size, 2)) * 1e-2
        self.pull = np.empty((2, n))

    def kernel(self) -> tuple[dense.Real, dense.Real]:
        """Changes of the rates, and impulse at the first joint with the angular one, by the sweep."""
        n = self.q.size
        trig = np.concatenate([np.sin(self.q), np.cos(self.q)])
        touch, change = np.zeros((n, TOUCH)), np.empty(n)
        for i, s, b, c in zip(self.at, self.place, self.b, self.c, strict=True):
            sweeps.add_contact(touch, i, s, trig[i], trig[n + i], tuple(b.ravel()), tuple(c))
        frame = np.concatenate([self.way, self.turned, self.slope[:, None], self.steady, self.own[:, None]], axis=1)
        call = chain_of(self.links), self.joint, frame, touch, self.base, self.tip
        load = sweeps.changes(*call, change, np.empty((2, n)), self.pull, np.empty(12 * n))
        return change, np.array(load)

    def dense(self) -> tuple[dense.Real, dense.Real, dense.Real]:
        """The sweep by virtual work: one linear system for all rates; and the force that turns each link, times its
        lever."""
        n, links = self.q.size, self.links
        across = dense.directions(self.q)[1]
        mass, reach = dense.bodies(links)
        turned, way = reach[:, :, None] * self.turned[None], reach[:, :, None] * self.way[None]
        steady = self.base[:2] + np.einsum("kj,ja->ka", reach, self.steady)  # of the bodies, without the change
        matrix = np.diag(links.inertia + self.slope) + np.einsum("k,kia,kja->ij", mass, way, turned)
        right = self.own - np.einsum("k,kia,ka->i", mass, way, steady) + way[n] @ self.tip
        relative = np.eye(n) - np.eye(n, k=-1)
        matrix += relative.T @ np.diag(self.joint[:, 1]) @ relative
        right += relative.T @ self.joint[:, 0]
        right[0] += self.joint[0, 1] * self.base[2]
        rows = []
        for i, s, b, c in zip(self.at, self.place, self.b, self.c, strict=True):
            arms = np.where(np.arange(n) < i, links.length, 0.0)[:, None]
            held = self.base[:2] + (arms * self.steady).sum(axis=0)
            own = np.where(np.arange(n) == i, s, 0.0)[:, None] * across  # its own link sees a contact as it is
            row, back = arms * self.turned + own, arms * self.way + own
            matrix += back @ b @ row.T
            right += back @ (c - b @ held)
            rows.append((i, row, b, c, held))
        change = np.linalg.solve(matrix, right)
        forces = mass[:, None] * (steady + np.einsum("kia,i->ka", turned, change))
        forces[n] -= self.tip
        pull = np.einsum("ki,ka->ia", reach, forces)
        force = forces.sum(axis=0)
        for i, row, b, c, held in rows:
            given = c - b @ (held + row.T @ change)
            force = force - given
            pull[:i] -= links.length[:i, None] * given
        moment = self.joint[0, 0] - self.joint[0, 1] * (change[0] - self.base[2])
        return change, np.append(force, moment), pull


@pytest.mark.parametrize("n", SIZES)
def test_changes_of_the_rates_are_those_of_the_dense_system(n):
    for seed in range(5):
        case = Case(n, seed)
        (change, load), (want, wanted_load, pull) = case.kernel(), case.dense()
        # Stiff contacts, a thousand times the rope's mass, cost the sweep and the dense solver three digits each.
        np.testing.assert_allclose(change, want, rtol=0, atol=1e-9 * np.abs(want).max())
        np.testing.assert_allclose(load, wanted_load, rtol=0, atol=1e-8 * (np.abs(wanted_load).max() + 1.0))
        np.testing.assert_allclose(case.pull.T, pull, rtol=0, atol=1e-8 * (np.abs(pull).max() + 1.0))


def test_contacts_are_taken_off_again():
    touch = np.zeros((3, TOUCH))
    sweeps.add_contact(touch, 1, 0.1, 0.6, 0.8, (1.0, 0.2, 0.3, 2.0), (0.5, -0.5))
    assert touch[1].all()
    sweeps.clear(touch, np.array([1]), 1)
    np.testing.assert_array_equal(touch, 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_closest_points_are_those_of_a_fine_sampling(seed):
    n, rng = 12, np.random.default_rng(seed)
    links, q = random_links(n, seed), random_state(n, seed).q
    chain, trig = chain_of(links), np.concatenate([np.sin(q), np.cos(q)])
    xy = np.empty((2, n + 1))
    gaps.joint_positions(chain, trig, 0.3, -0.2, xy)
    along, _ = dense.directions(q)
    np.testing.assert_allclose(xy[:, -1], [0.3, -0.2] + links.length @ along, rtol=0, atol=1e-14)
    none = np.zeros(3)
    place = (rng.normal(size=3), rng.normal(size=3))
    pegs = gaps.Pegs(*place, none, none, none, none + 0.05, none + 0.3, none, none + np.inf, none, 0)
    found = gaps.new_contacts(3 * n)
    margin = np.full(n, 0.4)
    least = gaps.find(chain, pegs, q, trig, xy, margin, found)
    part = np.linspace(0.0, 1.0, 2001)[:, None]
    seen = {}
    for i in range(n):
        points = xy[:, i] + part * (xy[:, i + 1] - xy[:, i])
        for p in range(3):
            away = np.hypot(points[:, 0] - pegs.x[p], points[:, 1] - pegs.y[p])
            seen[i, p] = away.min() - 0.05, points[away.argmin()]
    nearest = min(gap for gap, _ in seen.values())
    assert least < nearest + 1e-4
    if nearest < 0.4:  # beyond the margin it is a lower bound
        assert least == pytest.approx(nearest, abs=1e-4)
    pairs = {(int(found.link[c]), int(found.peg[c])): c for c in range(found.total[0])}
    # A sample of the link lies within a two-thousandth of its length from the closest point.
    assert set(pairs) <= {pair for pair, (gap, _) in seen.items() if gap < 0.401}
    assert set(pairs) >= {pair for pair, (gap, _) in seen.items() if gap < 0.399}
    for pair, c in pairs.items():
        gap, point = seen[pair]
        normal = (found.nx[c], found.ny[c])
        assert found.gap[c] == pytest.approx(gap, abs=1e-4)
        np.testing.assert_allclose(xy[:, pair[0]] + found.place[c] * along[pair[0]], point, rtol=0, atol=1e-3)
        centre = np.array([pegs.x[pair[1]], pegs.y[pair[1]]])
        np.testing.assert_allclose(centre + (found.gap[c] + 0.05) * np.array(normal), point, rtol=0, atol=1e-3)


def test_a_link_through_the_centre_of_a_peg_has_a_normal_of_length_one():
    links = random_links(1, 0)
    trig = np.array([np.sin(0.4), np.cos(0.4)])
    xy = np.empty((2, 2))
    gaps.joint_positions(chain_of(links), trig, 0.0, 0.0, xy)
    link = (0.0, 0.0, xy[0, 1], xy[1, 1], links.length[0], trig[0], trig[1])
    s, size, nx, ny = gaps.closest(link, 0.5 * xy[0, 1], 0.5 * xy[1, 1])
    assert size == pytest.approx(0.0, abs=1e-15)
    assert s == pytest.approx(0.5 * links.length[0], rel=1e-14)
    assert np.hypot(nx, ny) == pytest.approx(1.0, rel=1e-14)
