"""Takes the pictures of reports that these pages show: `python docs/pictures.py [NAME...]`.

It is run in the checkout, with the extra `browser` and Chromium. The pictures are kept beside the pages, so that
these can be built without.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

HERE = Path(__file__).parent
SERVOTWIN = [sys.executable, "-c", "from identification.cli import main; main()"]
VIEW = {"width": 1100, "height": 720}


@dataclass(frozen=True)
class Picture:
    """What is to be seen of the report that commands leave in `{out}/result`: from a heading on."""

    commands: tuple[str, ...]
    heading: str


PICTURES = {
    "run": Picture(("run scenarios/butterfly/sine.yaml --out {out}/result",), "Expectations"),
    "calibrate": Picture(
        (
            "run scenarios/butterfly/rig.yaml --out {out}/rig",
            "calibrate scenarios/butterfly/rig_calibration.yaml --data {out}/rig --out {out}/result",
        ),
        "Result",
    ),
    "tune": Picture(("tune scenarios/flexible_arm/control/tuning/pi.yaml --out {out}/result",), "Opened loops"),
    "sweep": Picture(("sweep scenarios/butterfly/sweep.yaml --out {out}/result",), "What figures depend on"),
}


def main() -> None:
    """Take those that are named, or all."""
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport=VIEW)
        for name in sys.argv[1:] or PICTURES:
            with tempfile.TemporaryDirectory() as folder:
                _take(page, PICTURES[name], Path(folder), HERE / "pictures" / f"{name}.png")
        browser.close()


def _take(page: Page, picture: Picture, out: Path, target: Path) -> None:
    for command in picture.commands:
        subprocess.run([*SERVOTWIN, *command.format(out=out).split()], check=True)
    page.goto((out / "result" / "report.html").as_uri())
    page.locator("h2", has_text=picture.heading).first.evaluate("heading => heading.scrollIntoView()")
    page.wait_for_timeout(1000)  # until the charts are drawn
    page.screenshot(path=target)


if __name__ == "__main__":
    main()
