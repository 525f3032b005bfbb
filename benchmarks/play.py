"""The page of hyperflex play: frame rate, slider latency, cancelling, memory; idle and while a cast is planned.

python benchmarks/play.py                  60 s of frames, a soak of 30 minutes; results in benchmarks/results/
python benchmarks/play.py --seconds 20 --minutes 2   the short form

The server is a separate process, started by the command; the page runs in a headless chromium without a graphics card.
All on one machine.
"""

import argparse
import http.client
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import machine
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from tests.browser import Browser, found

RESULTS = Path(__file__).parent / "results"
LINKS, PAUSE, PIECE, SETTLED = (
    200,
    0.1,
    15.0,
    20.0,
)  # s between moves of the slider, of a measurement, before a soak
PATIENCE = 20.0  # s without a frame, after which the page has stopped
AIM = {"delivered": 55.0, "painted": 20.0, "idle p95": 100.0, "planning p95": 200.0, "cancel": 1.0, "growth": 5.0}
SLIDE = """(async () => {
    const took = [], end = performance.now() + 1000 * %g;
    for (let k = 0; performance.now() < end; k++) {
        const begin = performance.now();
        await play.ask({ set: { t_rest: k %% 2 ? 0.5 : 0.6 } });
        took.push(performance.now() - begin);
        await new Promise((done) => setTimeout(done, 1000 * %g));
    }
    return took;
})()"""


