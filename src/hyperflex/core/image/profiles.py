"""Profiles of a picture along lines across a rope, and where a moving rope fits them best."""

import math

import numpy as np

from hyperflex.core.jit import kernel

OFFSET, GAIN, ENERGY, AMPLITUDE, CERTAINTY, RESIDUAL, COLUMNS = range(7)  # columns of candidates, and their number
MARGIN = 4.0  # px of background on both sides of the rope, to which it is compared


@kernel
def add_light(image, tone, u, v, weight, out):  # type: ignore[no-untyped-def]
    """Add the light of a picture between its pixels, times a weight, to out (3,); NaN beyond its border."""
    height, width = image.shape[0], image.shape[1]
    if not (0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0):
        out[:] = np.nan
        return
    i, j = min(int(v), height - 2), min(int(u), width - 2)
    down, right = v - i, u - j
    for c in range(3):
        above = (1.0 - right) * tone[image[i, j, c]] + right * tone[image[i, j + 1, c]]
        below = (1.0 - right) * tone[image[i + 1, j, c]] + right * tone[image[i + 1, j + 1, c]]
        out[c] += weight * ((1.0 - down) * above + down * below)


@kernel
def sample_places(image, tone, places, out):  # type: ignore[no-untyped-def]
    """Set out (K, M, 3) to the light of a picture at places (K, M, 2), px; NaN beyond its border."""
    out[:] = 0.0
    for k in range(out.shape[0]):
        for m in range(out.shape[1]):
            add_light(image, tone, places[k, m, 0], places[k, m, 1], 1.0, out[k, m])


@kernel
def sample_lines(image, tone, points, normals, step, reach, out):  # type: ignore[no-untyped-def]
    """Average the light along M lines across each of K pieces of a rope.

    Parameters
    ----------
    image : (height, width, 3) uint8
    tone : (256,) float64
        Light of its levels.
    points, normals : (K, M, 2) float64
        Middles of the lines, px, and their directions.
    step : float
        px between samples.
    reach : (K,) float64
        How far the lines of each piece go to both sides, px.
    out : (K, X, 3) float64
        Set on return; sample (X - 1) / 2 is at the points. NaN beyond the reach and the picture's border.
    """
    half, lines = 0.5 * (out.shape[1] - 1), points.shape[1]
    for k in range(out.shape[0]):
        for j in range(out.shape[1]):
            x = (j - half) * step
            out[k, j] = 0.0 if abs(x) <= reach[k] else np.nan
            if abs(x) <= reach[k]:
                for m in range(lines):
                    u, v = points[k, m, 0] + x * normals[k, m, 0], points[k, m, 1] + x * normals[k, m, 1]
                    add_light(image, tone, u, v, 1.0 / lines, out[k, j])


@kernel
def time_density(linear, bend, step):  # type: ignore[no-untyped-def]
    """Return how long a point is where, (2 H + 1,), while it moves as linear u + bend u^2 / 2, -1/2 <= u <= 1/2."""
    most = 0.5 * abs(linear) + 0.125 * abs(bend)
    size, samples = int(most / step) + 1, 4 * int(most / step) + 1
    density = np.zeros(2 * size + 1)
    for j in range(samples):
        u = (j + 0.5) / samples - 0.5
        place = (linear * u + 0.5 * bend * u * u) / step + size
        i = min(int(place), 2 * size - 1)
        density[i] += (1.0 - (place - i)) / samples
        density[i + 1] += (place - i) / samples
    return density


@kernel
def spread_by(density, kernel_values):  # type: ignore[no-untyped-def]
    """Return the convolution of two sequences of odd lengths."""
    out = np.zeros(density.size + kernel_values.size - 1)
    for i in range(density.size):
        for j in range(kernel_values.size):
            out[i + j] += density[i] * kernel_values[j]
    return out


@kernel
def cover(across, width, blur):  # type: ignore[no-untyped-def]
    """Return which share (M,) of points across a strip, px from its middle, it covers, with a Gaussian blur, px."""
    out, scale = np.empty(across.size), 1.0 / (blur * math.sqrt(2.0))
    for j in range(across.size):
        out[j] = 0.5 * (math.erf((across[j] + 0.5 * width) * scale) - math.erf((across[j] - 0.5 * width) * scale))
    return out


