"""The identification experiment (paper section III): its twin, Tables I and II, Figs. 3, 5, 6, claims C6 and C7.

The paper does not describe its identification rope. Length, mass and number of links are inferred from its figures, J
and eta are what it found. Its errors are read so: E of (7) is the sum of squares over samples and links, and a noise of
0.01 rad makes it 0.04 rad^2 for 81 samples of 5 links, as in Fig. 6; Tables I and II, whose unit is lost, then hold
sqrt(E / 81) in 0.01 rad, for 2.23 there is 0.0403 rad^2. With this reading a swing of 0.15 rad gives all errors of both
tables within 15 %, so that is what the paper's swing is taken for; a wide one of 1 rad is there beside it, for J can be
told from zero only there.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import cache

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Rope
from hyperflex.paper.natural_frequency import cylinder_inertia, natural_frequency_inertia, natural_period, swing_period
from hyperflex.paper.results import Claim, Table
from hyperflex.paper.revision import IterativeRevision, RevisionProfile, iterative_revision
from hyperflex.paper.simplex import InitialState, estimate_initial_state, squared_error
from hyperflex.recording import Recording
from hyperflex.simulation import angles, simulate

LENGTH, LINK_MASS, LINKS = 1.0, 1.53e-3, 5  # m, kg; inferred
INERTIA, FRICTION = 0.143e-6, 0.631e-3  # kg m^2 of a link, N m s/rad of a joint: what the paper found
RATE, POINTS, FEW = 7.5, 81, 22  # frames a second; samples; samples of the first 3 s
NOISE = 0.01  # rad, root mean square over all samples of a recording
SEED = 2007
COUNTS = (*range(12, 33, 5), *range(41, 62, 10), POINTS)  # samples used, Fig. 6
METHODS = ("NF", "CM", "IR", "IR(theta_0)")


@dataclass(frozen=True)
class Swing:
    """One recording of the twin: of a rope held straight at an angle, rad, and let go at t = 0.

    The chain that makes the data has 5 links, as the fitted model, or 40.
    """

    angle: float
    links: int = LINKS

    @property
    def title(self) -> str:
        """The recording in words."""
        return f"swing of {self.angle:g} rad, data from {self.links} links"

    @property
    def key(self) -> str:
        """A short name for file columns."""
        return f"{'small' if self.angle < 0.5 else 'wide'}_{self.links}"


SMALL, WIDE = Swing(0.15), Swing(1.0)
SWINGS = (SMALL, WIDE)
FINER = tuple(Swing(swing.angle, 40) for swing in SWINGS)
DRAWN = (*SWINGS, *FINER)
CURVES = (*SWINGS, FINER[0])  # of Fig. 6


def true_rope(links: int = LINKS) -> Rope:
    """Return the rope that makes the data: of 5 links with the paper's J and eta.

    Of a multiple of 5 links it is the same rope cut finer, as a thin cylinder, with the friction in each joint that
    bends alike (joint friction times link length is the same) and the same first joint.
    """
    rope = Rope.uniform(LENGTH, LINKS * LINK_MASS, links, name=f"identification twin, {links} links")
    if links == LINKS:
        return rope.replace(inertia=np.full(LINKS, INERTIA), friction=np.full(LINKS, FRICTION))
    friction = np.full(links, FRICTION * links / LINKS)
    friction[0] = FRICTION
    return rope.replace(friction=friction)


def guess() -> Rope:
    """Return what the revision starts from: the cylinder's inertia, and the paper's 1.26e-3 N m s/rad."""
    rope = Rope.uniform(LENGTH, LINKS * LINK_MASS, LINKS, friction=1.26e-3, name="identification guess")
    return rope.replace(inertia=cylinder_inertia(rope))


@cache
def record(swing: Swing, seed: int = SEED) -> Recording:
    """Simulate a swing and look at it as the paper's camera would: 81 samples at 7.5 frames a second.

    The noise is normal, and scaled so that its root mean square in this recording is 0.01 rad exactly: E of the true
    motion is 0.0405 rad^2. The angles are those of 5 links; of a finer chain those of the straight lines between every
    eighth joint.
    """
    t = np.arange(POINTS) / RATE
    run = simulate(true_rope(swing.links), duration=t[-1], t_eval=t, q0=np.full(swing.links, swing.angle), tol=1e-9)
    along = np.diff(run.joints[:, :: swing.links // LINKS], axis=1)
    q = np.unwrap(np.arctan2(along[..., 0], -along[..., 1]), axis=0)
    noise = np.random.default_rng(seed).standard_normal(q.shape)
    noise *= NOISE / np.sqrt((noise**2).mean())
    return Recording(t, q + noise, noise=NOISE, name=f"{swing.title} (simulated)", source="simulated")  # type: ignore[arg-type]


@cache
def revised(
    swing: Swing, points: int = POINTS, profile: RevisionProfile = "response", seed: int = SEED
) -> IterativeRevision:
    """Return the iterative revision on the first `points` samples of a swing; each is made once in a process."""
    recording = record(swing, seed)
    part = recording.window(-np.inf, (points - 0.5) / RATE)
    return iterative_revision(part, guess(), profile=profile, rounds=8 if profile == "response" else 5)


def whole_error(swing: Swing, found: IterativeRevision, seed: int = SEED) -> float:
    """Return E over all 81 samples, rad^2, of a revision that may have used fewer."""
    state = np.append(found.best.q, found.best.qd)
    return squared_error(record(swing, seed), found.rope, state)


def per_sample(error: float) -> float:
    """Return sqrt(E / 81) in 0.01 rad, as Tables I and II are read."""
    return 100.0 * float(np.sqrt(error / POINTS))


@dataclass(frozen=True, eq=False)
class Method:
    """A row of Table II, one of METHODS: its rope has the inertia of that method and the friction of the revision.

    E is its error, rad^2, from a start `state` (2 n,), rad and rad/s: for "IR" the measured angles, for the others
    those that suit them best.
    """

    name: str
    rope: Rope
    error: float
    state: Array


@cache
def methods(swing: Swing) -> tuple[Method, ...]:
    """Return the rows of Table II: inertia by natural frequency, as a cylinder, and by the revision."""
    recording, found = record(swing), revised(swing)
    inertias = {
        "NF": natural_frequency_inertia(found.rope, swing_period(recording)),
        "CM": float(cylinder_inertia(guess())[0]),
    }
    rows = []
    for name, inertia in inertias.items():
        rope = found.rope.replace(inertia=np.full(LINKS, inertia))
        best: InitialState = estimate_initial_state(recording, rope)
        rows.append(Method(name, rope, best.error, np.append(best.q, best.qd)))
    measured = np.append(recording.data[0], np.zeros(LINKS))
    rows.append(Method("IR", found.rope, found.best.measured_start, measured))
    rows.append(Method("IR(theta_0)", found.rope, found.error, np.append(found.best.q, found.best.qd)))
    return tuple(rows)


def motion(rope: Rope, state: Array, t: Array) -> Array:
    """Return angles (T, n), rad, at times t, s, of a run from `state` (2 n,)."""
    return angles(rope, t, state[:LINKS], state[LINKS:])[0]


def table1() -> Table:
    """J, eta and E in each round of the revision (Table I), one row a round, for every swing."""
    rows = [
        (*astuple(swing), k, each.inertia, each.friction, each.error, per_sample(each.error), each.evaluations)
        for swing in DRAWN
        for k, each in enumerate(revised(swing).rounds)
    ]
    names = ("angle", "data_links", "revision", "inertia", "friction", "error", "error_per_sample", "rollouts")
    return _table("table1", "change of J, eta and E", _columns(names, rows))


def table2() -> Table:
    """J, eta and E of NF, CM and IR (Table II); ``method`` counts them in that order."""
    rows = [
        (*astuple(swing), k, each.rope.inertia[0], each.rope.friction[0], each.error, per_sample(each.error))
        for swing in DRAWN
        for k, each in enumerate(methods(swing))
    ]
    names = ("angle", "data_links", "method", "inertia", "friction", "error", "error_per_sample")
    table = _table("table2", "comparison of NF, CM and IR", _columns(names, rows))
    table.notes["methods"] = "; ".join(f"{k}: {name}" for k, name in enumerate(METHODS))
    table.notes["periods"] = periods_text()
    return table


def fig3() -> Table:
    """Measured and optimised initial angles (Fig. 3), one row a link."""
    columns = {"link": np.arange(1.0, LINKS + 1.0)}
    for swing in SWINGS:
        columns[f"measured_{swing.key}"] = np.array(record(swing).data[0])
        columns[f"optimised_{swing.key}"] = revised(swing).best.q
        columns[f"true_{swing.key}"] = np.full(LINKS, swing.angle)
    return _table("fig3", "measured and optimised initial angles", columns)


def fig5() -> Table:
    """Measured and calculated angles against time (Fig. 5), of every link of the small swing."""
    recording, found = record(SMALL), revised(SMALL)
    calculated = motion(found.rope, np.append(found.best.q, found.best.qd), recording.t)
    columns = {"t": np.array(recording.t)}
    for k in range(LINKS):
        columns[f"measured_{k + 1}"] = np.array(recording.data[:, k])
        columns[f"calculated_{k + 1}"] = calculated[:, k]
    return _table("fig5", "measured and calculated angles", columns)


def residuals(swing: Swing, rope: Rope, start: Array) -> Array:
    """Return the last link's measured less calculated angles (81,), rad, of a run from rest at angles `start` (n,)."""
    recording = record(swing)
    return np.asarray(recording.data[:, -1] - motion(rope, np.append(start, np.zeros(LINKS)), recording.t)[:, -1])


