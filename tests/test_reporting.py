"""Reports: one reading of the narrative for HTML and PDF, safe with any text, the same bytes every time."""

import io
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import pytest
from reporting_demo import CHAPTER, NASTY, built_demo, demo_results, write_demo

from sysid.errors import DataError, ReportError, UsageError
from sysid.reporting import build, numbers
from sysid.reporting import display as show
from sysid.reporting.document import Chapter, assemble, blocks_of
from sysid.reporting.execute import execute
from sysid.reporting.front import front_page, summary
from sysid.reporting.html import html, page
from sysid.reporting.markdown import inline, parse
from sysid.reporting.mathematics import embedded_math_font, math_font_file, mathml
from sysid.reporting.nodes import plain, walk
from sysid.reporting.pdf import pdf
from sysid.reporting.style import COLOURS, LINE_STYLES, MARKERS, series, subplots, svg
from sysid.reporting.typst_math import typst_math

FORMULAE = [
    r"J(\hat a) = \frac1N \left\| \left(I - A[A^\top A]^{-1} A^\top\right) Y \right\|^2",
    r"x = \begin{cases} 1 & u > a \text{ or } |u| \le a, \\ -1 & \text{otherwise} \end{cases}",
    r"\begin{pmatrix} w(1) \\ \vdots \end{pmatrix} = \begin{pmatrix} 0 & \cdots \\ w & 1 \end{pmatrix}",
    r"\begin{pmatrix} a & b \end{pmatrix} \begin{bmatrix} a \\ b \end{bmatrix}",
    r"\begin{aligned} a &= b \\ c &= \frac{d}{2} \end{aligned}",
    r"x = \left\{ \begin{aligned} a &= b \\ c &= d \end{aligned} \right.",
    r"\operatorname{sgn} x + \sin x + \mathrm{E}\, y + \mathbf{E} + \mathcal{N} + \mathbb{R}^l",
    r"\sum_{k=1}^N e_{\hat a}^2(k) + \int_0^1 x\,dx + \prod_i p_i + \lim_{n\to\infty} a_n",
    r"\hat{a} + \bar x + \tilde y + \dot x + \ddot x + \vec v + \widehat{ab} + \overline{xyz}",
    r"\arg\min_{x \in X} f + \underbrace{a+b}_{n} + \overbrace{c}^{2} + \boldsymbol{\theta}",
    r"a' + f''(x) + a_1' + \bigl( x \bigr) + \lVert x \rVert + |u| \mid v \ne w, y; z!",
    r"\binom{n}{k} \sqrt{x} \sqrt[3]{y} \lfloor z \rfloor \lceil w \rceil \langle u, v \rangle",
    r"1 + \dots + n, \quad \alpha\beta\gamma\Sigma\varepsilon\phi \approx \sim \propto \ll \subset",
    r": \% \# \& \_ \{ 1, 2 \} a/b 1.5 \pm \infty \Rightarrow \mapsto \cdot",
    r'\text{quotes " and \# and \_ and \$ \#panic()}',
]


# ------------------------------------------------------------------ numbers


@pytest.mark.parametrize(
    ("value", "std_error", "expected"),
    [
        (-0.8333174600000001, 0.0042, "−0.8333"),
        (0.1 + 0.2, None, "0.3"),
        (1.0, None, "1"),
        (1.0, 0.013, "1.000"),
        (-1e-17, 0.01, "0.000"),
        (12345.678, 250.0, "12350"),
        (1.23456e-9, 1.2e-11, "1.235×10⁻⁹"),
        (float("inf"), None, "∞"),
        (float("nan"), None, "not a number"),
        (True, None, "yes"),
        (None, None, "–"),
        ("text", None, "text"),
        (0.99999, None, "1"),
    ],
)
def test_numbers_show_the_digits_that_mean_something(value, std_error, expected):
    assert numbers.number(value, std_error) == expected


def test_rounded_number_differs_by_less_than_the_error():
    for exponent in range(-6, 6):
        value, error = 1.23456789 * 10**exponent, 0.034 * 10**exponent
        shown = numbers.number(value, error).replace("−", "-")
        mantissa, _, power = shown.partition("×10")
        digits = "".join(str("⁰¹²³⁴⁵⁶⁷⁸⁹".index(c)) if c in "⁰¹²³⁴⁵⁶⁷⁸⁹" else "-" for c in power) or "0"
        assert abs(float(mantissa) * 10.0 ** int(digits) - value) <= 0.05 * error


