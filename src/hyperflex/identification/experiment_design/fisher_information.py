"""Fisher information that a simulated experiment has of the parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.experiment_design.experiments import Experiment
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import linearise
from hyperflex.identification.fit.windows import Window, decimation_step, usual_length
from hyperflex.identification.measurements import build_plant, measure, with_torque
from hyperflex.identification.model.parameters import Parameter, Parameters
from hyperflex.identification.model.plant import PRECISION, Plant, pivot_places
from hyperflex.identification.model.scale import in_common_factor
from hyperflex.identification.options import RecordingSetup
from hyperflex.identification.uncertainty.covariance import Information, known_directions
from hyperflex.identification.uncertainty.ratios import ratio_spread, ratios
from hyperflex.model import Arm, Rope
from hyperflex.recording import Recording
from hyperflex.sensors import Markers
from hyperflex.simulation import simulate

FAINT = 1e-3  # a ratio below this part of the largest of its kind is judged by that


@dataclass(frozen=True)
class ExpectedInformation:
    """What an experiment would tell about the free parameters of a rope."""

    parameters: Parameters
    information: Information

    def spreads(self, want: Sequence[str]) -> dict[str, tuple[float, float]]:
        """Return standard deviation, and the same over the size of the value, of each single number in `want`.

        InvalidInput for a word that is neither free nor a ratio.
        """
        x = self.information.x
        rope = self.parameters.rope(x)
        std = self.information.deviations(self.parameters.derivatives(x))
        own = {
            p.label: (p.name, float(s), size(p, float(each)))
            for p, s, each in zip(self.parameters.all, std, x, strict=True)
        }
        known = ratios(rope, self.parameters.names)
        result: dict[str, tuple[float, float]] = {}
        for word in want:
            if word in known:
                spread, value = ratio_spread(self.parameters, self.information)[word], np.abs(known[word])
                against = np.maximum(value, FAINT * value.max() or 1.0)
                for k in range(value.size):
                    if word != "p/p1" or k > 0:  # the first is 1 by definition
                        result[f"{word}[{k}]"] = (float(spread[k]), float(spread[k] / against[k]))
                continue
            found = {label: (s, s / of) for label, (name, s, of) in own.items() if word in (label, name)}
            if not found:
                raise InvalidInput(
                    "want names what is not free",
                    got=word,
                    allowed=", ".join(dict.fromkeys([*(p.name for p in self.parameters.all), *own, *known])),
                )
            result |= found
        return result


def size(parameter: Parameter, x: float) -> float:
    """Return what a standard deviation is compared with: the value, or a typical change of what is 0 or an offset."""
    value = abs(parameter.value(x))
    return value if value > 0.0 and parameter.form != "linear" else parameter.width * parameter.scale


def expected_information(
    rope: Rope, experiment: Experiment, free: Sequence[str], arm: Arm | None, noise: float
) -> ExpectedInformation:
    """Return the Fisher information of the parameters in a simulated recording, windows and states as in ``identify``.

    InvalidInput or SimulationError if the experiment does not fit the rope or cannot be simulated.
    """
    t, motion = experiment.t, experiment.motion
    base = arm if motion is not None else None
    tol = PRECISION * rope.total_length
    q0, qd0 = experiment.start(rope)
    run = simulate(rope, motion, arm=base, duration=float(t[-1]), t_eval=t, tol=tol, q0=q0, qd0=qd0)
    spread = experiment.noise or noise
    if experiment.markers is None:
        arc_lengths, recording = None, Recording(t, run.q, noise=np.full(1, spread).repeat(rope.n_links))
    else:
        arc_lengths = np.linspace(0.0, rope.total_length, experiment.markers)
        places = Markers(arc_lengths).predict(rope, run.q, pivot_places(motion, base, t))
        recording = Recording(t, places, "markers", np.full(places.shape[1], spread))
    torque = experiment.torque_noise
    if torque is not None and base is None:
        raise InvalidInput("the torque of no motor can be measured", fix="Give a motion, and arm=... to design")
    setup = RecordingSetup(motion, base, torque=None if torque is None else run.motor_torque)
    plant = build_plant(recording, rope, free, arc_lengths, setup)
    measured = measure(recording, rope, arc_lengths)
    if torque is not None:
        measured = with_torque(measured, run.motor_torque, torque)
    length = min(usual_length(measured.shape, rope), 1.001 * recording.duration)
    windows, _ = measured.windows(length, decimation_step(recording, length))
    states = np.hstack([run.q, run.qd])[np.searchsorted(t, [window.t[0] for window in windows])]
    return ExpectedInformation(plant.parameters, _information(plant, windows, states))


def _information(plant: Plant, windows: Sequence[Window], states: Array) -> Information:
    """Return the information of windows that the model fits, the noise as given."""
    x, widths = plant.parameters.start, plant.parameters.widths
    rows = [np.zeros((x.size, x.size))]
    for window, state in zip(windows, states, strict=True):
        linear = linearise(plant, window, x, state, np.zeros(window.y.size), Loss())
        rows.append(linear.reduced()[0] * widths)
    singular, known, unknown = known_directions(rows)
    covariance = (known / singular[: known.shape[1]] ** 2) @ known.T * np.outer(widths, widths)
    tied = in_common_factor(plant.parameters, x, unknown)
    return Information(x, widths, singular, known, unknown, covariance, 1.0, growing=tied)
