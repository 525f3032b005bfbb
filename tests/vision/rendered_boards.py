"""Pictures of calibration boards by ray casting: an undistorted ray for each of several samples of a pixel."""

from __future__ import annotations

import functools

import cv2
import numpy as np

SIZE = (768, 432)
MATRIX = np.array([[720.0, 0.0, 400.0], [0.0, 724.0, 208.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.12, 0.06, 0.001, -0.0008, 0.0])
SAMPLES = 2  # a side of a pixel
PIXELS_PER_SQUARE = 48


@functools.cache
def fine_rays():
    """Return the undistorted rays of all samples of all pixels."""
    width, height = SIZE
    fine = (np.arange(width * SAMPLES) + 0.5) / SAMPLES - 0.5, (np.arange(height * SAMPLES) + 0.5) / SAMPLES - 0.5
    u, v = np.meshgrid(*fine)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    rays = cv2.undistortPoints(pixels, MATRIX, DISTORTION, criteria=criteria)[:, 0]
    return np.column_stack([rays, np.ones(len(rays))])


def render(board, rotation, translation, *, legacy=False, noise=2.0, seed=0):
    """Return a picture of a board (its frame: x right, y down, z into it) with the camera above; 8 bit, gray levels."""
    width, height = SIZE
    rays = fine_rays()
    turn = cv2.Rodrigues(np.asarray(rotation, float))[0]
    origin, rays = -turn.T @ translation, rays @ turn  # in the board's frame
    depth = -origin[2] / rays[:, 2]
    on_board = origin[:2] + depth[:, None] * rays[:, :2]
    texture = board.draw(PIXELS_PER_SQUARE, legacy=legacy)
    margin = PIXELS_PER_SQUARE
    texture = cv2.copyMakeBorder(texture, *[margin] * 4, cv2.BORDER_CONSTANT, value=255)
    where = (on_board / board.square * PIXELS_PER_SQUARE + margin - 0.5).astype(np.float32)
    where = where.reshape(height * SAMPLES, width * SAMPLES, 2)
    seen = cv2.remap(texture, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=110)
    seen = seen.astype(np.float32).reshape(height, SAMPLES, width, SAMPLES).mean(axis=(1, 3))
    seen = cv2.GaussianBlur(30.0 + 0.75 * seen, (0, 0), 0.6)
    seen += np.random.default_rng(seed).normal(0.0, noise, seen.shape)
    return cv2.cvtColor(np.clip(np.rint(seen), 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)


def poses(board, count, *, tilt=0.6, seed=1):
    """Return rotation vectors and translations of boards about the middle of the picture, tilted to all sides."""
    rng = np.random.default_rng(seed)
    middle = 0.5 * board.square * np.array([*board.squares, 0.0])
    found = []
    for k in range(count):
        direction = 2.0 * np.pi * k / count
        rotation = tilt * np.array([np.cos(direction), np.sin(direction), 0.0]) + rng.normal(0.0, 0.05, 3) * (tilt > 0)
        place = np.array([rng.uniform(-0.09, 0.09), rng.uniform(-0.05, 0.05), rng.uniform(0.42, 0.6)])
        found.append((rotation, place - cv2.Rodrigues(rotation)[0] @ middle))
    return found
