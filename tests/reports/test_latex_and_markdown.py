"""Names from files stay text in tables of LaTeX and Markdown."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.latex import latex_escape, latex_label
from reports.markdown import markdown_escape


@pytest.mark.parametrize(
    ("text", "latex"),
    [
        (r"\input{/etc/passwd}", r"\textbackslash{}input\{/etc/passwd\}"),
        ("50 % of a_b & c#1 $x$", r"50 \% of a\_b \& c\#1 \$x\$"),
        ("~/a^b", r"\textasciitilde{}/a\textasciicircum{}b"),
        ("a\n\nb\x00\tc", "a b c"),
        ("p < .001, −3 m/s²", r"p \textless{} .001, $-$3 m/s$^2$"),
    ],
)
def test_latex(text, latex):
    assert latex_escape(text) == latex


@given(st.text())
def test_latex_holds_no_open_group_comment_or_command_but_ours(text):
    escaped = latex_escape(text)
    assert escaped.splitlines() in ([], [escaped])
    ours = r"\\text(backslash|asciicircum|asciitilde|less|greater|bar)\{\}|\\[{}&%_#$]|\$(\^[23]|\\cdot|-)\$"
    left = re.sub(ours, "", escaped)
    assert not set(left) & set("\\{}&%_#$^~<>|")


@pytest.mark.parametrize(
    ("text", "markdown"),
    [
        ("holden[large]: p < .001 & a_b", "holden[large]: p < .001 & a_b"),
        ("a|b", r"a\|b"),
        (r"a\|b", r"a\\\|b"),
        ("<img src=x onerror=alert(1)>", "&lt;img src=x onerror=alert(1)>"),
        ("</td> <!-- <?x", "&lt;/td> &lt;!-- &lt;?x"),
        ("&lt;b &#60;b", "&amp;lt;b &amp;#60;b"),
        ("[click](javascript:alert(1))", r"\[click\](javascript:alert(1))"),
        ("a ![x](y) [y]: z", r"a ![x\](y) [y]: z"),
        ("[y]: javascript:alert(1)", r"\[y]: javascript:alert(1)"),
        ("_a_ b_c _", r"\_a\_ b_c \_"),
        ("**bold** `code`", r"\*\*bold\*\* \`code\`"),
        ("a\n# head\r\n| b", r"a # head \| b"),
    ],
)
def test_markdown(text, markdown):
    assert markdown_escape(text) == markdown


@given(st.text())
def test_a_markdown_cell_stays_one_cell(text):
    escaped = markdown_escape(text)
    assert escaped.splitlines() in ([], [escaped])
    left = re.sub(r"\\[\\|`*_~\[\]]", "", escaped)
    assert not set(left) & set("|`*\\") and "](" not in left and not left.startswith("[")


@given(st.text(alphabet="_*~`<>[]()!&;:#ab1 |\\\"'=/"))
def test_a_reader_of_markdown_shows_the_text_that_was_meant(text):
    reader = pytest.importorskip("markdown_it").MarkdownIt("commonmark").enable(["table", "strikethrough"])
    html = reader.renderInline(markdown_escape(f"x{text}"))
    assert "<" not in re.sub(r"&lt;", "", html)


def test_labels_hold_no_sign_of_latex():
    assert latex_label(r"tab:a_b\c{d}-über 1") == "tab:a-b-c-d---ber-1"
