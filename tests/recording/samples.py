"""One swing as each program that tracks markers writes it: the files are made here after the makers' documentation."""

import io
import pickle
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import h5py
import numpy as np

RATE, COUNT = 50.0, 12
FRAMES = np.arange(COUNT)
T = FRAMES / RATE
ANGLE = 0.4 * np.cos(6.0 * T)
# x to the right, y away from the camera, z up; mm, rounded as programs round
PIVOT = np.tile([10.0, -3.0, 900.0], (COUNT, 1))
TIP = np.round(PIVOT + 250.0 * np.stack([np.sin(ANGLE), 0.004 * np.sin(9.0 * T), -np.cos(ANGLE)], axis=1), 3)
PLANAR = {"pivot": PIVOT[:, [0, 2]], "tip": TIP[:, [0, 2]]}  # mm, x right and y up
GONE = 4  # the frame in which the tip is lost
LIKELY = np.where(FRAMES == 7, 0.05, 0.98)  # of the tip


class Sample(NamedTuple):
    """A file: its bytes, the arguments of its reader, and its contents, m: times and x, y of markers."""

    content: bytes
    arguments: dict[str, Any]
    t: Any = T
    data: Any = None
    suffix: str = ".csv"


def lost(tip: np.ndarray, *frames: int) -> np.ndarray:
    """Return places of the tip with gaps."""
    tip = np.array(tip, dtype=float)
    tip[list(frames)] = np.nan
    return tip


METRES = 1e-3 * np.hstack([PLANAR["pivot"], lost(PLANAR["tip"], GONE)])
SPACE = {"plane": "xz"}
BOTH = {"markers": ["pivot", "tip"]}
PIXELS = {"scale": 1e-3}
LIKELIEST = {**PIXELS, "min_likelihood": 0.6}


def cells(values: Any) -> list[str]:
    return ["" if np.isnan(x) else repr(float(x)) for x in values]


def table(rows: list[list[str]], mark: str = ",", end: str = "\n") -> str:
    return "".join(mark.join(row) + end for row in rows)


def motive() -> Sample:
    """Motive 1.23: a rigid body with its quaternion, and two markers."""
    meta = f"Format Version,1.23,Take Name,swing,Export Frame Rate,{RATE:.6f},Length Units,Millimeters".split(",")
    kinds = ["Rigid Body"] * 8 + ["Marker"] * 6
    names = ["base"] * 8 + ["rope:pivot"] * 3 + ["rope:tip"] * 3
    parts = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"] + ["Position"] * 6
    axes = [*"XYZW", *"XYZ", "", *"XYZ", *"XYZ"]
    rows = [
        meta,
        [],
        ["", "Type", *kinds],
        ["", "Name", *names],
        ["", "ID", *(f"{k}" for k in range(14))],
        ["", "", *parts],
        ["Frame", "Time (Seconds)", *axes],
    ]
    tip = lost(TIP, GONE)
    for k in FRAMES:
        values = cells([0, 0, 0, 1, *PIVOT[k], 0.1, *PIVOT[k], *tip[k]])
        rows.append([f"{k}", repr(float(T[k])), *values])
    arguments = {"markers": ["rope:pivot", "rope:tip"], **SPACE}
    return Sample(table(rows, end="\r\n").encode(), arguments, data=METRES)


def motive_frames() -> Sample:
    """Motive 1.1: a line a frame, with a rigid body and the markers that are seen."""
    lines = ["comment,OptiTrack export", "info,version,1.1", f"info,framecount,{COUNT}", "righthanded"]
    for k in FRAMES:
        seen = [("pivot", PIVOT[k])] + ([("tip", TIP[k])] if k != GONE else [])
        body = ["1", *cells([0, 0, 0, 0, 0, 0, 1, 0, 0, 0])]
        markers = [cell for j, (name, place) in enumerate(seen) for cell in (*cells(place), f"{j + 1}", name)]
        lines.append(",".join(["frame", f"{k}", repr(float(T[k])), "1", *body, f"{len(seen)}", *markers]))
    return Sample("\n".join([*lines, ""]).encode(), {**BOTH, **SPACE, "unit": "mm"}, data=METRES)