# ------------------------------------------------------------------ narrative


def test_markdown_is_read_into_nodes():
    blocks = parse("# T $x$\n\nwords $$y \\tag{2.9}$$ more\n\n- a\n- b\n\n| h |\n|--:|\n| $z$ |\n")
    assert [block["t"] for block in blocks] == ["heading", "para", "equation", "para", "list", "table"]
    assert blocks[2] == {"t": "equation", "tex": "y", "tag": "2.9"}
    assert blocks[5]["columns"][0]["align"] == "right"


def test_escaped_dollar_and_raw_html_stay_text():
    content = inline(r"\$5 and \$6 <b>x</b> a_1 `$c$`")
    assert plain(content) == "$5 and $6 <b>x</b> a_1 $c$"
    assert not any(node["t"] == "math" for node in content)


def test_formulae_may_run_over_lines():
    assert [node["t"] for node in inline("a $b +\nc$ d")] == ["text", "math", "text"]
    blocks = parse("words\n$$\na\n= b\n- c \\tag{1}\n$$\nwords\n\n- item\n\n  $$\n  x\n  $$\n\n> $$y$$\n")
    assert [node["t"] for node in blocks] == ["para", "equation", "para", "list", "quote"]
    assert blocks[1] == {"t": "equation", "tex": "a\n= b\n- c", "tag": "1"}
    assert blocks[3]["items"][0][1]["t"] == blocks[4]["c"][0]["t"] == "equation"


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("costs $5 each", "lone dollar sign"),
        ("![x](picture.png)", "display.figure"),
        ("[x](javascript:alert)", "javascript:alert"),
        ("[x](other/file.html)", "results folder"),
        (r"$$a \tag{1} \tag{2}$$", "2 tags"),
    ],
)
def test_narrative_that_no_page_can_hold_is_refused(source, says):
    with pytest.raises(ReportError, match=re.escape(says)):
        parse(source)


# ------------------------------------------------------------------ mathematics


@pytest.mark.parametrize("formula", FORMULAE)
def test_formula_becomes_wellformed_mathml(formula):
    root = ET.fromstring(mathml(formula, display=True))
    assert root.tag == "math"
    assert root.get("display") == "block"


def test_unknown_command_is_an_error_with_the_formula():
    with pytest.raises(ReportError, match=r"unknowncommand.*"):
        mathml(r"\unknowncommand{x}")


def test_formulae_compile_in_typst_with_every_glyph_in_the_font():
    import typst

    lines = [typst_math(mathml(tex, display=display)) for tex in FORMULAE for display in (True, False)]
    rows = [f'#math.equation(eval({json.dumps(line, ensure_ascii=False)}, mode: "math"))' for line in lines]
    source = '#show math.equation: set text(font: "STIX Two Math", fallback: false)\n' + "\n\n".join(rows)
    options = {"font_paths": [str(math_font_file().parent)], "ignore_system_fonts": True, "format": "pdf"}
    content, warnings = typst.compile_with_warnings(source.encode(), **options)
    assert content.startswith(b"%PDF")
    assert [str(warning) for warning in warnings] == []


def test_typst_mathematics_keeps_the_structure():
    assert typst_math(mathml(r"\frac{a}{b}")) == "frac(a,b)"
    assert typst_math(mathml(r"x_1^2")) == "attach(x,b:1,t:2)"
    assert typst_math(mathml(r"a'")) == "a'"
    assert typst_math(mathml(r"\hat a")) == "hat(a)"
    assert typst_math(mathml(r"a, b; (c]")) == r"a\,b\;\(c\]"
    assert typst_math(mathml(r"\operatorname{sgn} u")) == 'op("sgn")u'
    assert typst_math(mathml(r"a + \cdots + b")) == r"a\+⋯\+b"


def test_embedded_font_holds_the_glyphs_and_is_repeatable():
    import base64

    from fontTools.ttLib import TTFont

    elements = [mathml(r"\hat\alpha_h + \sum_k \sqrt{x} \in \mathbb{R}")]
    rule = embedded_math_font(elements)
    assert rule == embedded_math_font(elements)
    font = TTFont(io.BytesIO(base64.b64decode(re.search(r"base64,([^\"]+)", rule)[1])))
    glyphs = font.getBestCmap()
    for char in ("𝛼", "ℎ", "𝑘", "𝑥", "∑", "√", "∈", "ℝ", "+", "="):
        assert ord(char) in glyphs, char
    assert "MATH" in font
    assert len(rule) < 120_000


