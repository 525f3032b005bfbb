"""Pegs and finer ropes, and the measures on a wound rope."""

import math
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.model import cuts
from hyperflex.winding import rope_slip, turns
from tests.reference import dense
from tests.reference.arm import links_of
from tests.reference.wrapping import capstan, laid
from tests.refusals import refuses

PEG = hf.Peg(0.6, -0.7, 0.03, 0.3)


def cable(**changes: object) -> hf.Rope:
    kept = {"length": 2.0, "mass": 0.125, "n_links": 50, "radius": 0.0025, "friction": 5e-4, **changes}
    return hf.Rope.uniform(**kept)


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ({"rope": {"friction_model": "printed"}}, "acts on both links"),
        ({"step": 1e-5}, "a stepper of their own"),
        ({"pegs": ["a peg"]}, "pegs holds something else"),
        ({"tip_force": (1.0, 0.0), "pegs": []}, "tip_force needs"),
        ({"contact_step": 0.0}, "contact_step has the wrong sign"),
        ({"until": hf.tip_speed_peak()}, "not available with pegs"),
    ],
)
def test_what_contact_cannot_do_is_refused(what, words):
    how = dict(what)
    rope = cable(**how.pop("rope", {}))
    refuses(words, hf.simulate, rope, **{"duration": 0.1, "pegs": [PEG], **how})


def test_a_finer_rope_is_the_same_rope():
    rope = cable(n_links=10, stiffness=1e-3, tip_mass=0.01)
    fine = hf.refine_rope(rope, [PEG])
    pieces = cuts(rope, [PEG])
    far = np.cumsum(rope.length) >= math.hypot(PEG.x, PEG.y) - 0.0325
    assert (fine.length[np.repeat(far, pieces)] <= 0.3 * 0.0325 + 1e-12).all()
    assert (pieces[~far] == 1).all()
    # Straight pieces are the old links: their masses, centres and inertias, so the energies of any shape of these.
    rng = np.random.default_rng(0)
    q, w = rng.normal(size=10), rng.normal(size=10)
    still = (np.zeros(2), np.zeros(2), 0.0)
    coarse_energy = dense.energies(links_of(rope.replace(stiffness=0.0)), q, w, *still)
    many = np.repeat(q, pieces), np.repeat(w, pieces)
    fine_energy = dense.energies(links_of(fine.replace(stiffness=np.zeros(fine.n_links))), *many, *still)
    np.testing.assert_allclose(fine_energy, coarse_energy, rtol=1e-12)


def test_a_fine_rope_is_left_alone_and_an_uneven_link_is_not_cut():
    rope = cable(n_links=300)
    assert hf.refine_rope(rope, [PEG]) is rope
    uneven = cable(n_links=10).replace(com=np.full(10, 0.05))
    refuses("not uniform", hf.refine_rope, uneven, [PEG])


def wound_up(mu: float = 0.3) -> hf.Trajectory:
    """A turn and a half round a peg, at rest under 1 N at the tip and 2 N at the other end."""
    peg, swept = hf.Peg(0.0, 0.0, 0.02, mu), 3.0 * math.pi
    length = 0.25 + swept * 0.0225
    rope = hf.Rope.uniform(length, 0.0625 * length, 60, 0.0025, friction=2e-3, gravity=(0.0, 0.0))
    return hf.simulate(capstan(rope, peg, swept, np.array([0.0, 3.0]), np.array([2.0, 2.0])))


def test_measures_of_a_wound_rope():
    run = wound_up()
    peg = run.setup.pegs[0]
    state = hf.measure_winding(run, peg)
    # Seen from the centre the straight ends reach from a turn and a half less what they stand off at either side.
    ends = sum(math.atan(0.0225 / np.hypot(*run.joints[-1, k])) for k in (0, -1))
    assert state.turns[-1] == pytest.approx(1.5 + (math.pi - ends) / (2.0 * math.pi) - 0.0, abs=0.02)
    np.testing.assert_array_equal(turns(run, peg), state.turns)
    assert state.arc[-1] == pytest.approx(3.0 * math.pi, abs=0.4)  # less a link at either end
    assert state.before[-1] == pytest.approx(2.0, rel=1e-3)
    assert state.after[-1] == pytest.approx(1.0, rel=1e-3)
    # The pegs bear what both ends pull, which here point the same way.
    total = run.contact_force[-1].sum(axis=0)
    np.testing.assert_allclose(total, [0.0, -3.0], rtol=0, atol=3e-3)
    refuses("not one of the run's", hf.measure_winding, run, hf.Peg(1.0, 0.0, 0.1))