def vicon() -> Sample:
    """Vicon Nexus: trajectories above the devices."""
    tip = lost(TIP, GONE)
    rows = [["Trajectories"], [f"{RATE:g}"], ["", "", "rope:pivot", "", "", "rope:tip", "", ""]]
    rows += [["Frame", "Sub Frame", *"XYZ", *"XYZ"], ["", "", *["mm"] * 6]]
    rows += [[f"{k + 1}", "0", *cells([*PIVOT[k], *tip[k]])] for k in FRAMES]
    rows += [row.split(",") for row in ("", "Devices", "1000", ",,Force", "Frame,Sub Frame,Fx", ",,N", "1,0,0.5")]
    arguments = {"markers": ["rope:pivot", "rope:tip"], **SPACE}
    return Sample(table(rows, end="\r\n").encode(), arguments, (FRAMES + 1) / RATE, METRES)


def qualisys() -> Sample:
    """Qualisys: lost markers at 0, 0, 0, names with a blank."""
    tip = np.nan_to_num(lost(TIP, GONE))
    head = {
        "NO_OF_FRAMES": COUNT,
        "NO_OF_MARKERS": 2,
        "FREQUENCY": f"{RATE:g}",
        "DESCRIPTION": "--",
        "TIME_STAMP": "2024-05-02, 10:47:36.627\t94247.4",
        "DATA_INCLUDED": "3D",
        "MARKER_NAMES": "New 0000\tNew 0001",
        "TRAJECTORY_TYPES": "Measured\tMeasured",
    }
    rows = [[key, f"{value}"] for key, value in head.items()]
    rows += [["Frame", "Time", *(f"{name} {axis}" for name in ("New 0000", "New 0001") for axis in "XYZ")]]
    rows += [[f"{k + 1}", f"{T[k]:.5f}", *(f"{x:.3f}" for x in (*PIVOT[k], *tip[k]))] for k in FRAMES]
    arguments = {"markers": ["New 0000", "New 0001"], **SPACE}
    return Sample(table(rows, "\t", "\r\n").encode(), arguments, data=METRES, suffix=".tsv")


def trc() -> Sample:
    """OpenSim: tabs, an empty line below the header."""
    tip = lost(TIP, GONE)
    keys = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate"]
    values = [f"{RATE:g}", f"{RATE:g}", f"{COUNT}", "2", "mm", f"{RATE:g}"]
    rows = [["PathFileType", "4", "(X/Y/Z)", "swing.trc"], keys, values]
    rows += [["Frame#", "Time", "pivot", "", "", "tip", "", ""], ["", "", "X1", "Y1", "Z1", "X2", "Y2", "Z2"], [""]]
    rows += [[f"{k + 1}", repr(float(T[k])), *cells([*PIVOT[k], *tip[k]])] for k in FRAMES]
    return Sample(table(rows, "\t").encode(), {**BOTH, **SPACE}, data=METRES, suffix=".trc")


def c3d() -> Sample:
    """C3D holds single precision, which is exact for these places in units of 1/8 mm."""
    from c3d import Writer

    eighths = np.round(8.0 * np.stack([PIVOT, TIP], axis=1)) / 8.0
    rows = np.zeros((COUNT, 2, 5), dtype=np.float32)
    rows[:, :, :3] = eighths
    rows[GONE, 1] = [0.0, 0.0, 0.0, -1.0, 0.0]
    writer = Writer(point_rate=RATE)
    writer.add_frames([(row, np.zeros((0, 0))) for row in rows])
    writer.set_point_labels(["pivot", "tip"])
    writer.set_screen_axis("+X", "+Z")
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # there are no analogue channels
        writer.write(buffer)
    data = 1e-3 * np.hstack([eighths[:, 0, [0, 2]], lost(eighths[:, 1, [0, 2]], GONE)])
    return Sample(buffer.getvalue(), {**BOTH, **SPACE}, (FRAMES + 1) / RATE, data, ".c3d")