# ------------------------------------------------------------------ figures


def test_svg_is_repeatable_and_needs_no_font():
    def draw():
        figure, axes = subplots(height=2.0)
        axes.plot([0, 1, 2], [1, 3, 2], label="x")
        axes.set_xlabel(r"$\hat a$")
        return svg(figure)

    assert draw() == draw()
    root = ET.fromstring(draw())
    assert not list(root.iter("{http://www.w3.org/2000/svg}text"))
    assert "date" not in draw().lower()


def test_looks_differ_without_colour():
    looks = [series(number, marker=True) for number in range(len(COLOURS))]
    assert len({(str(look["linestyle"]), look["marker"]) for look in looks}) == len(COLOURS)
    assert len(set(map(str, LINE_STYLES))) == len(set(MARKERS)) == len(COLOURS)


# ------------------------------------------------------------------ displays


def test_table_sets_numbers_right_and_formats_columns():
    node = show.table([["a", 1.23456, None]], ["$x$", "v", "w"], caption="C", formats={"v": ".2f"}).blocks[0]
    assert [column["align"] for column in node["columns"]] == ["left", "right", "left"]
    assert [plain(cell) for cell in node["rows"][0]] == ["a", "1.23", "–"]
    assert node["columns"][0]["c"][0]["t"] == "math"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"rows": [[1, 2]], "columns": ["a"]}, "row 0 has 2 cells"),
        ({"rows": [], "columns": ["a"], "formats": {"b": ".1f"}}, "no column: b"),
        ({"rows": [], "columns": ["a"], "align": "x"}, "align"),
    ],
)
def test_table_refuses_what_does_not_fit(arguments, says):
    with pytest.raises(UsageError, match=re.escape(says)):
        show.table(**arguments)


def test_records_that_do_not_exist_are_named():
    results = demo_results()
    with pytest.raises(ReportError, match="no claim of demo 'x'"):
        show.claim(results, "demo", "x")
    with pytest.raises(ReportError, match="no paper 'x'; there are: demo, plain"):
        show.gates(results, "x")
    with pytest.raises(ReportError, match="no Monte-Carlo case 'x'; there are: preload"):
        show.monte_carlo(results, "demo", "x")


def test_red_gates_come_first_and_empty_bounds_are_dashes():
    rows = show.gates(demo_results(), "demo").blocks[0]["rows"]
    assert [plain(cell) for cell in rows[0]] == [f"slope – {NASTY}"]
    assert [plain(cell) for cell in rows[1][:2]] == ["red_gate", "failed"]
    assert [plain(cell) for cell in rows[-1]] == ["empty", "passed", "–", "–"]
    assert {plain(row[1]) for row in rows[2:] if len(row) > 1} == {"passed"}
    assert sum(len(row) == 1 for row in rows) == 3  # one line for each reason


def test_summary_counts_and_names_the_red_gates():
    results = demo_results()
    assert summary(results) == ("16 of 17 gates passed; red: demo/red_gate.", False)
    results["papers"]["demo"]["gates"] = [g for g in results["papers"]["demo"]["gates"] if g["passed"]]
    assert summary(results) == ("16 gates: all passed.", True)
    assert summary({"papers": {}}) == ("No gates were run.", False)


def test_front_page_sums_up_many_gates_and_lists_the_red_ones():
    results = demo_results()
    del results["papers"]["plain"]
    gate = {"value": 1.0, "lower": 0.0, "upper": 2.0, "type": "relative", "passed": True, "reason": "r"}
    results["papers"]["demo"]["gates"] += [{**gate, "id": f"gain/{number}"} for number in range(30)]
    tables = [node for node in front_page(results, "T") if node["t"] == "table"]
    cells = [[plain(cell) for cell in row] for shown in tables for row in shown["rows"]]
    assert ["red_gate", "failed", "−0.0071", "≤\N{NO-BREAK SPACE}−0.01"] in cells
    assert ["gain", "all 30 passed", "relative"] in cells
    assert ["monte-carlo", "all 12 passed", "Monte-Carlo band"] in cells
    assert ["red_gate", "failed", "slope"] in cells


