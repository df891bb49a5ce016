from __future__ import annotations

import pytest

from benchmark.errors import ConfigError
from reports.study.layout import StudyFolder
from reports.study.texts import CONSENT, Block, check_filled_in, read_blocks, read_text


def test_headings_paragraphs_and_lists():
    text = "# One\nfirst\nline\r\n\r\n- a\n  goes on\n- b\nafter\n\n## Two\n\n\n<b>last</b>"
    assert read_blocks(text) == (
        Block("heading", ("One",)),
        Block("paragraph", ("first line",)),
        Block("list", ("a goes on", "b after")),
        Block("heading", ("Two",)),
        Block("paragraph", ("<b>last</b>",)),
    )


def test_what_is_still_to_be_filled_in_is_named_with_its_line(built, study):
    with pytest.raises(ConfigError, match=r"consent.md, line 7: \[NAME AND INSTITUTION\] is still to be filled in"):
        check_filled_in(built)
    check_filled_in(study)


def test_a_text_must_be_there(tmp_path):
    folder = StudyFolder(tmp_path)
    folder.texts.mkdir()
    with pytest.raises(ConfigError, match=r"consent\.md is missing"):
        read_text(folder, CONSENT)
    (folder.texts / CONSENT).write_text(" \n")
    with pytest.raises(ConfigError, match="empty"):
        read_text(folder, CONSENT)
    (folder.texts / CONSENT).write_bytes(b"\xff\xfe1")
    with pytest.raises(ConfigError, match="UTF-8"):
        read_text(folder, CONSENT)
