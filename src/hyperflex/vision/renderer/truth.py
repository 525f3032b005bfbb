"""What a rendered video shows in truth: places of the markers in metres and pixels, and which are seen."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.files import NetCDF, PathLike, Variable

FORMAT = "hyperflex rendered truth 1"


@dataclass(frozen=True, eq=False)
class Truth:
    """The truth of T frames with K markers.

    Parameters
    ----------
    stamps : (T,) float64
        Time stamps of the frames, s.
    times : (T, K) float64
        When each marker was exposed (the middle of it, in its own row), s.
    places : (T, K, 3) float64
        Where it was then, m: x, y, and off the plane.
    pixels : (T, K, 2) float64
        Where it is seen, px.
    streaks : (T, K, 2) float64
        How far it moves in the picture during the exposure, px.
    visible : (T, K) bool
        Whether its middle is in the picture and nothing covers it.
    arc_lengths : (K,) float64
        Where the markers sit, m.
    """

    stamps: Array
    times: Array
    places: Array
    pixels: Array
    streaks: Array
    visible: npt.NDArray[np.bool_]
    arc_lengths: Array

    def write(self, path: PathLike) -> None:
        """Write the truth to a NetCDF file, wholly or not at all."""
        frame, each = ("frame",), ("frame", "marker")
        files.write_netcdf(
            path,
            NetCDF(
                {
                    "stamp": Variable(frame, self.stamps, {"units": "s"}),
                    "time": Variable(each, self.times, {"units": "s", "long_name": "middle of the exposure"}),
                    "place": Variable((*each, "axis"), self.places, {"units": "m"}),
                    "pixel": Variable((*each, "image_axis"), self.pixels, {"units": "px"}),
                    "streak": Variable((*each, "image_axis"), self.streaks, {"units": "px"}),
                    "visible": Variable(each, self.visible.astype(np.int8), {"units": "1"}),
                    "arc_length": Variable(("marker",), self.arc_lengths, {"units": "m"}),
                },
                {"format": FORMAT},
            ),
        )
