"""A headless Chromium that opens a report, and reads what it shows."""

import shutil
from contextlib import contextmanager

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_PIXEL = """([x, y]) => {
  const shown = document.getElementById("canvas"), copy = document.createElement("canvas");
  [copy.width, copy.height] = [shown.width, shown.height];
  const context = copy.getContext("2d");
  context.drawImage(shown, 0, 0);
  const place = [x * copy.width, y * copy.height].map(Math.floor);
  return [...context.getImageData(...place, 1, 1).data];
}"""


@contextmanager
def chromium():
    """A browser; without one, the test is skipped."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="needs playwright; pip install it"
    )
    path = next(filter(None, map(shutil.which, _NAMES)), None)
    if path is None:
        pytest.skip("needs Chromium; install it (Debian, Ubuntu: apt install chromium)")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


class Page:
    """A report that is open."""

    def __init__(self, browser, file, **settings):
        script = settings.pop("script", "")
        self.page = browser.new_page(**{"viewport": {"width": 1400, "height": 900}, **settings})
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        if script:
            self.page.add_init_script(script)
        self.page.goto(file.as_uri())

    def press(self, *keys):
        """Press keys, and let the picture be drawn."""
        for key in keys:
            self.page.keyboard.press(key)
        self.settle()

    def settle(self):
        """Wait until the picture is drawn with all its values."""
        self.wait("document.getElementById('canvas').dataset.drawn")
        self.page.evaluate(
            "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )

    def pixel(self, x, y):
        """The colour at a place of the view, in parts of its width and height."""
        self.settle()
        return list(self.page.evaluate(_PIXEL, [x, y]))

    def text(self, selector):
        """The text of an element."""
        return str(self.page.text_content(selector))

    def names(self):
        """The names in the table, as it is sorted and filtered."""
        return list(self.page.locator("tbody tr:visible .name").all_text_contents())

    def point(self, x, y):
        """Move the pointer to a place of the view, in parts of its width and height."""
        box = self.page.locator("#canvas").bounding_box()
        self.page.mouse.move(box["x"] + x * box["width"], box["y"] + y * box["height"])

    def wait(self, condition):
        """Wait until a condition holds, in JavaScript; the page itself may evaluate none."""
        for _ in range(1000):
            if self.page.evaluate(condition):
                return
            assert not self.complaints, condition
            self.page.wait_for_timeout(20)
        raise AssertionError(condition)

    def close(self):
        """Close it; there must have been no complaint, and nothing loaded but the file."""
        self.page.close()
        assert self.complaints == []
        assert all(url.startswith(("file:", "data:")) for url in self.requests)
