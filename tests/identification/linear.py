"""A plant whose measurements are linear in parameters and state: least squares has closed forms there."""

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.fit import Loss, LossName, Window, fit
from hyperflex.identification.model import Parameters, Plant, PredictedChannels, parse
from hyperflex.identification.uncertainty.covariance import Basis, estimate_covariance
from hyperflex.model import Rope

ROPE = Rope(length=[1.0], mass=[1.0], com=[0.5], inertia=[1.0], friction=[1.0])
FREE = ["inertia", "friction"]  # both kept >= 0


class Line(Plant):
    """What is seen: `shared` (m, C, 2) times (x - truth), and `own` (m, C, 2) times the state; times do not matter."""

    def __init__(self, shared: Array, own: Array, truth: Array, free: list[str] | None = None) -> None:
        super().__init__(Parameters(ROPE, parse(ROPE, free or FREE)))
        self.shared, self.own, self.truth = shared, own, truth

    def predict(self, x: Array, t: Array, state: Array) -> Array | None:
        return self.shared @ (x - self.truth) + self.own @ state

    def jacobian(self, x: Array, t: Array, state: Array) -> PredictedChannels | None:
        return PredictedChannels(self.shared @ (x - self.truth) + self.own @ state, self.own, self.shared)


def waves(samples: int, channels: int = 1, truth: Array | float = 10.0, tied: float = 0.5) -> Line:
    """Parameters act as two waves, `tied` as the first is in the second; the state as a mean and a trend."""
    t = np.linspace(0.0, 1.0, samples)
    shared = np.stack([np.sin(20.0 * t), np.cos(33.0 * t) + tied * np.sin(20.0 * t)], axis=1)
    own = np.stack([np.ones(samples), t - 0.5], axis=1)
    wide = np.arange(1, channels + 1)[None, :, None]
    return Line(shared[:, None] * wide, own[:, None] / wide, np.full(2, truth, dtype=np.float64))


def fitted(plant: Line, noise: Array, loss: LossName = "squares", pieces: int = 1) -> Basis:
    """Fit noise (m pieces, C) around the truth, the plant once more for each piece."""
    m, channels = noise.shape[0] // pieces, noise.shape[1]
    t, nothing = np.arange(m, dtype=np.float64), np.zeros((0, 2))
    windows = [
        Window(t, noise[k * m : (k + 1) * m], np.ones((m, channels)), np.zeros(2), nothing) for k in range(pieces)
    ]
    found = fit(plant, windows, plant.truth, [w.guess for w in windows], loss=Loss(loss), enough=1e-9)
    return Basis(plant, windows, found, estimate_covariance(plant, windows, found))


def autoregressive(random: np.random.Generator, shape: tuple[int, ...], part: float) -> Array:
    """Noise of variance 1 whose autocorrelation over k samples is part^k."""
    noise = random.standard_normal(shape)
    for k in range(1, shape[0]):
        noise[k] = part * noise[k - 1] + np.sqrt(1.0 - part**2) * noise[k]
    return noise
