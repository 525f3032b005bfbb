"""Ropes that swing in closed form, and cameras before them."""

import numpy as np

from hyperflex.vision import Camera, RopeMotion

ARCS = np.linspace(0.2, 2.0, 10)


def swinging(speed=6.0, links=100, until=2.0, **more):
    """Return a rope of 2 m whose link angles are sums of travelling waves; its tip reaches about `speed`, m/s."""
    t = np.arange(0.0, until, 0.005)[:, None]
    s = (np.arange(links) + 0.5)[None] / links
    rate = speed / 1.5
    q = 0.6 * np.sin(rate * t - 2.0 * s) + 0.35 * s * np.sin(1.7 * rate * t - 4.0 * s)
    qd = rate * (0.6 * np.cos(rate * t - 2.0 * s) + 0.35 * 1.7 * s * np.cos(1.7 * rate * t - 4.0 * s))
    return RopeMotion(t[:, 0], q, qd, np.full(links, 2.0 / links), **more)


def camera(**timing):
    return Camera.facing((1280, 720), pixels_per_metre=300.0, origin=(640.0, 60.0), **timing)


def sliding(velocity, start=(0.0, 0.0), links=2):
    """Return a straight rope of 1 m that hangs and slides with a constant velocity, m/s, from a place at t = 0."""
    t = np.array([-1.0, 1.0])
    base = np.asarray(start, float) + t[:, None] * np.asarray(velocity, float)
    rest = np.zeros((2, links))
    return RopeMotion(t, rest, rest, np.full(links, 1.0 / links), base, np.tile(np.asarray(velocity, float), (2, 1)))
