"""Fisher's linear discriminant between a marker's colour and the pixels around it."""

import numpy as np

from hyperflex.core.jit import kernel, summing

PASSES = (0.3, 0.15)  # shares below which pixels count as wall, first roughly and then finely
LEAST_WALL = 20  # pixels


@kernel
def discriminant(image, axes, target, contrast, out):  # type: ignore[no-untyped-def]
    """Find the linear measure that is 0 on the wall and 1 on the marker, and varies least over the wall.

    Parameters
    ----------
    image : (h, w, 3) uint8
        A small part of a picture, h, w >= 3; most of it, and of its border, is wall.
    axes : (2, 3) float64
        Directions in the three channels that distinguish the marker; the second one may be zero.
    target : (2,) float64
        Components of the marker along them.
    contrast : (2,) float64
        Least distance between marker and wall, and noise of a channel at least, levels.
    out : (4,) float64
        Set on return: share = out[:3] . channels + out[3].

    Returns
    -------
    float
        Standard deviation of the share over the wall; 0 if marker and wall cannot be distinguished.
    """
    h, w = image.shape[0], image.shape[1]
    x, y = np.empty(h * w), np.empty(h * w)
    along(image.reshape(-1), axes, x, y)
    wall_x, wall_y = border_median(x, h, w), border_median(y, h, w)
    dx, dy = target[0] - wall_x, target[1] - wall_y
    size = dx * dx + dy * dy
    out[:] = 0.0
    if size < contrast[0] * contrast[0]:
        return 0.0
    gx, gy = dx / size, dy / size
    noise = 0.0
    for least in PASSES:
        count, sx, sy, sxx, sxy, syy = wall_sums(x, y, wall_x, wall_y, gx, gy, least)
        if count < LEAST_WALL:
            return 0.0
        mx, my = sx / count, sy / count
        floor = contrast[1] * contrast[1]
        cxx, cxy, cyy = sxx / count - mx * mx + floor, sxy / count - mx * my, syy / count - my * my + floor
        wall_x += mx
        wall_y += my
        dx, dy = target[0] - wall_x, target[1] - wall_y
        hx, hy = (
            cyy * dx - cxy * dy,
            cxx * dy - cxy * dx,
        )  # inverse of the covariance times the contrast, but for a factor
        size = hx * dx + hy * dy
        if not size > 0.0:
            return 0.0
        gx, gy = hx / size, hy / size
        noise = np.sqrt(gx * gx * cxx + 2.0 * gx * gy * cxy + gy * gy * cyy)
    for c in range(3):
        out[c] = gx * axes[0, c] + gy * axes[1, c]
    out[3] = -gx * wall_x - gy * wall_y
    return noise


@kernel
def along(channels, axes, x, y):  # type: ignore[no-untyped-def]
    """Set x and y (P,) to the components of pixels (3 P,), uint8, along two axes (2, 3)."""
    a, b, c = axes[0, 0], axes[0, 1], axes[0, 2]
    d, e, f = axes[1, 0], axes[1, 1], axes[1, 2]
    for i in range(x.size):
        blue, green, red = float(channels[3 * i]), float(channels[3 * i + 1]), float(channels[3 * i + 2])
        x[i] = a * blue + b * green + c * red
        y[i] = d * blue + e * green + f * red


@summing
def wall_sums(x, y, wall_x, wall_y, gx, gy, least):  # type: ignore[no-untyped-def]
    """Return number and first and second moments about a point of the pixels (P,) whose share is less than `least`."""
    count, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(x.size):
        px, py = x[i] - wall_x, y[i] - wall_y
        wall = 1.0 if px * gx + py * gy < least else 0.0
        count += wall
        sx += wall * px
        sy += wall * py
        sxx += wall * px * px
        sxy += wall * px * py
        syy += wall * py * py
    return count, sx, sy, sxx, sxy, syy


@kernel
def border_median(values, h, w):  # type: ignore[no-untyped-def]
    """Return the median of the values (h w,) at the border of a picture."""
    border = np.empty(2 * (h + w))
    for u in range(w):
        border[u], border[w + u] = values[u], values[(h - 1) * w + u]
    for v in range(h):
        border[2 * w + v], border[2 * w + h + v] = values[v * w], values[v * w + w - 1]
    return np.median(border)
