"""A camera's pixels of points, with derivatives, and the way back to the plane (OpenCV's model of a camera)."""

import numpy as np

from hyperflex.core.jit import kernel

# A lens: rotation (9) and translation (3) to the camera, fx, fy, cx, cy, and k1, k2, p1, p2, k3, k4, k5, k6
LENS = 24
UNDISTORTIONS, NEWTON_STEPS, CLOSE, MISSED = 5, 12, 1e-9, 1e-6  # numbers of steps; px


@kernel
def project(places, lens, pixels, slopes):  # type: ignore[no-untyped-def]
    """Set pixels (K, 2) of places (K, 3), m, and their derivatives (K, 2, 3); NaN behind the camera.

    `lens` (24,) is described at ``LENS``. OpenCV's documentation, "Camera Calibration and 3D Reconstruction".
    """
    for k in range(len(places)):
        seen = project_point(places[k, 0], places[k, 1], places[k, 2], lens)
        pixels[k, 0], pixels[k, 1], a, b, depth, aa, ab, bb = seen
        for j in range(3):
            da, db = (lens[j] - a * lens[6 + j]) / depth, (lens[3 + j] - b * lens[6 + j]) / depth
            slopes[k, 0, j], slopes[k, 1, j] = lens[12] * (aa * da + ab * db), lens[13] * (ab * da + bb * db)


@kernel
def locate(pixels, lens, to_plane, places):  # type: ignore[no-untyped-def]
    """Set places (K, 2) in the plane, m, of pixels (K, 2); NaN where a pixel shows no point of it.

    `to_plane` (3, 3) leads from the picture without distortion to the plane. The distortion is taken away by a
    fixed-point iteration, what that leaves by Newton's method.
    """
    for k in range(len(pixels)):
        a, b = ideal((pixels[k, 0] - lens[14]) / lens[12], (pixels[k, 1] - lens[15]) / lens[13], lens)
        w = to_plane[2, 0] * a + to_plane[2, 1] * b + to_plane[2, 2]
        x = (to_plane[0, 0] * a + to_plane[0, 1] * b + to_plane[0, 2]) / w
        y = (to_plane[1, 0] * a + to_plane[1, 1] * b + to_plane[1, 2]) / w
        error = np.nan
        for _ in range(NEWTON_STEPS):
            u, v, a, b, depth, aa, ab, bb = project_point(x, y, 0.0, lens)
            du, dv = pixels[k, 0] - u, pixels[k, 1] - v
            error = max(abs(du), abs(dv))
            if not error > CLOSE:
                break
            ax, bx = (lens[0] - a * lens[6]) / depth, (lens[3] - b * lens[6]) / depth
            ay, by = (lens[1] - a * lens[7]) / depth, (lens[4] - b * lens[7]) / depth
            ux, uy = lens[12] * (aa * ax + ab * bx), lens[12] * (aa * ay + ab * by)
            vx, vy = lens[13] * (ab * ax + bb * bx), lens[13] * (ab * ay + bb * by)
            size = ux * vy - uy * vx
            x += (vy * du - uy * dv) / size
            y += (ux * dv - vx * du) / size
        good = error <= MISSED
        places[k, 0], places[k, 1] = x if good else np.nan, y if good else np.nan


@kernel
def project_point(x, y, z, lens):  # type: ignore[no-untyped-def]
    """Return the pixel u, v of a point, its slopes a and b of sight, its depth, m, and what distortion makes of them.

    The last three are the derivatives of the distorted a and b by a and b, of which the two across are the same.
    """
    depth = lens[6] * x + lens[7] * y + lens[8] * z + lens[11]
    if not depth > 0.0:
        depth = np.nan
    a = (lens[0] * x + lens[1] * y + lens[2] * z + lens[9]) / depth
    b = (lens[3] * x + lens[4] * y + lens[5] * z + lens[10]) / depth
    k1, k2, p1, p2, k3, k4, k5, k6 = lens[16], lens[17], lens[18], lens[19], lens[20], lens[21], lens[22], lens[23]
    r = a * a + b * b
    below = 1.0 + r * (k4 + r * (k5 + r * k6))
    radial = (1.0 + r * (k1 + r * (k2 + r * k3))) / below
    by_r = (k1 + r * (2.0 * k2 + 3.0 * r * k3) - radial * (k4 + r * (2.0 * k5 + 3.0 * r * k6))) / below
    u = lens[12] * (a * radial + 2.0 * p1 * a * b + p2 * (r + 2.0 * a * a)) + lens[14]
    v = lens[13] * (b * radial + 2.0 * p2 * a * b + p1 * (r + 2.0 * b * b)) + lens[15]
    aa = radial + 2.0 * a * a * by_r + 2.0 * p1 * b + 6.0 * p2 * a
    ab = 2.0 * a * b * by_r + 2.0 * p1 * a + 2.0 * p2 * b
    bb = radial + 2.0 * b * b * by_r + 6.0 * p1 * b + 2.0 * p2 * a
    return u, v, a, b, depth, aa, ab, bb


@kernel
def ideal(u, v, lens):  # type: ignore[no-untyped-def]
    """Return the slopes of sight that a lens distorts to u and v, nearly."""
    k1, k2, p1, p2, k3, k4, k5, k6 = lens[16], lens[17], lens[18], lens[19], lens[20], lens[21], lens[22], lens[23]
    a, b = u, v
    for _ in range(UNDISTORTIONS):
        r = a * a + b * b
        inverse = (1.0 + r * (k4 + r * (k5 + r * k6))) / (1.0 + r * (k1 + r * (k2 + r * k3)))
        if inverse < 0.0:  # too far outside for such a lens
            return u, v
        across, along = 2.0 * p1 * a * b + p2 * (r + 2.0 * a * a), 2.0 * p2 * a * b + p1 * (r + 2.0 * b * b)
        a, b = (u - across) * inverse, (v - along) * inverse
    return a, b
