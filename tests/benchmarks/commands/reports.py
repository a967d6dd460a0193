"""What reports cost: their size, and in Chromium how soon the first curves are seen and a zoom is drawn.

The large report holds 10 signals of 1,000,000 rows, all of them noise: the worst that can be packed. First paint is
what the browser says itself ("first-contentful-paint"), or when curves are drawn where that is later; the least of a
few. What a zoom takes is from asking for it to the frame after it is drawn, with the numbers fetched and inflated for
it; beside it is the processor time that the page spent, which other work on the machine does not change.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter

import numpy as np

from orchestrator.report import Report
from orchestrator.report import figures as drawn
from orchestrator.trace import Trace
from tests.support.tools.browser import Seen, browsing, opened

from ..figure import Figure

ROOT = Path(__file__).parents[3]
SCENARIO = ROOT / "scenarios" / "butterfly" / "sine.yaml"
SIGNALS, ROWS, SPIKES = 10, 1_000_000, 20
LIGHT, LARGE, PAINT, ZOOM = 300e3, 60e6, 1.0, 50.0  # bytes, bytes, s, ms
REPEATS = 3
WATCH = """
    const watch = () => document.querySelector("canvas")?.dataset.view
        ? requestAnimationFrame(() => (window.firstCurves = performance.now())) : setTimeout(watch, 1);
    watch();
"""


def figures() -> list[Figure]:
    """Of a run's report, and of a large one with even stamps and with uneven ones."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        return [*light(folder), *large(folder, True), *large(folder, False)]


def light(folder: Path) -> Iterator[Figure]:
    """The report of a run, without its numbers."""
    command = [sys.executable, "-c", "from identification.cli import main; main()", "run", str(SCENARIO), "-q"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([*command, "--out", str(folder / "run")], check=True, env=environment, stdout=subprocess.DEVNULL)
    html = (folder / "run" / "report.html").read_text(encoding="utf-8")
    numbers = sum(len(piece.split("</script>")[0]) for piece in html.split('<script type="text/plain"')[1:])
    own = len(html) - numbers
    found = f"{own / 1e3:.0f} kB + {numbers / 1e3:.0f} kB of numbers"
    yield Figure(f"report of {SCENARIO.name}", f"under {LIGHT / 1e3:.0f} kB + numbers", found, own < LIGHT, True)


def large(folder: Path, even: bool) -> Iterator[Figure]:
    """Size, making, first paint and zooms of a large report."""
    name = f"{SIGNALS} x {ROWS:,} rows{'' if even else ', uneven stamps'}"
    trace, spikes = noise(even)
    begun = perf_counter()
    page = Report("Large")
    page.section("Curves").figure(drawn.overlay(trace))
    file = page.write(folder / "large.html")
    made, size = perf_counter() - begun, file.stat().st_size
    yield Figure(f"{name}: size", f"at most {LARGE / 1e6:.0f} MB", f"{size / 1e6:.1f} MB", size <= LARGE, True)
    yield Figure(f"{name}: written in", "-", f"{made:.2f} s")
    if not shutil.which("chromium"):
        yield Figure(f"{name}: first paint and zooms", f"under {PAINT:g} s and {ZOOM:g} ms", "chromium is not there")
        return
    with browsing() as browser:
        paints, zooms, firsts, spent = [], [], [], []
        kept = True
        for repeat in range(REPEATS):
            with opened(browser, file, script=WATCH) as seen:
                paints.append(painted(seen))
                clock = processor(seen)
                for number, (signal, row) in enumerate(spikes[repeat::REPEATS]):
                    before = clock()
                    taken, shown = zoomed(seen, trace, row)
                    spent.append(clock() - before)
                    (firsts if number == 0 else zooms).append(taken)
                    kept &= bool(abs(shown[signal][2] - trace[f"signal {signal}"][row]) < 1e-5)
                assert seen.complaints == [], seen.complaints
    paint, zoom = min(paints), float(np.median(zooms))
    yield Figure(f"{name}: first paint with curves", f"under {PAINT:g} s", f"{paint:.2f} s", paint < PAINT)
    worst = f"{zoom:.0f} ms (worst of {len(zooms)}: {max(zooms):.0f} ms; first of a page: {min(firsts):.0f} ms)"
    yield Figure(f"{name}: zoom to 100 samples", f"under {ZOOM:g} ms", worst, zoom < ZOOM)
    yield Figure(f"{name}: its processor time", "-", f"{np.median(spent):.0f} ms (most: {max(spent):.0f} ms)")
    yield Figure(f"{name}: peaks lost of {len(spikes)}", "0", "0" if kept else "some", kept, True)


def noise(even: bool) -> tuple[Trace, list[tuple[int, int]]]:
    """Signals, and where (signal, row) one sample is higher than all around it."""
    rng = np.random.default_rng(1)
    time = np.arange(ROWS) / 1000 if even else np.cumsum(rng.uniform(0.0005, 0.0015, ROWS))
    signals = {f"signal {number}": rng.normal(size=ROWS) for number in range(SIGNALS)}
    spikes = [(int(rng.integers(SIGNALS)), int(rng.integers(200, ROWS - 200))) for _ in range(SPIKES)]
    for number, (signal, row) in enumerate(spikes):
        signals[f"signal {signal}"][row] = 20.0 + number
    return Trace(time, signals), spikes


def painted(seen: Seen) -> float:
    """When curves were drawn for the first time, or the page was painted where that was later [s]."""
    seen.page.wait_for_function("window.firstCurves && performance.getEntriesByName('first-contentful-paint').length")
    found: float = seen.page.evaluate(
        "Math.max(performance.getEntriesByName('first-contentful-paint')[0].startTime, window.firstCurves)"
    )
    return found / 1000


def processor(seen: Seen) -> Callable[[], float]:
    """Processor time that the page has spent so far [ms]."""
    session = seen.page.context.new_cdp_session(seen.page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def spent() -> float:
        metrics = session.send("Performance.getMetrics")["metrics"]
        return 1000 * next(float(one["value"]) for one in metrics if one["name"] == "TaskDuration")

    return spent


def zoomed(seen: Seen, trace: Trace, row: int) -> tuple[float, list[list[float]]]:
    """What it takes to show 100 samples about a row, of all signals [ms]; label, lowest and highest of each."""
    start, stop = (float(trace.time[row + off]) for off in (-50, 50))
    taken, view = seen.page.evaluate(
        """([start, stop]) => new Promise((done) => {
            const canvas = document.querySelector("canvas"), begun = performance.now();
            document.querySelector(".chart").chart.zoom(start, stop);
            const look = () => {
                const view = JSON.parse(canvas.dataset.view);
                if (view.rough) return requestAnimationFrame(look);
                requestAnimationFrame(() => setTimeout(() => done([performance.now() - begun, canvas.dataset.view])));
            };
            look();
        })""",
        [start, stop],
    )
    return taken, [panel[0] for panel in json.loads(view)["panels"]]
