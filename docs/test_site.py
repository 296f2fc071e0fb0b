"""The site as `make docs` leaves it in out/docs.

Nothing is loaded from the network, and the search works from a disk.
"""

import re
import shutil
from pathlib import Path

import pytest

SITE = Path(__file__).parents[1] / "out/docs"
PAGES = sorted(SITE.rglob("*.html"))


def test_every_page_is_built():
    pages = {
        path.relative_to(Path(__file__).parent).with_suffix(".html")
        for path in SITE.parents[1].glob("docs/**/*.md")
    }
    assert pages and pages <= {path.relative_to(SITE) for path in PAGES}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(SITE)))
def test_nothing_is_loaded_from_the_network(page):
    text = page.read_text(encoding="utf-8")
    loaded = re.findall(r"<(?:script|img|iframe|source)[^>]*\ssrc=\"([^\"]*)\"", text)
    loaded += re.findall(
        r"<link[^>]*rel=\"(?:stylesheet|preconnect|icon)\"[^>]*href=\"([^\"]*)\"", text
    )
    assert loaded and not [address for address in loaded if re.match(r"(?:https?:)?//", address)]


def test_the_search_works_from_a_disk():
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("no command chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page, wrong = browser.new_page(), []
        page.on("pageerror", lambda fault: wrong.append(str(fault)))
        page.on("requestfailed", lambda request: wrong.append(request.url))
        page.goto((SITE / "learn/tdcr.html").as_uri())
        page.fill(".md-search__input", "backlash")
        first = page.locator(".md-search-result__item").first
        first.wait_for(state="attached", timeout=20_000)
        assert "backlash" in first.inner_text().lower() and not wrong
        browser.close()