def kinovea() -> Sample:
    """Kinovea: trajectories below each other, decimal commas, a name that returns after a gap."""
    lines = ["#Kinovea Trajectory data export", "#T X Y", ""]
    for name, places, frames in (
        ("pivot", PLANAR["pivot"], FRAMES),
        ("tip", PLANAR["tip"], FRAMES[:GONE]),
        ("tip", PLANAR["tip"], FRAMES[GONE + 1 :]),
    ):
        lines.append(f"# {name}")
        lines += [f"{float(T[k])} {float(places[k, 0])} {float(places[k, 1])} ".replace(".", ",") for k in frames]
        lines += ["", ""]
    text = "\n".join(lines)
    arguments = {**BOTH, "time_unit": "s", "unit": "mm", "y_axis": "up"}
    return Sample(text.encode(), arguments, data=METRES, suffix=".txt")


def kva() -> Sample:
    """Kinovea's annotations: time stamps, and coordinates with two decimals."""
    rounded = {name: np.round(places, 2) for name, places in PLANAR.items()}
    tracks = ""
    for name, places in rounded.items():
        frames = [k for k in FRAMES if name == "pivot" or k != GONE]
        points = "".join(
            f'<TrackPoint UserX="{x}" UserXInvariant="{x:.2f}" UserY="{y}" UserYInvariant="{y:.2f}" UserTime="0">'
            f"1;2;{512 * k}</TrackPoint>"
            for k in frames
            for x, y in [places[k]]
        )
        tracks += (
            f'<Track><TrackPointList Count="{len(frames)}" UserUnitLength="mm">{points}</TrackPointList>'
            f'<MainLabel Text="{name}"/></Track>'
        )
    text = (
        '<?xml version="1.0" encoding="utf-8"?>\n<KinoveaVideoAnalysis><FormatVersion>2.0</FormatVersion>'
        f"<AverageTimeStampsPerFrame>512</AverageTimeStampsPerFrame><CaptureFramerate>{RATE:g}</CaptureFramerate>"
        f"<Tracks>{tracks}</Tracks></KinoveaVideoAnalysis>"
    )
    data = 1e-3 * np.hstack([rounded["pivot"], lost(rounded["tip"], GONE)])
    return Sample(text.encode(), BOTH, data=data, suffix=".kva")


TRACKER = "org.opensourcephysics.cabrillo.tracker"


def held(name: str, value: object, kind: str = "double") -> str:
    return f'<property name="{name}" type="{kind}">{value}</property>'


def array(content: str) -> str:
    return f'<property name="framedata" type="array">{content}</property>'


def instance(kind: str, *content: str) -> str:
    return f'<object class="{kind}">{"".join(content)}</object>'


def item(kind: str, *content: str) -> str:
    return f'<property name="item" type="object">{instance(kind, *content)}</property>'