class Measured:
    """The server, and the page in a browser."""

    def __init__(self, folder: str) -> None:
        command = [sys.executable, "-m", "hyperflex", "play", "--no-open", "--json", "--folder", folder]
        self.server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.address = json.loads(self.server.stdout.readline())["address"]
        self.browser = Browser(found() or sys.exit("no chromium was found"))
        self.browser.open(self.address)
        self.wait("window.play && play.scene && play.frames.length")
        self.browser.evaluate(f"play.ask({{ set: {{ links: {LINKS} }} }})")
        self.browser.evaluate("play.ask({ button: 'swing' })")

    def close(self) -> None:
        self.browser.close()
        self.server.terminate()
        self.server.wait()

    def wait(self, what: str) -> None:
        while not self.browser.evaluate(f"Boolean({what})"):
            time.sleep(0.05)

    def memory(self) -> float:
        """Resident memory of the server, MB."""
        status = Path(f"/proc/{self.server.pid}/status").read_text()
        return int(status.partition("VmRSS:")[2].split()[0]) / 1024.0

    def processor(self) -> float:
        """Processor time of the server without planning, s."""
        fields = Path(f"/proc/{self.server.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def plan(self) -> None:
        """Start planning, again if the last search has ended."""
        self.browser.evaluate("play.ask({ set: { time_budget: 120, target_x: -0.83, target_y: -1.07 } })")
        self.browser.evaluate("play.ask({ button: 'plan' })")
        self.wait("play.scene.planning && play.scene.planning.spent > 0")

    def cancel(self) -> float:
        """Cancel; return the time that it took, s."""
        took = "(async () => { const t = performance.now(); await play.ask({ button: 'cancel' }); "
        return float(self.browser.evaluate(took + "return performance.now() - t; })()")) / 1000.0

    def frames(self, seconds: float) -> dict[str, Any]:
        """Count delivered and painted frames, and measure the latency of a slider."""
        before, begin = self.browser.evaluate("[play.counts.frames, play.counts.painted]"), time.monotonic()
        took: list[float] = []
        used = self.processor()
        while (left := seconds - (time.monotonic() - begin)) > 0.5:
            took += self.browser.evaluate(SLIDE % (min(left, PIECE), PAUSE))
        after, spent = self.browser.evaluate("[play.counts.frames, play.counts.painted]"), time.monotonic() - begin
        return {
            "seconds": spent,
            "processor": 1e3 * (self.processor() - used) / (after[0] - before[0]),
            "delivered": (after[0] - before[0]) / spent,
            "painted": (after[1] - before[1]) / spent,
            "answer p50": float(np.percentile(took, 50)),
            "answer p95": float(np.percentile(took, 95)),
            "answers": len(took),
            "load": os.getloadavg()[0],
        }


def ask(place: str, **message: Any) -> float:
    """Send a request; return the time until the answer, s."""
    begin, connection = time.monotonic(), http.client.HTTPConnection(place)
    connection.request("POST", "/do", json.dumps(message))
    connection.getresponse().read()
    return time.monotonic() - begin


def read_frames(place: str, frames: list[float], ended: threading.Event) -> None:
    """Record the arrival times of frames."""
    connection = http.client.HTTPConnection(place)
    connection.request("GET", "/stream")
    with connection.getresponse() as stream:
        while not ended.is_set():
            if stream.readline().startswith(b"event: frame"):
                frames.append(time.monotonic())


def soak(page: Measured, minutes: float) -> dict[str, float]:
    """Move the peg every second from a client without a display; measure memory, frames and latency."""
    place, frames, ended = page.address.removeprefix("http://").rstrip("/"), [time.monotonic()], threading.Event()
    reader = threading.Thread(target=read_frames, args=(place, frames, ended), daemon=True)
    reader.start()
    for button in ("hang", "swing"):
        ask(place, button=button)
    begin, took, first, stops = time.monotonic(), [], 0.0, 0
    while (now := time.monotonic()) < begin + SETTLED + 60.0 * minutes:
        if not first and now > begin + SETTLED:
            first, took = page.memory(), []
            frames[:] = [now]
        took.append(ask(place, set={"target_x": -0.8 - 0.05 * np.random.default_rng(len(took)).random()}))
        time.sleep(max(now + 1.0 - time.monotonic(), 0.0))
        if time.monotonic() > frames[-1] + PATIENCE:  # it was reported that the next frame takes too long
            stops += 1
            for button in ("hang", "swing"):
                ask(place, button=button)
    last = page.memory()
    ended.set()
    return {
        "minutes": minutes,
        "first MB": first,
        "last MB": last,
        "growth %": 100.0 * (last / first - 1.0),
        "delivered": (len(frames) - 1) / (frames[-1] - frames[0]),
        "answer p50": 1e3 * float(np.percentile(took, 50)),
        "answer p95": 1e3 * float(np.percentile(took, 95)),
        "stops": stops,
    }


def measure(seconds: float, minutes: float) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        page = Measured(folder)
        try:
            time.sleep(3.0)  # kernels are loaded
            idle = page.frames(seconds)
            page.plan()
            busy = page.frames(seconds)
            still = bool(page.browser.evaluate("Boolean(play.scene.planning)"))
            cancelled = [page.cancel()] if still else []
            while len(cancelled) < 3:
                page.plan()
                cancelled.append(page.cancel())
            foreign = [each for each in page.browser.requests if not each.split("://")[1].startswith("127.0.0.1:")]
            complaints = list(page.browser.complaints)
            page.browser.call("Page.navigate", url="about:blank")
            soaked = soak(page, minutes)
        finally:
            page.close()
    return {
        "idle": idle,
        "planning": busy,
        "planned throughout": still,
        "cancel s": max(cancelled),
        "soak": soaked,
        "foreign requests": len(foreign),
        "console": len(complaints),
    }


def text(found: dict[str, Any]) -> str:
    rows = ["| | aim | at rest | while planning |", "|---|---|---|---|"]
    idle, busy, long = found["idle"], found["planning"], found["soak"]
    aim = f"{AIM['idle p95']:g}; {AIM['planning p95']:g} while planning"
    for what, wanted, name in (
        (
            "frames delivered, including those due to the slider (less than 10), 1/s",
            f"{AIM['delivered']:g}",
            "delivered",
        ),
        ("frames painted without a graphics card, 1/s", f"{AIM['painted']:g}", "painted"),
        ("slider latency, p50, ms", "", "answer p50"),
        ("slider latency, p95, ms", aim, "answer p95"),
        ("processor time of the server per frame, ms", "", "processor"),
        ("busy threads of all programs", "", "load"),
    ):
        rows.append(f"| {what} | {wanted} | {idle[name]:.1f} | {busy[name]:.1f} |")
    search = "the search ran throughout" if found["planned throughout"] else "the search ended earlier"
    grown = f"{long['first MB']:.0f} to {long['last MB']:.0f} MB, {long['growth %']:+.1f} %"
    answers = f"{long['answer p50']:.1f} ms (p50) and {long['answer p95']:.1f} ms (p95)"
    lines = [
        f"A rope of {LINKS} links swings near a peg and strikes it; {idle['seconds']:.0f} s for each column, {search}.",
        f"Cancelling a search took at most {found['cancel s']:.2f} s in three attempts (aim {AIM['cancel']:g} s).",
        f"Memory of the server in {long['minutes']:g} minutes with a client that moves the peg and has no display:",
        f"{grown} (aim +{AIM['growth']:g} % in 30 minutes). It received {long['delivered']:.1f} frames a second,",
        f"and answers in {answers}; the rope was reset {long['stops']} times because a frame took too long.",
        f"Requests to other hosts: {found['foreign requests']}. Errors in the console: {found['console']}.",
    ]
    return "\n".join(rows) + "\n\n" + "\n".join(lines)


def main() -> None:
    """Measure, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--minutes", type=float, default=30.0)
    given = parser.parse_args()
    about = machine.describe() | {"niceness": str(os.nice(0))}
    measured = measure(given.seconds, given.minutes)
    about["load after"] = machine.load()
    short = given.seconds < 60.0 or given.minutes < 30.0
    words = f"\nThe short form: `--seconds {given.seconds:g} --minutes {given.minutes:g}`.\n" if short else ""
    page = f"# hyperflex play: frames, answers, memory\n\n{text(measured)}\n{words}\n{machine.sentence(about)}\n\n"
    page += "Reproduce: `python benchmarks/play.py`\n"
    sys.stdout.write(page)
    (RESULTS / "play.md").write_text(page, encoding="utf-8")
    content = {"machine": about, **measured}
    (RESULTS / "play.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