@kernel
def strip(width, blur, step):  # type: ignore[no-untyped-def]
    """Return the cover (2 G + 1,) across a strip, in steps, as far as it reaches."""
    size = int((0.5 * width + 3.0 * blur) / step) + 1
    return cover(step * np.arange(-size, size + 1), width, blur)


@kernel
def match_lines(profiles, sweeps, widths, blur, step, reach, out):  # type: ignore[no-untyped-def]
    """Find where moving strips fit profiles best, by least squares with free contrast over a sloping background.

    Parameters
    ----------
    profiles : (K, X) float64
        Of :func:`sample_lines`.
    sweeps : (K, 2) float64
        Movement of each strip across itself during the exposure: linear and quadratic part, as of
        :func:`time_density`, px.
    widths : (K,) float64
        px.
    blur : float
        Standard deviation of the blur of a still edge, px.
    step : float
        px between samples.
    reach : (K,) float64
        Largest offset, px.
    out : (K, C, COLUMNS) float64
        Set on return: the best C offsets, px, from the middle of the profile, the best first (NaN: none); by how much
        each reduces the squares; squares of its derivative by the offset; contrast; squares of the strip; mean square
        of the rest.
    """
    half = (profiles.shape[1] - 1) // 2
    out[:] = np.nan
    for k in range(profiles.shape[0]):
        strip_values = spread_by(time_density(sweeps[k, 0], sweeps[k, 1], step), strip(widths[k], blur, step))
        inner = (strip_values.size - 1) // 2
        size = inner + int(MARGIN / step)
        window = 2 * size + 1
        form, slope = np.zeros(window), np.zeros(window)
        form[size - inner : size + inner + 1] = strip_values
        for j in range(1, window - 1):
            slope[j] = (form[j + 1] - form[j - 1]) / (2.0 * step)
        squares = size * (size + 1.0) * window / 3.0  # of -size .. size
        without_line(form, squares)
        without_line(slope, squares)
        own, across, energy = 0.0, 0.0, 0.0
        for j in range(window):
            own += form[j] * form[j]
            across += form[j] * slope[j]
            energy += slope[j] * slope[j]
        energy -= across * across / own
        far = min(int(reach[k] / step), half - size)
        if far < 1:
            continue
        gains, rests, contrasts = np.zeros(2 * far + 1), np.zeros(2 * far + 1), np.zeros(2 * far + 1)
        for d in range(2 * far + 1):
            first = half - far + d - size
            total, moment, square, fit = 0.0, 0.0, 0.0, 0.0
            for j in range(window):
                y = profiles[k, first + j]
                total += y
                moment += (j - size) * y
                square += y * y
                fit += form[j] * y
            if np.isnan(square):
                continue
            gains[d] = fit * fit / own if fit > 0.0 else 0.0
            contrasts[d] = fit / own
            rests[d] = max(square - total * total / window - moment * moment / squares - gains[d], 0.0) / (window - 3)
        free = np.ones(2 * far + 1, np.bool_)
        for c in range(out.shape[1]):
            best = -1
            for d in range(1, 2 * far):
                peak = gains[d] > 0.0 and gains[d] >= gains[d - 1] and gains[d] >= gains[d + 1]
                if free[d] and peak and (best < 0 or gains[d] > gains[best]):
                    best = d
            if best < 0:
                break
            free[max(best - inner, 0) : best + inner + 1] = False
            shift = 0.0  # a step of Gauss-Newton from the best sample
            for j in range(window):
                shift -= (slope[j] - across / own * form[j]) * profiles[k, half - far + best - size + j]
            shift = min(max(shift / (contrasts[best] * energy), -step), step)
            out[k, c, OFFSET] = (best - far) * step + shift
            out[k, c, GAIN], out[k, c, ENERGY] = gains[best], energy
            out[k, c, AMPLITUDE], out[k, c, CERTAINTY], out[k, c, RESIDUAL] = contrasts[best], own, rests[best]