def trk() -> Sample:
    """Tracker's own file: places in the image, axes turned by 30 degrees, 2000 px per m, every second frame."""
    turn, scale, (ox, oy) = np.radians(30.0), 2000.0, (320.0, 100.0)

    masses = ""
    for name, places in PLANAR.items():
        x, y = 1e-3 * places.T
        u = scale * (np.cos(turn) * x - np.sin(turn) * y) + ox
        v = -scale * (np.sin(turn) * x + np.cos(turn) * y) + oy
        frames = [k for k in FRAMES if name == "pivot" or k != GONE]
        steps = "".join(
            f'<property name="[{3 + 2 * k}]" type="object">'
            f"{instance('FrameData', held('x', float(u[k])), held('y', float(v[k])))}</property>"
            for k in frames
        )
        masses += item(f"{TRACKER}.PointMass", held("name", name, "string"), array(steps))
    axes = (
        held(name, value)
        for name, value in (("xorigin", ox), ("yorigin", oy), ("angle", 30.0), ("xscale", scale), ("yscale", scale))
    )
    frame = f'<property name="[0]" type="object">{instance("FrameData", *axes)}</property>'
    clip = (held(name, value, "int") for name, value in (("startframe", 3), ("stepsize", 2), ("stepcount", COUNT)))
    panel = instance(
        f"{TRACKER}.TrackerPanel",
        f'<property name="videoclip" type="object">{instance("VideoClip", *clip)}</property>',
        f'<property name="clipcontrol" type="object">{instance("Control", held("delta_t", 500.0 / RATE))}</property>',
        f'<property name="coords" type="object">{instance("ImageCoordSystem", array(frame))}</property>',
        held("length_unit", "m", "string"),
        f'<property name="tracks" type="collection">{masses}</property>',
    )
    text = f'<?xml version="1.0" encoding="UTF-8"?>\n{panel}'
    return Sample(text.encode(), BOTH, data=METRES, suffix=".trk")


def tracker_table() -> Sample:
    """Tracker's table of two masses, tabs, decimal commas, a score that is infinite."""
    tip = lost(PLANAR["tip"], GONE)
    rows = [["", "pivot", "", "tip", "", ""], ["t_{1}", "x", "y", "x", "y", "score"]]
    rows += [
        [cell.replace(".", ",") for cell in cells([T[k], *PLANAR["pivot"][k], *tip[k]])] + ["Infinity"] for k in FRAMES
    ]
    arguments = {**BOTH, "time_unit": "s", "unit": "mm", "y_axis": "up"}
    return Sample(table(rows, "\t").encode(), arguments, data=METRES, suffix=".txt")


def image(places: np.ndarray) -> np.ndarray:
    """Return places as an image shows them: y down."""
    return places * [1.0, -1.0]


UNLIKELY = 1e-3 * np.hstack([PLANAR["pivot"], lost(PLANAR["tip"], 7)])


def deeplabcut() -> Sample:
    parts = ["bodyparts", *["pivot"] * 3, *["tip"] * 3]
    head = [["scorer", *["net"] * 6], parts, ["coords", *["x", "y", "likelihood"] * 2]]
    rows = [[f"{k}", *cells([*image(PLANAR["pivot"])[k], 0.99, *image(PLANAR["tip"])[k], LIKELY[k]])] for k in FRAMES]
    return Sample(table(head + rows).encode(), {**BOTH, **LIKELIEST, "frame_rate": RATE}, data=UNLIKELY)


def deeplabcut_h5() -> Sample:
    """What pandas writes: a table, whose names are a pickle."""
    labels = [("net", part, axis) for part in ("pivot", "tip") for axis in ("x", "y", "likelihood")]
    rows = np.zeros(COUNT, dtype=[("index", "<i8"), ("values_block_0", "<f8", (6,))])
    rows["index"] = FRAMES
    sure = np.full(COUNT, 0.99)
    rows["values_block_0"] = np.column_stack([image(PLANAR["pivot"]), sure, image(PLANAR["tip"]), LIKELY])
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        held = file.create_dataset("df_with_missing/table", data=rows)
        held.attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(labels, 0))
    return Sample(buffer.getvalue(), {**BOTH, **LIKELIEST, "frame_rate": RATE}, data=UNLIKELY, suffix=".h5")


def sleap() -> Sample:
    buffer = io.BytesIO()
    places = np.stack([image(each) for each in PLANAR.values()])  # nodes, frames, axes
    places[1, GONE] = np.nan
    with h5py.File(buffer, "w") as file:
        file["tracks"] = places.transpose(2, 0, 1)[None]
        file["node_names"] = np.array([b"pivot", b"tip"])
        file["track_names"] = np.array([b"rope"])
        file["point_scores"] = np.stack([np.ones(COUNT), LIKELY])[None]
    return Sample(buffer.getvalue(), {**BOTH, **PIXELS, "frame_rate": RATE}, data=METRES, suffix=".h5")


