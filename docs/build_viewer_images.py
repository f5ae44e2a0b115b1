"""Fly the demo's swap on simulated time and film its page: docs/images/swap.webp, which stands on top of README.md.

make test-browser    (once: it installs the browser's driver, and leaves the picture of the console behind)
.venv/bin/python docs/build_viewer_images.py
"""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "test" / "support"))

from browser import SCREENS, Page, browser  # noqa: E402

from flatsat_ros.cli.demo import main as demo  # noqa: E402

IMAGES = ROOT / "docs" / "images"
SIZE = (1080, 560)  # pixels
FRAMES, PAUSE = 64, 120  # number, ms of each
COLOURS = 64
SWAP = (8.2, 20.8)  # s


def film(page: Page) -> list[Image.Image]:
    """Return the page at times spread over the swap."""
    page.wait(lambda: page.run("return document.body.dataset.ready") == "yes", "the flight in the page")
    # nearer than the view of everything, which leaves room for labels and trails
    page.run("report.view.camera.zoom = 1.5; report.view.camera.updateProjectionMatrix()")
    page.run("document.documentElement.style.overflow = 'hidden'")
    frames = []
    for time in np.linspace(*SWAP, FRAMES):
        page.run(f"report.seek({time:.3f})")
        frames.append(Image.open(io.BytesIO(page.driver.get_screenshot_as_png())).convert("RGB"))
    return frames


def main() -> int:
    """Write the pictures; return 0, or what the demo returned."""
    with tempfile.TemporaryDirectory() as folder:
        code = demo(["--headless", "--output", folder])
        if code != 0:
            return code
        with browser((Path(folder) / "report.html").as_uri(), SIZE) as page:
            frames = film(page)
    target = IMAGES / "swap.webp"
    frames[0].save(target, save_all=True, append_images=frames[1:], duration=PAUSE, loop=0, quality=55, method=6)
    print(f"{target}: {target.stat().st_size / 1e3:.0f} kB")
    console = SCREENS / "console_desktop_light.png"
    if console.exists():
        Image.open(console).convert("P", palette=Image.Palette.ADAPTIVE, colors=COLOURS).save(
            IMAGES / "console.png", optimize=True
        )
        print(f"{IMAGES / 'console.png'}: {(IMAGES / 'console.png').stat().st_size / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