def test_front_page_of_an_empty_run_renders():
    blocks = blocks_of(assemble("T", front_page({"papers": {}, "provenance": None}, "T"), []))
    assert "No paper was run." in html(blocks)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "cannot read"),
        ("{", "not valid JSON"),
        ("{}", "no object 'papers'"),
        ('{"papers": {}}', "schema None"),
    ],
)
def test_results_that_cannot_be_read_end_in_one_sentence(tmp_path, content, says):
    if content is not None:
        (tmp_path / "results.json").write_text(content)
    with pytest.raises(DataError, match=re.escape(says)):
        build(tmp_path)


# ------------------------------------------------------------------ the whole


class _Page(HTMLParser):
    """What a browser would see: tags with attributes, and the text of the body."""

    def __init__(self, source):
        super().__init__()
        self.tags, self.words = [], []
        self.feed(source)
        self.text = "".join(self.words)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.words.append(data)

    def all(self, name):
        return [attributes for tag, attributes in self.tags if tag == name]


@pytest.fixture(scope="module")
def folder():
    return built_demo()


@pytest.fixture(scope="module")
def seen(folder):
    return _Page((folder / "report.html").read_text(encoding="utf-8"))


def test_page_holds_front_page_chapters_and_results(seen):
    for words in (
        "Replication report",
        "16 of 17 gates passed",
        "Demo (2002) <&>",
        "A paper without a notebook",
        "What was run",
        "20020101",
        "False alarm of one in a million.",
        "0.00123\u00a0±\u00a00.00042",
    ):
        assert words in seen.text, words
    assert seen.text.count("monte-carlo/case-3/bias") == 2  # front page and chapter


def test_text_of_results_is_shown_letter_for_letter(seen):
    assert seen.text.count(NASTY) == 4  # claim twice, claims table, gate reason
    assert "silver<box>.csv" in seen.text
    assert not seen.all("script")
    assert not seen.all("b")


def test_page_loads_nothing(folder, seen):
    source = (folder / "report.html").read_text(encoding="utf-8")
    loaded = [attributes["src"] for _, attributes in seen.tags if "src" in attributes]
    assert loaded
    assert all(value.startswith("data:") for value in loaded)
    assert all(link["href"].startswith("data:") for link in seen.all("link"))
    assert "@import" not in source
    assert re.findall(r"url\(\"?(?!\"?data:)", source) == []
    assert len(source.encode()) < 3_000_000


def test_page_is_accessible(seen):
    assert seen.all("html")[0]["lang"] == "en"
    assert all(image["alt"] for image in seen.all("img"))
    assert {header["scope"] for header in seen.all("th")} == {"col", "row", "rowgroup"}
    identifiers = [attributes["id"] for _, attributes in seen.tags if "id" in attributes]
    assert len(identifiers) == len(set(identifiers))
    targets = {link["href"][1:] for link in seen.all("a") if link["href"].startswith("#")}
    assert targets <= set(identifiers)


def test_every_formula_is_mathml(seen):
    text = seen.text
    for shown_as_it_is in (NASTY, "$5 and $6", "nasty_$id$", "odd_name $x$", "# $not math$"):
        text = text.replace(shown_as_it_is, "")
    assert "$" not in text
    assert len(seen.all("math")) > 25


def test_pdf_holds_the_same_and_no_date(folder):
    content = (folder / "report.pdf").read_bytes()
    assert content.startswith(b"%PDF-")
    assert b"CreationDate" not in content
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext is not installed: the words of the PDF are not checked")
    text = subprocess.run(
        ["pdftotext", "-layout", folder / "report.pdf", "-"],
        check=True,
        capture_output=True,
        encoding="utf-8",
    ).stdout
    for words in (
        "Replication report",
        "16 of 17 gates passed",
        "(2.9)",
        "(3.3)",
        '<script>alert("x")</script>',
        "#typst",
        "red_gate",
        "failed",
        "Figure 1.1.",
        "Table 2.3.",
        "not replicated",
    ):
        assert words in text, words