def anipose() -> Sample:
    parts = ("x", "y", "z", "error", "ncams", "score")
    rows = [[f"{name}_{part}" for name in ("pivot", "tip") for part in parts] + ["M_00", "fnum"]]
    tip = lost(TIP, GONE)
    rows += [[*cells([*PIVOT[k], 1.5, 2, 0.9, *tip[k], 1.5, 2, LIKELY[k], 1.0]), f"{k}"] for k in FRAMES]
    return Sample(table(rows).encode(), {**BOTH, **SPACE, "unit": "mm", "frame_rate": RATE}, data=METRES)


def idtracker() -> Sample:
    tip = lost(image(PLANAR["tip"]), GONE)
    rows = [["seconds", "x1", "y1", "x2", "y2"]]
    rows += [[f"{T[k]:.3f}", *(f"{x:.3f}" for x in (*image(PLANAR["pivot"])[k], *tip[k]))] for k in FRAMES]
    return Sample(table(rows).encode(), {"markers": ["1", "2"], **PIXELS}, data=METRES)


def animalta() -> Sample:
    tip = lost(image(PLANAR["tip"]), GONE)
    rows = [["Frame", "Time", "X_Arena0_Ind0", "Y_Arena0_Ind0", "X_Arena1_Ind0", "Y_Arena1_Ind0"]]
    rows += [[f"{k}", repr(float(T[k])), *cells([*image(PLANAR["pivot"])[k], *tip[k]])] for k in FRAMES]
    arguments = {"markers": ["Arena0_Ind0", "Arena1_Ind0"], "unit": "px", "y_axis": "down", **PIXELS}
    return Sample(table(rows, ";").encode(), arguments, data=METRES)


def matlab73() -> Sample:
    """MATLAB 7.3: HDF5 behind a header of 512 bytes, arrays with their axes turned round."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=512) as file:
        for name, values in (("run/t", T[None]), ("run/xy", METRES.T)):
            file[name] = values
        file["run"].attrs["MATLAB_class"] = np.bytes_(b"struct")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + bytes(384)
    content = head + buffer.getvalue()[512:]
    arguments = {"columns": ["run/xy"], "kind": "markers", "time_unit": "s", "unit": "m", "y_axis": "up"}
    return Sample(content, arguments, data=METRES, suffix=".mat")


def hdf5() -> Sample:
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file["a/stamps"] = T
        for k, name in enumerate(("px", "py", "qx", "qy")):
            file[f"b/{name}"] = METRES[:, k]
        file["b/notes"] = "a swing"
    columns = ["b/px", "b/py", "b/qx", "b/qy"]
    named = {"time": "a/stamps", "columns": columns, "kind": "markers"}
    arguments = {**named, "time_unit": "s", "unit": "m", "y_axis": "up"}
    return Sample(buffer.getvalue(), arguments, data=METRES, suffix=".hdf5")


def plotjuggler() -> Sample:
    """PlotJuggler: two topics by turns, stamps since 1970, the joint a whole turn off."""
    start = 1_700_000_000.0
    rows = [["__time", "/imu/z", "/joint/position"]]
    for k in FRAMES:
        stamp = repr(start + float(T[k]))
        rows += [[stamp, "9.81", ""], [stamp, "", repr(float(ANGLE[k] + 2 * np.pi))]]
    t = start + T
    arguments = {"columns": ["/joint/position"], "kind": "angles", "unit": "rad", "wrapped": True}
    return Sample(table(rows).encode(), arguments, t - t[0], ANGLE[:, None])


SAMPLES: dict[str, Callable[[], Sample]] = {
    make.__name__: make
    for make in (
        motive, motive_frames, vicon, qualisys, trc, c3d, kinovea, kva, trk, tracker_table, deeplabcut, deeplabcut_h5,
        sleap, anipose, idtracker, animalta, matlab73, hdf5, plotjuggler,
    )
}  # fmt: skip
