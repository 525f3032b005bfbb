"""Vision: camera and calibration, video, markers and bars in pictures, and a synthetic camera to test them with."""

from typing import TYPE_CHECKING

from hyperflex import extras
from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.vision.assignment import (
        Assignment,
        ClutterMap,
        Ordering,
        assign_markers,
        check_increasing,
        order_markers,
    )
    from hyperflex.vision.bars import BarDetector, BarObservations, BarTrack, link_angles, track_bars
    from hyperflex.vision.calibration import Board, BoardView, Calibration, calibrate_camera
    from hyperflex.vision.camera import Camera, PlaneView, read_camera
    from hyperflex.vision.colour import MarkerColour
    from hyperflex.vision.curve import CurveDetector, CurveOffsets, CurveView, view_curve
    from hyperflex.vision.first_frame import FoundRope, NoRope, Reason, find_rope
    from hyperflex.vision.look import RopeLook
    from hyperflex.vision.markers import Blobs, Gate, MarkerDetector
    from hyperflex.vision.renderer.boards import film_board
    from hyperflex.vision.renderer.motion import RopeMotion
    from hyperflex.vision.renderer.renderer import (
        Bar,
        Occluder,
        Renderer,
        Scene,
        Truth,
        frame_times,
        random_occlusion,
    )
    from hyperflex.vision.stereo import stereo_recording
    from hyperflex.vision.tone import linear_tone, srgb_tone
    from hyperflex.vision.video import (
        Frame,
        Image,
        LiveCamera,
        VideoReader,
        VideoWriter,
        follow_video,
        read_image,
        read_pictures,
    )

extras.require(("cv2", "av"), "vision", "Cameras, pictures and videos")

__getattr__, __dir__, __all__ = attach(__name__, __file__)