def start_residuals(swing: Swing) -> dict[str, Array]:
    """Return the residuals of the revised rope from the measured and from the optimised initial angles (Fig. 3)."""
    found = revised(swing)
    return {
        "measured": residuals(swing, found.rope, record(swing).data[0]),
        "optimised": residuals(swing, found.rope, found.best.q),
    }


def fig5_curves() -> list[tuple[Array, Array, Array]]:
    """Return the curves with the first guess, from the initial angles that suit it best, and after the revision.

    Each a time (m,), s, the angle of the last link then (m,), rad, and its residuals at the samples (81,), rad.
    """
    found, first = revised(SMALL), revised(SMALL).rounds[0]
    end = record(SMALL).t[-1]
    t = np.linspace(0.0, end, round(40.0 * end) + 1)
    guessed = found.rope.replace(inertia=np.full(LINKS, first.inertia), friction=np.full(LINKS, first.friction))
    return [
        (t, motion(rope, np.append(start, np.zeros(LINKS)), t)[:, -1], residuals(SMALL, rope, start))
        for rope, start in ((guessed, first.q), (found.rope, found.best.q))
    ]


def fig6() -> Table:
    """E over all samples against the number of samples that the revision used (Fig. 6)."""
    columns = {"samples": np.array(COUNTS, dtype=np.float64)}
    for swing in CURVES:
        made = [revised(swing, count) for count in COUNTS]
        columns[f"error_{swing.key}"] = np.array([whole_error(swing, each) for each in made])
        columns[f"inertia_{swing.key}"] = np.array([each.best.inertia for each in made])
        columns[f"friction_{swing.key}"] = np.array([each.best.friction for each in made])
    return _table("fig6", "identification error against samples used", columns)


