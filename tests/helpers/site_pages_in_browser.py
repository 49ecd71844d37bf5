"""Faults of the built site: in its files (links, anchors), and in a browser at a width."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from headless_browser import Browser

# Content beyond the width of the window, pictures without pixels, formulas that stayed LaTeX,
# and elements whose content is cut off.
_FAULTS = r"""(() => {
  const wide = document.documentElement.scrollWidth - innerWidth, faults = [];
  if (wide > 0) faults.push(`wider than the window by ${wide} px`);
  for (const image of document.images)
    if (!image.complete || !image.naturalWidth) faults.push(`broken picture ${image.src}`);
  const article = document.querySelector("article");
  if (!article) return faults;
  for (const math of article.querySelectorAll("math"))
    if (!math.getBoundingClientRect().width) faults.push(`empty formula ${math.textContent}`);
  for (const part of article.querySelectorAll("p, td, li, h1, h2, h3, h4, dt")) {
    const style = getComputedStyle(part);
    if (style.display !== "inline" && part.scrollWidth > part.clientWidth + 1 &&
        !part.closest("table, pre, .formula, dt") && !part.querySelector("table, pre, .formula"))
      faults.push(`text is wider than its place: ${part.textContent.slice(0, 60)}`);
  }
  for (const table of article.querySelectorAll("table"))
    if (innerWidth < 500 && table.scrollWidth > table.clientWidth + 1)
      faults.push(`table scrolls: ${table.textContent.trim().slice(0, 60)}`);
  const prose = [...article.querySelectorAll("p, li, td")].map((e) => {
    const copy = e.cloneNode(true);
    copy.querySelectorAll("code, math").forEach((c) => c.remove());
    return copy.textContent;
  }).join("\n");
  const latex = prose.match(/\\(tfrac|frac|dot|xi|mathrm|begin)\b|\$\S+\$|\*\*|\{py:/);
  if (latex) faults.push(`text that is not rendered: ${latex[0]}`);
  return faults;
})()"""


class _Links(HTMLParser):
    """Targets of the links of a page, and the anchors that it has."""

    def __init__(self) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.anchors.update(v for k in ("id", "name") if (v := values.get(k)))
        if tag == "a" and (target := values.get("href")):
            self.targets.append(target)


def broken_links(site: Path) -> list[str]:
    """Return the links between pages of the site whose file or anchor does not exist."""
    pages: dict[Path, _Links] = {}
    for path in site.rglob("*.html"):
        pages[path.resolve()] = links = _Links()
        links.feed(path.read_text("utf-8"))
    broken = []
    for path, links in pages.items():
        for target in links.targets:
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            anchors = pages[file].anchors if file in pages else set()
            lacks_anchor = bool(parts.fragment) and unquote(parts.fragment) not in anchors
            if not file.exists() or (file in pages and lacks_anchor):
                broken.append(f"{path.relative_to(site.resolve())}: {target}")
    return sorted(set(broken))


def faults_in_browser(browser: Browser, page: Path, width: int) -> list[str]:
    """Open a page at a width and return its faults.

    Args:
        browser: Browser.
        page: HTML file.
        width: Width of the window [px].
    """
    browser.open(page.resolve().as_uri(), width=width, height=900)
    browser.run("document.querySelectorAll('[loading]').forEach((e) => e.loading = 'eager')")
    browser.wait_for("[...document.images].every((image) => image.complete)")
    faults = list(browser.run(_FAULTS))
    for event in browser.events:
        values = event["params"]
        if event["method"] == "Network.requestWillBeSent":
            address = values["request"]["url"]
            if urlsplit(address).scheme not in ("file", "data", "blob", "about"):
                faults.append(f"request to {address}")
        elif event["method"] == "Runtime.exceptionThrown":
            faults.append(f"script fails: {values['exceptionDetails']['text']}")
        elif event["method"] == "Log.entryAdded" and values["entry"]["level"] == "error":
            faults.append(f"console: {values['entry']['text']}")
        elif event["method"] == "Network.loadingFailed" and not values.get("canceled"):
            faults.append(f"not loaded: {values['errorText']}")
    return faults
