"""Blobs in a small picture of weights: connected components and their moments."""

import numpy as np

from hyperflex.core.jit import kernel

AREA, MEAN_U, MEAN_V, COV_UU, COV_UV, COV_VV, PEAK, PIXELS, BORDER, SPREAD, FULL, COLOUR = range(12)
COLUMNS = COLOUR + 3
LARGEST = 64  # blobs in one picture, 255 at most
GROWTH = 2  # px beyond the threshold that still count
FAINT = 0.2  # of a blob's greatest weight: less is no part of it
FULLY = 0.85  # weight from which a pixel shows the marker alone


@kernel
def weigh(image, functional, weights):  # type: ignore[no-untyped-def]
    """Set weights (h, w) to functional[:3] . colour + functional[3] of image (h, w, 3), uint8."""
    a, b, c, d = functional[0], functional[1], functional[2], functional[3]
    for v in range(image.shape[0]):
        for u in range(image.shape[1]):
            weights[v, u] = a * image[v, u, 0] + b * image[v, u, 1] + c * image[v, u, 2] + d


@kernel
def blob_moments(image, weights, threshold, out):  # type: ignore[no-untyped-def]
    """Find connected components above a threshold and take the moments of the weights in and about them.

    Parameters
    ----------
    image : (h, w, 3) uint8
    weights : (h, w) float64
        Share of the pixel that a marker covers; noise about 0 elsewhere.
    threshold : float
        Weight above which pixels belong together (eight neighbours), where it is a fifth of the blob's greatest, too.
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
    Weights are summed over each component and two pixels around it, not cut at the threshold: so edges count with
    their shares, and the mean is not displaced.
    """
    h, w = weights.shape
    label, members = np.zeros((h, w), np.uint8), np.empty(h * w, np.int64)
    _, size = label_blobs(weights, threshold, label, members, out.shape[0])
    sure = weights.copy()
    drop_faint(sure, label, members, size)
    label[:] = 0
    count, size = label_blobs(sure, threshold, label, members, out.shape[0])
    for _ in range(GROWTH):
        size = grow(label, members, size)
    out[:] = 0.0
    for i in range(size):
        v, u = members[i] // w, members[i] % w
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
        v, u = members[i] // w, members[i] % w
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

    `label` (h, w), zeros on entry, and `members` (h w,), the indices of their pixels, are set. Returns how many
    components, `most` at most, and how many pixels.
    """
    h, w = weights.shape
    count, size = 0, 0
    for y in range(h):
        for x in range(w):
            if weights[y, x] <= threshold or label[y, x] != 0:
                continue
            if count == most:
                return count, size
            count += 1
            done = size
            members[size] = y * w + x
            size += 1
            label[y, x] = count
            while done < size:
                v, u = members[done] // w, members[done] % w
                done += 1
                for b in range(max(v - 1, 0), min(v + 2, h)):
                    for a in range(max(u - 1, 0), min(u + 2, w)):
                        if label[b, a] == 0 and weights[b, a] > threshold:
                            label[b, a] = count
                            members[size] = b * w + a
                            size += 1
    return count, size


@kernel
def drop_faint(weights, label, members, size):  # type: ignore[no-untyped-def]
    """Set to zero what is much fainter than the greatest weight of its component: a rope that touches a marker, say."""
    w = weights.shape[1]
    peak = np.zeros(size + 1)
    for i in range(size):
        v, u = members[i] // w, members[i] % w
        peak[label[v, u]] = max(peak[label[v, u]], weights[v, u])
    for i in range(size):
        v, u = members[i] // w, members[i] % w
        if weights[v, u] < FAINT * peak[label[v, u]]:
            weights[v, u] = 0.0


@kernel
def grow(label, members, size):  # type: ignore[no-untyped-def]
    """Let each component take the free pixels beside it (eight neighbours); return the number of members then."""
    h, w = label.shape
    before = size
    for i in range(before):
        v, u = members[i] // w, members[i] % w
        for b in range(max(v - 1, 0), min(v + 2, h)):
            for a in range(max(u - 1, 0), min(u + 2, w)):
                if label[b, a] == 0:
                    label[b, a] = label[v, u]
                    members[size] = b * w + a
                    size += 1
    return size
