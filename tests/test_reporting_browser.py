"""The HTML report in a real browser with the network cut."""

import shutil

import pytest
from reporting_demo import built_demo

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")

ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
TEXT_COLOURS = """() => {
  const pick = (selector, property) => getComputedStyle(document.querySelector(selector))[property];
  return [["body", "body"], ["a[href^='#']", "body"], [".lead", "body"], [".passed", "body"],
          [".failed", "body"], [".open", "body"], [".quiet", "body"], [".summary", ".summary"],
          ["pre", "pre"]]
    .map(([text, behind]) => [text, pick(text, "color"), pick(behind, "backgroundColor")]);
}"""


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser):
    """Open the report at a width; everything but the file itself is refused."""
    contexts = []

    def opened(width=1280, scheme="light"):
        context = browser.new_context(
            viewport={"width": width, "height": 900}, offline=True, color_scheme=scheme
        )
        contexts.append(context)
        view = context.new_page()
        view.heard, view.asked = [], []
        view.on("console", lambda message: view.heard.append(message.text))
        view.on("pageerror", lambda error: view.heard.append(str(error)))
        view.on("request", lambda request: view.asked.append(request.url))
        context.route(lambda url: not url.startswith(("file:", "data:")), lambda route: route.abort())
        view.goto((built_demo() / "report.html").as_uri())
        return view

    yield opened
    for context in contexts:
        context.close()


def test_page_asks_for_nothing_and_complains_of_nothing(open_page):
    view = open_page()
    assert view.heard == []
    assert [url for url in view.asked if not url.startswith("data:")] == [
        (built_demo() / "report.html").as_uri()
    ]


def test_mathematics_is_laid_out_in_the_embedded_font(open_page):
    view = open_page()
    sizes = view.evaluate("""[...document.querySelectorAll('math')]
        .map(element => element.getBoundingClientRect()).map(box => [box.width, box.height])""")
    assert len(sizes) > 25
    assert all(width > 2 and height > 2 for width, height in sizes)
    above, below = view.evaluate("""() => [...document.querySelector('mfrac').children]
        .map(child => child.getBoundingClientRect()).map(box => (box.top + box.bottom) / 2)""")
    assert above < below - 3, "the numerator stands above the denominator"
    assert view.evaluate("document.fonts.ready.then(() => [...document.fonts].map(f => f.status))") == [
        "loaded"
    ]
    inner, root = view.evaluate("""() => { const root = document.querySelector('msqrt');
        return [root.firstElementChild, root].map(element => element.getBoundingClientRect().width) }""")
    assert root > inner + 4, "the radical sign has a glyph"


@pytest.mark.parametrize("width", [390, 768, 1280])
def test_page_never_scrolls_sideways(open_page, width):
    view = open_page(width)
    assert view.evaluate("document.documentElement.scrollWidth") == width
    outside = view.evaluate(
        """width => [...document.querySelectorAll('main *')]
        .filter(e => !e.closest('.scroll, .equation, pre'))
        .filter(e => e.getBoundingClientRect().right > width + 0.5 || e.getBoundingClientRect().left < -0.5)
        .map(e => e.outerHTML.slice(0, 80))""",
        width,
    )
    assert outside == []


def test_figures_are_drawn_and_links_lead_somewhere(open_page):
    view = open_page()
    drawn = view.evaluate("""[...document.images]
        .map(image => image.complete && image.naturalWidth > 0 && image.height > 50)""")
    assert drawn
    assert all(drawn)
    lost = view.evaluate("""() => [...document.querySelectorAll('a[href^="#"]')]
        .map(link => link.getAttribute('href').slice(1))
        .filter(id => !document.getElementById(id))""")
    assert lost == []


def test_text_of_the_results_runs_no_script(open_page):
    view = open_page()
    assert view.evaluate("document.scripts.length") == 0
    assert '<script>alert("x")</script> #typst' in view.inner_text("main")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_colour_has_contrast(open_page, scheme):
    for name, ink, paper in open_page(scheme=scheme).evaluate(TEXT_COLOURS):
        assert contrast(ink, paper) >= 4.5, (name, ink, paper)  # WCAG 2.2, level AA


def contrast(ink, paper):
    bright, dark = sorted((luminance(ink), luminance(paper)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


def luminance(colour):
    channels = [int(part) / 255 for part in colour[colour.index("(") + 1 : -1].split(",")[:3]]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
