"""Pages in Chromium, for tests of what a reader sees; whatever goes wrong in a page, or leaves it, is kept."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


@dataclass
class Seen:
    """A page that is open.

    Attributes:
        complaints: of its script and its console.
        requests: for anything but the file itself.
    """

    page: Page
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def view(self, number: int = 0) -> dict[str, Any]:
        """What a chart shows, once all its numbers are there."""
        chart = self.page.locator(".chart canvas").nth(number)
        chart.scroll_into_view_if_needed()
        self.page.wait_for_function(
            "n => { const seen = document.querySelectorAll('.chart canvas')[n].dataset.view;"
            " return seen && !JSON.parse(seen).rough; }",
            arg=number,
        )
        found: dict[str, Any] = json.loads(chart.get_attribute("data-view") or "")
        return found

    def drag(self, start: float, stop: float, number: int = 0) -> None:
        """Zoom a chart from one share of its horizontal axis to another."""
        box = self.page.locator(".chart canvas").nth(number).bounding_box()
        assert box is not None
        left, width = box["x"] + 68, box["width"] - 68 - 22
        up = box["y"] + 60
        self.page.mouse.move(left + start * width, up)
        self.page.mouse.down()
        self.page.mouse.move(left + stop * width, up, steps=3)
        self.page.mouse.up()


@contextmanager
def browsing() -> Iterator[Browser]:
    """The Chromium of this machine."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(
    browser: Browser, file: Path, scheme: Literal["light", "dark"] = "light", script: str = ""
) -> Iterator[Seen]:
    """A file, opened as by a double click; `script` runs before its own."""
    context = browser.new_context(viewport={"width": 1200, "height": 900}, color_scheme=scheme)
    page = context.new_page()
    page.add_init_script(script)
    seen = Seen(page)
    page.on("console", lambda message: seen.complaints.append(message.text))
    page.on("pageerror", lambda error: seen.complaints.append(str(error)))
    page.on("request", lambda request: seen.requests.append(request.url))
    try:
        page.goto(file.as_uri())
        seen.requests.remove(file.as_uri())
        yield seen
    finally:
        context.close()