def periods_text() -> str:
    """Return T_nat in words: measured on each swing, and computed for the models; the paper's is 1.61 s."""
    seen = "; ".join(f"{swing.title}: {swing_period(record(swing)):.3f} s" for swing in DRAWN)
    models = ", ".join(f"{links} links {natural_period(true_rope(links)):.3f} s" for links in (LINKS, FINER[0].links))
    return f"measured, {seen}; small swings computed, {models}; the paper's 1.61 s"


def _columns(names: tuple[str, ...], rows: Sequence[tuple[float, ...]]) -> dict[str, Array]:
    return dict(zip(names, np.array(rows, dtype=np.float64).T, strict=True))


def _table(name: str, title: str, columns: dict[str, Array]) -> Table:
    notes = {
        "title": title,
        "source": "simulated",
        "units": "SI, angles and E in rad and rad^2; error_per_sample is sqrt(E / 81) in 0.01 rad",
        "parameters": (
            f"L = {LENGTH} m, {LINK_MASS} kg a link, J = {INERTIA} kg m^2, eta = {FRICTION} N m s/rad (length and mass "
            f"inferred), first guess J = {guess().inertia[0]:.3g}, eta = {guess().friction[0]:.3g}; {POINTS} samples "
            f"at {RATE} Hz, noise {NOISE} rad rms"
        ),
    }
    return Table(name, title, columns, notes)