def test_tension_of_a_hanging_rope_is_its_weight():
    rope = cable(n_links=7, tip_mass=0.02)
    run = hf.simulate(rope, duration=0.1, pegs=[hf.Peg(1.0, 1.0, 0.1)], refine=False)
    weight = 9.81 * (0.02 + np.append(np.cumsum(rope.mass[::-1])[::-1], 0.0))
    np.testing.assert_allclose(hf.rope_tension(run)[-1], weight, rtol=1e-12)


def test_a_tug_tells_what_a_wound_rope_holds():
    """Pulled off, a rope that hangs over a peg half a turn gives way at exp(mu pi) times the weight of its tail."""
    rope = hf.Rope.uniform(1.0, 0.02, 60, 0.0025, friction=1e-3, tip_mass=0.2)
    peg = hf.Peg(0.0, 0.0, 0.03, 0.2)
    start = hf.moving_pivot([0.0, 1.0], [-0.0326, -0.0326], [-0.3, -0.3])
    q0 = math.pi - laid(rope.length, (-0.0326, 0.3), 0.0326, math.pi)  # up, over the peg and down
    run = hf.simulate(rope, start, duration=0.5, q0=q0, pegs=[peg])
    pull = hf.tug_test(run, peg, speed=0.02, distance=0.03)
    assert pull.slipped
    tail = 9.81 * (0.2 + 0.02 * (1.0 - 0.3 - math.pi * 0.0325))
    up = 9.81 * 0.02 * 0.3  # and the weight of the way up
    # The pull is dynamic, at 0.02 m/s, and the rope's place on the peg changes meanwhile: 5 % (3 % were seen).
    limit = tail * math.exp(0.2 * math.pi) - up
    assert pull.hold == pytest.approx(limit, rel=0.05)
    assert pull.holds(0.9 * limit)
    assert not pull.holds(1.1 * limit)
    # Once all of the rope slides, it follows the end that is pulled; before, what lies on the peg does not move.
    assert -pull.slip[-1] == pytest.approx(0.03, abs=3e-3)
    refuses("force has the wrong sign", pull.holds, -1.0)


def test_a_tug_takes_up_the_slack_before_it_pulls():
    """As above on a rough peg, with the end 8 cm nearer: the rope there hangs in a bight at first, which holds it."""
    rope = hf.Rope.uniform(1.0, 0.02, 60, 0.0025, friction=1e-4, tip_mass=0.01)
    peg = hf.Peg(0.0, 0.0, 0.03, 1.0)
    nearer = hf.moving_pivot([0.0, 0.5], [-0.0326, -0.0326], [-0.3, -0.22])
    q0 = math.pi - laid(rope.length, (-0.0326, 0.3), 0.0326, math.pi)
    run = hf.simulate(rope, nearer, duration=0.8, q0=q0, pegs=[peg])
    weak = hf.tug_test(run, peg, distance=0.04)
    assert not weak.slipped
    assert weak.hold < 0.3
    pull = hf.tug_test(run, peg)
    assert pull.slipped
    # As above; and what resists bending where the rope comes on to the peg counts e^pi times: 1e-4 v / R^2 = 2e-3 N.
    limit = hf.measure_winding(run, peg).tail[-1] * math.exp(math.pi) - 9.81 * 0.02 * 0.3
    assert pull.hold == pytest.approx(limit, rel=0.06)


