"""A camera's pixels of points, with derivatives: OpenCV's model of a lens."""

import numpy as np

from hyperflex.core.jit import kernel


@kernel
def project(points, pose, matrix, distortion, pixels, slopes):  # type: ignore[no-untyped-def]
    """Set pixels (K, 2) of points (K, D), and their derivatives (K, 2, D); NaN behind the camera.

    Parameters
    ----------
    points : (K, D) float64
        In the swing plane (D = 2), or off it (D = 3), m.
    pose : (3, 4) float64
        Rotation and translation from the plane to the camera, m.
    matrix : (3, 3) float64
        Focal lengths and centre, px.
    distortion : (8,) float64
        k1, k2, p1, p2, k3, k4, k5, k6.

    Notes
    -----
    OpenCV's documentation, "Camera Calibration and 3D Reconstruction".
    """
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    k1, k2, p1, p2, k3, k4, k5, k6 = distortion
    for k in range(points.shape[0]):
        x, y, z = pose[0, 3], pose[1, 3], pose[2, 3]  # in the camera, m
        for j in range(points.shape[1]):
            x += pose[0, j] * points[k, j]
            y += pose[1, j] * points[k, j]
            z += pose[2, j] * points[k, j]
        if not z > 0.0:
            z = np.nan
        a, b = x / z, y / z
        r = a * a + b * b
        below = 1.0 + r * (k4 + r * (k5 + r * k6))
        radial = (1.0 + r * (k1 + r * (k2 + r * k3))) / below
        by_r = (k1 + r * (2.0 * k2 + 3.0 * r * k3) - radial * (k4 + r * (2.0 * k5 + 3.0 * r * k6))) / below
        pixels[k, 0] = fx * (a * radial + 2.0 * p1 * a * b + p2 * (r + 2.0 * a * a)) + cx
        pixels[k, 1] = fy * (b * radial + 2.0 * p2 * a * b + p1 * (r + 2.0 * b * b)) + cy
        # derivatives of distorted a and b by a and b: the two mixed ones are equal
        aa = radial + 2.0 * a * a * by_r + 2.0 * p1 * b + 6.0 * p2 * a
        ab = 2.0 * a * b * by_r + 2.0 * p1 * a + 2.0 * p2 * b
        bb = radial + 2.0 * b * b * by_r + 6.0 * p1 * b + 2.0 * p2 * a
        for j in range(points.shape[1]):
            da, db = (pose[0, j] - a * pose[2, j]) / z, (pose[1, j] - b * pose[2, j]) / z
            slopes[k, 0, j] = fx * (aa * da + ab * db)
            slopes[k, 1, j] = fy * (ab * da + bb * db)
