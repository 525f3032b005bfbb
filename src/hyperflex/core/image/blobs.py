"""Blobs in a small picture of weights: connected components and their moments."""

import numpy as np

from hyperflex.core.jit import kernel, non_allocating

AREA, MEAN_U, MEAN_V, COV_UU, COV_UV, COV_VV, PEAK, PIXELS, BORDER, SPREAD, FULL, COLOUR = range(12)
COLUMNS = COLOUR + 3
LARGEST = 64  # blobs in one picture, 255 at most
GROWTH = 2  # px beyond the threshold that still count
FAINT = 0.2  # of a blob's greatest weight: smaller weights do not belong to it
PIECE = 32  # pixels that are compared with the threshold together
FULLY = 0.85  # weight above which a pixel shows only the marker


@kernel
def weigh(image, functional, weights):  # type: ignore[no-untyped-def]
    """Set weights (h, w) to functional[:3] . colour + functional[3] of image (h, w, 3), uint8."""
    a, b, c, d = functional[0], functional[1], functional[2], functional[3]
    channels, flat = image.reshape(-1), weights.reshape(-1)
    for i in range(flat.size):
        flat[i] = a * channels[3 * i] + b * channels[3 * i + 1] + c * channels[3 * i + 2] + d


@kernel
def blob_moments(image, weights, threshold, out):  # type: ignore[no-untyped-def]
    """Find connected components above a threshold and take the moments of the weights in and about them.

    Parameters
    ----------
    image : (h, w, 3) uint8
    weights : (h, w) float64
        Share of the pixel that a marker covers; noise about 0 elsewhere.
    threshold : float
        Weight above which neighbouring pixels (of eight) belong together, if it is also a fifth of the blob's greatest
        weight.
    out : (M, COLUMNS) float64
        Set on return, a row for each component, in the order of their first rows: area (sum of weights), means and
        covariances of u and v, greatest weight, pixels, whether it touches the border, sum of squared distances from
        the mean, and of the pixels that are fully covered their number and the mean of three channels.

    Returns
    -------
    int
        Number of components, M at most.

    Notes
    -----
    Weights are summed over each component and two pixels around it, without a cut at the threshold: edges count with
    their weights, so the mean is not displaced.
    """
    h, w = weights.shape
    label, members = np.zeros((h, w), np.uint8), np.empty((h * w, 2), np.int32)
    _, size = label_blobs(weights, threshold, label, members, out.shape[0])
    sure = weights.copy()
    drop_faint(sure, label, members, size)
    label[:] = 0
    count, size = label_blobs(sure, threshold, label, members, out.shape[0])
    for _ in range(GROWTH):
        for i in range(size):
            size = add_neighbours(weights, -np.inf, label, members, i, size)
    out[:] = 0.0
    for i in range(size):
        v, u = members[i, 0], members[i, 1]
        x, row = weights[v, u], out[label[v, u] - 1]
        row[AREA] += x
        row[MEAN_U] += x * u
        row[MEAN_V] += x * v
        row[PIXELS] += 1.0
        row[PEAK] = max(row[PEAK], x)
        if u == 0 or v == 0 or u == w - 1 or v == h - 1:
            row[BORDER] = 1.0
        if x > FULLY:
            row[FULL] += 1.0
            for c in range(3):
                row[COLOUR + c] += image[v, u, c]
    for k in range(count):
        row = out[k]
        row[MEAN_U] /= row[AREA]
        row[MEAN_V] /= row[AREA]
        for c in range(3):
            row[COLOUR + c] /= max(row[FULL], 1.0)
    for i in range(size):
        v, u = members[i, 0], members[i, 1]
        row = out[label[v, u] - 1]
        du, dv, share = u - row[MEAN_U], v - row[MEAN_V], weights[v, u] / row[AREA]
        row[COV_UU] += share * du * du
        row[COV_UV] += share * du * dv
        row[COV_VV] += share * dv * dv
        row[SPREAD] += du * du + dv * dv
    return count


@kernel
def label_blobs(weights, threshold, label, members, most):  # type: ignore[no-untyped-def]
    """Number connected components above a threshold from 1 on.

    `label` (h, w), zeros on entry, and `members` (h w, 2), row and column of each of their pixels, are set. Returns the
    numbers of components, at most `most`, and of pixels.
    """
    h, w = weights.shape
    flat, labels = weights.reshape(-1), label.reshape(-1)
    count, size = 0, 0
    for first in range(0, h * w, PIECE):
        piece, above = flat[first : first + PIECE], 0
        for k in range(piece.size):
            above += piece[k] > threshold
        for i in range(first, first + piece.size if above else first):  # most blocks contain nothing
            if flat[i] <= threshold or labels[i] != 0:
                continue
            if count == most:
                return count, size
            count += 1
            done = size
            members[size, 0], members[size, 1] = i // w, i % w
            size += 1
            labels[i] = count
            while done < size:
                size = add_neighbours(weights, threshold, label, members, done, size)
                done += 1
    return count, size


@kernel
def drop_faint(weights, label, members, size):  # type: ignore[no-untyped-def]
    """Set pixels much fainter than the greatest weight of their component to zero, such as a rope at a marker."""
    peak = np.zeros(size + 1)
    for i in range(size):
        v, u = members[i, 0], members[i, 1]
        peak[label[v, u]] = max(peak[label[v, u]], weights[v, u])
    for i in range(size):
        v, u = members[i, 0], members[i, 1]
        if weights[v, u] < FAINT * peak[label[v, u]]:
            weights[v, u] = 0.0


@non_allocating
def add_neighbours(weights, threshold, label, members, i, size):  # type: ignore[no-untyped-def]
    """Add the free neighbours (of eight) of member i above a threshold to its component; return the number of members.

    Arguments as of :func:`label_blobs`.
    """
    v, u = members[i, 0], members[i, 1]
    for b in range(max(v - 1, 0), min(v + 2, label.shape[0])):
        for a in range(max(u - 1, 0), min(u + 2, label.shape[1])):
            if label[b, a] == 0 and weights[b, a] > threshold:
                label[b, a] = label[v, u]
                members[size, 0], members[size, 1] = b, a
                size += 1
    return size