def test_a_link_that_rolls_does_not_slip():
    """A rod that rolls over a peg under its own weight: its contact moves equally along it and round the peg."""
    peg, rod = hf.Peg(0.0, 0.0, 0.05, 1.0), hf.Rope(length=[1.0], mass=[0.1], radius=0.0025)
    angle = np.linspace(0.5 * math.pi, 0.7 * math.pi, 50)
    far = hf.moving_pivot([0.0, 1.0], [5.0, 5.0], [5.0, 5.0])  # any run of 50 samples, given other places below
    run = hf.simulate(hf.Setup(rod, far, pegs=[peg, hf.Peg(9.0, 0.0, 0.05)], duration=0.49))
    axis = 0.0525
    place = 0.5 - axis * (angle - angle[0])
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along = np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    rolling = replace(run, q=angle[:, None], base=axis * normal - place[:, None] * along)
    np.testing.assert_allclose(rope_slip(rolling, peg), 0.0, rtol=0, atol=1e-12)
    slid = replace(run, q=angle[:, None], base=axis * normal - 0.5 * along)
    # The same point of the rod stays on the peg while the contact moves round it: it slides by as much.
    np.testing.assert_allclose(np.abs(rope_slip(slid, peg)), axis * (angle - angle[0]), rtol=0, atol=1e-12)


def placed(run: hf.Trajectory, q: np.ndarray, base: np.ndarray) -> hf.Trajectory:
    """A wound rope as it is at the end of a run, then in other places (k, n) and (k, 2), there for good."""
    rows = np.minimum(np.arange(run.t.size), len(q))
    return replace(run, q=np.stack([run.q[-1], *q])[rows], base=np.stack([run.base[-1], *base])[rows])


def test_a_rope_is_held_as_long_as_one_of_its_links_is():
    run = wound_up()
    peg, q, base = run.setup.pegs[0], run.q[-1], run.base[-1]
    # A loose tail that falls away and slides is no slip of the rope: the rest of it stays where it is.
    loose = q.copy()
    loose[40:] += np.linspace(0.0, 1.0, 20)
    np.testing.assert_allclose(rope_slip(placed(run, loose[None], base[None]), peg), 0.0, rtol=0, atol=1e-15)
    # All of it turned about the peg has slipped by the way round; in the watch as well as from the start.
    angle = 0.4
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    turned = placed(run, np.stack([loose, q + angle]), np.stack([base, turn @ base]))
    np.testing.assert_allclose(np.abs(rope_slip(turned, peg)[:3]), [0.0, 0.0, 0.0225 * angle], rtol=0, atol=1e-12)
    late = rope_slip(turned, peg, since=float(turned.t[1]))
    assert np.isnan(late[0])
    np.testing.assert_allclose(np.abs(late[1:3]), [0.0, 0.0225 * angle], rtol=0, atol=1e-12)
    # A rope that has left the peg holds nothing; one that was not on it cannot slip.
    away = placed(run, q[None], base[None] + 1.0)
    np.testing.assert_array_equal(rope_slip(away, peg)[:2], [0.0, np.inf])
    assert np.isnan(rope_slip(replace(away, base=away.base + 1.0), peg)).all()
    refuses("since is after the end", rope_slip, run, peg, since=99.0)


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_what_a_rope_covers_does_not_depend_on_its_size(scale):
    """One link of a wound rope is lifted by a fraction of its length: a tenth counts as contact, more does not."""
    peg, length = hf.Peg(0.0, 0.0, 0.05 * scale, 0.3), 0.01 * scale
    rope = hf.Rope.uniform(60 * length, 0.1 * scale**3, 60, 0.002 * scale, friction=1e-4 * scale**4.5)
    axis = (peg.radius + rope.radius) * (1.0 + 1e-6)
    start, covered = (-axis, 0.1 * scale), []
    q = laid(rope.length, start, axis, 1.5 * math.pi)
    fixed = hf.moving_pivot([0.0, 1.0], [start[0]] * 2, [start[1]] * 2)
    run = hf.simulate(rope, fixed, q0=q, pegs=[peg], duration=1e-5, t_eval=[0.0, 1e-5], refine=False)
    for part in (0.0, 0.05, 0.3):
        shifted = run.q.copy()
        shifted[:, 20] -= part  # so that link 21 is `part` of a link farther out
        shifted[:, 22] += part
        covered.append(hf.measure_winding(replace(run, q=shifted), peg).contact[0])
    whole, slight, far = covered
    assert whole == pytest.approx(1.5 * math.pi, abs=0.4)
    assert slight == pytest.approx(whole, abs=0.01)
    assert far < whole - 1.5 * length / axis
