#!/usr/bin/env python3
"""Write docs/images/dashboard.png: a screenshot of the dashboard for the NAO example, by headless Chromium.

    docs/dashboard.py [--output FILE] [--width 1280] [--height 1000] [--dark] [--seconds 12]
    docs/dashboard.py --serve [--port 8088]

Needs Chromium, tornado and rosbags, and no ROS: a bag of the simulated NAO is played in real time.
With ``--serve``, the dashboard is served to any browser until the bag ends.
"""

import argparse
import os
import sys
import tempfile
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT / folder) for folder in ("src", "test", "examples/nao")]

from browser import Browser  # noqa: E402
from make_bag import make_bag  # noqa: E402

from retalis import BagReader, Playback, record_origins  # noqa: E402
from retalis.dashboard.page_server import Dashboard  # noqa: E402
from retalis.dashboard.view_model import DashboardSource, TopicRow  # noqa: E402

TOPICS = (
    TopicRow("/tf", "tf/tfMessage"),
    TopicRow("/ar_pose_marker", "ar_pose/ARMarkers"),
    TopicRow("/face_recognition/feedback", "face_recognition/FaceRecognitionActionFeedback"),
)


def play_in_real_time(playback, bag):
    """Play a bag in real time."""
    first_stamp, start = None, time.monotonic()
    now = playback.clock.now

    def wait(done):
        nonlocal first_stamp
        first_stamp = now() if first_stamp is None else first_stamp
        time.sleep(max(0.0, (now() - first_stamp) / 1e9 - (time.monotonic() - start)))

    with BagReader(bag) as reader:
        for _ in playback.run(reader, wait):
            pass


def main():
    """Serve the dashboard or write its screenshot."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path, default=HERE / "images" / "dashboard.png")
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--height", type=int, help="default: the height of the page")
    parser.add_argument("--dark", action="store_true")
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--serve", action="store_true")
    parser.add_argument("--port", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "nao.bag"
        make_bag(bag, options.seconds + 10, 1)
        os.chdir(ROOT)  # The dashboard shows the files of rules relative to the working directory.
        playback = Playback("application_source", report=print)
        record_origins(playback.engine)
        dashboard = Dashboard(
            DashboardSource(playback.engine, "/retalis", lambda: TOPICS, allows_queries=True), options.port
        )
        print(dashboard.url, flush=True)
        player = threading.Thread(target=play_in_real_time, args=(playback, bag), daemon=True)
        player.start()
        if options.serve:
            player.join()
        else:
            options.output.write_bytes(screenshot(dashboard.url, options))
        dashboard.close()


def screenshot(url, options):
    """Return the dashboard as PNG, after it has been open for ``options.seconds``."""
    browser = Browser(options.width, options.height or 1000, options.dark)
    try:
        browser.open(url)
        browser.wait_for(f"Number(document.body?.dataset.looks) >= {options.seconds}")
        button = "[...document.querySelectorAll('#events tr')].find(row => row.innerText.includes('face_by_marker('))"
        browser.ask(f"({button} || document).querySelector('button').click()")
        browser.wait_for("document.getElementById('why-text').textContent.length > 3")
        browser.resize(options.width, options.height or browser.height())
        browser.wait_for(f"Number(document.body?.dataset.looks) >= {options.seconds + 2}")
        print(*browser.take_problems(), sep="\n")
        return browser.picture(whole=options.height is None)
    finally:
        browser.close()


if __name__ == "__main__":
    main()