@kernel
def without_line(values, squares):  # type: ignore[no-untyped-def]
    """Subtract from values (2 s + 1,) the line that fits them best; `squares` is the sum of those of -s .. s."""
    size, total, moment = (values.size - 1) // 2, 0.0, 0.0
    for j in range(values.size):
        total += values[j]
        moment += (j - size) * values[j]
    for j in range(values.size):
        values[j] -= total / values.size + (j - size) * moment / squares


@kernel
def sum_across(image, tone, point, along, step, side, out):  # type: ignore[no-untyped-def]
    """Integrate the light, less that beside, across each point of a line along a rope.

    Parameters
    ----------
    image : (height, width, 3) uint8
    tone : (256,) float64
        Light of its levels.
    point, along : (2,) float64
        Middle of the line, px, and its direction.
    step : float
        px between samples.
    side : float
        Half of the width over which it is integrated, px; beside are MARGIN px beyond on both sides.
    out : (X, 3) float64
        Set on return, px; NaN beyond the picture's border.
    """
    half, inner, outer = 0.5 * (out.shape[0] - 1), int(side / step) + 1, int(MARGIN / step)
    for i in range(out.shape[0]):
        x = (i - half) * step
        out[i] = 0.0
        for j in range(-inner - outer, inner + outer + 1):
            y = j * step
            u, v = point[0] + x * along[0] - y * along[1], point[1] + x * along[1] + y * along[0]
            weight = step if abs(j) <= inner else -step * (2 * inner + 1) / (2 * outer)
            add_light(image, tone, u, v, weight, out[i])


@kernel
def match_end(profile, sweep, blur, step, reach, out):  # type: ignore[no-untyped-def]
    """Find where a rope that covers what is before a moving end fits a profile along it best.

    Parameters
    ----------
    profile : (X,) float64
        Of :func:`sum_across`.
    sweep : (2,) float64
        Movement of the end along the line, as in :func:`match_lines`.
    blur, step, reach : float
    out : (COLUMNS,) float64
        As a row of :func:`match_lines`; the gain is over the better of no rope and a rope without an end.
    """
    density, half = time_density(sweep[0], sweep[1], step), (profile.size - 1) // 2
    edge = spread_by(density, strip(step, blur, step))
    inner, total = (edge.size - 1) // 2, edge.sum()
    size = inner + int(MARGIN / step)
    form, window = np.zeros(2 * size + 1), 2 * size + 1
    covered = 1.0
    for j in range(window):
        if 0 <= j - size + inner < edge.size:
            covered -= edge[j - size + inner] / total
        form[j] = covered
    own, energy, across = (form * form).sum(), 0.0, 0.0
    for j in range(1, window - 1):
        slope = (form[j + 1] - form[j - 1]) / (2.0 * step)
        energy += slope * slope
        across += slope * form[j]
    energy -= across * across / own
    far, out[:] = min(int(reach / step), half - size), np.nan
    best = -1.0
    gains = np.zeros(max(2 * far + 1, 0))
    for d in range(gains.size):
        total, square, fit = 0.0, 0.0, 0.0
        for j in range(window):
            y = profile[half - far + d - size + j]
            total += y
            square += y * y
            fit += form[j] * y
        if np.isnan(square) or fit <= 0.0:
            continue
        gains[d] = fit * fit / own - max(total, 0.0) ** 2 / window
        if 0 < d < gains.size - 1 and gains[d] > best:
            best = gains[d]
            out[OFFSET], out[GAIN], out[ENERGY] = (d - far) * step, gains[d], energy
            out[AMPLITUDE], out[CERTAINTY] = fit / own, own
            out[RESIDUAL] = max(square - fit * fit / own, 0.0) / (window - 1)
    if best > 0.0:
        d = round(out[OFFSET] / step) + far
        bend = gains[d - 1] - 2.0 * gains[d] + gains[d + 1]
        if bend < 0.0:
            out[OFFSET] += 0.5 * step * (gains[d - 1] - gains[d + 1]) / bend
