"""Online estimation: a rope's state, and what is unknown of it, from its markers in frames or in metres."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.estimate.changes import Change, ChangeTests
    from hyperflex.estimate.doubts import Doubt, DoubtKind
    from hyperflex.estimate.error_levels import RunErrors, run_errors
    from hyperflex.estimate.filter import RopeFilter
    from hyperflex.estimate.live.frames import FrameThread, open_frames
    from hyperflex.estimate.live.page import PicturePage
    from hyperflex.estimate.live.state_source import CameraStateSource, TrackingTask
    from hyperflex.estimate.live.watch import LiveEstimate, Watch, WatchLog
    from hyperflex.estimate.measurements import (
        BaseElsewhere,
        CurveMeasurement,
        MarkedCurveMeasurement,
        MarkerMeasurement,
        curve_arc_lengths,
        marked_arc_lengths,
    )
    from hyperflex.estimate.moving_horizon import MovingHorizon, SmoothedTrack, smooth
    from hyperflex.estimate.observations import MarkerModel, Observations
    from hyperflex.estimate.parameters import EstimatedParameter, moving_base
    from hyperflex.estimate.picture import draw_frame
    from hyperflex.estimate.tracker import Measurement, Prediction, RopeTracker, TrackedFrame
    from hyperflex.estimate.video_track import VideoTrack, track_video

__getattr__, __dir__, __all__ = attach(__name__, __file__)
