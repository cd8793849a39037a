"""Pages of plots as tests read them: their elements, their data, and what they do in a browser."""

import base64
import json
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

BROWSER_SECONDS = 60

_PROBE = """
<script>
const mistakes = [];
addEventListener("error", (event) => mistakes.push(event.message));
addEventListener("securitypolicyviolation", (event) => mistakes.push(event.blockedURI));
</script>
"""


class Page(HTMLParser):
    """The elements of a page, the texts of some of them, and where it would fetch from."""

    VOID = ("meta", "br", "link", "img", "input")

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, str] = {}
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        tag = self.open[-1] if self.open else ""
        self.texts[tag] = self.texts.get(tag, "") + data


def assert_self_contained(page: Page) -> None:
    """Hold that a page is well formed and fetches nothing."""
    assert page.open == []
    assert not [
        (tag, name)
        for tag, attributes in page.tags
        for name in attributes
        if name in ("src", "href", "srcset", "data", "action")
    ]
    policies = [a["content"] for _, a in page.tags if "Content-Security-Policy" in a.values()]
    assert len(policies) == 1
    assert str(policies[0]).startswith("default-src 'none';")
    assert "http" not in str(policies[0])
    assert "@import" not in page.texts["style"]
    assert "url(" not in page.texts["style"]


def data_of(text: str) -> dict[str, Any]:
    """Return what the plots of a page draw."""
    start = text.index('id="data">') + len('id="data">')
    return json.loads(text[start : text.index("</script>", start)])


def unpack(text: str) -> np.ndarray:
    """Return the numbers of a curve."""
    return np.frombuffer(base64.b64decode(text), "<f4")


def browsed(path: Path, act: str, folder: Path) -> dict[str, Any]:
    """Open a page in Chromium, use it, and return what was found; skip where there is none.

    Args:
        path: The page, which is changed.
        act: The body of a script, run when all is drawn, that fills the object `found`; what went
            wrong is found as `mistakes`.
        folder: For the browser's own files.
    """
    chromium = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("needs chromium")
    script = f"""
<pre id="found"></pre>
<script>
drawAll().then(async () => {{
  const found = {{}};
  {act}
  found.mistakes = mistakes;
  document.getElementById("found").textContent = JSON.stringify(found);
}});
</script>
"""
    text = path.read_text(encoding="utf-8").replace("<title>", _PROBE + "<title>", 1)
    path.write_text(text.replace("</body>", script + "</body>"), encoding="utf-8")
    page = subprocess.run(
        [
            *(chromium, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"),
            *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
            *(f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=10000"),
            *("--window-size=1200,2000", "--dump-dom", path.as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=BROWSER_SECONDS,
        check=True,
    ).stdout
    start = page.index('<pre id="found">', page.index("</section>")) + len('<pre id="found">')
    content = page[start : page.index("</pre>", start)]
    return json.loads(content.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