def settles(swing: Swing) -> Claim:
    """C6: the revision settles within two or three rounds. Measured: revisions that still moved J or eta."""
    found = revised(swing)
    moved = found.converged_after
    steps = ", ".join(f"{1e6 * each.inertia:.3g}" for each in found.rounds)
    frictions = ", ".join(f"{1e3 * each.friction:.3g}" for each in found.rounds)
    note = f"J {steps} e-6 kg m^2; eta {frictions} e-3 N m s/rad; {found.seconds:.1f} s, {found.evaluations} rollouts"
    count = float("inf") if moved is None else float(moved)
    return Claim("C6", "IR settles: revisions that moved J or eta", swing, count, 3, note, "<=")


def finds_the_truth(swing: Swing, seed: int = SEED) -> Claim:
    """C6: J and eta lie within their uncertainty of the truth. Measured: the larger distance in standard deviations."""
    found = revised(swing, seed=seed)
    j_std, eta_std = found.std["inertia"], found.std["friction"]
    inertia = abs(found.best.inertia - INERTIA) / j_std
    friction = abs(found.best.friction - FRICTION) / eta_std
    note = (
        f"J = {1e6 * found.best.inertia:.3f} +- {1e6 * j_std:.3f} e-6 kg m^2 (true {1e6 * INERTIA:.3f}), "
        f"eta = {1e3 * found.best.friction:.3f} +- {1e3 * eta_std:.3f} e-3 N m s/rad "
        f"(true {1e3 * FRICTION:.3f}); J's relative standard deviation is {j_std / INERTIA:.2f}"
    )
    statement = "J and eta are the true ones: distance in standard deviations"
    return Claim("C6", statement, swing, max(inertia, friction), 2.0, note, "<=")


def in_order(swing: Swing) -> Claim:
    """C6: the errors are in the order NF > CM > IR. Measured: the smaller of the two ratios."""
    error = {method.name: method.error for method in methods(swing)}
    ratio = min(error["NF"] / error["CM"], error["CM"] / error["IR"])
    note = ", ".join(f"{name} {value:.3g}" for name, value in error.items()) + " rad^2"
    return Claim("C6", "errors NF > CM > IR: smaller ratio of neighbours", swing, ratio, 1.0, note)


def few_samples_do(swing: Swing) -> Claim:
    """C7: 22 of 81 samples suffice. Measured: E over all samples, of the fit to 22 over that of the fit to all."""
    few, full = whole_error(swing, revised(swing, FEW)), whole_error(swing, revised(swing))
    note = f"{few:.4f} against {full:.4f} rad^2 (the paper: 0.046 against 0.040)"
    return Claim("C7", "22 of 81 samples: ratio of errors over all samples", swing, few / full, 1.15, note, "<=")


def identification_claims() -> list[Claim]:
    """Measure C6 and C7 on the small and the wide swing."""
    return [measure(swing) for measure in (settles, finds_the_truth, in_order, few_samples_do) for swing in SWINGS]