def test_equal_results_give_equal_bytes():
    results = demo_results()
    blocks = show.gates(results, "demo")._repr_mimebundle_()

    def document():
        from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

        cells = [
            new_markdown_cell("# C\n\n$x^2$", metadata={"place": "cell 1"}),
            new_code_cell(outputs=[new_output("display_data", data=blocks)], metadata={"place": "cell 2"}),
        ]
        return assemble("T", front_page(results, "T"), [Chapter("demo", "D", new_notebook(cells=cells))])

    results["papers"].pop("plain")
    assert pdf(document()) == pdf(document())
    assert page(document()) == page(document())


def _chapter(tmp_path, source):
    write_demo(tmp_path)
    path = tmp_path / "chapter.py"
    path.write_text(source, encoding="utf-8")
    results = demo_results()
    results["papers"] = {"demo": results["papers"]["demo"]}
    (tmp_path / "results.json").write_text(json.dumps(results))
    return {"demo": path}


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("# %% [markdown]\n# # T\n\n# %% [markdown]\n# $\\nosuch x$\n", r"cell 2 of chapter.py: .*\\nosuch"),
        ("# %% [markdown]\n# [x](#nowhere)\n", "cell 1 of chapter.py: the link #nowhere"),
        ("# %%\n1 + 1\n\n# %%\nvalue = 1 / 0\n", "cell 2 of chapter.py .*'value = 1 / 0'.*ZeroDivisionError"),
        (
            "# %%\nfrom IPython.display import SVG\nSVG('<svg xmlns=\"http://www.w3.org/2000/svg\"/>')\n",
            "cell 1 of chapter.py: .*display.figure",
        ),
        ("# %%\nimport os\nos._exit(3)\n", "kernel for chapter.py died"),
    ],
)
def test_a_faulty_chapter_is_an_error_naming_the_cell(tmp_path, source, says):
    with pytest.raises(ReportError, match=says):
        build(tmp_path, ["html"], notebooks=_chapter(tmp_path, source))
    assert not (tmp_path / "report.html").exists()


def test_chapter_runs_in_this_interpreter_without_any_installed_kernel(tmp_path, monkeypatch):
    import sys

    for name in ("JUPYTER_PATH", "JUPYTER_DATA_DIR", "JUPYTER_CONFIG_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path / "empty"))
    source = "# %%\nimport os, sys\nprint(sys.executable, os.getcwd(), os.environ['SYSID_RESULTS'])\n"
    notebook = execute(_chapter(tmp_path, source)["demo"], tmp_path)
    assert notebook.cells[0].outputs[0].text.split() == [sys.executable, str(tmp_path), str(tmp_path)]


def test_unknown_format_and_missing_notebook_are_refused(tmp_path):
    write_demo(tmp_path)
    with pytest.raises(UsageError, match="'docx' is unknown; choose from html, pdf"):
        build(tmp_path, ["docx"])
    with pytest.raises(ReportError, match="cannot read the notebook"):
        build(tmp_path, ["html"], notebooks={"demo": tmp_path / "absent.py"})


def test_only_the_wanted_formats_are_written_and_progress_is_told(tmp_path):
    write_demo(tmp_path)
    steps = []
    written = build(tmp_path, ["pdf"], lambda done, total, what: steps.append((done, total, what)))
    assert list(written) == ["pdf"]
    assert not (tmp_path / "report.html").exists()
    assert steps == [(0, 3, "chapter demo"), (1, 3, "chapter plain"), (2, 3, "report.pdf"), (3, 3, "done")]
    assert build(tmp_path, []) == {}


def test_a_green_run_says_so_in_words(tmp_path):
    results = demo_results()
    results["papers"] = {"plain": results["papers"]["plain"]}
    (tmp_path / "results.json").write_text(json.dumps(results))
    text = build(tmp_path, ["html"])["html"].read_text(encoding="utf-8")
    assert "2 gates: all passed." in text
    assert 'class="failed"' not in text


def test_bai_chapter_is_sound():
    """Every formula and link of the chapter, without running it."""
    from sysid.reporting.execute import read
    from sysid.reporting.html import templates

    notebook = read(templates().parent / "bai.py")
    blocks = blocks_of(assemble("T", [], [Chapter("bai", "Bai", notebook)]))
    tags = {node["tag"] for node in walk(blocks) if node["t"] == "equation"}
    assert {"2.1", "2.9", "3.14"} <= tags


def test_demo_chapter_is_where_the_tests_say():
    assert CHAPTER.is_file()
