"""Online estimation: a rope's state, and what is unknown of it, from its markers in frames or in metres."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.estimate.filter import RopeFilter
    from hyperflex.estimate.moving_horizon import MovingHorizon
    from hyperflex.estimate.observations import MarkerModel, Observations
    from hyperflex.estimate.parameters import EstimatedParameter
    from hyperflex.estimate.smoother import SmoothedTrack, smooth
    from hyperflex.estimate.tracker import RopeTracker, TrackedFrame, VideoTrack, track_video

__getattr__, __dir__, __all__ = attach(__name__, __file__)
